"""The closed forms of the Euler top against Taylor series and iterated maps at 30 digits and more.

``TOPCLI_RANDOM_TOPS=200 pytest tests/tops/test_euler_exact.py`` compares 200 random tops with mpmath (minutes).
"""

from __future__ import annotations

import math
import os
from decimal import Decimal, localcontext
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf

from conftest import GEN
from test_euler import random_tops
from topcli.analysis.reference import reference_states
from topcli.arithmetic.elliptic import DIGITS, carlson_rc, carlson_rf, carlson_rj, jacobi, to_dd
from topcli.contracts import Outcome, Sampler, Top
from topcli.engine.loop import Run
from topcli.errors import RunError
from topcli.schemes.registry import find_scheme
from topcli.tops.euler import Euler, EulerGamma

RANDOM_TOPS = int(os.environ.get("TOPCLI_RANDOM_TOPS", "12"))
OMEGA_BAR, GAMMA_BAR = 1e-13, 1e-11
SEPARATRIX = (0.7, 0.1, 0.7 * math.sqrt(3.0))
"""For A, B, C = 3, 2, 1 the separatrix is omega3² = 3 omega1²."""


def sampled(name: str, top: Top, y0, h: float, n) -> np.ndarray:
    method = find_scheme(name, top.form).build(top, None)
    assert isinstance(method, Sampler)
    return method.states(np.array(y0, dtype=float), h, np.array(n, dtype=np.int64), top.constants())


def taylor(moments, y0, t: float, digits: int = 34, order: int = 32) -> list[mpf]:
    """The free motion with gamma at time t by Taylor series in mpmath; all inputs are exact numbers."""
    with mp.workdps(digits + 6):
        I = [mpf(x) for x in moments]  # noqa: E741
        alpha = [(I[1] - I[2]) / I[0], (I[2] - I[0]) / I[1], (I[0] - I[1]) / I[2]]
        y, now, end = [mpf(float(x)) for x in y0], mpf(0), mpf(t)
        while now < end:
            w, g = ([[x] for x in y[:3]], [[x] for x in y[3:]])
            for m in range(order):
                new_w, new_g = [], []
                for i in range(3):
                    j, k = (i + 1) % 3, (i + 2) % 3
                    new_w.append(alpha[i] * mp.fdot(w[j], w[k][::-1]) / (m + 1))
                    new_g.append((mp.fdot(g[j], w[k][::-1]) - mp.fdot(g[k], w[j][::-1])) / (m + 1))
                for i in range(3):
                    w[i].append(new_w[i])
                    g[i].append(new_g[i])
            last = max(abs(series[order]) for series in (*w, *g)) + mpf(10) ** -60
            step = min((mpf(10) ** -digits / last) ** (mpf(1) / order), end - now, mpf(1))
            powers = [step**m for m in range(order + 1)]
            y = [mp.fdot(series, powers) for series in (*w, *g)]
            now += step
        return y


def missed(states: np.ndarray, exact: list[mpf]) -> tuple[float, float]:
    """Largest errors of omega and of gamma."""
    errors = [abs(float(mpf(float(x)) - e)) for x, e in zip(states, exact, strict=True)]
    return max(errors[:3]), max(errors[3:])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(RANDOM_TOPS))
def test_exact_is_the_motion_at_thirty_digits(seed: int) -> None:
    """At t = 50, against Taylor series in mpmath."""
    ((top, y0),) = random_tops(1, seed=100 + seed)
    omega, gamma = missed(sampled("exact", top, y0, 0.5, [100])[0], taylor((top.A, top.B, top.C), y0, 50.0))
    assert omega < OMEGA_BAR
    assert gamma < GAMMA_BAR


