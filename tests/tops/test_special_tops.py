"""The special tops are cases of the heavy top: reached through it they give the same numbers, to round-off."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import GEN, random_states
from topcli.contracts import Top
from topcli.engine.loop import Run
from topcli.schemes.registry import find_scheme
from topcli.tops.euler import EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

SPECIAL = [
    EulerGamma(A=3.0, B=2.0, C=1.0),
    EulerGamma(A=1.3, B=2.0, C=0.9),
    Lagrange(A=1.4, C=2.1, mu=-0.8),
    Lagrange(A=2.0, C=0.7, mu=1.3),
    Kowalevski(),
    Kowalevski(c0=-1.5, A=3.0),
]


def as_heavy(top: Top) -> Heavy:
    """The heavy top with the same moments and centre of gravity."""
    equations = top.euler_poisson()
    return Heavy(**dict(zip(("A", "B", "C", "x0", "y0", "z0"), (*equations.moments, *equations.gravity), strict=True)))


def end(top: Top, scheme: str, y0, h: float, N: int) -> np.ndarray:
    found = find_scheme(scheme, top.form)
    return Run(top, found.build(top, found.options()), y0, h, N, N).collect().states[-1]


@pytest.mark.slow
@pytest.mark.parametrize("top", SPECIAL, ids=repr)
@pytest.mark.parametrize("scheme", ["hk", "midpoint", "rk4"])
def test_one_step_is_the_heavy_tops(top: Top, scheme: str) -> None:
    for y0 in random_states(20, seed=4):
        assert np.abs(end(top, scheme, y0, 0.05, 1) - end(as_heavy(top), scheme, y0, 0.05, 1)).max() < 4e-15


@pytest.mark.parametrize("top", SPECIAL, ids=repr)
@pytest.mark.parametrize("scheme", ["hk", "midpoint", "rk4"])
def test_a_run_is_the_heavy_tops(top: Top, scheme: str) -> None:
    assert np.abs(end(top, scheme, GEN, 0.02, 1000) - end(as_heavy(top), scheme, GEN, 0.02, 1000)).max() < 2e-11


@pytest.mark.parametrize("top", SPECIAL, ids=repr)
def test_another_top_gives_other_numbers(top: Top) -> None:
    """The control: a centre of gravity moved by a thousandth shows after one step."""
    moved = as_heavy(top).model_copy(update={"y0": 1e-3})
    assert 1e-5 < np.abs(end(top, "hk", GEN, 0.05, 1) - end(moved, "hk", GEN, 0.05, 1)).max() < 8.9e-5
