"""Sweep files: what they say, what is wrong in them and where, and what their rows compute."""

from __future__ import annotations

import ast
import hashlib
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from cases import cases_of
from topcli.config.load import load_experiment
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import load_sweep
from topcli.config.text import parse_yaml
from topcli.errors import TopcliError

BASE: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]},
    "scheme": "hk",
    "h": 0.01,
    "N": 100,
}


def rows(**sections: Any) -> list[Row]:
    return list(RowReader(load_sweep({"base": BASE, **sections})).rows())


KEYS = """
grid: {scheme: [hk, rk4], h: [0.1, 0.2, 0.3]}
    [('hk', 0.1), ('hk', 0.2), ('hk', 0.3), ('rk4', 0.1), ('rk4', 0.2), ('rk4', 0.3)]
zip: [{scheme: [hk, hk], N: [10, 20]}, {top.c0: [1, 2]}]
    [('hk', 10, 1.0), ('hk', 10, 2.0), ('hk', 20, 1.0), ('hk', 20, 2.0)]
grid: {scheme: [hk, rk4], h: [0.1, 0.2]}; exclude: [{scheme: hk, h: 0.2}]
    [('hk', 0.1), ('rk4', 0.1), ('rk4', 0.2)]
grid: {h: {from: 0.1, to: 0.4, count: 4}}
    [(0.1,), (0.2,), (0.3,), (0.4,)]
grid: {N: {from: 10, to: 1000, count: 5, spacing: log}}
    [(10,), (32,), (100,), (316,), (1000,)]
grid: {initial.omega: [[0, 2, 1]]}
    [('[0.0, 2.0, 1.0]',)]
grid: {initial.gamma3: [0.6]}
    [(0.6,)]
grid: {scheme: [hk, {name: hybrid, branch: sign}]}
    [('hk',), ('hybrid:branch=sign',)]
grid: {T: [null]}
    [(1.0,)]
grid: {output.every: [100]}
    [(100,)]
"""


@pytest.mark.parametrize(("sections", "keys"), cases_of(KEYS))
def test_keys_of_rows(sections: str, keys: list[str]) -> None:
    """The last key of a grid varies fastest; the rest is that of the base."""
    found = rows(**parse_yaml(sections.replace("; ", "\n"), "x")[0])
    assert [row.keys for row in found] == ast.literal_eval(keys[0])
    for row in found:
        loaded = load_experiment(row.config("any"))
        assert (loaded.y0, loaded.h, loaded.N, loaded.output.every) == (row.initial, row.h, row.N, row.every)
        assert loaded.resolved()["top"] == json.loads(row.top)
        assert loaded.resolved()["scheme"] == json.loads(row.scheme)


def test_keys_set_what_they_name() -> None:
    (component,) = rows(grid={"initial.gamma3": [0.6]})
    assert component.initial == (2.0, 0.0, 0.0, math.sqrt(1.0 - 0.6 * 0.6), 0.0, 0.6)
    (row,) = rows(zip={"scheme": [{"name": "hybrid", "branch": "sign"}], "top.c0": [3], "h": [0.5], "N": [7]})
    assert (row.h, row.N, json.loads(row.top)["c0"], json.loads(row.scheme)["branch"]) == (0.5, 7, 3.0, "sign")


def test_a_row_records_at_most_a_hundred_million_states() -> None:
    base = {**BASE, "N": 10**9}
    assert rows(base=base, grid={"output.every": [11]})[0].every == 11
    with pytest.raises(TopcliError, match=r"output.every: records 100000001 states of a row \(at most 100000000\)"):
        rows(base=base, grid={"output.every": [10]})


def test_ranges_have_both_ends_and_even_spacing() -> None:
    log = [row.h for row in rows(grid={"h": {"from": 1e-4, "to": 1e-1, "count": 7, "spacing": "log"}})]
    assert log[::2] == [1e-4, 1e-3, 1e-2, 1e-1]
    assert all(math.isclose(b / a, 10.0**0.5, rel_tol=1e-13) for a, b in pairwise(log))


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


def test_the_digest_is_that_of_the_canonical_config_without_its_name() -> None:
    (row,) = rows(grid={"h": [0.02]})
    resolved = load_experiment(row.config("any")).resolved()
    data = {key: resolved[key] for key in ("top", "initial", "scheme", "h", "N")} | {"every": 1}
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    assert row.digest == hashlib.sha256(text.encode()).hexdigest()


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


def test_a_packaged_sweep_needs_no_path() -> None:
    assert load_sweep("Heavy-Drift").name == "heavy_drift"


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


def test_exclude_may_name_what_an_override_removed() -> None:
    data = {"base": BASE, "grid": {"scheme": ["hk", "rk4", "dop853"], "h": [0.1, 0.2]}}
    data["exclude"] = [{"scheme": "dop853", "h": 0.2}, {"scheme": "hk", "h": 0.1}]
    fewer = list(RowReader(load_sweep(data, ["grid.scheme=[hk, rk4]"])).rows())
    assert [row.keys for row in fewer] == [("hk", 0.2), ("rk4", 0.1), ("rk4", 0.2)]
    with pytest.raises(TopcliError, match=r"exclude\[0\].scheme: is not varied by grid or zip"):
        load_sweep(data, ["grid={h: [0.1, 0.2]}"])
    assert load_sweep("kowalevski_errors", ["grid.scheme=[hk, rk4]"]).count_left > 0
    with pytest.raises(TopcliError, match=r"exclude\[0\].scheme: no row has the value 'dop8'"):
        load_sweep({**data, "exclude": [{"scheme": "dop8"}]})
