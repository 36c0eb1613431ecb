"""Reports on stored runs, ensembles and sweeps, which ``topcli.run`` and ``topcli.sweep`` return and pages show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.cli.running import code_of_run
from topcli.config.load import load
from topcli.contracts import Outcome
from topcli.errors import ExitCode, UsageError, counted, nearest, quoted
from topcli.figures.figure import picture_of
from topcli.figures.stored import draw_series, recorded_vectors, run_figure, series_of
from topcli.figures.sweep import draw_sweep, points_of, usual_choices
from topcli.runs.report import ensemble_statements, precision_note, report_tables, warning_of
from topcli.runs.run import RunResult
from topcli.store.results import MANIFEST, REPORT, StoredResult, intact_result
from topcli.store.series import read_series, series_names
from topcli.studies.report import Report, read_record
from topcli.sweeps.aggregates import Frame, key_labels, read_rows
from topcli.sweeps.store import COMPLETED, is_sweep, stored_sweep_file
from topcli.table import Table, number, plain

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

_PROVENANCE = ("started", "ended", "commit", "dirty", "digest", "code")
"""Entries of a manifest that a page shows, besides the environment."""
MOST_ROWS, MOST_PICTURES = 200, 6
"""Largest numbers of rows and measures of a sweep on a page."""


@dataclass(frozen=True, repr=False)
class StoredReport(Report):
    """Report on a result in a folder.

    Attributes
    ----------
    stored : StoredResult
        The folder of the result with its manifest, the description of the run or sweep.
    """

    stored: StoredResult = field(kw_only=True)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.title}: {self.answer}>"

    @property
    def folder(self) -> Path:
        """Folder of the result."""
        return self.stored.folder

    def record(self) -> dict[str, Any]:
        """Everything that a page shows, with the environment in which the result was computed."""
        manifest = self.stored.manifest
        times = {key: manifest[key] for key in _PROVENANCE if manifest.get(key)}
        return super().record() | {"environment": times | manifest["environment"]}


@dataclass(frozen=True, repr=False)
class RunReport(StoredReport):
    """Report on a stored run or ensemble, as returned by ``topcli.run``.

    ``report[name]`` is the column called ``name`` of the series, which contains the recorded rows of the run. The
    report draws the last vector of the state over time, for example gamma; an ensemble has no picture.

    Attributes
    ----------
    result : RunResult
        The folder of the run, the content of ``report.json``, and ``status``.
    """

    result: RunResult = field(kw_only=True)

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run.

        For an ensemble, it is ``interrupted`` if a trajectory was interrupted. Otherwise it is the outcome of the first
        trajectory that failed, or ``completed`` if none failed.
        """
        return self.result.outcome

    @property
    def status(self) -> str:
        """``"ran"``, ``"continued"`` or ``"up to date"``, depending on what the call of ``topcli.run`` did."""
        return self.result.status

    @property
    def table(self) -> pd.DataFrame:
        """Deviations, drift and verdict of each invariant, or quantiles over the trajectories, indexed by its name."""
        import pandas as pd

        return pd.json_normalize(self.result.report["invariants"], sep=", ").set_index("name")

    @property
    def series(self) -> pd.DataFrame:
        """DataFrame of all stored rows. Raises RunError if the file is damaged."""
        import pandas as pd

        return pd.DataFrame(read_series(self.stored.series))

    def __getitem__(self, name: str) -> np.ndarray:
        """Column of the series by name, shape (m,). Raises UsageError for an unknown name."""
        names = series_names(self.stored.series)
        if name not in names:
            raise UsageError(f"unknown column {quoted(name)}; {nearest(name, names)}")
        return read_series(self.stored.series, [name])[name]

    def as_dict(self) -> dict[str, Any]:
        """Return the content of ``report.json``, with the ``folder`` and the ``status``."""
        return {"folder": str(self.folder), "status": self.status, **self.result.report}

    def picture(self, form: str) -> bytes:
        """Picture of all columns in a format, "png", "pdf" or "svg". Raises UsageError for an ensemble."""
        figure = run_figure(self.stored)
        return picture_of(lambda canvas: figure.draw(canvas, figure.data()), figure.size, form)


def report_on_run(result: RunResult) -> RunReport:
    """Report on a finished or interrupted run or ensemble, with a sentence on each invariant as notes."""
    report, stored = result.report, result.stored
    notes = [f"{report['top_title']}; {report['scheme']}: {report['scheme_title']}; h = {report['h']}"]
    many = report.get("kind") == "ensemble"
    if many:
        notes += ensemble_statements(report)
    else:
        notes += [f"{row['symbol']}: {row['statement']}" for row in report["invariants"]]
        notes += filter(None, [precision_note(report), warning_of(report)])
    return RunReport(
        "run",
        report["name"],
        report["message"],
        report_tables(report),
        notes,
        code=code_of_run(result),
        config=stored.manifest["config"],
        draw=None if many else lambda axes, looks: _draw_last_vector(stored, axes),
        stored=stored,
        result=result,
    )


