"""``topcli.run`` and ``topcli.sweep``: run experiments, ensembles and sweeps, and store the results in folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.config.load import load
from topcli.config.sweep import load_sweep
from topcli.contracts import Outcome
from topcli.errors import UsageError, nearest, quoted
from topcli.figures.study import on_axes
from topcli.runs.report import report_tables
from topcli.runs.run import CHECKPOINT_SECONDS, RunOptions, RunResult, run_experiment
from topcli.show.progress import Progress
from topcli.show.report import ResultReport
from topcli.store.series import read_series, series_names
from topcli.sweeps.run import SweepOptions, SweepResult, run_sweep
from topcli.sweeps.table import read_rows, require_names

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter
    from topcli.table import Cells


@dataclass(frozen=True, repr=False)
class RunReport(ResultReport):
    """Report on a stored run or ensemble, as returned by ``topcli.run``.

    ``report[name]`` is the column called ``name`` of the series, which contains the recorded rows of the run.

    Attributes
    ----------
    result : RunResult
        The folder of the run with its manifest (the description of the run), the content of ``report.json``, and
        ``status``.
    table : pandas.DataFrame
        One row per invariant, indexed by the name of the invariant. The columns contain deviations, drift and verdict;
        for an ensemble, they contain quantiles over the trajectories.
    """

    result: RunResult

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
    def is_ensemble(self) -> bool:
        """True if the report is on an ensemble."""
        return self.result.report.get("kind") == "ensemble"

    @property
    def table(self) -> pd.DataFrame:
        """DataFrame of the invariants, one row each, indexed by name."""
        import pandas as pd

        return pd.json_normalize(self.result.report["invariants"], sep=", ").set_index("name")

    @property
    def series(self) -> pd.DataFrame:
        """DataFrame of all stored rows. Raises RunError if the file is damaged."""
        import pandas as pd

        return pd.DataFrame(read_series(self.result.stored.series))

    def __getitem__(self, name: str) -> np.ndarray:
        """Column of the series by name, shape (m,). Raises UsageError for an unknown name."""
        self._require([name])
        return read_series(self.result.stored.series, [name])[name]

    def _require(self, names: Sequence[str], place: str = "") -> list[str]:
        """Columns of the series. Raises UsageError if one of the ``names`` is not among them."""
        known = series_names(self.result.stored.series)
        for name in names:
            if name not in known:
                raise UsageError(f"{place}unknown column {quoted(name)}; {nearest(name, known)}")
        return known

    def as_dict(self) -> dict[str, Any]:
        """Return the content of ``report.json``, with the ``folder`` and the ``status``."""
        return {"folder": str(self.folder), "status": self.status, **self.result.report}

    def chapter(self) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.results import run_chapter

        return run_chapter(self.result.stored)

    def cells(self) -> Cells:
        """Texts of the invariants."""
        return report_tables(self.result.report)[0].cells()

    @property
    def headline(self) -> str:
        """Name of the run, and how it ended."""
        return f"{self.result.report['name']}: {self.result.report['message']}"

    def plot(self, ax: Axes | None = None, *, columns: Sequence[str] = (), deviation: bool = False) -> Axes:
        """Draw columns of the recorded rows over time; for an ensemble, quantiles of the deviations of all invariants.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into; their style is kept. By default, new axes are made.
        columns : sequence of str, optional
            Names of columns. The default is the last vector of the state, for example gamma. If ``deviation`` is true,
            the default is all recorded invariants.
        deviation : bool, optional
            True to draw absolute deviations from the first values, on a logarithmic axis.

        Returns
        -------
        matplotlib Axes
            The axes.

        Raises
        ------
        UsageError
            If a column is unknown, or if ``columns`` are given for an ensemble.
        """
        from topcli.figures.run import draw_quantiles, draw_series, quantiles_of, recorded_vectors, series_of

        stored = self.result.stored
        if self.is_ensemble:
            if columns:
                raise UsageError("plot: an ensemble is drawn by the deviations of its invariants; read columns by name")
            quantiles = quantiles_of(self.folder, self.result.report)
            return on_axes(lambda axes: draw_quantiles(axes, quantiles), ax)
        known = self._require(columns, "plot: ")
        experiment = load(stored.manifest["config"])
        vectors = list(recorded_vectors(known, experiment).values())
        integrals = [each.name for each in (*experiment.top.invariants(), *experiment.modified) if each.name in known]
        chosen = list(columns) or (integrals if deviation else (vectors or [integrals])[-1])
        data = series_of(stored.series, experiment.h, chosen)
        return on_axes(lambda axes: draw_series(axes, data, chosen, experiment, deviation), ax)


def run(
    config: str | Path | Mapping[str, Any],
    out: str | Path = "results",
    *,
    overrides: Sequence[str] = (),
    force: bool = False,
    checkpoint_every: float = CHECKPOINT_SECONDS,
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
    checkpoint_every : float, optional
        Seconds between checkpoints, from which an interrupted run continues when it is run again. With 0, a checkpoint
        is written after every chunk of steps (the engine divides a run into chunks).
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
    with Progress(experiment.name, progress) as bar:
        options = RunOptions(force, checkpoint_every, threads, on_progress=bar)
        return RunReport(run_experiment(experiment, Path(out), options))


@dataclass(frozen=True, repr=False)
class SweepReport(ResultReport):
    """Report on a sweep, as returned by ``topcli.sweep``.

    Attributes
    ----------
    result : SweepResult
        Folder of the sweep, its number of rows, and the number of finished rows with each outcome.
    table : pandas.DataFrame
        The rows of the sweep, indexed by their numbers. The columns are the varied keys, ``outcome``, ``message``, the
        measures, and ``digest`` (a hash of what the row computes). ``table.attrs`` names the keys and the measures.
    """

    result: SweepResult

    @property
    def folder(self) -> Path:
        """Folder of the sweep."""
        return self.result.folder

    @property
    def outcomes(self) -> dict[str, int]:
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

    def chapter(self) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.results import sweep_chapter
        from topcli.sweeps.store import intact_sweep

        return sweep_chapter(intact_sweep(self.folder))

    def cells(self) -> Cells:
        """Texts of the first rows."""
        from topcli.pages.results import rows_table

        return rows_table(read_rows(self.folder))

    @property
    def headline(self) -> str:
        """Name of the sweep, and the number of its rows for each outcome."""
        return f"{self.folder.name}: {', '.join(f'{count} {outcome}' for outcome, count in self.outcomes.items())}"

    def plot(
        self,
        ax: Axes | None = None,
        *,
        x: str | None = None,
        y: str | None = None,
        by: str | None = None,
        aggregate: str | None = None,
    ) -> Axes:
        """Draw a measure against one key of the sweep, with a curve for each value of another key.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into. By default, new axes are made.
        x, y, by : str, optional
            ``x`` is the key on the horizontal axis, and ``y`` is the measure on the vertical axis. There is one curve
            for each value of the key ``by``. If ``x``, ``by`` and ``aggregate`` are all left out, the plot is the one
            on the page of ``topcli report``: ``x`` is the numeric key with the most values, and ``by`` is the key with
            the next most.
        aggregate : {"median", "mean", "max"}, optional
            Function that combines the values of ``y`` in rows that have the same values of ``x`` and ``by``.

        Returns
        -------
        matplotlib Axes
            The axes.

        Raises
        ------
        UsageError
            If the name of a key or measure is unknown, or if several rows fall on one point of a curve and
            ``aggregate`` is not given.
        """
        from topcli.figures.sweep import Choice, draw_sweep
        from topcli.pages.results import sweep_choices

        rows = read_rows(self.folder)
        if y is not None:
            require_names(rows, "measure", [y], "plot: y")
        usual = {choice.y: choice for choice in sweep_choices(rows)}
        if not usual:
            raise UsageError("plot: no key of the sweep varies, or no measure has a value")
        choice = usual.get(y or next(iter(usual))) or next(iter(usual.values()))
        if x or by or aggregate:
            choice = Choice(x or choice.x, y or choice.y, by, aggregate=aggregate)
        choice.require(rows)
        return on_axes(lambda axes: draw_sweep(axes, rows, choice), ax)


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
    with Progress(loaded.name, progress, unit="rows") as bar:
        options = SweepOptions(force=force, threads=threads, dask=dask, on_progress=bar)
        return SweepReport(run_sweep(loaded, Path(out), options))
