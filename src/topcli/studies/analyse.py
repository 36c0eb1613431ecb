"""``topcli analyse``: analyse a time series of another program like a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Flag, Head, Overrides, Result, Study, parts_of, steps_flag
from topcli.table import DASH, Column, Table, number, ten_digits

SHOWN_TIMES = 5
"""Times of swings in the table; --json has them all."""


def measure(
    path: Annotated[str | Path, Flag("", "FILE")],
    config: Annotated[str | Path | Mapping[str, Any], Flag("--config", "CONFIG")],
    overrides: Overrides = (),
    *,
    columns: Annotated[Sequence[str], Flag("--rename", "NAME=COLUMN,...")] = (),
    steps: Annotated[int | None, steps_flag("rows - 1, or from the column n")] = None,
    watch: Watch = SILENT,
) -> Result:
    """Analyse a time series that another program computed.

    The report on the series has the same form as the report of a run. The times may start anywhere, increase or
    decrease, and have uneven spacing. The reference solution starts from the initial state of the config if the first
    row agrees with this state to 1e-6, and otherwise from the first row.

    Parameters
    ----------
    path : path or str
        CSV or Parquet file with the time t and the components of the state as columns.
    config : path, str or mapping
        Config that gives the top and the initial state.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    columns : sequence of str, optional
        Read t or a component from a column of another name, e.g. t=time.
    steps : int, optional
        Number of steps that the program took, for the bound of round-off. By default, it is the difference between the
        last and the first step number in a column n or, without this column, the number of rows minus 1.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        Report on the series. ``table`` contains the deviations and drifts of the invariants. ``summary`` gives the
        numbers of rows and steps, the errors against the reference solution, and the times of the swings (falls and
        rises of the top).

    Raises
    ------
    UsageError
        If the file is not a series of this top. The message names the row and the column.
    """
    from topcli.config.load import load_experiment
    from topcli.store.foreign import ForeignSeries
    from topcli.studies.analyse_series import analyse_series, column_map

    experiment = load_experiment(config, overrides, any_precision=isinstance(config, Mapping))
    watch.begin("analyse", experiment)
    return analyse_series(experiment, ForeignSeries(Path(path)), column_map(columns, experiment.top), steps)


def _summary_columns(data: Data) -> list[Column]:
    swing = data["swing"]

    def span(data: Data) -> str:
        return f"{ten_digits(data['t_first'])} to {ten_digits(data['t_last'])}, {data['times']}"

    def start(data: Data) -> str:
        known = {"config": "the config's initial state", "first row": "the first row"}[data["reference"]["start"]]
        return "none" if data["reference"]["message"] else known

    def minima(times: Sequence[float]) -> str:
        listed = ", ".join(map(ten_digits, times[:SHOWN_TIMES])) or DASH
        return listed + (f" and {len(times) - SHOWN_TIMES} more" if len(times) > SHOWN_TIMES else "")

    def spacing(data: Data) -> str:
        reference = swing["reference_first_swing_spacing"]
        return ten_digits(swing["first_swing_spacing"]) + (
            "" if reference is None else f" (reference {ten_digits(reference)})"
        )

    return [
        Column("rows", "rows"),
        Column("times", span),
        *(Column("", key) for key in ("t_first", "t_last", "times")),
        Column("steps", lambda data: f"{data['steps']} ({data['steps_from']})"),
        *(Column("", key) for key in ("steps", "steps_from")),
        Column("reference from", start),
        Column("first row − config", "reference.difference", number, "difference"),
        Column("max error", "max_error", number),
        Column("final error", "final_error", number),
        Column(f"minima of {swing['component']}", "swing.times", minima, ""),
        Column("their first spacing", spacing),
        *(Column("", f"swing.{key}", key=key) for key in ("first_swing_spacing", "reference_first_swing_spacing")),
    ]


SUMMARY = Table(
    lambda data: [data],
    _summary_columns,
    name="summary",
    heading="Series",
    title=lambda data: f"{data['file']}: {data['top_title']}",
    across=Column("", "file"),
    ruled=False,
    numbers=False,
)


def head(data: Data) -> Head:
    """Head of the chapter."""
    left = data["left_motion"]
    return Head(str(data["file"]), data["top_title"], "left its motion" if left else "judged", not left)


def notes(data: Data) -> Iterator[str]:
    """Facts that the tables leave out: a missing reference, a motion that was left, components that were not read."""
    if data["reference"]["message"]:
        yield f"warning: no error: {data['reference']['message']}"
    if left := data["left_motion"]:
        where = f"row {left['row']} (t = {left['t']:.6g})"
        yield f"warning: {data['file']}: far off its energy surface at {where}"
    if data["unread"]:
        yield f"not read: {', '.join(data['unread'])}; the config's initial state has no such components"


def _tables(data: Data) -> tuple[Table, Table]:
    from topcli.runs.report import INVARIANTS

    return SUMMARY, INVARIANTS


def _captions(data: Data) -> list[str]:
    swing = f"{data['swing']['component']} over time t"
    return ["error of the state over time t", swing, "deviations of the invariants over time t"]


ANALYSE = Study(
    "analyse",
    measure,
    head,
    _tables,
    notes=notes,
    figure="topcli.figures.comparison:loaded_analysis",
    draws="the errors, one component of the state, and the deviations of the invariants over time",
    captions=_captions,
    stem=lambda data: f"{data['config']['name']}_{Path(data['file']).stem}",
    parts=lambda data: parts_of(data["config"], ()),
)