@pytest.mark.slow
@pytest.mark.parametrize("offset", [1e-3, 1e-6, 1e-9, 1e-12, 1e-15, -1e-15, -1e-12, -1e-9, -1e-6, -1e-3])
def test_exact_beside_the_separatrix(offset: float) -> None:
    """From either side, at t = 50; the motion amplifies an error of the offset by 1e12."""
    top, y0 = EulerGamma(), (SEPARATRIX[0] * (1.0 + offset), *SEPARATRIX[1:], *GEN[3:])
    exact = taylor((3, 2, 1), y0, 50.0, digits=44, order=40)
    omega, gamma = missed(sampled("exact", top, y0, 0.5, [100])[0], exact)
    assert omega < OMEGA_BAR
    assert gamma < GAMMA_BAR


def test_separatrix_comparison_detects_an_offset() -> None:
    """Control: offsets 1e-12 apart are distinguished by t = 50."""
    top = EulerGamma()
    states = [
        sampled("exact", top, (0.7 * (1 + e), *SEPARATRIX[1:], *GEN[3:]), 0.5, [100])[0] for e in (1e-9, 1.001e-9)
    ]
    assert np.abs(states[0] - states[1]).max() == pytest.approx(1.35e-07, rel=0.05)


@pytest.mark.slow
def test_exact_is_the_reference() -> None:
    """200 random tops, 400 times up to t = 50, against the package's own Taylor series in double-double."""
    n = np.arange(1, 401)
    for top, y0 in random_tops(200, seed=41):
        error = np.abs(sampled("exact", top, y0, 0.125, n) - reference_states(top, y0, n * 0.125))
        assert error[:, :3].max() < 1e-14
        assert error[:, 3:].max() < 1e-13


SPECIAL = {
    "on the separatrix": ((3.0, 2.0, 1.5), (0.5, 0.1, 1.0)),
    "spherical": ((2.0, 2.0, 2.0), (0.5, 0.1, 1.0)),
    "oblate": ((1.0, 1.0, 1.5), (0.5, 0.1, 1.0)),
    "prolate": ((1.0, 2.0, 2.0), (0.5, 0.1, 1.0)),
    "equatorial": ((1.0, 2.0, 2.0), (0.0, 0.1, 1.0)),
    "nearly symmetric": ((1.0, 1.0 + 1e-12, 2.0), (1.0, 1.0, 1.0)),
    "principal axis": ((3.0, 2.0, 1.0), (0.0, 0.7, 0.0)),
    "at rest": ((3.0, 2.0, 1.0), (0.0, 0.0, 0.0)),
    "no middle component": ((3.0, 2.0, 1.0), (0.5, 0.0, 0.1)),
    "no third component": ((3.0, 2.0, 1.0), (0.5, 0.1, 0.0)),
    "no first component": ((3.0, 2.0, 1.0), (0.0, 0.1, 0.5)),
    "tennis racket": ((3.0, 2.0, 1.0), (1e-9, 0.7, 0.0)),
    "wobble of 1e-12": ((1.0, 3.0, 2.0), (1.0, 1e-12, 1e-10)),
    "impossible body": ((9.0, 2.0, 1.0), (0.5, -0.3, 0.8)),
    "slow": ((3.0, 2.0, 1.0), (7e-8, -4e-8, 1.3e-7)),
}


@pytest.mark.slow
@pytest.mark.parametrize("signs", [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (1, 1, -1), (-1, -1, -1)], ids=str)
@pytest.mark.parametrize("scene", SPECIAL)
def test_exact_in_special_cases(scene: str, signs: tuple[int, int, int]) -> None:
    """Every degenerate case, in every octant up to rotation, forwards and backwards, with and without gamma."""
    (A, B, C), omega = SPECIAL[scene]
    y0 = (*(s * w for s, w in zip(signs, omega, strict=True)), *GEN[3:])
    top, n = EulerGamma(A=A, B=B, C=C), np.arange(1, 201)
    for h in (0.25, -0.25):
        states = sampled("exact", top, y0, h, n)
        assert np.abs(states - reference_states(top, y0, n * h)).max() < 1e-13
        assert np.array_equal(sampled("exact", Euler(A=A, B=B, C=C), y0[:3], h, n), states[:, :3])