def _draw_last_vector(stored: StoredResult, axes: Axes) -> None:
    """Draw the last vector of the state over time."""
    experiment = load(stored.manifest["config"])
    data = series_of(stored.series, experiment.h)
    *_, components = recorded_vectors(list(data), experiment).values()
    draw_series(axes, data, components, experiment)


@dataclass(frozen=True, repr=False)
class SweepReport(StoredReport):
    """Report on a finished sweep, as returned by ``topcli.sweep``.

    The report draws the first measure against the numeric key with the most values, with a curve for each scheme or
    top. ``table`` gives the rows for other plots.
    """

    @property
    def outcomes(self) -> Mapping[str, int]:
        """Number of rows for each outcome."""
        return dict(Counter(self.table["outcome"]))

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the rows of the sweep, indexed by number."""
        return read_rows(self.folder).set_index("row")

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON: names of keys and measures, outcomes, and the rows."""
        table = read_rows(self.folder)
        return {
            "folder": str(self.folder),
            "keys": table.attrs["keys"],
            "measures": table.attrs["measures"],
            "outcomes": dict(self.outcomes),
            "rows": table.astype(object).where(table.notna(), None).to_dict("records"),
        }

    def picture(self, form: str) -> bytes:
        """Picture of the first measures in a format, "png", "pdf" or "svg". Raises UsageError if no key varies."""
        rows = read_rows(self.folder)
        panels = [points_of(rows, choice) for choice in islice(usual_choices(rows), MOST_PICTURES)]
        if not panels:
            raise UsageError("plot: no key of the sweep varies, or no measure has a value")
        heights = [points.height for points in panels]

        def draw(canvas: Any) -> None:
            grid = canvas.subplots(len(panels), 1, squeeze=False, height_ratios=heights)
            for axes, points in zip(grid[:, 0], panels, strict=True):
                draw_sweep(axes, points)

        return picture_of(draw, (5.6, sum(heights)), form)


def report_on_sweep(stored: StoredResult) -> SweepReport:
    """Report on a stored sweep."""
    rows = read_rows(stored.folder)
    outcomes, choice = Counter(rows["outcome"]), next(usual_choices(rows), None)
    return SweepReport(
        "sweep",
        rows.attrs["name"],
        f"{counted(len(rows), 'row')}: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()),
        [rows_table(rows)],
        code=ExitCode.SUCCESS if set(outcomes) <= {COMPLETED} else ExitCode.PARTLY_FAILED,
        config=stored_sweep_file(stored.folder).resolved(),
        draw=None if choice is None else lambda axes, looks: draw_sweep(axes, points_of(rows, choice)),
        stored=stored,
    )


def rows_table(rows: Frame) -> Table:
    """The first rows of a sweep with their keys, outcome and measures."""
    keys, measures = rows.attrs["keys"], rows.attrs["measures"]
    columns = ["row", *keys, "outcome", *measures]
    first = plain(rows.head(MOST_ROWS)[columns].to_dict("records"))
    formats: dict[str, Any] = {key: key_labels(rows[key]).get for key in keys}
    formats |= {name: _format_of(rows[name]) for name in measures}
    more = len(rows) - len(first)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.attrs['path']}." if more > 0 else ""
    marks = {outcome: "bad" for outcome in rows["outcome"] if outcome != COMPLETED}
    return Table("Rows", first, formats, names={name: name for name in columns}, caption=caption, marks=marks)


def _format_of(values: Frame) -> Any:
    """Format of a measure: that of counts if all values are whole, some of which may be missing."""
    counts = values.dropna().mod(1).eq(0).all() and values.abs().max() < 2.0**53
    return ".0f" if counts else partial(number, digits=4)


def stored_record(place: Path) -> dict[str, Any]:
    """``Report.record`` of the result in a folder, which any of its files stands for, or of the file of a study.

    Raises UsageError if there is nothing that topcli stored or the result is not finished, and RunError if it is
    damaged.
    """
    beside = place.suffix != ".json" and (place.parent / MANIFEST).is_file()
    folder = place.parent if place.is_file() and (beside or place.name in (MANIFEST, REPORT)) else place
    if not folder.is_dir():
        return read_record(place)
    stored = intact_result(folder)
    if is_sweep(folder):
        return report_on_sweep(stored).record()
    return report_on_run(RunResult(stored, stored.report(), "up to date")).record()
