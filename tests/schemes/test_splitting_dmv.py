"""Splitting and discrete Moser-Veselov: what is exact in them, and where they end."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from conftest import GEN
from declared import BODIES, Heavy
from stepping import Steps, made, ran, root_mean_square, states_of
from topcli.analysis.reference import reference_states
from topcli.arithmetic.vectors import orthogonal_rodrigues_increment, rodrigues_increment
from topcli.contracts import Outcome, Top
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

TOPS_TRIED = [*(TOPS[form].new() for form in BODIES), Euler(A=2.0, B=2.0, C=0.7), EulerGamma(A=1.1, B=1.1, C=0.4)]


@pytest.mark.parametrize("change", [2.0**-52, -(2.0**-53), 1e-9, 1e-3, -1e-3])
@pytest.mark.parametrize("gravity", [True, False])
def test_the_closed_form_is_taken_for_equal_moments_only(gravity: bool, change: float) -> None:
    """On both sides of A = B by one bit: a closed form for nearly equal moments would move another top."""

    def body(B: float) -> Top:
        return Heavy(A=1.0, B=B, C=0.7) if gravity else Euler(A=1.0, B=B, C=0.7)

    equal, other = Steps(body(1.0), "splitting"), Steps(body(1.0 + change), "splitting")
    for y in states_of(body(1.0), 5, seed=31):
        assert np.abs(equal(y, 0.4) - other(y, 0.4)).max() > 1e-5


@pytest.mark.slow
def test_rotation_about_an_axis_is_unbiased() -> None:
    """Mean growth of the squared length over some hundred vectors: 1e-18, and 1e-17 without the corrections."""
    means = {}
    for form in (orthogonal_rodrigues_increment, rodrigues_increment):
        vectors, found = np.random.default_rng(29), []
        for axis in np.random.default_rng(30).normal(size=(8, 3)) * 0.2 / math.sqrt(3.0):
            total = Fraction(0)
            for v in vectors.normal(size=(400, 3)).tolist():
                change = form(*axis.tolist(), *v)
                total += sum(
                    (Fraction(x) + Fraction(d)) ** 2 - Fraction(x) ** 2 for x, d in zip(v, change, strict=True)
                )
            found.append(float(total) / 400)
        means[form.__name__] = root_mean_square(np.array(found))
    assert means["orthogonal_rodrigues_increment"] < 3e-18
    assert means["rodrigues_increment"] == pytest.approx(1.04e-17, rel=0.3)


def test_free_symmetric_top_is_exact() -> None:
    """Round-off after a thousand steps, also with steps of several radians."""
    for top in (Euler(A=2.0, B=2.0, C=0.7), EulerGamma(A=1.1, B=1.1, C=0.4), Kowalevski(c0=0.0), Lagrange(mu=0.0)):
        y = GEN[: len(top.components)]
        for h, N in ((0.01, 1000), (2.0, 50)):
            truth = reference_states(top, y, np.array([h * N]))[0]
            assert np.abs(Steps(top, "splitting")(y, h, N) - truth).max() < 2e-13


def test_moser_veselov_keeps_a_small_momentum_along_an_axis_of_symmetry() -> None:
    """Bit for bit, also if it is far below the round-off of the other components."""
    y = (1.0, -0.7, 1e-18, 0.6, 0.0, 0.8)
    assert Steps(Lagrange(), "dmv")(y, 0.05, 1000)[2] == 1e-18
    assert Steps(EulerGamma(A=1.0, B=2.0, C=2.0), "dmv")((1e-18, 1.0, -0.7, 0.6, 0.0, 0.8), 0.05, 1000)[0] == 1e-18


@pytest.mark.parametrize("top", TOPS_TRIED, ids=repr)
def test_too_long_a_step_ends_the_run(top: Top) -> None:
    _, failed = ran(made(top, "dmv"), GEN[: len(top.components)], 3.0, 10, 1, top)
    assert (failed.outcome, failed.step) == (Outcome.NO_CONVERGENCE, 1)