@pytest.mark.parametrize("relabel", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)], ids=str)
def test_exact_for_every_order_of_the_moments(relabel: tuple[int, int, int]) -> None:
    A, B, C = (float((3.0, 2.0, 1.0)[i]) for i in relabel)
    for omega in ((0.9, -0.4, 0.3), (0.2, -0.4, 0.9)):
        y0 = (*(omega[i] for i in relabel), *GEN[3:])
        top, n = EulerGamma(A=A, B=B, C=C), np.arange(1, 101)
        assert np.abs(sampled("exact", top, y0, 0.5, n) - reference_states(top, y0, n * 0.5)).max() < 1e-13


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


def hk_iterated(moments, w, h: float, steps: int) -> list[mpf]:
    """The HK map iterated at 40 digits by Cramer's rule on the paper's equations."""
    with mp.workdps(40):
        A, B, C = (mpf(x) for x in moments)
        d = mpf(h) / 2
        a, b, c = d * (B - C) / A, d * (C - A) / B, d * (A - B) / C
        x, y, z = (mpf(float(v)) for v in w)
        for _ in range(steps):
            matrix = mp.matrix([[1, -a * z, -a * y], [-b * z, 1, -b * x], [-c * y, -c * x, 1]])
            x, y, z = mp.lu_solve(matrix, mp.matrix([x, y, z]))
        return [x, y, z]


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.2, 0.05, -0.01])
def test_hk_exact_is_the_iterated_map(h: float) -> None:
    """1000 steps, random tops; the map iterated in double differs by its own round-off, the closed form does not."""
    own = []
    for top, y0 in random_tops(5, seed=50, cls=Euler):
        exact = hk_iterated((top.A, top.B, top.C), y0, h, 1000)
        got = sampled("hk-exact", top, y0, h, [1000])[0]
        assert max(abs(float(mpf(float(g)) - e)) for g, e in zip(got, exact, strict=True)) < 1e-12
        *_, end = Run(top, find_scheme("hk", "euler").build(top, None), y0, h, 1000, 1000)
        own.append(max(abs(float(mpf(float(g)) - e)) for g, e in zip(end.states[-1], exact, strict=True)))
        motion = sampled("exact", top, y0, h, [1000])[0]
        assert 3.4e-7 < np.abs(motion - got).max() < 3.3  # control: the map is not the motion
    assert 1e-15 < np.median(own) < 1e-11


@pytest.mark.parametrize("scene", SPECIAL)
@pytest.mark.parametrize("h", [0.1, -0.1])
def test_hk_exact_in_special_cases(scene: str, h: float) -> None:
    (A, B, C), omega = SPECIAL[scene]
    top = Euler(A=A, B=B, C=C)
    states = Run(top, find_scheme("hk", "euler").build(top, None), omega, h, 100).collect().states
    got = sampled("hk-exact", top, omega, h, np.arange(101))
    assert np.abs(got - states).max() < 1e-13


def test_hk_exact_becomes_the_motion_as_h_vanishes() -> None:
    """At t = 10 the difference falls by four as h halves, down to h = 1e-7, where h² is below round-off."""
    top = Euler()
    gaps = []
    for h in (0.02, 0.01, 0.005):
        n = [round(10 / h)]
        gaps.append(np.abs(sampled("hk-exact", top, GEN[:3], h, n) - sampled("exact", top, GEN[:3], h, n)).max())
    assert np.array(gaps[:-1]) / gaps[1:] == pytest.approx(4.0, rel=0.02)
    n = [10**8]
    assert np.abs(sampled("hk-exact", top, GEN[:3], 1e-7, n) - sampled("exact", top, GEN[:3], 1e-7, n)).max() < 1e-13


