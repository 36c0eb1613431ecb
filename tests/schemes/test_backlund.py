"""The integrable map: against the dressing of the Lax matrix with 50 digits, Poisson, commuting, drift, projection."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf

from conftest import GEN, PAPER, random_states
from steppers import physical
from test_beyond import DELONE, deviations, ran
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Outcome, Stepper
from topcli.schemes.kowalevski.backlund_parameters import (
    frozen_constants,
    longest_step,
    tau_at,
    tau_of,
)
from topcli.schemes.kowalevski.backlund_step import numerators, physical_step, scaled_step
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski

HANGING = (0.05, -0.03, 0.02, -math.sqrt(1.0 - 0.1**2 - 0.2**2), 0.1, 0.2)
CHOICES: list[dict[str, Any]] = [
    {},
    {"constants": "recomputed"},
    {"project": 1},
    {"substeps": "auto"},
    {"compensated": True},
    {"compensated": True, "constants": "recomputed"},
    {"compensated": True, "substeps": "auto"},
]
Vector = Sequence[Any]


def stepper(top: Kowalevski | None = None, name: str = "backlund", **options: Any) -> Stepper:
    scheme = find_scheme(name, "kowalevski")
    made = scheme.build(top or Kowalevski(), scheme.options(**options))
    assert isinstance(made, Stepper)
    return made


def limit(y: Floats, c: float = 1.0) -> float:
    """The longest admissible step."""
    return longest_step(*frozen_constants(y, (c,))[:4])


# The same map by other formulas, with 50 digits


def integrals(y: Vector, c: Any) -> list[Any]:
    """gamma², 2l, E, k² for C = 1."""
    w1, w2, w3, g1, g2, g3 = y
    k_sq = (w1 * w1 - w2 * w2 - c * g1) ** 2 + (2 * w1 * w2 - c * g2) ** 2
    two_l = 2 * (w1 * g1 + w2 * g2) + w3 * g3
    return [g1 * g1 + g2 * g2 + g3 * g3, two_l, w1 * w1 + w2 * w2 + w3 * w3 / 2 + c * g1, k_sq]


def nus(y: Vector, h: Any, c: Any) -> list[Any]:
    """The two eigenvalues near -4/h of the Lax matrix at lambda = -2/h, from its characteristic polynomial."""
    gamma_sq, two_l, energy, k_sq = integrals(y, c)
    alpha, q = -2 / h, c * c * h * h / 4
    discriminant = 16 * k_sq + q * (4 * two_l**2 - 8 * energy * gamma_sq) + q * q * gamma_sq**2
    root = mpmath.sqrt(mpmath.mpc(discriminant))
    halves = [2 * energy - q * gamma_sq / 2 - sign * root / 2 for sign in (1, -1)]
    return [mpmath.sign(alpha) * mpmath.sqrt(4 * alpha**2 - e2) for e2 in halves]


def lax(m: Vector, gamma: Vector, lam: Any, c: Any) -> Any:
    """The 5x5 Lax matrix of Bobenko, Reyman, Semenov-Tian-Shansky."""
    m1, m2, m3 = m
    v = [-c / lam * g for g in gamma]
    v[0] += 2 * lam
    return mpmath.matrix(
        [
            [0, m3, -m2, v[0], 0],
            [-m3, 0, m1, v[1], 2 * lam],
            [m2, -m1, 0, v[2], 0],
            [v[0], v[1], v[2], 0, -m3],
            [0, 2 * lam, 0, m3, 0],
        ]
    )


def null_vector(A: Any) -> list[Any]:
    """The vector with A x = 0 and the last component 1."""
    x = mpmath.qr_solve(A[:, :4], -A[:, 4])[0]
    return [*x, mpf(1)]


def elementary(m: Vector, gamma: Vector, h: Any, nu: Any, c: Any) -> tuple[list[Any], list[Any]]:
    """One Bäcklund transformation: the dressing with the eigenvector (a; b), in vectors."""
    alpha = -2 / h
    x = null_vector(lax(m, gamma, alpha, c) - nu * mpmath.eye(5))
    size_a = mpmath.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
    size_b = mpmath.sqrt(x[3] ** 2 + x[4] ** 2)
    a, b = [x[0] / size_a, x[1] / size_a, x[2] / size_a], [x[3] / size_b, x[4] / size_b, mpf(0)]

    def reflected(v: Vector, axis: Vector) -> list[Any]:
        along = sum(p * q for p, q in zip(v, axis, strict=True))
        return [p - 2 * along * q for p, q in zip(v, axis, strict=True)]

    cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    return (
        [4 * alpha * p - q for p, q in zip(cross, reflected(m, b), strict=True)],
        reflected(reflected(gamma, a), b),
    )


def dressed(y: Vector, h: Any, c: Any) -> list[Any]:
    """Two transformations with the two eigenvalues; the state in between may be complex."""
    m, gamma = [2 * y[0], 2 * y[1], y[2]], list(y[3:])
    for nu in nus(y, h, c):
        m, gamma = elementary(m, gamma, h, nu, c)
    return [mpmath.re(v) for v in (m[0] / 2, m[1] / 2, m[2], *gamma)]


def exact_tau(y: Vector, h: Any, c: Any) -> Any:
    """tau = 2 - (nu1 + nu2)/(2 alpha) for the step -2/alpha."""
    return mpmath.re(2 + sum(nus(y, h, c)) * h / 4)


def with_digits(step: Callable[[Vector, Any, Any], Sequence[Any]], y: Vector, h: Any, c: Any) -> list[Any]:
    """A step in mpmath's current precision, from floats or numbers of mpmath."""
    return list(step([mpf(v) for v in y], mpf(h), mpf(c)))


