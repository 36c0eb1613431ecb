"""Sweeps: what runs, what is kept, and that a row has the numbers of a run by itself."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import topcli
from conftest import ROOT
from sweeping import BASE, DATA, MANY, sweep, table, with_grid
from topcli.config.files import scene_files
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import load_sweep
from topcli.config.text import parse_yaml
from topcli.errors import RunError, UsageError
from topcli.schemes.own_tops import top_class
from topcli.schemes.registry import find_scheme
from topcli.sweeps import row_results
from topcli.sweeps.batch import Measuring
from topcli.sweeps.measures import resolve_measures
from topcli.sweeps.row_results import Pace, Results, Work, batches, results_of_rows
from topcli.sweeps.run import SweepOptions, in_threads, planned, run_sweep


def test_a_sweep_writes_a_tidy_table(tmp_path: Path) -> None:
    result = sweep(tmp_path)
    assert (result.finished, result.ran, result.failed, result.outcomes) == (4, 4, 0, {"completed": 4})
    found = pq.read_table(tmp_path / "study" / "rows.parquet")
    assert found.column_names == [
        "row",
        "scheme",
        "h",
        "outcome",
        "message",
        "max_deviation.energy",
        "digest",
        "cpu",
        "current",
    ]
    kinds = "int64 string double string string double string string bool"
    assert " ".join(map(str, found.schema.types)) == kinds
    described = json.loads(found.schema.metadata[b"topcli.sweep"])
    assert described["name"] == "study"
    assert described["keys"] == ["scheme", "h"]
    assert described["measures"] == ["max_deviation.energy"]
    assert described["log"] == []
    rows = found.to_pylist()
    assert [(row["row"], row["scheme"], row["h"]) for row in rows] == [
        (0, "hk", 0.01),
        (1, "hk", 0.02),
        (2, "rk4", 0.01),
        (3, "rk4", 0.02),
    ]
    assert all(row["current"] and row["message"].startswith("completed 60 steps") for row in rows)
    assert json.loads((tmp_path / "study" / "manifest.json").read_text())["rows"] == 4


def test_rows_hold_the_states_and_parameters_that_were_drawn(tmp_path: Path) -> None:
    """A run from the columns of a row alone, as its reader would make it, has the row's deviation of the energy."""
    drawn = {
        "random": {"count": 3, "seed": 5, "omega": {"near": 0.5}, "gamma": "sphere", "top.c0": {"from": 1, "to": 2}}
    }
    data = {**DATA, **drawn, "grid": {"scheme": ["hk", "rk4"]}}
    sweep(tmp_path, data)
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
    sweep(tmp_path, {**data, "grid": {"scheme": ["rk4"]}})
    again = table(tmp_path)
    assert [[row[name] for name in names] for row in again if row["current"]] == [
        [row[name] for name in names] for row in rows if row["scheme"] == "rk4"
    ]
    assert {row[name] for row in again if not row["current"] for name in names} == {None}


def test_a_changed_file_runs_only_new_rows_and_keeps_the_others(tmp_path: Path) -> None:
    sweep(tmp_path)
    changed = with_grid(h=[0.02, 0.04])
    plan, changes = planned(load_sweep(changed), tmp_path, SweepOptions())
    assert (plan.to_run, plan.done, plan.left) == (2, 2, 2)
    assert plan.reasons() == {"new": 2}
    assert changes == ["grid.h: [0.01, 0.02] -> [0.02, 0.04]"]
    assert sweep(tmp_path, changed).ran == 2
    rows = table(tmp_path)
    assert [(row["row"], row["h"], row["current"]) for row in rows] == [
        (0, 0.02, True),
        (1, 0.04, True),
        (2, 0.02, True),
        (3, 0.04, True),
        (-1, 0.01, False),
        (-1, 0.01, False),
    ]
    assert sweep(tmp_path).ran == 0, "the rows that were kept belong to the first file again"
    sweep(tmp_path, with_grid(h=[0.08]))
    left = [row["h"] for row in table(tmp_path) if not row["current"]]
    assert left[4:] == [0.04] * 2, "in the order of the sweeps"


def test_a_new_key_at_the_value_of_the_base_keeps_the_rows(tmp_path: Path) -> None:
    sweep(tmp_path)
    assert sweep(tmp_path, with_grid(**{"top.c0": [1.0, 2.0]})).ran == 4