def test_hk_exact_says_when_the_step_is_too_long() -> None:
    with pytest.raises(RunError, match=r"hk-exact: h = 1\.5 is too large .* use \|h\| < 0\.577"):
        sampled("hk-exact", Euler(), (0.7, -6.0, 1.3), 1.5, [1])
    assert np.isfinite(sampled("hk-exact", Euler(), (0.7, -6.0, 1.3), 0.577, [1])).all()


def test_a_sampled_run_is_independent_of_its_chunks() -> None:
    top = EulerGamma()
    run = Run(top, find_scheme("exact", top.form).build(top, None), GEN, 0.01, 50_000, 3)
    pieces = [(chunk.n.copy(), chunk.states.copy()) for chunk in run]
    assert len(pieces) > 2
    assert run.ending is not None
    assert run.ending.outcome is Outcome.COMPLETED
    n, states = (np.concatenate([piece[i] for piece in pieces]) for i in (0, 1))
    assert np.array_equal(n, np.arange(0, 50_001, 3))
    assert np.array_equal(states[1:], sampled("exact", top, GEN, 0.01, n[1:]))


@pytest.mark.parametrize(
    "arguments", [("0.3", "1.7", "0.01"), ("0", "1e-30", "1"), ("2", "2", "2"), ("1e-20", "0", "5")]
)
def test_carlsons_integrals_to_thirty_five_digits(arguments: tuple[str, str, str]) -> None:
    with localcontext(prec=DIGITS), mp.workdps(60):
        x, y, z = (Decimal(a) for a in arguments)
        pairs = [(carlson_rf(x, y, z), mpmath.elliprf(*arguments))]
        if y:
            pairs.append((carlson_rc(x, y), mpmath.elliprc(*arguments[:2])))
        for p in ("0.5", "30", "1e-6"):
            pairs.append((carlson_rj(x, y, z, Decimal(p)), mpmath.elliprj(*arguments, p)))
        for got, exact in pairs:
            assert abs(mpf(str(got)) / exact - 1) < mpf(10) ** -35


@pytest.mark.slow
@pytest.mark.parametrize("m1", [1.0, 0.7, 0.01, 1e-6, 1e-12, 1e-25])
def test_jacobis_functions_keep_the_digits_of_the_small(m1: float) -> None:
    """sn, cn and dn to some ulp each of its own size, though cn and dn fall to sqrt(m1) and below."""
    with localcontext(prec=DIGITS):
        quarter = to_dd(carlson_rf(Decimal(0), Decimal(m1), Decimal(1)))
    u = np.concatenate([np.linspace(-1, 1, 41), [1e-12, -1e-200, 1 - 1e-6]]) * quarter[0]
    got = jacobi((u, np.zeros_like(u)), quarter, m1)
    with mp.workdps(60):
        m = 1 - mpf(m1)
        for i, at in enumerate(u):
            for name, values in zip(("sn", "cn", "dn"), got, strict=True):
                exact = mp.ellipfun(name, mpf(float(at)), m=m)
                # K itself has 32 digits, and mpmath's sn(0) and cn(K) are not quite zero
                slack = 32 * 2.0**-52 * abs(exact) + 2.0**-106 * quarter[0]
                assert abs(mpf(float(values[i])) - exact) <= slack, (name, at)


def test_the_digits_of_the_small_are_lost_by_scipy() -> None:
    """Control: the parameter m = 1 - m1 in double does not hold m1, and beyond K nothing is right."""
    from scipy.special import ellipj, ellipkm1

    m1 = 1e-12
    for part, error in ((0.99, 1e-12), (1.5, 1e-8)):
        u = part * ellipkm1(m1)
        exact = mpmath.ellipfun("cn", mpf(u), m=1 - mpf(m1))
        assert abs(ellipj(u, 1.0 - m1)[1] / float(exact) - 1.0) > error


def test_decimal_pi_is_correct() -> None:
    from topcli.arithmetic.elliptic import PI

    with mp.workdps(110):
        assert abs(mpf(str(PI)) - mp.pi) < mpf(10) ** -99
    assert Fraction(PI) != Fraction(math.pi)
