"""Sweep files: what they say, what is wrong in them and where, and what their rows compute."""

from __future__ import annotations

import copy
import hashlib
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from topcli.config.load import load_experiment
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import load_sweep
from topcli.errors import ConfigError, TopcliError
from topcli.sweeps.plan import survey

BASE: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]},
    "scheme": "hk",
    "h": 0.01,
    "N": 100,
}
TEXT = """\
base:
  top: kowalevski
  initial: {omega: [2, 0, 0], gamma: [auto, 0, 0.1]}
  scheme: hk
  h: 0.01
  N: 100
"""


def rows(**sections: Any) -> list[Row]:
    return list(RowReader(load_sweep({"base": BASE, **sections})).rows())


def keys(**sections: Any) -> list[tuple[Any, ...]]:
    return [row.keys for row in rows(**sections)]


BAD = {
    "an empty grid": ("grid: {}", 7, "grid: must be a section of keys and their values, not an empty one"),
    "no values": ("grid:\n  h: []", 8, "grid.h: must be a list of values or a range, not an empty list"),
    "nothing varies": ("store: none", 1, "varies nothing"),
    "a number": ("grid:\n  h: 0.1", 8, "grid.h: must be a list of values or a range, not 0.1"),
    "an unknown key": ("grid:\n  top.c1: [1]", 8, "grid.top.c1: unknown key; did you mean 'top.c0'"),
    "an unknown section": ("grd:\n  h: [1]", 7, "grd: unknown key; did you mean 'grid'?"),
    "an unknown option": ("grid:\n  scheme.compensate: [true]", 8, "did you mean 'scheme.compensated'"),
    "a zip of unequal lengths": ("zip:\n  h: [0.1, 0.2]\n  N: [1, 2, 3]", 7, "h has 2, N has 3"),
    "an unknown scheme": ("grid:\n  scheme: [hk, hkk]", 8, "unknown scheme 'hkk'; did you mean 'hk'?"),
    "a scheme of another top": ("grid:\n  scheme: [bs]", 8, "scheme 'bs' does not fit top 'kowalevski'"),
    "a measure of another top": (
        "grid:\n  h: [0.1]\nmeasure: [drift.foo]",
        9,
        "measure 'drift.foo': top 'kowalevski' under scheme 'hk' has no invariant 'foo'",
    ),
    "an unknown measure": ("grid:\n  h: [0.1]\nmeasure: [second]", 9, "did you mean 'seconds'"),
    "a log range over zero": (
        "grid:\n  h: {from: -1, to: 1, count: 3, spacing: log}",
        8,
        "both positive or both negative",
    ),
    "a range without count": ("grid:\n  h: {from: 1, to: 2}", 8, "grid.h.count: missing"),
    "a key varied twice": ("grid:\n  h: [0.1]\nzip:\n  h: [0.2]", 10, "zip.h: is varied twice"),
    "an equal value": ("grid:\n  h: [0.1, 0.1]", 8, "grid.h: holds 0.1 twice"),
    "an exclusion of no row": (
        "grid:\n  h: [0.1]\nexclude:\n  - {h: 0.3}",
        10,
        "no row has the value 0.3; values: 0.1",
    ),
    "an exclusion of all rows": ("grid:\n  h: [0.1]\nexclude:\n  - {h: 0.1}", 9, "excludes every row"),
    "an exclusion of a fixed key": ("grid:\n  h: [0.1]\nexclude:\n  - {N: 9}", 10, "is not varied by grid or zip"),
    "flat numbers for a vector": ("grid:\n  initial.omega: [2, 0, 0]", 8, "write [[2, 0, 0]]"),
    "an impossible component": ("grid:\n  initial.gamma3: [1.5]", 8, "auto cannot make it a unit vector"),
    "text for h": ("grid:\n  h: [0.1, a]", 8, "h: must be a number, not the text 'a'"),
    "h = 0": ("grid:\n  h: [0.1, 0]", 8, "h: must not be zero"),
    "every beyond N": ("grid:\n  output.every: [1, 1000]", 8, "must be at most N = 100, not 1000"),
    "a sample without draws": ("grid:\n  sample: [1]", 8, "needs the section random"),
    "an unknown vector": (
        "random: {count: 3, omga: {sphere: 2}}",
        7,
        "random.omga: unknown key; did you mean 'omega'?",
    ),
    "a vector drawn and varied": (
        "random: {gamma: sphere}\ngrid:\n  initial.gamma3: [0.1]",
        7,
        "random.gamma: is drawn in every row, and initial.gamma3 is varied",
    ),
    "a parameter drawn and varied": (
        "random: {top.c0: {from: 1, to: 2}}\ngrid:\n  top.c0: [1]",
        7,
        "is drawn in every row, and top.c0 is varied",
    ),
    "nothing random": ("random: {count: 3}", 7, "nothing is random"),
    "another store": ("grid:\n  h: [0.1]\nstore: all", 9, "store: must be 'none' or 'series', not the text 'all'"),
    "an included unknown key": ("include:\n  - {h: 0.1, top.c9: 3}", 8, "include[0].top.c9: unknown key"),
    "a parameter that is no number": ("grid:\n  top.c0: [1, a]", 8, "top.c0: must be a number, not the text 'a'"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_mistake_is_named_with_file_line_and_key(name: str, tmp_path: Path) -> None:
    text, line, message = BAD[name]
    path = tmp_path / "study.yaml"
    path.write_text(TEXT + text + "\n")
    with pytest.raises(TopcliError) as caught:
        survey(load_sweep(path))
    assert str(caught.value).startswith(f"{path}:{line}: ")
    assert message in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(("N", "every", "most"), [(100, 100, 100), (100, 50, 100), (7, 7, 7), (1, 1, 1)])
def test_rows_are_recorded_at_most_every_n_steps(N: int, every: int, most: int) -> None:
    """From both sides, in a sweep and in a run."""
    base = {**BASE, "N": N}
    assert rows(base=base, grid={"output.every": [every]})[0].every == every
    assert load_experiment({**base, "output": {"every": every}}).output.every == every
    wrong = rf"output.every: must be at most N = {N}, not {most + 1}"
    with pytest.raises(TopcliError, match=wrong):
        rows(base=base, grid={"output.every": [most + 1]})
    with pytest.raises(TopcliError, match=wrong):
        load_experiment({**base, "output": {"every": most + 1}})


def test_a_row_records_at_most_a_hundred_million_states() -> None:
    base = {**BASE, "N": 10**9}
    assert rows(base=base, grid={"output.every": [11]})[0].every == 11
    with pytest.raises(TopcliError, match=r"output.every: records 100000001 states of a row \(at most 100000000\)"):
        rows(base=base, grid={"output.every": [10]})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "x"}, "base.name: the base has no name"),
        ({"ensemble": {}}, "base.ensemble: a row is one trajectory"),
        ({"M": 1}, "base.M: unknown key"),
        ({"N": None, "T": None}, "two of h, N and T are needed, and there is h"),
        ({"T": 1.0}, "two of h, N and T are needed, and there is h and N and T"),
        (
            {"N": None, "T": 0.015},
            "T/h = 0.015/0.01 = 1.5 is not a whole number of steps; nearest: T = 0.01 (N = 1) or T = 0.02 (N = 2)",
        ),
    ],
)
def test_a_wrong_base_is_refused(change: dict[str, Any], message: str) -> None:
    base = {key: value for key, value in {**BASE, **change}.items() if value is not None}
    with pytest.raises(TopcliError, match=message.replace("(", r"\(").replace(")", r"\)")):
        list(RowReader(load_sweep({"base": base, "grid": {"scheme": ["hk"]}})).rows())


