"""Sweeps on a Dask cluster of this machine: rows, lost workers, other code."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from scheme_files import unchanged_tables
from sweeping import DATA, MANY, sweep, table
from topcli.errors import RunError, UsageError
from topcli.plugins import FILES, REGISTERED, load_plugin_file
from topcli.sweeps.compute import code_of_process, compute_batch

KILLER = """
import os, signal
import topcli

@topcli.measure("killer", summary="ends the process of one row", needs=["omega1"])
def killer(batch):
    if (batch.initial[:, 0] == 0.5).any():
        os.kill(os.getpid(), signal.SIGKILL)
    return batch.columns["omega1"].max(axis=1)
"""


def test_a_missing_package_and_a_wrong_address_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UsageError, match="--dask local:two: no scheduler can be reached"):
        sweep(tmp_path, dask="local:two")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"pip install 'topcli\[dask\]'"):
        sweep(tmp_path, dask="local:1")


def test_a_worker_with_other_code_is_refused() -> None:
    assert compute_batch([], ["steps"], code=code_of_process()) == []
    with pytest.raises(UsageError, match="a worker has another version of topcli or of a plugin"):
        compute_batch([], ["steps"], code="other")


@pytest.mark.slow
def test_rows_of_a_cluster_are_those_of_threads_and_a_row_that_kills_its_workers_ends_the_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="the extra dask is not installed")
    for key in [*FILES]:  # of other tests, which no worker has
        monkeypatch.delitem(FILES, key)
    REGISTERED.clear()
    sweep(tmp_path / "here", MANY)
    sweep(tmp_path / "there", MANY, dask="local:1")
    assert table(tmp_path / "there") == table(tmp_path / "here")
    (tmp_path / "killer.py").write_text(KILLER)
    monkeypatch.setattr("topcli.sweeps.run_sweep.BATCH_ROWS", 4)
    grid = {"initial.omega1": [0.1 * k for k in range(1, 9)]}
    with unchanged_tables():
        load_plugin_file(tmp_path / "killer.py")
        with pytest.raises(RunError, match=r"--dask local:1: .*; finished rows are kept"):
            sweep(tmp_path, {**DATA, "grid": grid, "measure": ["killer"]}, dask="local:1")