def exact_step(y: Vector, h: Any, c: Any) -> list[Any]:
    """The product's algebra in mpmath, its parameter tau by the eigenvalues."""
    k = -h / 2
    z = scaled_step((k * y[0], k * y[1], k * y[2] / 2, *y[3:]), c * h * h / 8, exact_tau(y, h, c))
    return [z[0] / k, z[1] / k, 2 * z[2] / k, *z[3:]]


CASES = [
    (GEN, 0.3, 1.0),
    (GEN, -1.2, 1.0),
    (PAPER, 0.5, 1.0),
    (DELONE, 0.4, 1.0),
    ((0.3, 1.1, -0.8, 0.0, 0.6, -0.8), 0.7, -0.7),
    ((-1.4, 0.2, 0.9, 0.48, -0.64, 0.6), 0.4, 2.5),
    ((1.1, -0.6, 0.4, 0.6, 0.0, 0.8), 0.8, 0.0),
    (HANGING, 2.0, 1.0),
]


@pytest.mark.parametrize(("y", "h", "c"), CASES)
def test_equals_the_dressing(y: Floats, h: float, c: float) -> None:
    """With 60 digits two elementary transformations, one after the other, and the integrals; in double round-off."""
    with mp.workdps(60):
        found, expected = with_digits(exact_step, y, h, c), with_digits(dressed, y, h, c)
        assert max(abs(p - q) for p, q in zip(found, expected, strict=True)) < 1e-45
        before, after = integrals([mpf(v) for v in y], mpf(c)), integrals(found, mpf(c))
        assert max(abs(p - q) for p, q in zip(before, after, strict=True)) < 1e-50
        assert max(abs(p - q) for p, q in zip(found, y, strict=True)) > 5e-4
        tau = float(exact_tau([mpf(v) for v in y], mpf(h), mpf(c)))
        exact = [float(v) for v in expected]
    assert tau_of(h, *frozen_constants(y, (c,))[:4]) == pytest.approx(tau, rel=1e-14)
    assert tau_at(y, h, c) == pytest.approx(tau, rel=1e-14)
    np.testing.assert_allclose(physical_step(y, h, c, tau), exact, rtol=0, atol=3e-15)
    for options in CHOICES:
        made = stepper(Kowalevski(c0=c), **options)
        # next to an equilibrium the gradients are nearly dependent, and a projection magnifies round-off
        bound = 3e-12 if y is PAPER and "project" in options else 3e-15
        np.testing.assert_allclose(physical(made)(y, h, (c,)), exact, rtol=0, atol=bound)


