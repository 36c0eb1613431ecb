"""``topcli roundoff``: measure how round-off grows with plain and compensated sums, and what compensation costs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

from topcli.errors import ExitCode, UsageError, counted, shortened
from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Faults, Flag, Head, Overrides, Result, Study, config_flag, parts_of, steps_flag
from topcli.table import Column, Table, two_digits


def measure(
    scheme: Annotated[str, Flag("", "SCHEME")],
    config: Annotated[str | Path | None, config_flag("a packaged scene at h = 0.01")] = None,
    overrides: Overrides = (),
    *,
    steps: Annotated[float, steps_flag("1e7")] = 1e7,
    copies: Annotated[int, Flag("--copies", "K")] = 8,
    max_exponent: Annotated[float | None, Flag("--max-exponent", "X")] = None,
    max_drift: Annotated[float | None, Flag("--max-drift", "X")] = None,
    watch: Watch = SILENT,
) -> Result:
    """Measure growth of round-off, and cost of compensated sums.

    Round-off may grow as a random walk, linearly because of a bias, or not at all. If the scheme has a form with
    compensated summation, both forms are measured. Limits on exponents and drifts then apply to the compensated form.

    Parameters
    ----------
    scheme : str
        Name of a scheme.
    config : path or str, optional
        Config of the experiment; by default, a packaged scene at h = 0.01.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    steps : float, optional
        Number of steps of each run, e.g. 1e8.
    copies : int, optional
        Run the experiment this many times, from initial states that differ by up to 1e-14 of their values.
    max_exponent : float, optional
        Report a violation (exit code 4) if the confidence interval (95 %) of a growth exponent is above this value.
        Round-off grows as the number of steps to the power of the growth exponent: 1/2 for a random walk, 1 for a bias.
    max_drift : float, optional
        Report a violation (exit code 4) if round-off changes an invariant by more than this value in any of the runs.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on round-off. ``table`` has a row for each invariant with plain sums, and another with compensated sums.
        ``study["violations"]`` lists the invariants that exceed ``max_exponent`` or ``max_drift``.

    Raises
    ------
    UsageError
        If the scheme is unknown or does not fit the config, or if the number of steps is too small.

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
    for text in overrides:
        if text.partition("=")[0].strip() in ("N", "T"):
            raise UsageError(f"--set {shortened(text)}: the number of steps is set by --steps")
    experiment = roundoff_experiment(scheme, config, overrides)
    watch.begin("roundoff", experiment)
    data = roundoff_study(experiment, int(steps), copies)
    return Result({**data, "violations": list(violations_of(data["forms"][-1], max_exponent, max_drift))})


def violations_of(form: Data, max_exponent: float | None, max_drift: float | None) -> Iterator[str]:
    """Violations of the stated tolerances by one form, a line each."""
    for row in form["invariants"]:
        where = f"{row['name']} of {form['scheme']} with {form['form']} sums"
        exponent, error = row["exponent"], row["exponent_error"]
        if max_exponent is not None and exponent is not None and exponent - error > max_exponent:
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
    return f"{scene}, h = {data['h']:g}, {counted(data['steps'], 'step')}, {counted(data['copies'], 'copy')}"


def _with_error(key: str, show: Callable[[float], str]) -> Callable[[Data], str | None]:
    """Text of a figure with half the width of its confidence interval."""

    def text(row: Data) -> str | None:
        return None if row[key] is None else f"{show(row[key])} ± {show(row[f'{key}_error'])}"

    return text


TABLE = Table(
    _table_rows,
    (
        Column("invariant", "symbol", key="invariant"),
        Column("sums", "form", key="sums"),
        Column("drift (rms)", "drift", two_digits),
        Column("largest", "max_drift", two_digits, detail=True),
        Column("exponent", _with_error("exponent", "{:.2f}".format)),
        *(Column("", key) for key in ("exponent", "exponent_error")),
        Column("growth", "verdict"),
        Column("bias per step", _with_error("bias", two_digits), detail=True),
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


def answer(data: Data) -> str:
    """Growth of round-off with each form of the sums; gain and cost of the compensated form."""
    parts = []
    for form in data["forms"]:
        named: dict[str, list[str]] = {}
        for row in form["invariants"]:
            named.setdefault(row["verdict"] or "unknown", []).append(row["symbol"])
        growth = ", ".join(f"{verdict} ({', '.join(names)})" for verdict, names in named.items())
        parts.append(f"{form['form']} sums: {growth}")
    plain, *others = data["forms"]
    for form in others:
        pairs = zip(plain["invariants"], form["invariants"], strict=True)
        gains = sorted(a["drift"] / b["drift"] for a, b in pairs if a["drift"] and b["drift"])
        if gains and form["cost"] is not None:
            parts[-1] += f", drifts {two_digits(gains[0])} to {two_digits(gains[-1])} times smaller"
            parts[-1] += f" at {form['cost']:.2f} times the cost"
    return "; ".join(parts)


def notes(data: Data) -> Iterator[str]:
    """Meaning of the drifts of a scheme without an exact invariant."""
    if not data["claimed"]:
        yield (
            f"{data['forms'][0]['scheme']} declares no exact invariant; the drifts are of means over long windows, "
            "relative to the change that all copies have in common"
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
    answer=answer,
    notes=notes,
    faults=faults,
    figure="topcli.figures.growth:loaded_roundoff",
    draws="the largest change of each invariant by round-off against the number of steps",
    captions=("drift of the invariants over the number of steps",),
    stem=lambda data: f"{data['forms'][0]['scheme']}_{data['config']['name']}",
    parts=lambda data: parts_of(data["config"], [data["forms"][0]["scheme"]]),
)
