"""Class, frequencies and distance to a separatrix of Kowalevski motions, against quadrature and formulas."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath as _mpmath
import numpy as np
import pytest

from cases import MOTIONS, numbers_of
from topcli.analysis.motion import Motion
from topcli.analysis.motion.of_top import motion_of
from topcli.schemes.kowalevski.separation import separated_motion
from topcli.tops.kowalevski import Kowalevski

mpmath: Any = _mpmath  # its annotations make every root complex
STATES = numbers_of(MOTIONS["tori"])
"""A state of each region."""


def motion(y, c0: float = 1.0, A: float = 2.0) -> Motion:
    return motion_of(Kowalevski(c0=c0, A=A), tuple(map(float, y)))


def constants(y, c: float = 1.0) -> tuple[float, float, float, float]:
    """E, L = l c, G = c² gamma² and k², from the definitions."""
    w1, w2, w3, g1, g2, g3 = y
    E, two_l = w1 * w1 + w2 * w2 + w3 * w3 / 2 + c * g1, 2 * (w1 * g1 + w2 * g2) + w3 * g3
    k_sq = (w1 * w1 - w2 * w2 - c * g1) ** 2 + (2 * w1 * w2 - c * g2) ** 2
    return E, c * two_l / 2, c * c * (g1 * g1 + g2 * g2 + g3 * g3), k_sq


@pytest.mark.slow
@pytest.mark.parametrize("name", STATES)
def test_regions_and_tori(name: str) -> None:
    y = STATES[name]
    torus = motion(y)
    tori = {"I": "the only torus", "V": "one of 4 tori"}.get(name, "one of 2 tori")
    assert (torus.kind, tori in torus.title) == (f"torus {name}", True)
    E, L, G, k_sq = constants(y)
    integrals = [torus[name] for name in ("energy", "two_l", "gamma_sq", "k_sq")]
    assert integrals == pytest.approx([E, 2 * L, G, k_sq], rel=1e-14)


def half_periods(y) -> list[tuple[Any, Any]]:
    """Integrals of ds/|w| and s ds/|w| over the ovals of s1 and s2; angles remove the roots at the ends."""
    E, L, G, k_sq = constants([mpmath.mpf(v) for v in y], mpmath.mpf(1))
    m, k = E / 3, mpmath.sqrt(k_sq)
    cubic = [-(m * (k_sq - G - m * m) + L * L), -(k_sq - G + 3 * m * m), 0, 4]
    roots = [*mpmath.polyroots(cubic, extraprec=200, maxsteps=200, asc=True), (m + k) / 2, (m - k) / 2]
    ends = sorted((z for z in roots if abs(mpmath.im(z)) < 1e-20), key=mpmath.re)
    low, a, b = ends[0], ends[-2], ends[-1]

    def upper(angle: Any, power: int) -> Any:
        s = mpmath.re(a + (b - a) * mpmath.sin(angle) ** 2)
        return s**power / mpmath.sqrt(mpmath.fprod(abs(s - z) for z in roots if z not in (a, b)))

    def lower(angle: Any, power: int) -> Any:
        S, C = mpmath.sin(angle), mpmath.cos(angle)
        rest = mpmath.fprod(abs((z - low) * C**2 + S**2) for z in roots if z != low)
        return mpmath.re(low * C**2 - S**2) ** power * C ** (2 - 2 * power) / mpmath.sqrt(rest)

    grid = [n * mpmath.pi / 8 for n in range(5)]

    def integral(density: Callable[..., Any], power: int) -> Any:
        return mpmath.quad(lambda angle: density(angle, power), grid)

    return [(integral(density, 0), integral(density, 1)) for density in (upper, lower)]


@pytest.mark.slow
@pytest.mark.parametrize("name", STATES)
def test_periods_by_quadrature(name: str) -> None:
    """To thirty digits, which states after 1e20 steps need."""
    torus, separated = motion(STATES[name]), separated_motion([Fraction(v) for v in STATES[name]], 1.0)
    with mpmath.workdps(45):
        (a, P), (b, Q) = half_periods(STATES[name])
        for oval, rate, value in zip(("s1", "s2"), separated.rates, (b, a), strict=True):
            period = 2 * abs(a * Q - b * P) / value
            assert abs(mpmath.mpf(rate) * period / 2 - 1) < 1e-30
            assert torus[f"period.{oval}"] == pytest.approx(float(period), rel=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("eps", [1e-3, 1e-6])
def test_time_between_swings_near_the_homoclinic_orbit(eps: float) -> None:
    found = motion((2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps))
    law = 2.0 * math.sqrt(2.0) * math.log(8.0 * math.sqrt(7.0) / eps)
    assert found["period.omega2"] == pytest.approx(law, rel=10 * eps**2 + 1e-12)
    if eps == 1e-3:
        assert round(found["period.omega2"], 4) == 28.1716


def collision_distance(E: float, L: float, G: float, k_sq: float) -> float:
    """Smallest distance of two roots of Phi, relative to the largest."""
    m, k = E / 3, math.sqrt(max(k_sq, 0.0))
    cubic = np.roots([4, 0, -(k_sq - G + 3 * m * m), -(m * (k_sq - G - m * m) + L * L)])
    roots = np.array([*cubic, (m + k) / 2, (m - k) / 2])
    apart = np.abs(roots[:, None] - roots[None, :]) + np.eye(5) * 1e9
    return float(apart.min() / np.abs(roots).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", STATES)
def test_two_roots_coincide_at_the_distance_of_the_separatrix(name: str) -> None:
    E, L, G, k_sq = constants(STATES[name])
    found = motion(STATES[name])["separatrix.distance"]
    assert collision_distance(E, L, G, k_sq) > 1e-2
    k = math.sqrt(k_sq)
    moved = [(E + found, k_sq), (E - found, k_sq), (E, (k + found) ** 2), (E, (k - found) ** 2)]
    assert min(collision_distance(E, L, G, k_sq) for E, k_sq in moved) < 1e-6


CRITICAL = numbers_of(MOTIONS["critical curves"])
"""The kind of motion comes first."""


@pytest.mark.slow
@pytest.mark.parametrize("name", CRITICAL)
def test_motions_on_critical_curves_have_no_frequencies(name: str) -> None:
    kind, found = name.partition(",")[0], motion(CRITICAL[name])
    assert found.kind == kind
    distance = ["separatrix.distance"] if kind == "separatrix" else []
    assert list(found) == ["gamma_sq", "two_l", "energy", "k_sq", *distance]
