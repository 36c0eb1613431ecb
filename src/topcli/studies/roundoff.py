"""``topcli roundoff``: growth of round-off with plain and compensated sums, and the cost of the latter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated

from topcli.errors import ExitCode, UsageError
from topcli.studies import SILENT, Watch
from topcli.studies.study import ConfigFile, Data, Faults, Flag, Head, Overrides, Result, Study, parts_of
from topcli.table import Column, Table, two_digits


def measure(
    scheme: Annotated[str, Flag("", "SCHEME")],
    config: ConfigFile = None,
    steps: Annotated[float, Flag("--steps", "N")] = 1e7,
    copies: Annotated[int, Flag("--copies", "K")] = 8,
    max_exponent: Annotated[float | None, Flag("--max-exponent", "X")] = None,
    max_drift: Annotated[float | None, Flag("--max-drift", "X")] = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Measure growth of round-off and the cost of compensation.

    Find whether round-off grows as a random walk, with a bias, or not at all, with plain and with compensated sums. The
    tolerances apply to the compensated form if the scheme has one.

    Parameters
    ----------
    scheme : str
        Name of a scheme.
    config : path or str, optional
        Read the experiment from a config; by default, a packaged scene at h = 0.01.
    steps : float, optional
        Take N steps in each copy, e.g. 1e8.
    copies : int, optional
        Follow K copies that differ initially by some ulp.
    max_exponent : float, optional
        Exit with status 4 if an exponent minus two standard errors exceeds X.
    max_drift : float, optional
        Exit with status 4 if a drift exceeds X.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` has a row for each invariant and form of the sums; ``study["violations"]`` lists exceeded tolerances.

    Raises
    ------
    UsageError
        For an unknown or unfit scheme, and for too few steps.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.roundoff("hk", "euler_hk", steps=20_000, copies=2)
    >>> sorted(set(report.table["sums"]))
    ['compensated', 'plain']
    """
    from topcli.studies.roundoff_copies import roundoff_experiment, roundoff_study

    if not 1.0 <= steps <= 1e12 or steps != int(steps):
        raise UsageError(f"--steps {steps:g}: must be a whole number from 1 to 1e12")
    experiment = roundoff_experiment(scheme, config, overrides)
    watch.begin("roundoff", experiment)
    data = roundoff_study(experiment, int(steps), copies)
    return Result({**data, "violations": list(violations_of(data["forms"][-1], max_exponent, max_drift))})


def violations_of(form: Data, max_exponent: float | None, max_drift: float | None) -> Iterator[str]:
    """Violations of the stated tolerances by one form, a line each."""
    for row in form["invariants"]:
        where = f"{row['name']} of {form['scheme']} with {form['form']} sums"
        exponent, error = row["exponent"], row["exponent_error"]
        if max_exponent is not None and exponent is not None and exponent - 2.0 * error > max_exponent:
            yield f"{where}: exponent {exponent:.2f} ± {error:.2f} exceeds {max_exponent:g}"
        if max_drift is not None and row["max_drift"] > max_drift:
            yield f"{where}: drift {row['max_drift']:.1e} exceeds {max_drift:g}"


def _table_rows(data: Data) -> list[Data]:
    """Invariants of all forms of the sums, those of the same invariant together."""
    symbols = [row["symbol"] for row in data["forms"][0]["invariants"]]
    rows = [{**form, **row} for form in data["forms"] for row in form["invariants"]]
    return sorted(rows, key=lambda row: symbols.index(row["symbol"]))


def _subject(data: Data) -> str:
    scene = f"{data['forms'][0]['scheme']} on {data['config']['name']}: {data['top']}"
    return f"{scene}, h = {data['h']:g}, {data['steps']} steps, {data['copies']} copies"


def _with_error(key: str, show: Callable[[float], str]) -> Callable[[Data], str | None]:
    """Text of a figure with its standard error."""

    def text(row: Data) -> str | None:
        return None if row[key] is None else f"{show(row[key])} ± {show(row[f'{key}_error'])}"

    return text


TABLE = Table(
    _table_rows,
    (
        Column("invariant", "symbol", key="invariant"),
        Column("sums", "form", key="sums"),
        Column("drift (rms)", "drift", two_digits),
        Column("largest", "max_drift", two_digits),
        Column("exponent", _with_error("exponent", "{:.2f}".format)),
        *(Column("", key) for key in ("exponent", "exponent_error")),
        Column("growth", "verdict"),
        Column("bias per step", _with_error("bias", two_digits)),
        *(Column("", key) for key in ("bias", "bias_error")),
        Column("ns/step", "nanoseconds_per_step", "{:.1f}".format),
        Column("cost", "cost", "{:.2f}".format),
    ),
    heading="Growth of round-off",
    title=_subject,
    index="invariant",
    keys=2,
    numbers=(2, 3, 4, 6, 7, 8),
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    code, lines = faults(data)
    state = {0: "measured", 1: "failed", 4: "tolerance exceeded"}[code]
    return Head("Growth of round-off", _subject(data), state, not lines)


def notes(data: Data) -> Iterator[str]:
    """Meaning of the drifts of a scheme without an exact invariant."""
    if not data["claimed"]:
        yield (
            f"{data['forms'][0]['scheme']} claims no invariant exactly; the drifts are of means over long windows, "
            "relative to the motion common to all copies"
        )


def faults(data: Data) -> Faults:
    """Forms that did not complete, and tolerances exceeded."""
    failed = [form for form in data["forms"] if form["outcome"] != "completed"]
    lines = [f"{form['scheme']} with {form['form']} sums: {form['message']}" for form in failed]
    code = ExitCode.FAILED if failed else ExitCode.VIOLATED if data["violations"] else ExitCode.SUCCESS
    return Faults(code, [*lines, *data["violations"]])


ROUNDOFF = Study(
    "roundoff",
    measure,
    head,
    (TABLE,),
    notes=notes,
    faults=faults,
    figure="topcli.figures.growth:loaded_roundoff",
    draws="the drift against the number of steps",
    captions=("drift of the invariants against the number of steps",),
    stem=lambda data: f"{data['forms'][0]['scheme']}_{data['config']['name']}",
    parts=lambda data: parts_of(data["config"], [data["forms"][0]["scheme"]]),
)
