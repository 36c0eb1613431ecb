"""The integrable map: against the dressing of the Lax matrix with 60 digits, its integrals, and its domain."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from mpmath import mp, mpf

import topcli
from conftest import GEN, PAPER, random_states
from steppers import physical
from stepping import deviations, made, ran
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Outcome, Stepper
from topcli.errors import StepTooLongError
from topcli.schemes.kowalevski.backlund_parameters import (
    admits,
    frozen_constants,
    longest_step,
    rounded_tau,
    tau_at,
    tau_of,
)
from topcli.schemes.kowalevski.backlund_step import numerators, physical_step, scaled_step
from topcli.tops.kowalevski import Kowalevski

DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
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


def stepper(top: Kowalevski | None = None, **options: Any) -> Stepper:
    return made(top or Kowalevski(), "backlund", **options)


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
    *((tuple(y), 0.999 * limit(tuple(y)), 1.0) for y in random_states(4, seed=95).tolist()),
]
"""The last ones with nearly the longest step."""


@pytest.mark.parametrize(("y", "h", "c"), CASES)
def test_equals_the_dressing(y: Floats, h: float, c: float) -> None:
    """With 60 digits two elementary transformations, one after the other, and the integrals; in double round-off."""
    with mp.workdps(60):
        start = [mpf(v) for v in y], mpf(h), mpf(c)
        found, expected = exact_step(*start), dressed(*start)
        assert max(abs(p - q) for p, q in zip(found, expected, strict=True)) < 1e-45
        before, after = integrals([mpf(v) for v in y], mpf(c)), integrals(found, mpf(c))
        assert max(abs(p - q) for p, q in zip(before, after, strict=True)) < 1e-50
        assert max(abs(p - q) for p, q in zip(found, y, strict=True)) > 5e-4
        tau = float(exact_tau([mpf(v) for v in y], mpf(h), mpf(c)))
        exact = [float(v) for v in expected]
    assert tau_of(h, *frozen_constants(y, (c,))[:4]) == pytest.approx(tau, rel=1e-14)
    assert tau_at(y, h, c) == pytest.approx(tau, rel=1e-14)
    np.testing.assert_allclose(physical_step(y, h, c, tau), exact, rtol=0, atol=1e-14)
    for options in CHOICES:
        made = stepper(Kowalevski(c0=c), **options)
        # next to an equilibrium the gradients are nearly dependent, and a projection magnifies round-off
        bound = 3e-12 if y is PAPER and "project" in options else 1e-14
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


@pytest.mark.slow
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
        if not {"project", "substeps"} & {*options}:
            continue  # the conformance of schemes tries the other choices
        made = stepper(**options)
        assert made.enter is not None
        h = 2.0 if "substeps" in options else 0.4
        s = made.enter(GEN, h, (1.0,))
        for _ in range(30):
            s = made.step(s, h, (1.0,))
        states, _ = ran(made, GEN, h, 30)
        assert tuple(states[-1]) == (made.leave(s, h, (1.0,)) if made.leave else s)[:6], options


# The domain


def safe(h: np.ndarray, y: Floats, c: float) -> np.ndarray:
    """True where round-off is safe at each of these steps: the limits of the docs on h and 1 - S + P."""
    gamma_sq, two_l, energy, k_sq = integrals(y, c)
    u, q = h * h / 16.0, c * c * h * h / 4.0
    S = u * (4.0 * energy - q * gamma_sq)
    P = u * u * (4.0 * energy**2 - 4.0 * k_sq - q * two_l**2)
    R = 1.0 - S + P
    short = np.maximum(h * h * (2.0 * energy + 2.0 * math.sqrt(k_sq)), h * h * abs(c) * math.sqrt(gamma_sq)) <= 25.0
    return short & (R >= 1.0 / 32.0)


DIPS = (-0.27, 0.3, 2.31, -0.262, -0.903, -0.341)
"""R falls below 1/32 and rises again before 5/sqrt(2E + 2k)."""


@pytest.mark.slow
@pytest.mark.parametrize("c", [1.0, -0.7, 0.0, 30.0])
def test_longest_step_is_the_first_that_is_not_safe(c: float) -> None:
    """On a fine grid; a little more is not admissible, and each of the limits binds for some state."""
    steps = np.linspace(0.0, 40.0, 200_001)[1:]
    for y in [*map(tuple, random_states(12, seed=77)), GEN, PAPER, HANGING, DELONE, DIPS]:
        off = np.flatnonzero(~safe(steps, y, c))
        longest = limit(y, c)
        assert longest == pytest.approx(steps[off[0]], abs=3e-4)
        constants = frozen_constants(y, (c,))[:4]
        assert admits(longest, *constants)
        assert admits(-longest, *constants)
        assert not any(admits(longest * factor, *constants) for factor in np.linspace(1.0 + 1e-9, 1.5, 51))


def test_extreme_states_have_a_domain() -> None:
    """At rest without gravity every step is possible; beyond |omega| = 1e154 none is."""
    assert limit((0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0) == 1e300
    assert limit((1e150, 0.0, 0.0, 0.0, 0.0, 1.0)) == pytest.approx(math.sqrt(31.0 / 32.0) * 2e-150, rel=1e-6)
    assert limit((1e200, 0.0, 0.0, 0.0, 0.0, 1.0)) == 0.0
    assert limit((1e-100, 0.0, 0.0, 0.0, 0.0, 1.0), 0.0) == pytest.approx(math.sqrt(31.0 / 32.0) * 2e100, rel=1e-6)


def simulated(scheme: Any = "backlund", h: float = 0.5, N: int = 3, **others: Any) -> topcli.Trajectory:
    initial = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}
    return topcli.simulate({"top": "kowalevski", "initial": initial, "scheme": scheme, "h": h, "N": N, **others})


@pytest.mark.parametrize(
    ("options", "longest", "named"),
    [
        ({}, 1.65, r"^h: \|h\| must be at most (1\.65) under backlund from this state, not 1\.\d+, or"),
        ({"compose": "suzuki4"}, 2.5, r"at most (2\.5\d*)"),
        ({"nodes": "exact"}, 2.7, r"at most (2\.7\d+) under backlund"),
    ],
    ids=str,
)
def test_too_long_a_step_is_refused_before_the_run(options: dict[str, Any], longest: float, named: str) -> None:
    """The message names the longest step, which is accepted in either direction; a composition counts stages."""
    scheme = {"name": "backlund", **options}
    with pytest.raises(StepTooLongError, match=named) as refusal:
        simulated(scheme, 1.05 * longest)
    found = re.search(named, str(refusal.value))
    assert found
    for sign in (1.0, -1.0):
        assert simulated(scheme, sign * float(found[1])).outcome is Outcome.COMPLETED
    with pytest.raises(StepTooLongError):
        simulated(scheme, 1.002 * float(found[1]))


def test_too_long_a_step_in_a_file_names_its_line(in_tmp: Path) -> None:
    initial = "{omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}"
    (in_tmp / "long.yaml").write_text(f"top: kowalevski\ninitial: {initial}\nscheme: backlund\nh: 3\nN: 5\n")
    with pytest.raises(StepTooLongError, match=r"long\.yaml:4: h: \|h\| must be at most 1\.65"):
        topcli.simulate("long.yaml")


def test_where_no_step_is_possible_says_so() -> None:
    with pytest.raises(StepTooLongError, match="no step is possible"):
        simulated(h=1e-210, initial={"omega": [1e200, 0, 0], "gamma": [0, 0, 1]})


@pytest.mark.parametrize("nodes", ["plain", "exact"])
def test_substeps_divide_a_long_step(nodes: str) -> None:
    """As few as the domain allows: the same states as with the divided h."""
    auto = simulated({"name": "backlund", "nodes": nodes, "substeps": "auto"}, 4.0, 50)
    parts = 3 if nodes == "plain" else 2
    short = simulated({"name": "backlund", "nodes": nodes}, 4.0 / parts, 50 * parts, output={"every": parts})
    np.testing.assert_allclose(auto.states, short.states, rtol=0, atol=1e-12)
    assert auto.outcome is Outcome.COMPLETED


def test_rounded_tau_makes_its_complements_exact() -> None:
    """2 - tau and 4 - tau have no rounding error, except for a tiny scaled state, where tau itself matters more."""
    for tau in np.random.default_rng(78).uniform(1e-3, 0.9, 200).tolist():
        rounded = rounded_tau(tau, 8.01e-3)
        assert abs(rounded - tau) < 3.5e-16
        assert Fraction(2.0 - rounded) == 2 - Fraction(rounded)
        assert Fraction(2.0 + (2.0 - rounded)) == 4 - Fraction(rounded)
        assert rounded_tau(tau, 7.99e-3) == tau