def test_a_new_measure_runs_the_rows_again(tmp_path: Path) -> None:
    sweep(tmp_path)
    more = {**DATA, "measure": ["max_deviation.energy", "steps"]}
    assert planned(load_sweep(more), tmp_path, SweepOptions())[0].reasons() == {"a measure is new": 4}
    assert sweep(tmp_path, more).ran == 4
    assert [row["steps"] for row in table(tmp_path)] == [60.0] * 4
    assert sweep(tmp_path).ran == 0


def test_changed_code_of_a_scheme_runs_its_rows_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from topcli.sweeps import plan as planning

    sweep(tmp_path)
    real = planning.code_digest
    codes: list[str] = []

    def changed(*parts: Any) -> str:
        codes.append(real(*parts))
        return codes[-1] if len(codes) == 1 else "0" * 64

    monkeypatch.setattr(planning, "code_digest", changed)
    plan, _ = planned(load_sweep(DATA), tmp_path, SweepOptions())
    assert plan.reasons() == {"the code of the scheme changed": 2}
    assert plan.status.tolist() == [0, 0, 2, 2]


FAILING = {**DATA, "grid": {"h": [0.01, 3.0, 0.02]}, "base": {**BASE, "scheme": "rk4"}}


def test_a_failed_row_stays_a_row(tmp_path: Path) -> None:
    messages: list[tuple[int, str]] = []
    notes: list[str] = []

    def together(made: Iterable[list[Row]], work: Work, stop: object) -> Iterator[tuple[list[Row], Results]]:
        rows = [row for batch in made for row in batch]
        yield rows, work(rows)

    options = SweepOptions(
        on_failure=lambda row, outcome, _: messages.append((row.number, outcome)),
        on_progress=lambda done, total, note: notes.append(f"{done} of {total} {note}"),
    )
    result = run_sweep(load_sweep(FAILING), tmp_path, options, together)
    assert messages == [(1, "blew_up")]
    assert notes == ["3 of 3 1 failed"]
    sweep(tmp_path, on_progress=lambda *counts: notes.append(counts[-1]))
    assert set(notes[1:]) == {""}
    sweep(tmp_path, FAILING)
    assert (result.failed, result.finished) == (1, 3)
    row = table(tmp_path)[1]
    assert row["outcome"] == "blew_up"
    assert row["message"].startswith("blew up at step ")
    assert np.isnan(row["max_deviation.energy"])
    again = sweep(tmp_path, FAILING)
    assert (again.ran, again.failed) == (0, 1)
    assert sweep(tmp_path, FAILING, retry_failed=True).ran == 1


