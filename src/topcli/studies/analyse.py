"""``topcli analyse``: a series of another program, judged like a run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from topcli.studies import SILENT, Watch
from topcli.studies.study import Data, Flag, Head, Overrides, Result, Study, parts_of
from topcli.table import DASH, Column, Table, number, ten_digits

SHOWN_TIMES = 5
"""Times of swings in the table; --json has them all."""


def measure(
    path: Annotated[str | Path, Flag("", "FILE")],
    config: Annotated[str | Path | Mapping[str, Any], Flag("--config", "CONFIG")],
    columns: Annotated[Sequence[str], Flag("--columns", "NAME=COLUMN,...")] = (),
    steps: Annotated[int | None, Flag("--steps", "COUNT", least=1)] = None,
    overrides: Overrides = (),
    watch: Watch = SILENT,
) -> Result:
    """Judge a series of another program like a run.

    Its times may start anywhere, rise or fall, and be uneven. The error is measured against a solution that starts from
    the config's initial state if the first row agrees with that to 1e-6, and otherwise from the first row.

    Parameters
    ----------
    path : path or str
        CSV or Parquet file with t and the components.
    config : path, str or mapping
        Take top and initial state from a config.
    columns : sequence of str, optional
        Name columns, e.g. t=time,omega1=w_x.
    steps : int, optional
        Set the steps taken; by default rows - 1.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    StudyReport
        ``table`` is the report on the invariants, ``summary`` what is known of rows, steps, errors and swings.

    Raises
    ------
    UsageError
        For a file that is no such series; the message names row and column.
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
        reference = swing["reference_spacing"]
        return ten_digits(swing["spacing"]) + ("" if reference is None else f" (reference {ten_digits(reference)})")

    return [
        Column("rows", "rows"),
        Column("times", span),
        *(Column("", key) for key in ("t_first", "t_last", "times")),
        Column("steps", lambda data: f"{data['steps']} ({data['steps_from']})"),
        *(Column("", key) for key in ("steps", "steps_from")),
        Column("reference from", start),
        Column("first row − config", "reference.difference", number, "difference"),
        Column("max error", "max_error", number),
        Column("error at the end", "end_error", number),
        Column(f"minima of {swing['component']}", "swing.times", minima, ""),
        Column("their spacing", spacing),
        *(Column("", f"swing.{key}", key=key) for key in ("spacing", "reference_spacing")),
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
    draws="errors, swings and deviations",
    captions=_captions,
    stem=lambda data: f"{data['config']['name']}_{Path(data['file']).stem}",
    parts=lambda data: parts_of(data["config"], ()),
)