def test_a_base_that_is_no_scene_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("grid:\n  h: [0.1]\nbase: kowalevski_hkk\n")
    with pytest.raises(TopcliError, match=r"s\.yaml:3: base: no packaged scene is called 'kowalevski_hkk'"):
        load_sweep(tmp_path / "s.yaml")


def test_the_grid_is_a_product_whose_last_key_varies_fastest() -> None:
    found = keys(grid={"scheme": ["hk", "rk4"], "h": [0.1, 0.2, 0.3]})
    assert found == [("hk", 0.1), ("hk", 0.2), ("hk", 0.3), ("rk4", 0.1), ("rk4", 0.2), ("rk4", 0.3)]


def test_zipped_lists_go_together_and_may_repeat_values() -> None:
    found = keys(zip=[{"scheme": ["hk", "hk"], "N": [10, 20]}, {"top.c0": [1.0, 2.0]}])
    assert found == [("hk", 10, 1.0), ("hk", 10, 2.0), ("hk", 20, 1.0), ("hk", 20, 2.0)]


def test_included_rows_come_last_and_take_the_rest_from_the_base() -> None:
    found = rows(grid={"h": [0.1]}, include=[{"scheme": "rk4", "top.c0": 3}])
    assert [row.keys for row in found] == [(0.1, "hk", 1.0), (0.01, "rk4", 3.0)]
    assert json.loads(found[1].top)["c0"] == 3.0


