"""``topcli.run``, ``sweep`` and ``motion``: what the commands do, with a result in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.motion import Motion
from topcli.config.load import load, load_experiment
from topcli.config.sweep import load_sweep
from topcli.contracts import Outcome
from topcli.errors import UsageError, nearest, quoted
from topcli.figures.study import on_axes
from topcli.figures.sweep import draw_sweep
from topcli.pages.stored import MOST_ROWS, rows_table, run_chapter, sweep_chapter, sweep_choices
from topcli.runs.report import report_tables
from topcli.runs.run import RunOptions, RunResult, run_experiment
from topcli.show.progress import Progress
from topcli.store.results import StoredResult
from topcli.store.series import read_series, series_names
from topcli.studies.report import Report
from topcli.sweeps.run import SweepOptions, SweepResult, run_sweep
from topcli.sweeps.store import intact_sweep
from topcli.sweeps.table import read_rows, require_names
from topcli.table import Table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.page import Chapter


@dataclass(frozen=True, repr=False)
class RunReport(Report):
    """Report on a stored run or ensemble, as returned by ``topcli.run``.

    ``report[name]`` is the column called ``name`` of the series, which contains the recorded rows of the run. The
    report draws the last vector of the state over time, for example gamma; an ensemble has no picture.

    Attributes
    ----------
    result : RunResult
        The folder of the run with its manifest (the description of the run), the content of ``report.json``, and
        ``status``.
    """

    result: RunResult = field(kw_only=True)

    def __repr__(self) -> str:
        return f"<RunReport of {self.title}: {self.answer}>"

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.result.stored.folder

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

        return pd.DataFrame(read_series(self.result.stored.series))

    def __getitem__(self, name: str) -> np.ndarray:
        """Column of the series by name, shape (m,). Raises UsageError for an unknown name."""
        names = series_names(self.result.stored.series)
        if name not in names:
            raise UsageError(f"unknown column {quoted(name)}; {nearest(name, names)}")
        return read_series(self.result.stored.series, [name])[name]

    def as_dict(self) -> dict[str, Any]:
        """Return the content of ``report.json``, with the ``folder`` and the ``status``."""
        return {"folder": str(self.folder), "status": self.status, **self.result.report}

    def _chapter(self) -> Chapter:
        return run_chapter(self.result.stored)


def _draw_run(stored: StoredResult, axes: Axes) -> None:
    """Draw the last vector of the state over time."""
    from topcli.figures.run import recorded_vectors, run_pictures, series_of

    experiment = load(stored.manifest["config"])
    data = series_of(stored.series, experiment.h)
    vectors = recorded_vectors(list(data), experiment)  # their pictures come first
    run_pictures(data, experiment)[len(vectors) - 1](axes)


def run(
    config: str | Path | Mapping[str, Any],
    out: str | Path = "results",
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    threads: int | None = None,
    progress: bool = True,
    **changes: Any,
) -> RunReport:
    """Run an experiment or ensemble and store it in a folder; a finished run is not repeated.

    Parameters
    ----------
    config : path, str or mapping
        Config file (YAML or TOML), name of a scene (a packaged config), or the content of a config as nested mappings.
    out : path or str, optional
        Folder for results, as for ``--out`` on the command line. The run is stored in its subfolder ``name``.
    overrides : sequence of str, optional
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line. They are applied
        after ``changes``.
    force : bool, optional
        True to repeat a run that exists already; the earlier result is renamed, not overwritten.
    threads : int, optional
        Number of threads for an ensemble, by default one per CPU. The results do not depend on this number.
    progress : bool, optional
        False to show no progress bar in a notebook or terminal.
    **changes
        Values that replace whole top-level keys of the config, such as ``h=0.01``. If the changes or the overrides
        alter the run, the first digits of its digest (a hash of the config) are appended to its name, unless they set
        the name themselves.

    Returns
    -------
    RunReport
        Report with the folder of the run. A failed run raises no exception; ``outcome`` says how the run ended.

    Raises
    ------
    ConfigError
        If the config cannot be read or is invalid. The message names the key and, for a file, the line.
    UsageError
        If the folder of the run contains something other than this run.
    RunError
        If the results cannot be written.

    Examples
    --------
    >>> import tempfile, topcli
    >>> folder = tempfile.mkdtemp()
    >>> report = topcli.run("kowalevski_hybrid", folder, h=0.01, N=1000)
    >>> report
    <RunReport of kowalevski_hybrid-84d1c2: completed 1000 steps (t = 10)>
    >>> report.table.loc["k_sq", "verdict"]
    'exact'
    >>> report["gamma1"].shape
    (1001,)
    >>> topcli.run("kowalevski_hybrid", folder, h=0.01, N=1000).status
    'up to date'
    """
    experiment = load(config, overrides, changes, rename=True)
    with Progress(progress) as bar:
        bar.begin(experiment.name)
        options = RunOptions(force, threads=threads, on_progress=bar)
        result = run_experiment(experiment, Path(out), options)
    report, stored = result.report, result.stored
    return RunReport(
        "run",
        report["name"],
        report["message"],
        report_tables(report),
        config=stored.manifest["config"],
        draw=None if experiment.ensemble else lambda axes, _: _draw_run(stored, axes),
        result=result,
    )


@dataclass(frozen=True, repr=False)
class SweepReport(Report):
    """Report on a stored sweep, as returned by ``topcli.sweep``.

    Attributes
    ----------
    result : SweepResult
        Folder of the sweep and number of rows for each outcome.
    """

    result: SweepResult = field(kw_only=True)

    def __repr__(self) -> str:
        return f"<SweepReport of {self.title}: {self.answer}>"

    @property
    def folder(self) -> Path:
        """Folder of the sweep."""
        return self.result.folder

    @property
    def outcomes(self) -> Mapping[str, int]:
        """Number of rows for each outcome."""
        return self.result.outcomes

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

    def _chapter(self) -> Chapter:
        return sweep_chapter(intact_sweep(self.folder))

    def plot(self, ax: Axes | None = None, y: str | None = None) -> Axes:
        """Draw a measure against the numeric key with the most values, with a curve for each scheme or top.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into. By default, new axes are made.
        y : str, optional
            Measure; by default the first one. ``table`` gives the rows for other plots.

        Raises
        ------
        UsageError
            If the measure is unknown, or if there is nothing to draw.
        """
        return on_axes(lambda axes: _draw_sweep(self.folder, axes, y), ax)


def _draw_sweep(folder: Path, axes: Axes, y: str | None = None) -> None:
    """Draw the measure ``y``, by default the first one."""
    rows = read_rows(folder)
    if y is not None:
        require_names(rows, "measure", [y], "plot: y")
    choices = {choice.y: choice for choice in sweep_choices(rows)}
    choice = choices.get(y or next(iter(choices), ""))
    if choice is None:
        raise UsageError("plot: no key of the sweep varies, or the measure has no value")
    draw_sweep(axes, rows, choice)


def sweep(
    file: str | Path | Mapping[str, Any],
    out: str | Path = "results",
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    threads: int | None = None,
    dask: str | None = None,
    progress: bool = True,
) -> SweepReport:
    """Run the unfinished rows of a sweep and return a report on all rows.

    A row is one run of the sweep, with one combination of the values of the varied keys.

    Parameters
    ----------
    file : path, str or mapping
        Sweep file (YAML or TOML), name of a packaged sweep, or the content of a sweep file as nested mappings.
    out : path or str, optional
        Folder for results, as for ``--out`` on the command line. The sweep is stored in its subfolder ``name``. Rows
        that are finished there do not run again.
    overrides : sequence of str, optional
        Texts ``"key=value"`` that replace keys of the sweep file, as for ``--set`` on the command line, such as
        ``"base.N=100"``.
    force : bool, optional
        True to begin anew; the folder of an earlier sweep of this name is renamed.
    threads : int, optional
        Number of threads, by default one per CPU. The results do not depend on this number.
    dask : str, optional
        Address of a Dask cluster that runs the rows, as for ``--dask`` on the command line. With a cluster,
        ``threads`` is ignored.
    progress : bool, optional
        False to show no progress bar.

    Returns
    -------
    SweepReport
        Report with the rows and the folder of the sweep. The table gives the outcome and message of each failed row.

    Raises
    ------
    ConfigError
        If the sweep file is invalid. The message names the key and, for a file, the line.
    UsageError
        If another sweep is using the folder, or if the folder contains something other than this sweep.
    RunError
        If the results cannot be written.

    Examples
    --------
    >>> import tempfile, topcli
    >>> start = {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]}
    >>> base = {"top": "kowalevski", "initial": start, "scheme": "hk", "T": 10}
    >>> study = {"base": base, "grid": {"h": [0.02, 0.01]}, "measure": ["max_deviation.energy"]}
    >>> result = topcli.sweep(study, tempfile.mkdtemp())
    >>> coarse, fine = result.table["max_deviation.energy"]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> result.plot().get_xlabel()
    'step size h'
    """
    loaded = load_sweep(file, overrides)
    with Progress(progress) as bar:
        bar.begin(loaded.name, unit="rows")
        options = SweepOptions(force=force, threads=threads, dask=dask, on_progress=bar)
        result = run_sweep(loaded, Path(out), options)
    rows = read_rows(result.folder)
    return SweepReport(
        "sweep",
        loaded.name,
        ", ".join(f"{count} {outcome}" for outcome, count in result.outcomes.items()),
        [Table("Rows", rows.head(MOST_ROWS).to_dict("records"), stored=rows_table(rows))],
        config=loaded.resolved(),
        draw=lambda axes, _: _draw_sweep(result.folder, axes),
        result=result,
    )


IRRELEVANT = {"scheme": "taylor", "h": 0.01}
"""Keys that a config needs and a motion does not."""


def motion(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] = (), **changes: Any
) -> Motion:
    """Return the class, the frequencies and the periods of an exact motion.

    All results follow from the initial state and the closed form of the motion. Nothing is integrated, so the scheme,
    ``h`` and ``N`` of the config do not matter. All quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file, name of a scene (a packaged config), or the content of a config, as for ``topcli.simulate``. The
        keys ``top`` and ``initial`` are enough.
    overrides : sequence of str
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line. They are applied
        after ``changes``.
    **changes
        Values that replace whole top-level keys of the config.

    Returns
    -------
    Motion
        For the Kowalevski top, the class of the torus, its frequencies and periods, and the distance to the nearest
        separatrix. For the Euler top, the class and the period of the polhode. For the Lagrange top, nutation and
        precession. For a top without a closed form, only the integrals.

    Raises
    ------
    ConfigError
        If the config cannot be read, is invalid, or describes an ensemble or a sweep.
    UnknownNameError
        If no scene has the given name.

    Examples
    --------
    >>> import topcli
    >>> motion = topcli.motion("lagrange_cusps")
    >>> motion.title
    'nutation with cusps: the axis stops at one of the bounds'
    >>> round(motion["period.nutation"], 6)
    2.15473
    """
    if config is None or isinstance(config, Mapping):
        length = {} if "T" in {**(config or {}), **changes} else {"N": 1}
        config = {"name": "motion", **IRRELEVANT, **length, **(config or {})}
    from topcli.analysis.motion.of_top import motion_of

    experiment = load_experiment(config, overrides, changes, any_precision=True)
    return motion_of(experiment.top, experiment.y0)