@pytest.mark.parametrize(("count", "raising"), [(3, [1]), (40, [0, 17, 18]), (40, list(range(40)))])
def test_a_raising_row_costs_that_row_alone(count: int, raising: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of one batch, which are stepped together; all others keep the bits that they have without it."""
    values = [0.125 + 0.01 * i for i in range(count)]
    rows = list(RowReader(load_sweep({**DATA, "grid": {"initial.omega1": values}})).rows())
    batch_of: list[int] = []
    whole, finished = results_of_rows(rows, ["max_deviation.energy"]), Measuring.finished

    def broken(run: Measuring, initial: Any, stop: Any) -> Any:
        batch_of.append(len(initial))
        if np.isin(initial[:, 0], [values[i] for i in raising]).any():
            raise RunError("no luck")
        return finished(run, initial, stop)

    monkeypatch.setattr(Measuring, "finished", broken)
    found = results_of_rows(rows, ["max_deviation.energy"], pace=Pace(first_piece=count))
    assert batch_of == {3: [1, 1, 1], 40: [40, *[1] * 40]}[count]  # so few as 3 are not stepped side by side
    assert found.done == [True] * count
    assert found.outcome == ["failed" if i in raising else "completed" for i in range(count)]
    assert found.message == ["no luck" if i in raising else whole.message[i] for i in range(count)]
    kept = [i for i in range(count) if i not in raising]
    value, expected = found.values["max_deviation.energy"], whole.values["max_deviation.energy"]
    assert [value[i] for i in kept] == [expected[i] for i in kept]
    assert all(np.isnan(value[i]) for i in raising)


def test_an_unfinished_sweep_has_no_manifest(tmp_path: Path) -> None:
    sweep(tmp_path)
    manifest = tmp_path / "study" / "manifest.json"
    assert manifest.exists()
    assert not sweep(tmp_path, with_grid(h=[0.03]), stop=lambda: True).finished
    assert not manifest.exists()


def test_no_batch_begins_after_a_stop() -> None:
    rows = list(RowReader(load_sweep(MANY)).rows())
    begun: list[int] = []

    class Counted(Work):
        def __call__(self, rows: Any, stop: Any = None) -> Results:
            begun.append(len(rows))
            return Results()

    made = ([row] for row in rows)
    assert len(list(in_threads(1)(made, Counted(()), lambda: len(begun) >= 3))) < 8
    assert next(made)[0].number < 8


def test_equal_rows_are_computed_once(tmp_path: Path) -> None:
    data = {**DATA, "grid": None, "zip": {"scheme": ["hk", "rk4", "hk"], "h": [0.01, 0.01, 0.01]}}
    result = sweep(tmp_path, data)
    assert (result.ran, result.finished) == (2, 3)
    rows = table(tmp_path)
    assert rows[2]["row"] == 2
    assert rows[2]["digest"] == rows[0]["digest"]
    assert rows[2]["max_deviation.energy"] == rows[0]["max_deviation.energy"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "pace",
    [Pace(1, 1), Pace(10**9, 10**9), Pace(first_piece=5, seconds=0.0)],
    ids=["one by one", "side by side", "pieces"],
)
def test_rows_do_not_depend_on_their_batch(pace: Pace) -> None:
    rows = list(RowReader(load_sweep(MANY)).rows())
    usual = results_of_rows(rows, MANY["measure"])
    other = results_of_rows(rows[::-1], MANY["measure"], pace=pace)
    for name, values in usual.values.items():
        assert np.array_equal(values, other.values[name][::-1], equal_nan=True)
    assert usual.message == other.message[::-1]
    assert len(set(usual.values["max_deviation.energy"])) == 160


def test_batches_hold_every_row_once_and_are_bounded() -> None:
    rows = list(RowReader(load_sweep(MANY)).rows())
    made = list(batches(iter(rows), 2))
    assert sorted(row.number for batch in made for row in batch) == list(range(160))
    assert len(made) >= 8
    assert max(sum(row.N for row in batch) for batch in made) <= 160 * 60 // 8 + 1


@pytest.mark.slow
def test_work_can_be_done_in_another_process_in_any_order(tmp_path: Path) -> None:
    def backend(made: Any, work: Work, stop: Any) -> Any:
        for batch in reversed(list(made)):
            sent = pickle.loads(pickle.dumps((work, batch)))
            yield batch, pickle.loads(pickle.dumps(sent[0](sent[1])))

    sweep(tmp_path / "here", MANY)
    run_sweep(load_sweep(MANY), tmp_path / "there", backend=backend)
    assert repr(table(tmp_path / "there")) == repr(table(tmp_path / "here"))


def test_a_folder_that_is_no_sweep_is_refused(tmp_path: Path) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="exists and is not a sweep; nothing was written"):
        sweep(tmp_path)
    assert os.listdir(tmp_path / "study") == ["notes.txt"]


def test_rows_name_the_processor_that_computed_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_results, "_cpu", lambda: "Abacus 9")
    sweep(tmp_path, with_grid(h=[0.01]))
    monkeypatch.setattr(row_results, "_cpu", lambda: "Abacus 10")
    sweep(tmp_path, with_grid(h=[0.01, 0.02]))
    assert [(row["h"], row["cpu"]) for row in table(tmp_path) if row["scheme"] == "hk"] == [
        (0.01, "Abacus 9"),
        (0.02, "Abacus 10"),
    ]


READY = sorted((ROOT / "configs" / "sweeps").iterdir())


def ready(name: str) -> Any:
    path = ROOT / "configs" / "sweeps" / f"{name}.yaml"
    return parse_yaml(path.read_text(encoding="utf-8"), str(path))[0]


def scheme_name(scheme: str | dict[str, Any]) -> str:
    """Name of a scheme, given alone or with options."""
    return scheme["name"] if isinstance(scheme, dict) else scheme


@pytest.mark.parametrize("name", [path.stem for path in READY])
def test_a_ready_sweep_is_short_and_its_measures_fit(name: str) -> None:
    path = ROOT / "configs" / "sweeps" / f"{name}.yaml"
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 30
    assert path.stem not in scene_files()
    found = ready(name)
    assert found["name"] == name
    top = top_class(found["base"]["top"]).new()
    for scheme in found["grid"].get("scheme", [found["base"].get("scheme")]):
        measures = resolve_measures(found["measure"], top, find_scheme(scheme_name(scheme), top.form))
        assert [one.name for one in measures] == found["measure"]
