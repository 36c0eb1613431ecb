"""Closed forms of the Euler and Lagrange tops and of the HK map, and the elliptic functions that they are made of."""

from __future__ import annotations

import math
from typing import Any

import mpmath as _mpmath
import numpy as np
import pytest

from cases import MOTIONS, numbers_of
from conftest import GEN, random_states
from steppers import built
from test_euler import random_tops
from topcli.analysis.reference import reference_states
from topcli.arithmetic.elliptic import Argument
from topcli.arithmetic.multiprecision import digits
from topcli.contracts import Sampler, Top
from topcli.engine.drive import orbit
from topcli.errors import RunError
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.lagrange import Lagrange, LagrangeInertial

mpmath: Any = _mpmath  # its annotations make every root complex
mp, mpf = mpmath.mp, mpmath.mpf


def sampled(name: str, top: Top, y0, h: float, n) -> np.ndarray:
    method = built(name, top)
    assert isinstance(method, Sampler)
    return method.states(np.array(y0, dtype=float), h, np.array(n, dtype=np.int64), top.constants())


@pytest.mark.slow
def test_exact_is_the_reference() -> None:
    """Random tops, 400 times up to t = 50, against the package's own Taylor series in double-double."""
    n = np.arange(1, 401)
    for top, y0 in random_tops(40, seed=41):
        error = np.abs(sampled("exact", top, y0, 0.125, n) - reference_states(top, y0, n * 0.125))
        assert error[:, :3].max() < 1e-14
        assert error[:, 3:].max() < 1e-13


@pytest.mark.parametrize("offset", [1e-3, 1e-9, 1e-15, -1e-15, -1e-9, -1e-3])
def test_exact_beside_the_separatrix(offset: float) -> None:
    """omega3² = 3 omega1² for A, B, C = 3, 2, 1; by t = 50 the motion amplifies an error of the offset by 1e12."""
    top, y0 = EulerGamma(), (0.7 * (1.0 + offset), 0.1, 0.7 * math.sqrt(3.0), *GEN[3:])
    error = np.abs(sampled("exact", top, y0, 0.5, [100])[0] - reference_states(top, y0, np.array([50.0]))[0])
    assert error[:3].max() < 1e-13
    assert error[3:].max() < 1e-11


SPECIAL = numbers_of(MOTIONS["free bodies"])
"""Moments, then omega."""


@pytest.mark.slow
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1)], ids=str)
@pytest.mark.parametrize("scene", SPECIAL)
def test_exact_in_special_cases(scene: str, signs: tuple[int, int, int]) -> None:
    """Every degenerate case, in every octant up to rotation, forwards and backwards, with and without gamma."""
    A, B, C, *omega = SPECIAL[scene]
    y0 = (*(s * w for s, w in zip(signs, omega, strict=True)), *GEN[3:])
    top, n = EulerGamma(A=A, B=B, C=C), np.arange(1, 201)
    for h in (0.25, -0.25):
        states = sampled("exact", top, y0, h, n)
        assert np.abs(states - reference_states(top, y0, n * h)).max() < 1e-13
        assert np.array_equal(sampled("exact", Euler(A=A, B=B, C=C), y0[:3], h, n), states[:, :3])


def test_exact_after_a_very_long_time() -> None:
    """1e12 steps of 2^-10: the phase is reduced without loss; mpmath's functions at 60 digits say the same."""
    top, n = Euler(), 10**12
    got = sampled("exact", top, GEN[:3], 2.0**-10, [n])[0]
    with mp.workdps(60):
        x, y, z = (mpf(w) for w in GEN[:3])  # 3, 2, 1: L = 3 x² - z² < 0, so the third axis carries dn
        p, q = 2 * y**2 + 6 * x**2, 2 * z**2 + 2 * y**2  # 2 T C - m², m² - 2 T A, up to sign
        m = 1 - 2 * (z**2 - 3 * x**2) / q
        a = (mp.sqrt(p / 6), mp.sqrt(p / 2), mp.sqrt(q / 2))
        sign = -1  # omega2' = -omega3 omega1
        u0 = mp.ellipf(mp.atan2(y / (sign * a[1]), x / a[0]), m)
        u = u0 + mp.sqrt(q / 6) * n / 2**10
        exact = (
            a[0] * mp.ellipfun("cn", u, m=m),
            sign * a[1] * mp.ellipfun("sn", u, m=m),
            a[2] * mp.ellipfun("dn", u, m=m),
        )
        assert max(abs(mpf(float(g)) - e) for g, e in zip(got, exact, strict=True)) < 1e-14