def test_small_steps_do_not_cancel() -> None:
    """The change of the state has a relative error of a few ulp at any h."""
    for h in (1e-3, 1e-6, 1e-9):
        with mp.workdps(60):
            y = [mpf(v) for v in GEN]
            change = [float(p - q) for p, q in zip(exact_step(y, mpf(h), mpf(1)), y, strict=True)]
        k = -0.5 * h
        z = (k * GEN[0], k * GEN[1], 0.5 * k * GEN[2], *GEN[3:])
        x1, x2, x3, y1, y2, y3, r, q = numerators(z, 0.125 * h * h, tau_of(h, *frozen_constants(GEN, (1.0,))[:4]))
        found = np.array([x1 / k * r, x2 / k * r, 2.0 * x3 / k * r, y1 * q, y2 * q, y3 * q])
        assert np.abs(found - change).max() < 2e-15 * np.abs(change).max()


def jacobian(step: Callable[[Vector], Vector], y: Vector) -> Any:
    """Derivatives with respect to (m, gamma) by differences, in mpmath's precision; an error of 1e-30 or so."""
    scale, d = [2, 2, 1, 1, 1, 1], mpf(10) ** -20
    J = mpmath.matrix(6, 6)
    for j in range(6):
        ahead, back = list(y), list(y)
        ahead[j] += d / scale[j]
        back[j] -= d / scale[j]
        for i, (p, q) in enumerate(zip(step(ahead), step(back), strict=True)):
            J[i, j] = scale[i] * (p - q) / (2 * d)
    return J


def poisson(y: Vector) -> Any:
    """The matrix of the bracket of e(3) at omega, gamma, for (m, gamma)."""

    def hat(v: Vector) -> list[list[Any]]:
        return [[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]]

    m, g = hat([2 * y[0], 2 * y[1], y[2]]), hat(y[3:])
    return mpmath.matrix([m[i] + g[i] for i in range(3)] + [g[i] + [0, 0, 0] for i in range(3)])


def poisson_defect(step: Callable[[Vector], Vector], y: Vector) -> tuple[float, float]:
    """Largest element of J P J^T - P', and det J - 1."""
    J = jacobian(step, y)
    off = J * poisson(y) * J.T - poisson(step(y))
    return float(max(abs(v) for v in off)), float(mpmath.det(J) - 1)


@pytest.mark.parametrize(("y", "h", "c"), [CASES[0], CASES[4], CASES[5]])
def test_poisson_and_volume(y: Floats, h: float, c: float) -> None:
    """J P J^T = P at the image and det J = 1, with tau as a function of the state; HK has neither."""
    with mp.workdps(50):
        start = [mpf(v) for v in y]
        defect, volume = poisson_defect(lambda z: exact_step(z, mpf(h), mpf(c)), start)
        assert (defect, abs(volume)) < (1e-28, 1e-28)
        frozen = exact_tau(start, mpf(h), mpf(c))
        k = -mpf(h) / 2

        def with_frozen_tau(z: Vector) -> list[Any]:
            s = scaled_step((k * z[0], k * z[1], k * z[2] / 2, *z[3:]), mpf(c) * k * k / 2, frozen)
            return [s[0] / k, s[1] / k, 2 * s[2] / k, *s[3:]]

        assert 1e-3 < -poisson_defect(with_frozen_tau, start)[1] < 1.0  # it contracts volume
        number: Any = mpf
        hk_defect, hk_volume = poisson_defect(lambda z: hk_kowalevski(tuple(z), number(h), (number(c),)), start)
    if y is GEN:
        assert hk_defect == pytest.approx(8.54e-3, rel=1e-3)
        assert hk_volume == pytest.approx(-1.297e-2, rel=1e-3)