def test_an_exclusion_removes_the_rows_that_match_all_its_keys() -> None:
    found = keys(grid={"scheme": ["hk", "rk4"], "h": [0.1, 0.2]}, exclude=[{"scheme": "hk", "h": 0.2}])
    assert found == [("hk", 0.1), ("rk4", 0.1), ("rk4", 0.2)]


def test_ranges_have_both_ends_and_even_spacing() -> None:
    linear = [row.h for row in rows(grid={"h": {"from": 0.1, "to": 0.4, "count": 4}})]
    assert linear == [0.1, 0.2, 0.3, 0.4]
    log = [row.h for row in rows(grid={"h": {"from": 1e-4, "to": 1e-1, "count": 7, "spacing": "log"}})]
    assert log[::2] == [1e-4, 1e-3, 1e-2, 1e-1]
    assert all(math.isclose(b / a, 10.0**0.5, rel_tol=1e-13) for a, b in pairwise(log))
    whole = [row.N for row in rows(grid={"N": {"from": 10, "to": 1000, "count": 5, "spacing": "log"}})]
    assert whole == [10, 32, 100, 316, 1000]


def test_steps_of_a_range_are_moved_to_divide_the_duration() -> None:
    base = {**{key: value for key, value in BASE.items() if key != "N"}, "T": 10.0}
    data = {"base": base, "grid": {"h": {"from": 0.01, "to": 0.3, "count": 6, "spacing": "log"}}}
    found = list(RowReader(load_sweep(data)).rows())
    assert all(row.h == 10.0 / row.N for row in found)
    wanted = [0.01 * 30.0 ** (i / 5) for i in range(6)]
    assert [row.N for row in found] == [round(10.0 / h) for h in wanted]


def test_h_follows_from_the_duration_and_the_number_of_steps() -> None:
    base = {key: value for key, value in BASE.items() if key not in ("h", "N")} | {"T": 5.0}
    found = list(RowReader(load_sweep({"base": base, "grid": {"N": [10, 40]}})).rows())
    assert [(row.h, row.N) for row in found] == [(0.5, 10), (0.125, 40)]


def test_a_component_is_set_within_its_vector() -> None:
    (row,) = rows(grid={"initial.gamma3": [0.6]})
    assert row.initial == (2.0, 0.0, 0.0, math.sqrt(1.0 - 0.6 * 0.6), 0.0, 0.6)
    assert row.keys == (0.6,)


def test_a_vector_is_shown_as_json() -> None:
    (row,) = rows(grid={"initial.omega": [[0, 2, 1]]})
    assert row.keys == ("[0.0, 2.0, 1.0]",)


def test_a_scheme_with_options_is_labelled_by_them() -> None:
    found = rows(grid={"scheme": ["hk", {"name": "hybrid", "branch": "sign"}]})
    assert [row.keys for row in found] == [("hk",), ("hybrid:branch=sign",)]
    assert json.loads(found[1].scheme)["branch"] == "sign"


def test_the_digest_is_that_of_the_canonical_config_without_its_name() -> None:
    (row,) = rows(grid={"h": [0.02]})
    resolved = load_experiment(row.config("any")).resolved()
    data = {key: resolved[key] for key in ("top", "initial", "scheme", "h", "N")} | {"every": 1}
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    assert row.digest == hashlib.sha256(text.encode()).hexdigest()


