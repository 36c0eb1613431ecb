"""``topcli.sweep``: every combination of a sweep file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.sweep import load_sweep
from topcli.errors import UsageError
from topcli.show.progress import Progress
from topcli.show.report import Report, draw_panel
from topcli.sweeps.rows import ROWS, SweepRows, read_rows
from topcli.sweeps.run import SweepOptions, SweepResult, run_sweep

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

    from topcli.pages.contents import Chapter


@dataclass(frozen=True, repr=False)
class SweepReport(Report):
    """Rows of a sweep, as ``topcli.sweep`` returns them.

    Attributes
    ----------
    result : SweepResult
        Folder of the sweep, its plan, and the numbers of rows by outcome.
    table : pandas.DataFrame
        A row for each row of the sweep, indexed by its number: the varied keys, ``outcome``, ``message``, the measures,
        ``digest`` and ``cpu``. Rows of an earlier version of the file are left out.
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
        """DataFrame of the rows, indexed by number."""
        import pandas as pd

        table = pd.read_parquet(self.folder / ROWS)
        return table[table["current"]].drop(columns="current").set_index("row")

    @property
    def rows(self) -> SweepRows:
        """Rows with the names of keys and measures."""
        return read_rows(self.folder)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON: names of keys and measures, outcomes, and the rows."""
        rows = self.rows
        table = self.table.reset_index()
        return {
            "folder": str(self.folder),
            "keys": list(rows.keys),
            "measures": list(rows.measures),
            "outcomes": dict(self.outcomes),
            "rows": table.astype(object).where(table.notna(), None).to_dict("records"),
        }

    def chapter(self, name: str | None) -> Chapter:
        """Return the chapter of a page."""
        from topcli.pages.sweeps import sweep_chapter

        return sweep_chapter(self.folder, name)

    def plot(
        self,
        ax: Axes | None = None,
        *,
        x: str | None = None,
        y: str | None = None,
        by: str | None = None,
        aggregate: str | None = None,
    ) -> Axes:
        """Draw a measure over a key, with a curve for each value of another.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Axes to draw into; new ones by default.
        x, y, by : str, optional
            Key on the horizontal axis, measure, and key of the curves. Without ``x``, ``by`` and ``aggregate`` those of
            the page of ``topcli report``: the numeric key with most values, and the next one.
        aggregate : {"median", "mean", "max", "order"}, optional
            How the values of rows that differ in other keys are combined.

        Returns
        -------
        matplotlib Axes
            The axes.

        Raises
        ------
        UsageError
            For unknown names, and if several rows fall on one point without an ``aggregate``.
        """
        from topcli.figures.sweep import Choice, curves
        from topcli.pages.sweeps import sweep_choices

        rows = self.rows
        if y is not None:
            rows.require_measure(y, "plot: y")
        usual = {choice.y: choice for choice in sweep_choices(rows)}
        if not usual:
            raise UsageError("plot: no key of the sweep varies, or no measure has a value")
        choice = usual.get(y or next(iter(usual))) or next(iter(usual.values()))
        if x or by or aggregate:
            choice = Choice(x or choice.x, y or choice.y, by, aggregate=aggregate)
        choice.require(rows)
        return draw_panel(*curves(rows, choice), ax)


def sweep(
    file: str | Path | Mapping[str, Any],
    out: str | Path = "results",
    *,
    overrides: Sequence[str] = (),
    retry_failed: bool = False,
    threads: int | None = None,
    dask: str | None = None,
    progress: bool = True,
) -> SweepReport:
    """Run what is new in a sweep and return its rows.

    Parameters
    ----------
    file : path, str or mapping
        Sweep file (YAML or TOML), name of a packaged sweep, or the content of a file as nested mappings.
    out : path or str, optional
        Folder for the folder of the sweep, as ``--out`` on the command line. Finished rows found there do not run
        again.
    overrides : sequence of str, optional
        Texts ``"key=value"`` as for ``--set`` on the command line, such as ``"base.N=100"``.
    retry_failed : bool, optional
        True to run rows that failed before again.
    threads : int, optional
        Number of threads, which does not change the results; all CPUs by default.
    dask : str, optional
        Address of a Dask cluster that runs the rows, as for ``--dask`` on the command line; ``threads`` is then
        ignored.
    progress : bool, optional
        False to show no progress bar.

    Returns
    -------
    SweepReport
        The rows with the folder of the sweep. A row that failed has its outcome and message in the table.

    Raises
    ------
    ConfigError
        If the file has a fault; the message names the key and, in a file, the line.
    UsageError
        If the folder is in use by another sweep or holds something else.
    RunError
        If the results cannot be written.

    Examples
    --------
    >>> import tempfile, topcli
    >>> start = {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]}
    >>> base = {"top": "kowalevski", "initial": start, "scheme": "hk", "T": 10}
    >>> study = {"base": base, "grid": {"h": [0.02, 0.01]}, "measure": ["deviation.energy"]}
    >>> result = topcli.sweep(study, tempfile.mkdtemp())
    >>> coarse, fine = result.table["deviation.energy"]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    >>> result.plot().get_xlabel()
    'h'
    """
    loaded = load_sweep(file, overrides)
    with Progress(loaded.name, progress, unit="rows") as bar:
        options = SweepOptions(confirmed=True, retry_failed=retry_failed, threads=threads, on_progress=bar)
        if dask is None:
            return SweepReport(run_sweep(loaded, Path(out), options))
        from topcli.sweeps.cluster import run_on_cluster

        return SweepReport(run_on_cluster(dask, loaded, Path(out), options))
