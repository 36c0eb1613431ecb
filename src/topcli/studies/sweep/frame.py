"""Python interface for sweeps: from a sweep file to a DataFrame of its rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.config.sweep.document import load_sweep, sweep_from
from topcli.studies.rows import ROWS
from topcli.studies.sweep.run import SweepOptions, run_sweep

if TYPE_CHECKING:
    import pandas as pd


def sweep(
    file: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    retry_failed: bool = False,
    threads: int | None = None,
    dask: str | None = None,
) -> pd.DataFrame:
    """Run what is new in a sweep and return the table of its rows.

    Parameters
    ----------
    file : path, str or mapping
        Sweep file (YAML or TOML), name of a packaged sweep, or the content of a file as nested mappings.
    out : path or str
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

    Returns
    -------
    pandas.DataFrame
        A row for each row of the sweep, indexed by its number: the varied keys, ``outcome``, ``message``, the measures,
        ``digest`` and ``cpu``. A row that failed has its outcome and message there. Rows of an earlier version of the
        file are left out.

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
    >>> folder = tempfile.mkdtemp()
    >>> table = topcli.sweep(study, folder)
    >>> coarse, fine = table["deviation.energy"]
    >>> bool(3.9 < coarse / fine < 4.1)
    True
    """
    import pandas as pd

    loaded = sweep_from(file, overrides) if isinstance(file, Mapping) else load_sweep(file, overrides)
    options = SweepOptions(confirmed=True, retry_failed=retry_failed, threads=threads)
    if dask is None:
        result = run_sweep(loaded, Path(out), options)
    else:
        from topcli.studies.sweep.cluster import run_on_cluster

        result = run_on_cluster(dask, loaded, Path(out), options)
    table = pd.read_parquet(result.folder / ROWS)
    return table[table["current"]].drop(columns="current").set_index("row")