def test_steps_commute() -> None:
    """Steps of different lengths, of either sign, in any order; HK's do not."""
    step, hk = physical(stepper()), physical(find_scheme("hk", "kowalevski").build(Kowalevski(), None))
    for y in map(tuple, random_states(20, seed=71)):
        longest = limit(y)
        for first, second in ((0.9, 0.3), (0.5, -0.8)):
            p, q = first * longest, second * longest
            one, other = step(step(y, p, (1.0,)), q, (1.0,)), step(step(y, q, (1.0,)), p, (1.0,))
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-13)
    off = np.subtract(hk(hk(GEN, 0.4, (1.0,)), 0.1, (1.0,)), hk(hk(GEN, 0.1, (1.0,)), 0.4, (1.0,)))
    assert np.abs(off).max() == pytest.approx(1.0297e-3, rel=1e-3)


@pytest.mark.parametrize("c0", [1.0, -0.7, 2.0, 0.0])
def test_commutes_with_the_motion(c0: float) -> None:
    """The step of the state at t = 1 is the motion of the stepped state, at 0.1 to 0.9 of the longest step."""
    top, time = Kowalevski(c0=c0, A=3.0), np.array([1.0])
    p = top.constants()
    step = physical(stepper(top))
    for y in map(tuple, random_states(6, seed=72)):
        for fraction in (0.1, 0.5, 1.0):
            h = fraction * min(limit(y, p[0]), 3.0) * (1.0 - 1e-12)
            later = tuple(reference_states(top, y, time)[0].tolist())
            stepped = reference_states(top, step(y, h, p), time)[0]
            np.testing.assert_allclose(step(later, h, p), stepped, rtol=0, atol=1e-13)


# Frozen constants, drift, projection


def deviations_of_tau(made: Stepper, h: float, steps: int) -> list[float]:
    """|tau(y) - tau(y0)| along a run that starts off the surface of its constants, by 1e-6 of omega1."""
    assert made.enter is not None
    tau = tau_of(h, *frozen_constants(GEN, (1.0,))[:4])
    s = made.enter(GEN, h, (1.0,))
    s = (s[0] * (1.0 + 1e-6), *s[1:])
    off = []
    for _ in range(steps):
        off.append(abs(tau_at(made.leave(s, h, (1.0,)) if made.leave else s[:6], h, 1.0) - tau))
        s = made.step(s, h, (1.0,))
    return off


@pytest.mark.slow
def test_frozen_constants_contract() -> None:
    """A state off the surface tau(y) = tau returns to it; with recomputed constants the deviation stays."""
    off = deviations_of_tau(stepper(), 0.6, 200)
    assert off[0] > 1e-8
    assert off[-1] < 2e-15
    kept = deviations_of_tau(stepper(constants="recomputed"), 0.6, 200)
    assert kept[-1] == pytest.approx(kept[0], rel=1e-6)


@pytest.mark.parametrize(("options", "bound"), [({}, 0.3), ({"project": 16}, 0.1)])
def test_long_steps_keep_all_four(options: dict[str, Any], bound: float) -> None:
    """Up to the longest step, within part of 50 ulp sqrt(N): 0.1 and 0.02 are typical. HK leaves at once."""
    made, N = stepper(**options), 4000
    for y in map(tuple, np.vstack([random_states(8, seed=73), 1.5 * random_states(4, seed=74)])):
        h = limit(y)
        states, ending = ran(made, y, h, N, 10)
        assert ending.outcome is Outcome.COMPLETED
        assert max(deviations(states).values()) < bound * 50.0 * math.sqrt(N)
        if options:
            assert ending.counters["unmet"] == 0


@pytest.mark.slow
def test_round_off_grows_as_a_random_walk() -> None:
    """Over 2e5 steps, up to the longest step: an error that repeats in every step would reach hundreds of ulp."""
    N, worst = 200_000, []
    for y in map(tuple, random_states(5, seed=75)):
        for fraction in (0.05, 0.5, 1.0):
            states, ending = ran(stepper(), y, fraction * limit(y), N, 200)
            assert ending.outcome is Outcome.COMPLETED
            worst.append(max(deviations(states).values()) / math.sqrt(N))
    assert max(worst) < 20.0  # typical: 0.5 to 4
    assert np.median(worst) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["suzuki4", "kahan-li6", "kahan-li8"])