CHANGES = {
    "top": {"top": {"kind": "kowalevski", "c0": 2.0}},
    "initial": {"initial": {"omega": [2, 0, 1e-300], "gamma": ["auto", 0, 0.1]}},
    "scheme": {"scheme": "rk4"},
    "options": {"scheme": {"name": "hk", "compensated": True}},
    "h": {"h": math.nextafter(0.01, 1.0)},
    "N": {"N": 101},
    "every": {"output": {"every": 2}},
}


@pytest.mark.parametrize("change", CHANGES)
def test_everything_that_a_row_computes_enters_its_digest(change: str) -> None:
    def digest(base: dict[str, Any]) -> str:
        sweep = load_sweep({"base": base, "include": [{"top.A": 2.0}]})
        return next(RowReader(sweep).rows()).digest

    assert digest({**BASE, **CHANGES[change]}) != digest(BASE)
    assert digest(copy.deepcopy(BASE)) == digest(BASE)


RANDOM = {"count": 4, "seed": 3, "omega": {"sphere": 2}, "gamma": "sphere", "top.c0": {"from": 1, "to": 2}}


def test_added_rows_change_no_drawn_state() -> None:
    before = {row.keys: row.digest for row in rows(random=RANDOM, grid={"scheme": ["hk"]})}
    data = {"random": {**RANDOM, "count": 9}, "grid": {"scheme": ["rk4", "hk"]}}
    after = {row.keys: row.digest for row in rows(**data)}
    assert len(after) == 18
    assert before.items() <= after.items()


def test_schemes_and_steps_start_from_the_same_drawn_states() -> None:
    found = rows(random=RANDOM, grid={"scheme": ["hk", "rk4"], "h": [0.01, 0.02]})
    by_sample: dict[int, set[tuple[float, ...]]] = {}
    for row in found:
        by_sample.setdefault(row.keys[2], set()).add((*row.initial, json.loads(row.top)["c0"]))
    assert [len(states) for states in by_sample.values()] == [1, 1, 1, 1]
    assert len(set.union(*by_sample.values())) == 4


def test_seed_sample_and_top_change_what_is_drawn() -> None:
    def states(random: dict[str, Any], **grid: Any) -> list[tuple[float, ...]]:
        return [row.initial for row in rows(random=random, grid=grid or {"N": [7]})]

    assert not set(states(RANDOM)) & set(states({**RANDOM, "seed": 4}))
    first, second = states({**RANDOM, "count": 1}, **{"top.A": [2.0, 3.0]})
    assert first != second
    assert states({**RANDOM, "count": 1}, seed=[3, 4])[0] == states({**RANDOM, "count": 1})[0]


def test_vectors_drawn_from_a_sphere_need_no_initial_vector_and_ignore_it() -> None:
    bare = {"base": {key: value for key, value in BASE.items() if key != "initial"}, "random": RANDOM}
    without = [row.digest for row in RowReader(load_sweep(bare)).rows()]
    assert without == [row.digest for row in rows(random=RANDOM)]


def test_the_centre_of_a_drawn_vector_may_vary() -> None:
    found = rows(random={"count": 2, "omega": {"near": 0.1}}, grid={"initial.omega": [[2, 0, 0], [0, 2, 0]]})
    for row, centre in zip(found, [(2, 0, 0)] * 2 + [(0, 2, 0)] * 2, strict=True):
        assert 0.0 < math.dist(row.initial[:3], centre) < 0.1
        assert json.loads(row.keys[0]) == list(centre), "the key is the centre, so that rows of one centre agree"


def test_drawn_values_have_the_asked_distribution() -> None:
    found = rows(random={**RANDOM, "count": 400})
    c0 = [json.loads(row.top)["c0"] for row in found]
    assert min(c0) >= 1.0
    assert max(c0) <= 2.0
    # 5 standard errors: a false alarm in 1.7 million
    assert abs(sum(c0) / 400 - 1.5) < 5.0 / math.sqrt(12 * 400)
    for row in found:
        assert math.isclose(math.hypot(*row.initial[:3]), 2.0, rel_tol=1e-14)
        assert math.isclose(math.hypot(*row.initial[3:]), 1.0, rel_tol=1e-14)


