"""``topcli check``: true declarations hold, false ones and failing code are found; ``topcli.testing`` on tops."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import topcli
from conftest import ROOT, Said
from documentation import read_page
from topcli.contracts import Stepper, Top
from topcli.testing import check_top, differing_lanes, states_near
from topcli.tops.euler import Euler

FILES = read_page(ROOT / "docs" / "own.md").files()
HEUN = "    return Stepper(heun, 3)"


@pytest.fixture
def check(cli: Callable[..., Said]) -> Callable[..., Said]:
    """Check the file of the page with one text replaced."""

    def call(old: str, new: str) -> Said:
        assert FILES["gyrostat.py"].count(old) == 1
        Path("mine.py").write_text(FILES["gyrostat.py"].replace(old, new))
        return cli("check", "mine.py", "--json")

    return call


def rows_of(said: Said) -> dict[str, dict[str, Any]]:
    return {f"{row['of'].split()[0]}: {row['trait']}": row for row in said.json()["tables"][0]["rows"]}


def test_true_declarations_hold(check: Callable[..., Said]) -> None:
    said = check(HEUN, HEUN)
    rows = rows_of(said)
    assert said.code == 0
    assert list(rows) == [
        "gyrostat: field",
        "gyrostat: energy: exact rate",
        "gyrostat: energy: rate on random states",
        "gyrostat: momentum: exact rate",
        "gyrostat: momentum: rate on random states",
        "heun: order 2",
        "heun: ensembles equal single runs",
        "heun: machine code equals Python",
    ]
    assert {row["verdict"] for row in rows.values()} == {"holds"}
    assert said.json()["answer"] == "no declaration is false; 8 hold"


def test_a_false_declaration_is_named(check: Callable[..., Said]) -> None:
    said = check("self_adjoint=False", "self_adjoint=True")
    assert said.code == 4
    assert [key for key, row in rows_of(said).items() if row["verdict"] == "false"] == ["heun: self-adjoint"]
    assert said.err.splitlines()[-1].startswith("error: heun (gyrostat): self-adjoint: ")


def test_code_that_fails_is_named_once(check: Callable[..., Said]) -> None:
    said = check(HEUN, "    raise KeyError('no')")
    assert said.code == 2
    assert said.err.splitlines()[-1] == "error: heun (gyrostat): mine.py:62: in build: KeyError: 'no'"
    assert said.err.count("KeyError") == 1


def test_a_config_gives_parameters_and_the_state() -> None:
    report = topcli.check(scheme=["exact"], config="euler_hk", overrides=["top.A=2.5"])
    assert report.title == "euler, exact (euler)"
    assert set(report.table["verdict"]) == {"holds"}


class Pendulum(Top):
    """Pendulum by its angle, with an energy and a function that is none."""

    kind = "angle-pendulum"
    components = ("angle", "speed")
    g: float = 2.0

    @staticmethod
    def field(y, p):
        return (y[1], -p[0] * math.sin(y[0]))

    integrals: ClassVar = {
        "energy": lambda y, p: y[1] ** 2 / 2 - p[0] * np.cos(y[0]),
        "wrong": lambda y, p: y[1] ** 2 / 2 - 3.0 * np.cos(y[0]),
    }


def test_an_integral_that_is_no_polynomial_is_judged_on_random_states() -> None:
    """The gradient is (2 sin x, v), the field (v, -2 sin x); with 3 cos x it is (3 sin x, v)."""
    y0 = (0.4, 1.1)
    traits = check_top(Pendulum(), y0)
    assert [(trait.trait, trait.holds) for trait in traits] == [
        ("field", True),
        ("energy: rate on random states", True),
        ("wrong: rate on random states", False),
    ]
    states = states_near(y0, 20)[1:]
    s, v = np.sin(states[:, 0]), states[:, 1]
    expected = np.abs(v * s) / np.hypot(3.0 * s, v) / np.hypot(v, 2.0 * s)
    assert traits[2].measured == pytest.approx(expected.max(), rel=1e-6)


def test_lanes_that_differ_in_a_bit_are_counted() -> None:
    states = states_near((0.7, -0.4, 1.3), 9)
    moved = states.copy()
    moved[4, 1] = np.nextafter(moved[4, 1], 2.0)
    assert differing_lanes(Euler(), Stepper(lambda y, h, p: (y[0] + h, y[1], y[2]), 3), moved, states, 0.1, 7) == 1