@pytest.mark.parametrize(("part", "options", "bound"), [(0.3, {}, 50.0), (1.0, {"project": 16}, 1.0)])
def test_long_runs_with_a_composition(name: str, part: float, options: dict[str, Any], bound: float) -> None:
    """Stages of several lengths, some negative, all with constants of their own; projection keeps the longest steps.

    Typically 4 ulp times sqrt(N) at 0.3 of the longest step, 0.2 with projection.
    """
    for y in map(tuple, random_states(2, seed=76)):
        scheme = find_scheme(f"backlund+{name}", "kowalevski")
        assert scheme.longest_step is not None
        h = part * scheme.longest_step(Kowalevski(), y, scheme.options())
        states, ending = ran(stepper(name=scheme.name, **options), y, h, 20_000, 20)
        assert ending.outcome is Outcome.COMPLETED
        assert max(deviations(states).values()) < bound * math.sqrt(20_000)


COMPENSATED = [
    ("backlund", {}, 0.01, 20.0),
    ("backlund", {}, 0.1, 1.4),
    ("backlund", {"substeps": "auto"}, 0.01, 20.0),
    ("backlund", {"constants": "recomputed"}, 0.01, 20.0),
    ("backlund+suzuki4", {}, 0.02, 10.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options", "h", "gain"), COMPENSATED)
def test_compensation_reduces_drift(name: str, options: dict[str, Any], h: float, gain: float) -> None:
    """The largest deviation of an integral after 2e5 steps, median of six states: typically 1/40; 1/2 at h = 0.1."""
    gains = []
    for y in map(tuple, random_states(6, seed=88)):
        plain, better = (
            max(deviations(ran(stepper(name=name, compensated=value, **options), y, h, 200_000, 500)[0]).values())
            for value in (False, True)
        )
        gains.append(plain / better)
    assert np.median(gains) > gain


@pytest.mark.slow
def test_projection_near_the_hanging_top() -> None:
    """There deviations do not contract: without projection 2l deviates by 19 times the bound, with it by nothing."""
    y0, N = (1e-3, -5e-4, 8e-4, -math.sqrt(1.0 - 5e-6), 1e-3, -2e-3), 100_000
    bound = 50.0 * math.sqrt(N)
    off, _ = ran(stepper(), y0, 1.0, N, 100)
    assert 2.0 < deviations(off)["two_l"] / bound < 30.0
    states, ending = ran(stepper(project=16), y0, 1.0, N, 100)
    assert max(deviations(states).values()) < 20.0
    assert ending.counters["unmet"] == 0


def test_projection_restores_the_first_values_every_k_steps() -> None:
    """From a state off its constants: nothing for two steps, then all four integrals at once."""
    made = stepper(project=3)
    assert made.enter is not None
    s = made.enter(GEN, 0.3, (1.0,))
    s = (s[0] + 1e-9, *s[1:])
    off = []
    for _ in range(3):
        s = made.step(s, 0.3, (1.0,))
        off.append(max(abs(p - q) for p, q in zip(integrals(s[:6], 1.0), integrals(GEN, 1.0), strict=True)))
    assert min(off[:2]) > 1e-10
    assert off[2] < 1e-14
    assert s[-3] >= 1.0
    assert s[-1] == 0.0


@pytest.mark.slow
def test_compiled_and_interpreted_agree() -> None:
    for options in CHOICES:
        made = stepper(**options)
        assert made.enter is not None
        h = 2.0 if "substeps" in options else 0.4
        s = made.enter(GEN, h, (1.0,))
        for _ in range(30):
            s = made.step(s, h, (1.0,))
        states, _ = ran(made, GEN, h, 30)
        assert tuple(states[-1]) == (made.leave(s, h, (1.0,)) if made.leave else s)[:6], options
