"""Sweeps: which rows run, and that a row has the numbers of a run by itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import topcli
from sweeping import BASE, DATA, MANY, sweep, table
from topcli.cli.reports import report_on_sweep
from topcli.contracts import stopping_when
from topcli.errors import RunError
from topcli.store.results import intact_result
from topcli.sweeps.batch import Measuring


def test_a_sweep_writes_a_tidy_table(tmp_path: Path) -> None:
    result = sweep(tmp_path)
    assert (result.finished, result.ran, result.failed, result.outcomes) == (4, 4, 0, {"completed": 4})
    rows = pd.read_parquet(tmp_path / "study" / "rows.parquet")
    assert list(rows) == ["row", "scheme", "h", "outcome", "message", "max_deviation.energy", "digest"]
    assert " ".join(map(str, rows.dtypes)) == "int64 str float64 str str float64 str"
    assert rows.attrs == {"name": "study", "keys": ["scheme", "h"], "measures": ["max_deviation.energy"]}
    values = rows[["row", "scheme", "h"]].to_numpy().tolist()
    assert values == [[0, "hk", 0.01], [1, "hk", 0.02], [2, "rk4", 0.01], [3, "rk4", 0.02]]
    assert all(message.startswith("completed 60 steps") for message in rows["message"])
    assert json.loads((tmp_path / "study" / "manifest.json").read_text())["rows"] == 4
    (tmp_path / "study" / "rows.parquet").write_bytes(b"damaged")
    assert sweep(tmp_path).ran == 0
    assert pd.read_parquet(tmp_path / "study" / "rows.parquet").equals(rows), "a damaged table is written again"
    assert json.loads((tmp_path / "study" / "manifest.json").read_text())["step"] == 4


def test_rows_hold_the_states_and_parameters_that_were_drawn(tmp_path: Path) -> None:
    """A run from the columns of a row alone, as its reader would make it, has the row's deviation of the energy."""
    draws = {"count": 3, "seed": 5, "omega": {"near": 0.5}, "gamma": "sphere", "top.c0": {"from": 1, "to": 2}}
    sweep(tmp_path, {**DATA, "random": draws, "grid": {"scheme": ["hk", "rk4"]}})
    rows = table(tmp_path)
    names = [
        "drawn." + name for name in ("top.c0", *(f"initial.{v}{i}" for v in ("omega", "gamma") for i in (1, 2, 3)))
    ]
    assert sorted(name for name in rows[0] if name.startswith("drawn")) == sorted(names)
    assert len({tuple(row[name] for name in names) for row in rows}) == 3, "schemes share their states"
    for row in rows:
        omega, gamma = ([row[f"drawn.initial.{vector}{i}"] for i in (1, 2, 3)] for vector in ("omega", "gamma"))
        top = {"kind": "kowalevski", "c0": row["drawn.top.c0"]}
        run = topcli.simulate(
            top=top, initial={"omega": omega, "gamma": gamma}, scheme=row["scheme"], h=BASE["h"], N=BASE["N"]
        )
        assert row["max_deviation.energy"] == np.abs(run["energy"] - run["energy"][0]).max()


FAILING = {**DATA, "grid": {"h": [0.01, 3.0, 0.02]}, "base": {**BASE, "scheme": "rk4"}}


def test_a_failed_run_is_a_result(tmp_path: Path) -> None:
    failures: list[int] = []
    notes: list[str] = []
    options = {
        "on_failure": lambda row, message: failures.append(row),
        "on_progress": lambda *counts: notes.append("{} of {} {}".format(*counts)),
    }
    result = sweep(tmp_path, FAILING, threads=1, **options)
    assert (failures, notes[-1]) == ([1], "3 of 3 1 failed")
    assert (result.failed, result.finished) == (1, 3)
    row = table(tmp_path)[1]
    assert row["outcome"] == "blew_up"
    assert row["message"].startswith("blew up at step ")
    assert row["max_deviation.energy"] is None
    again = sweep(tmp_path, FAILING)
    assert (again.ran, again.failed) == (0, 1)
    assert report_on_sweep(intact_result(tmp_path / "study")).code == 3


@pytest.mark.parametrize("raising", [[1], [0, 17, 18], list(range(40))])
def test_a_raising_row_costs_that_row_alone_and_runs_again(
    raising: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows that are stepped together; all others keep the bits that they have without it."""
    values = [0.125 + 0.01 * i for i in range(40)]
    data = {**DATA, "grid": {"initial.omega1": values}}
    sweep(tmp_path / "whole", data)
    finished = Measuring.finished

    def broken(run: Measuring, initial: Any) -> Any:
        if np.isin(initial[:, 0], [values[i] for i in raising]).any():
            raise RunError("no luck")
        return finished(run, initial)

    with monkeypatch.context() as patch:
        patch.setattr(Measuring, "finished", broken)
        assert sweep(tmp_path, data).outcomes.get("failed") == len(raising)
    wanted = table(tmp_path / "whole")
    for row, whole in zip(table(tmp_path), wanted, strict=True):
        if row["row"] in raising:
            assert (row["outcome"], row["message"]) == ("failed", "no luck")
        else:
            assert row == whole
    notes: list[str] = []
    assert sweep(tmp_path, data, on_progress=lambda *counts: notes.append(counts[2])).ran == len(raising)
    assert set(notes) == {""}, "the failures of before do not count"
    assert table(tmp_path) == wanted


def test_a_stopped_sweep_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("topcli.sweeps.run_sweep.BATCH_ROWS", 4)
    done: list[int] = []
    with stopping_when(lambda: bool(done)):
        result = sweep(tmp_path, MANY, threads=1, on_progress=lambda n, *_: done.append(n))
    assert result.interrupted
    assert 0 < result.finished < 160
    assert json.loads((tmp_path / "study" / "manifest.json").read_text())["outcome"] == "interrupted"
    rest = sweep(tmp_path, MANY)
    assert (rest.ran, rest.finished, rest.interrupted) == (160 - result.finished, 160, False)


@pytest.mark.slow
def test_options_of_one_scheme_have_machine_code_of_their_own(tmp_path: Path) -> None:
    """Two rows of a batch: the code of one is not used for the other."""
    other, h = {"name": "hk", "compensated": True}, {"h": [0.01, 0.02, 0.03, 0.04]}
    sweep(tmp_path / "both", {**DATA, "grid": {**h, "scheme": ["hk", other]}}, threads=1)
    sweep(tmp_path / "alone", {**DATA, "grid": {**h, "scheme": [other]}}, threads=1)
    both, alone = ([row["max_deviation.energy"] for row in table(tmp_path / name)] for name in ("both", "alone"))
    assert both[1::2] == alone != both[::2]


def test_equal_rows_are_computed_once(tmp_path: Path) -> None:
    data = {**DATA, "grid": None, "zip": {"scheme": ["hk", "rk4", "hk"], "h": [0.01, 0.01, 0.01]}}
    result = sweep(tmp_path, data)
    assert (result.ran, result.finished) == (2, 3)
    rows = table(tmp_path)
    assert rows[2] == {**rows[0], "row": 2}
