"""``topcli.run``, ``sweep`` and ``motion``: what the commands do, with a result in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.analysis.motion import Motion
from topcli.config.load import load, load_experiment
from topcli.config.sweep import load_sweep
from topcli.runs.run import RunOptions, run_experiment
from topcli.show.progress import Progress
from topcli.show.reports import RunReport, SweepReport, run_report, sweep_report
from topcli.store.results import read_result
from topcli.sweeps.run_sweep import SweepOptions, run_sweep


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
        return run_report(run_experiment(experiment, Path(out), options))


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
        stored = read_result(run_sweep(loaded, Path(out), options).folder)
        assert stored
        return sweep_report(stored)


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
