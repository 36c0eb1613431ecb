"""Sweep files: the rows that they name, in groups that share an experiment, and what is drawn at random."""

from __future__ import annotations

import ast
import math
from itertools import pairwise
from typing import Any, NamedTuple

import pytest

from cases import cases_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.config.sweep import Sweep, load_sweep
from topcli.config.text import parse_yaml

BASE: dict[str, Any] = {
    "top": "kowalevski",
    "initial": {"omega": [2, 0, 0], "gamma": ["auto", 0, 0.1]},
    "scheme": "hk",
    "h": 0.01,
    "N": 100,
}


class Row(NamedTuple):
    """Row of a sweep."""

    keys: tuple[Any, ...]
    state: tuple[float, ...]
    experiment: Experiment

    @property
    def identity(self) -> str:
        return self.experiment.model_copy(update={"y0": self.state}).digest


def rows_of(sweep: Sweep) -> list[Row]:
    """Rows in order."""
    rows = {
        number: Row(
            tuple(group.values[key][i] for key in sweep.keys), tuple(group.states[i].tolist()), group.experiment
        )
        for group in sweep.groups()
        for i, number in enumerate(group.numbers.tolist())
    }
    assert sorted(rows) == list(range(len(rows)))
    return [rows[number] for number in range(len(rows))]


def rows(**sections: Any) -> list[Row]:
    return rows_of(load_sweep({"base": BASE, **sections}))


KEYS = """
grid: {scheme: [hk, rk4], h: [0.1, 0.2, 0.3]}
    [('hk', 0.1), ('hk', 0.2), ('hk', 0.3), ('rk4', 0.1), ('rk4', 0.2), ('rk4', 0.3)]
grid: {initial.omega1: [1, 2], scheme: [hk, rk4]}
    [(1.0, 'hk'), (1.0, 'rk4'), (2.0, 'hk'), (2.0, 'rk4')]
zip: [{scheme: [hk, hk], N: [10, 20]}, {top.c0: [1, 2]}]
    [('hk', 10, 1.0), ('hk', 10, 2.0), ('hk', 20, 1.0), ('hk', 20, 2.0)]
grid: {scheme: [hk, rk4], initial.gamma3: [0.1, 0.2]}; exclude: [{scheme: hk, initial.gamma3: 0.2}]
    [('hk', 0.1), ('rk4', 0.1), ('rk4', 0.2)]
grid: {h: {from: 0.1, to: 0.4, count: 4}}
    [(0.1,), (0.2,), (0.3,), (0.4,)]
grid: {N: {from: 10, to: 1000, count: 5, spacing: log}}
    [(10,), (32,), (100,), (316,), (1000,)]
grid: {initial.omega: [[0, 2, 1]]}
    [('[0, 2, 1]',)]
grid: {scheme: [hk, {name: hybrid, branch: sign}]}
    [('hk',), ('hybrid:branch=sign',)]
grid: {output.every: [100]}
    [(100,)]
"""


@pytest.mark.parametrize(("sections", "keys"), cases_of(KEYS))
def test_keys_of_rows(sections: str, keys: list[str]) -> None:
    """The last key of a grid varies fastest; a row is the experiment that its config says."""
    sweep = load_sweep({"base": BASE, **parse_yaml(sections.replace("; ", "\n"), "x")[0]})
    listed = rows_of(sweep)
    assert [row.keys for row in listed] == ast.literal_eval(keys[0])
    for number, row in enumerate(listed):
        single = sweep.row(number)
        assert (single.digest, single.y0) == (row.identity, row.state)
        assert load_experiment(single.resolved()).digest == row.identity


def test_a_component_completes_its_vector() -> None:
    (component,) = rows(grid={"initial.gamma3": [0.6]})
    assert component.state == (2.0, 0.0, 0.0, math.sqrt(1.0 - 0.6 * 0.6), 0.0, 0.6)


def test_ranges_have_both_ends_and_even_spacing() -> None:
    log = [row.experiment.h for row in rows(grid={"h": {"from": 1e-4, "to": 1e-1, "count": 7, "spacing": "log"}})]
    assert log[::2] == [1e-4, 1e-3, 1e-2, 1e-1]
    assert all(math.isclose(b / a, 10.0**0.5, rel_tol=1e-13) for a, b in pairwise(log))
    first, last = 0.12345678901234568, 1.7976931348623157e308  # which 15 digits round to infinity
    for spacing in ("linear", "log"):
        grid = {"top.c0": {"from": first, "to": last, "count": 3, "spacing": spacing}}
        values = load_sweep({"base": BASE, "grid": grid}).axes[0]["top.c0"]
        assert (values[0], values[2]) == (first, last)


def test_h_and_the_number_of_steps_follow_from_the_duration() -> None:
    """A step of a range is moved to the nearest that divides the duration."""
    base = {key: value for key, value in BASE.items() if key not in ("h", "N")} | {"T": 10.0}
    assert [(row.experiment.h, row.experiment.N) for row in rows(base=base, grid={"N": [10, 40]})] == [
        (1.0, 10),
        (0.25, 40),
    ]
    moved = rows(base=base, grid={"h": {"from": 0.01, "to": 0.3, "count": 6, "spacing": "log"}})
    assert all(row.experiment.h == 10.0 / row.experiment.N for row in moved)
    assert [row.experiment.N for row in moved] == [round(10.0 / (0.01 * 30.0 ** (i / 5))) for i in range(6)]


RANDOM = {"count": 4, "seed": 3, "omega": {"sphere": 2}, "gamma": "sphere", "top.c0": {"from": 1, "to": 2}}


def test_the_seed_and_the_sample_alone_change_what_is_drawn() -> None:
    """Schemes, steps and tops start from the same states; an initial vector that is drawn is not needed."""
    by_sample: dict[int, set[tuple[float, ...]]] = {}
    for row in rows(random=RANDOM, grid={"scheme": ["hk", "rk4"], "h": [0.01, 0.02], "top.A": [2.0, 3.0]}):
        c0 = row.experiment.resolved()["top"]["c0"]
        by_sample.setdefault(row.keys[3], set()).add((*row.state, c0))
    assert [len(states) for states in by_sample.values()] == [1, 1, 1, 1]
    assert len(set.union(*by_sample.values())) == 4
    (other,) = rows(random={**RANDOM, "count": 1, "seed": 4})
    assert not {*other.state} & set().union(*set.union(*by_sample.values()))
    bare = {key: value for key, value in BASE.items() if key != "initial"}
    assert [row.state for row in rows(base=bare, random=RANDOM)] == [row.state for row in rows(random=RANDOM)]


def test_overrides_reach_the_base_and_the_grid() -> None:
    data = {"base": BASE, "grid": {"h": [0.1], "top.c0": [1.0]}}
    changed = rows_of(load_sweep(data, ["base.N=7", "base.top.A=3", "grid.top.c0=[5, 6]", "base.initial.omega1=1"]))
    assert [row.keys for row in changed] == [(0.1, 5.0), (0.1, 6.0)]
    assert (changed[0].experiment.N, changed[0].experiment.resolved()["top"]["A"]) == (7, 3.0)
    assert changed[0].state[0] == 1.0
