"""``topcli compare``: compare schemes, options and step sizes on one experiment."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from topcli.errors import ExitCode, UnknownNameError, UsageError, counted, quoted
from topcli.studies import SILENT, Watch
from topcli.studies.study import PYTHON_ONLY, Data, Faults, Flag, Head, Overrides, Result, Study, cited_parts, top_title
from topcli.table import Column, Table, number

PAPER_SCENE = "kowalevski_hk"


def measure(
    *entries: Annotated[str, Flag("", "SCHEME[:KEY=VALUE,...]", required=True)],
    config: Annotated[str | Path | Mapping[str, Any], Flag("--config", "CONFIG")] = PAPER_SCENE,
    overrides: Overrides = (),
    options: Annotated[Mapping[str, Any] | None, PYTHON_ONLY] = None,
    reference: Annotated[str, Flag("--reference", "KIND")] = "taylor",
    watch: Watch = SILENT,
    **changes: Any,
) -> Result:
    """Compare errors, drifts, reversibility and speed of schemes.

    A scheme may have its own step size and options, as in hk:h=0.01 or hybrid:branch=sign. Runs with different steps
    cover the same time span and are compared at common times. A sweep (topcli sweep) compares schemes on many
    trajectories.

    Parameters
    ----------
    *entries : str
        Names of schemes, each with its own h and options if needed. Examples are ``"hk"``, ``"hk:h=0.02"`` and
        ``"hybrid:branch=sign"``.
    config : path, str or mapping, optional
        Read the experiment from a config or scene. In Python, ``config`` may also be the content of a config, as a
        mapping.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign. An option of schemes, such as
        ``scheme.branch``, is set for every scheme that has it. Overrides are applied after ``changes``.
    options : mapping, optional
        Options of schemes by name, such as ``{"branch": "sign"}``. Each option is set for every scheme that has it.
    reference : {"taylor", "exact"}, optional
        Measure errors against taylor (a Taylor series) or exact (the exact solution). The Taylor series is computed in
        double-double arithmetic (32 digits), the exact solution from a closed form.
    watch : Watch, optional
        Observer of the study.
    **changes
        Values that replace whole top-level keys of the config, such as ``h=0.01``.

    Returns
    -------
    StudyReport
        Report on all schemes in ``entries``. An error is the Euclidean norm of the difference between a state and the
        reference state. ``figures`` is a dict of all measured data; its item ``"reference"`` describes the reference.
        ``series`` is a DataFrame with the compared times and, for each entry, the columns ``error:<entry>`` and
        ``swing:<entry>``. ``swing:<entry>`` contains the component that shows the swings of the top, such as gamma1;
        ``plot(what="swing")`` draws this component instead of the errors.

    Raises
    ------
    ConfigError
        If the config is invalid or describes an ensemble.
    UsageError
        If a scheme or an option is unknown, if the runs have no common times because of their step sizes, or if
        ``reference="exact"`` is given for a top without a closed form.

    Examples
    --------
    >>> import topcli
    >>> report = topcli.compare("hk", "hk:h=0.02", "rk4", config="kowalevski_generic_hk", h=0.01, T=5)
    >>> report
    <StudyReport of kowalevski_generic_hk: completed>
    >>> fine, coarse = report.table["max_error"][["hk", "hk:h=0.02"]]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> axes = report.plot()
    >>> axes.get_yscale()
    'log'
    """
    from topcli.config.files import is_config
    from topcli.config.load import load_experiment
    from topcli.studies.compare_runs import compare_schemes
    from topcli.studies.entries import scheme_options

    if not entries:
        raise UsageError("compare: name at least one scheme, as in topcli.compare('hk', 'hybrid')")
    own, others = scheme_options(overrides)
    options = {**(options or {}), **own}
    experiment = load_experiment(config, others, changes, any_precision=True)
    try:
        watch.begin(experiment.name, experiment)
        return compare_schemes(experiment, entries, options, reference)
    except UnknownNameError as error:
        for entry in entries:
            if quoted(entry) in str(error) and is_config(entry):
                command = f"topcli compare hk hybrid --config {entry}"
                hint = f"{quoted(entry)} is a config, not a scheme; to compare schemes on it: {command}"
                raise UsageError(hint) from error
        raise


def _label(scheme: Data) -> str:
    """Label of an entry, with the options other than the defaults that it does not name."""
    changed = [f"{key}={value}" for key, value in scheme["changed"].items() if key not in scheme["own"]]
    return scheme["label"] + (f" ({', '.join(changed)})" if changed else "")


def _same_step(data: Data) -> bool:
    return len({scheme["h"] for scheme in data["schemes"]}) == 1


def _title(data: Data) -> str:
    """Experiment, top, and steps, or the time if the steps differ."""
    config, first = data["config"], data["schemes"][0]
    steps = f"h = {first['h']:g}, N = {first['N']}" if _same_step(data) else f"t from 0 to {first['N'] * first['h']:g}"
    title = f"{config['name']}: {top_title(config)}, {steps}"
    return f"{title}, precision {config['precision']}" if "precision" in config else title


def _columns(data: Data) -> list[Column]:
    """Figures of each entry: its settings, and what was measured."""
    sizes = (Column("h", "h", "{:g}".format), Column("N", "N"))
    plain = [Column("", name) for name in ("h", "N")] if _same_step(data) else list(sizes)
    return [Column("", "label", key="entry"), Column("", "scheme"), *plain, *_measured_columns(data)]


def _reversal_label(data: Data) -> str:
    return "reversal defect" + (f" at h = {abs(data['schemes'][0]['h']):g}" if _same_step(data) else "")


def _swing_label(data: Data) -> str:
    return f"first swing spacing of {data['reference']['swing']}"


def _shown(name: str) -> Callable[[float | None], str]:
    """Function that writes values of a measure; times between swings have more digits."""
    return partial(number, digits=6 if name.endswith("spacing") else 3)


def _order_of(data: Data) -> Callable[[Data], str | None]:
    """Function of an entry that writes the order of its reversal defect."""
    from topcli.engine.numbers import RATIONAL

    return partial(_order, rational=data["config"].get("precision") == RATIONAL)


def _order(scheme: Data, rational: bool) -> str | None:
    """Order of the reversal defect, or its cause where it has none."""
    defect, found = scheme["reversal_defect"], scheme["reversal_order"]
    if found is not None or defect is None:
        return None if found is None else f"{found:.2f}"
    return "exact" if rational and defect == 0.0 else "round-off"


def _measured_columns(data: Data) -> list[Column]:
    schemes = data["schemes"]
    closed = ", of a closed form per state" if any(scheme["closed_form"] for scheme in schemes) else ""
    return [
        Column("outcome", "outcome"),
        Column("", "message"),
        Column("max error", "max_error", number),
        Column("final error", "final_error", number),
        *_invariant_columns(schemes),
        *_modified_columns(schemes),
        Column(_reversal_label(data), "reversal_defect", number),
        Column("order of the reversal defect", _order_of(data)),
        Column("", "reversal_order"),
        Column(_swing_label(data), "first_swing_spacing", "{:.4f}".format),
        Column(f"ns per step{closed}", "nanoseconds_per_step", "{:.1f}".format),
        Column("compile or load, s", "compile_seconds", "{:.3f}".format, ""),
    ]


def _invariant_columns(schemes: Sequence[Data]) -> Iterator[Column]:
    """Figures of the report that comparisons show, of each invariant of the top."""
    from topcli.runs.report import REPORT_COLUMNS

    for i, invariant in enumerate(schemes[0]["invariants"]):
        for figure in REPORT_COLUMNS:
            if figure.compared:
                head, key = figure.compared_head(invariant["symbol"]), f"{figure.of}.{invariant['name']}"
                yield Column(head, f"invariants.{i}.{figure.of}", figure.show, key)


def _modified_columns(schemes: Sequence[Data]) -> Iterator[Column]:
    """Figures of the integrals of the schemes themselves; a dash if a scheme has no such integral."""

    def correction(term: Data) -> str:
        power = {1: "h", 2: "h²"}.get(term["power"], f"h^{term['power']}")
        return f"{number(term['size'])} = {term['coefficient']:.3g} {power}"

    for name, known in {row["name"]: row for scheme in schemes for row in scheme["modified"]}.items():

        def of(scheme: Data, key: str, name: str = name) -> Any:
            return next((row[key] for row in scheme["modified"] if row["name"] == name), None)

        yield Column(
            f"max deviation of {known['symbol']}", partial(of, key="max_deviation"), number, f"max_deviation.{name}"
        )
        yield from (Column("", partial(of, key=key), key=f"{key}.{name}") for key in ("drift", "drift_error"))
        yield Column(f"verdict of {known['symbol']}", partial(of, key="verdict"), key=f"verdict.{name}")
        if "correction" in known:
            yield Column(
                f"{known['symbol']} less {known['correction']['of']}, at most",
                partial(of, key="correction"),
                correction,
            )


def _reference_note(data: Data) -> str:
    reference = data["reference"]
    spacing = reference.get("first_swing_spacing")
    own = "" if spacing is None else f" The {_swing_label(data)} in the reference is {spacing:.4f}."
    return f"Errors are norms of the difference of states from the reference, a {reference['method']}.{own}"


TABLE = Table(
    "schemes",
    _columns,
    heading="Comparison",
    title=_title,
    caption=_reference_note,
    index="entry",
    across=Column("", _label),
)


def _brief_columns(data: Data) -> list[Column]:
    """Errors, reversal and swings, and the outcomes unless all runs completed."""
    labels = {name: name.replace("_", " ") for name in ("max_error", "final_error", "reversal_defect")}
    labels["first_swing_spacing"] = _swing_label(data)
    columns = [Column(" ", _label)]
    if not all(map(_completed, data["schemes"])):
        columns.append(Column("outcome", "outcome"))
    for name, head in labels.items():
        if any(scheme[name] is not None for scheme in data["schemes"]):
            columns.append(Column(head, name, _shown(name)))
        if name == "reversal_defect":
            columns.append(Column("its order in h", _order_of(data)))
    return columns


def _drift(scheme: Data, i: int) -> str | None:
    """Drift of an invariant, significant or bounded; otherwise the verdict."""
    from topcli.runs.report import drift_text

    row = scheme["invariants"][i]
    return drift_text(row, short=True) if row["verdict"] in ("drifting", "no drift seen") else row["verdict"]


def _deviation(scheme: Data, i: int) -> str | None:
    from topcli.runs.report import deviation_text

    return deviation_text(scheme["invariants"][i])


def _of_invariants(text: Callable[..., str | None]) -> Callable[[Data], list[Column]]:
    """Columns for a figure of each invariant of the top."""

    def columns(data: Data) -> list[Column]:
        rows = enumerate(data["schemes"][0]["invariants"])
        return [Column(" ", _label), *(Column(row["symbol"], partial(text, i=i)) for i, row in rows)]

    return columns


BRIEF = (
    Table("schemes", _brief_columns, title=_title, caption=_reference_note),
    Table(
        "schemes",
        _of_invariants(_deviation),
        title=lambda data: "max deviation, relative to the first value",
    ),
    Table(
        "schemes",
        _of_invariants(_drift),
        title=lambda data: "drift per unit time, with 95 % bounds, or the verdict",
    ),
)
"""Tables of a terminal without ``--verbose``: a line for each entry."""


def printed(result: Result, verbose: bool) -> Iterator[Table | str]:
    """Tables on a terminal: all figures with a column for each entry, or a few with a line for each."""
    if verbose:
        yield TABLE
        return
    from topcli.runs.report import open_lines

    yield from BRIEF
    yield from open_lines([(_label(scheme), row) for scheme in result.data["schemes"] for row in scheme["invariants"]])
    timed = [scheme for scheme in result.data["schemes"] if scheme["nanoseconds_per_step"] is not None]
    if timed:
        speeds = (f"{_label(scheme)} {scheme['nanoseconds_per_step']:.1f}" for scheme in timed)
        yield f"ns per step: {', '.join(speeds)}"
    yield "-v prints all values"


def _completed(scheme: Data) -> bool:
    """True if an entry completed."""
    return scheme["outcome"] == "completed"


def head(data: Data) -> Head:
    """Head of the chapter."""
    title, _, subtitle = _title(data).partition(": ")
    lines = faults(data).lines
    return Head(title, subtitle, f"{len(lines)} failed" if lines else "completed", not lines, "; ".join(lines))


def notes(data: Data) -> Iterator[str]:
    """Warning about few rows."""
    if data.get("few_rows"):
        yield (
            f"warning: the errors are compared at {counted(data['rows'], 'time')}, which all step sizes share; "
            "step sizes with a simple ratio, such as 2 or 5, share more"
        )


def faults(data: Data) -> Faults:
    """Entries that did not complete, and those whose code failed."""
    failed = data.get("failed", [])
    bad = [scheme for scheme in data["schemes"] if not _completed(scheme)]
    lines = [f"{row['label']}: {row['message']}" for row in bad]
    lines += [f"{row['label']}: {row['reason']}" for row in failed]
    if failed:
        return Faults(ExitCode.PARTLY_FAILED, lines)
    return Faults(ExitCode.FAILED if bad else ExitCode.SUCCESS, lines)


def _frame_of_series(result: Result) -> Any:
    import pandas as pd

    return pd.DataFrame(dict(result.arrays))


COMPARE = Study(
    "compare",
    measure,
    head,
    (TABLE,),
    printed=printed,
    notes=notes,
    faults=faults,
    figure="topcli.figures.comparison:loaded_comparison",
    plotted="topcli.figures.comparison:comparison_curves",
    draws="the errors and one component of the state over time",
    captions=lambda data: ("error of the state over time t", f"{data['reference']['swing']} over time t"),
    stem=lambda data: str(data["config"]["name"]),
    parts=cited_parts,
    extras={
        "figures": lambda result: result.data,
        "arrays": lambda result: result.arrays,
        "series": _frame_of_series,
    },
)