def test_an_override_reaches_the_base_and_a_key_of_the_grid() -> None:
    data = {"base": BASE, "grid": {"h": [0.1], "top.c0": [1.0]}}
    found = list(RowReader(load_sweep(data, ["base.N=7", "base.top.A=3", "grid.top.c0=[5, 6]"])).rows())
    assert [(row.N, row.keys) for row in found] == [(7, (0.1, 5.0)), (7, (0.1, 6.0))]
    assert json.loads(found[0].top)["A"] == 3.0


def test_the_resolved_file_gives_the_same_rows(tmp_path: Path) -> None:
    first = load_sweep(
        {
            "name": "again",
            "base": "kowalevski_hk",
            "grid": {"h": {"from": 1e-3, "to": 1e-2, "count": 3, "spacing": "log"}},
            "random": {"count": 2, "gamma": {"near": 0.1}},
            "measure": ["seconds"],
        },
        ["base.N=100"],
    )
    (tmp_path / "other.yaml").write_text(first.to_yaml())
    second = load_sweep(tmp_path / "other.yaml")
    assert list(RowReader(second).rows()) == list(RowReader(first).rows())
    assert second.digest == first.digest


def test_a_row_is_a_config_that_loads_to_the_same_bits() -> None:
    for row in rows(random=RANDOM, grid={"scheme": ["hk", {"name": "hybrid", "branch": "sign"}]}):
        loaded = load_experiment(row.config("one"))
        assert loaded.y0 == row.initial
        assert (loaded.h, loaded.N, loaded.output.every) == (row.h, row.N, row.every)
        assert loaded.resolved()["top"] == json.loads(row.top)
        assert loaded.resolved()["scheme"] == json.loads(row.scheme)


def test_a_sweep_and_an_experiment_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(TEXT + "grid:\n  h: [0.1]\n")
    with pytest.raises(TopcliError, match=r"s\.yaml:1: base: this is a sweep, and an experiment is needed here"):
        load_experiment(path)
    with pytest.raises(TopcliError, match="this is an experiment; `topcli run` takes experiments"):
        load_sweep(BASE)


def test_a_packaged_sweep_needs_no_path() -> None:
    assert load_sweep("Heavy-Drift").name == "heavy_drift"
    with pytest.raises(TopcliError, match=r"no packaged sweep is called 'heavy_drif'.*did you mean 'heavy_drift'"):
        load_sweep("heavy_drif")


@pytest.mark.parametrize("key", ["sample", "seed"])
@pytest.mark.parametrize("first", [float("nan"), float("inf"), "x", None, [1], {}])
def test_a_range_of_draws_with_odd_ends_is_refused(key: str, first: object) -> None:
    data = {
        "base": {"top": "kowalevski", "scheme": "hk", "h": 0.01, "N": 10},
        "random": {"omega": {"sphere": 1}, "gamma": "sphere"},
        "grid": {key: {"from": first, "to": 5}},
    }
    with pytest.raises(ConfigError, match=rf"grid\.{key}\.(from|count)"):
        load_sweep(data)


@pytest.mark.parametrize("spacing", ["linear", "log"])
def test_the_ends_of_a_range_are_those_that_are_given(spacing: str) -> None:
    """All 17 digits of them, and the largest double, which 15 digits round to infinity."""
    first, last = 0.12345678901234568, 1.7976931348623157e308
    data = {
        "base": {"top": "kowalevski", "scheme": "hk", "h": 0.01, "N": 10},
        "grid": {"top.c0": {"from": first, "to": last, "count": 3, "spacing": spacing}},
    }
    values = load_sweep(data).axes[0].columns[0]
    assert (values[0], values[2]) == (first, last)


def test_a_duration_of_null_is_that_of_the_base() -> None:
    initial = {"omega": [1, 0, 0], "gamma": [0, 0, 1]}
    data = {
        "base": {"top": "kowalevski", "initial": initial, "scheme": "hk", "h": 0.5, "N": 10},
        "grid": {"T": [None]},
    }
    assert [row.keys for row in RowReader(load_sweep(data)).rows()] == [(5.0,)]