@pytest.mark.parametrize("scene", SPECIAL)
@pytest.mark.parametrize("h", [0.1, -0.1])
def test_hk_exact_in_special_cases(scene: str, h: float) -> None:
    A, B, C, *omega = SPECIAL[scene]
    top = Euler(A=A, B=B, C=C)
    states = orbit(top, built("hk", top), omega, h, 100).states
    got = sampled("hk-exact", top, omega, h, np.arange(101))
    assert np.abs(got - states).max() < 1e-13


def test_hk_exact_says_when_the_step_is_too_long() -> None:
    with pytest.raises(RunError, match=r"hk-exact: h = 1\.5 is too large .* use \|h\| < 0\.577"):
        sampled("hk-exact", Euler(), (0.7, -6.0, 1.3), 1.5, [1])
    assert np.isfinite(sampled("hk-exact", Euler(), (0.7, -6.0, 1.3), 0.577, [1])).all()


@pytest.mark.parametrize("m1", [1.0, 0.7, 0.01, 1e-6, 1e-12, 1e-25])
def test_jacobis_functions_keep_the_digits_of_the_small(m1: float) -> None:
    """sn, cn and dn to some ulp each of its own size, though cn and dn fall to sqrt(m1) and below."""
    turn = np.concatenate([np.linspace(-0.5, 0.5, 21), [1e-12, -1e-200, 0.5 - 1e-6]])
    with digits():
        functions = Argument.of(mp.mpf(0), mp.mpf(1), mp.mpf(m1)).at(turn)
    with mp.workdps(60):
        quarter = mp.ellipk(1 - mpf(m1))
        for i, part in enumerate(turn):
            for name, values in zip(("sn", "cn", "dn"), functions, strict=True):
                exact = mp.ellipfun(name, 2 * quarter * mpf(float(part)), m=1 - mpf(m1))
                # u is a double, and mpmath's sn(0) and cn(K) are not quite zero
                slack = 32 * 2.0**-52 * abs(exact) * max(1, quarter) + mpf(10) ** -40
                assert abs(mpf(float(values[i])) - exact) <= slack, (name, part)


# the Lagrange top


@pytest.mark.slow
def test_lagrange_motions_are_the_reference() -> None:
    times, random = np.arange(0, 2001, 50), np.random.default_rng(5)
    for y0 in random_states(8, seed=6):
        A, C, mu = random.uniform((0.5, 0.3, 0.1), 2.0) * (1.0, 1.0, random.choice([-1.0, 1.0]))
        for top in (Lagrange(A=A, C=C, mu=mu), LagrangeInertial()):
            for h in (0.02, -0.05):
                error = sampled("exact", top, y0, h, times) - reference_states(top, y0, times * h)
                assert np.abs(error).max() < 1e-12


LAGRANGE = numbers_of(MOTIONS["Lagrange tops"])


@pytest.mark.parametrize("y0", LAGRANGE.values(), ids=LAGRANGE)
@pytest.mark.parametrize("mu", [1.0, 0.0, -1.3])
def test_lagrange_motions_of_special_kinds(y0: tuple[float, ...], mu: float) -> None:
    top, n = Lagrange(C=1.0, mu=mu), np.arange(0, 1001, 10)
    assert np.abs(sampled("exact", top, y0, 0.02, n) - reference_states(top, y0, n * 0.02)).max() < 2e-13
