"""The integrable map: against the dressing of the Lax matrix with 60 digits, its integrals, and its domain."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
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
from topcli.arithmetic.fused import fma
from topcli.contracts import Floats, Outcome, Stepper
from topcli.errors import StepTooLongError
from topcli.schemes.kowalevski.backlund import (
    constants_at,
    length_step,
    longest_composition,
    longest_step,
    numerators,
    tau_of,
)
from topcli.tops.kowalevski import Kowalevski

DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
HANGING = (0.05, -0.03, 0.02, -math.sqrt(1.0 - 0.1**2 - 0.2**2), 0.1, 0.2)
Vector = Sequence[Any]


def stepper(top: Kowalevski | None = None, **options: Any) -> Stepper:
    return made(top or Kowalevski(), "backlund", **options)


def limit(y: Floats, c: float = 1.0) -> float:
    """The longest admissible step."""
    return longest_step(constants_at(y, c))


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
    x1, x2, x3, y1, y2, y3, r, q = numerators(
        (k * y[0], k * y[1], k * y[2] / 2, *y[3:]), c * h * h / 8, exact_tau(y, h, c)
    )
    return [y[0] + x1 * r / k, y[1] + x2 * r / k, y[2] + 2 * x3 * r / k, y[3] + y1 * q, y[4] + y2 * q, y[5] + y3 * q]


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
    assert tau_of(h, constants_at(y, c)) == pytest.approx(tau, rel=1e-14)
    k = -0.5 * h
    new = length_step(y, c, k, 1.0 / k, fma(-k, 1.0 / k, 1.0) / k, tau)
    np.testing.assert_allclose(new, exact, rtol=0, atol=1e-14)
    np.testing.assert_allclose(physical(stepper(Kowalevski(c0=c)))(y, h, (c,)), exact, rtol=0, atol=1e-14)


def test_small_steps_do_not_cancel() -> None:
    """The change of the state has a relative error of a few ulp at any h."""
    for h in (1e-3, 1e-6, 1e-9):
        with mp.workdps(60):
            y = [mpf(v) for v in GEN]
            change = [float(p - q) for p, q in zip(exact_step(y, mpf(h), mpf(1)), y, strict=True)]
        k = -0.5 * h
        z = (k * GEN[0], k * GEN[1], 0.5 * k * GEN[2], *GEN[3:])
        x1, x2, x3, y1, y2, y3, r, q = numerators(z, 0.125 * h * h, tau_of(h, constants_at(GEN, 1.0)))
        found = np.array([x1 / k * r, x2 / k * r, 2.0 * x3 / k * r, y1 * q, y2 * q, y3 * q])
        assert np.abs(found - change).max() < 2e-15 * np.abs(change).max()


# The domain


def test_the_domain_is_safe() -> None:
    """Within the longest step 1 - S + P is at least 1/32, for all kinds of states; the bound is nearly reached."""
    random, least = np.random.default_rng(77), math.inf
    for y in (random.normal(size=(4000, 6)) * 10.0 ** random.uniform(-1, 1, size=(4000, 1))).tolist():
        h, (gamma_sq, two_l, energy, k_sq) = limit(tuple(y)), integrals(y, 1.0)
        u, q = h * h / 16.0, h * h / 4.0
        S = u * (4.0 * energy - q * gamma_sq)
        P = u * u * (4.0 * energy**2 - 4.0 * k_sq - q * two_l**2)
        least = min(least, 1.0 - S + P)
    assert 1.0 / 32.0 < least < 0.06


def simulated(scheme: Any = "backlund", h: float = 0.5, N: int = 3, **others: Any) -> topcli.Trajectory:
    initial = {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}
    return topcli.simulate({"top": "kowalevski", "initial": initial, "scheme": scheme, "h": h, "N": N, **others})


@pytest.mark.parametrize(("options", "longest"), [({}, 1.43), ({"nodes": "exact"}, 2.714)], ids=str)
def test_too_long_a_step_is_refused_before_the_run(options: dict[str, Any], longest: float) -> None:
    """The message names the longest step, which is accepted in either direction."""
    scheme = {"name": "backlund", **options}
    with pytest.raises(StepTooLongError, match=r"^h: \|h\| must be at most (\d\.\d+) under backlund") as refusal:
        simulated(scheme, 1.05 * longest)
    largest = re.search(r"at most (\d\.\d+)", str(refusal.value))
    assert largest
    assert float(largest[1]) == pytest.approx(longest, rel=1e-3)
    for sign in (1.0, -1.0):
        assert simulated(scheme, sign * float(largest[1])).outcome is Outcome.COMPLETED
    with pytest.raises(StepTooLongError):
        simulated(scheme, 1.002 * float(largest[1]))


# Exact nodes

EQUILIBRIUM = (2.0, 0.0, 0.0, 1.0, 0.0, 0.0)
AT_REST = (0.0, 0.0, 0.0, 0.6, 0.48, 0.64)


def longest(y: Floats, c: float = 1.0, count: int = 4) -> float:
    """The longest step that ``count`` steps forward and one back can make."""
    return longest_composition(constants_at(y, c), count)


def reference(y: Floats, t: float, c: float = 1.0) -> np.ndarray:
    return reference_states(Kowalevski(c0=c), y, np.array([t]))[0]


FAMILIES: dict[str, tuple[Floats, float]] = {
    "generic": (GEN, 1.0),
    "paper": (PAPER, 1.0),
    "no gravity": (GEN, 0.0),
    "faint gravity": (GEN, 1e-8),
    "negative gravity": (GEN, -0.7),
    "strong negative gravity": (GEN, -30.0),
    "Delone": (DELONE, 1.0),
    "near Delone": ((DELONE[0] + 1e-7, *DELONE[1:]), 1.0),
    "far from Delone by 1e-12": ((DELONE[0], DELONE[1] + 1e-12, *DELONE[2:]), 1.0),
    "Delone, negative gravity": ((DELONE[1], -DELONE[0], DELONE[2], *DELONE[3:]), -1.0),
    "hanging": (HANGING, 1.0),
    "hanging closely": ((1e-6, -2e-6, 1e-6, -1.0, 1e-6, 0.0), 1.0),
    "hanging, negative gravity": ((1e-3, -2e-3, 1e-3, 1.0, 0.0, 0.0), -2.0),
    "equilibrium": (EQUILIBRIUM, 1.0),
    "from rest": (AT_REST, 1.0),
    "spin about the third axis": ((0.0, 0.0, 2.0, 0.0, 0.0, 1.0), 1.0),
    "pendulum": ((0.0, 1.5, 0.0, 0.8, 0.0, 0.6), 1.0),
    "no vertical": ((0.7, -0.4, 1.3, 0.0, 0.0, 0.0), 1.0),
    "fast": ((7e5, -4e5, 1.3e6, 0.6, 0.48, 0.64), 1.0),
    "long vertical": ((0.7, -0.4, 1.3, 6e5, 4.8e5, 6.4e5), 1.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_one_step_of_every_kind_of_motion(family: str) -> None:
    """Of either sign, up to the longest: within a few ulp of the sizes of omega and gamma."""
    y, c = FAMILIES[family]
    top, made = Kowalevski(c0=c), stepper(nodes="exact")
    gamma = max(map(abs, y[3:]))
    sizes = np.repeat([max(map(abs, y[:3])) + math.sqrt(abs(c) * gamma), gamma or 1.0], 3)
    most = min(longest(y, c), 20.0)
    for h in (0.1 * most, -0.6 * most, 0.999 * most):
        states, ending = ran(made, y, h, 1, 1, top)
        assert ending.outcome is Outcome.COMPLETED, ending.message
        assert (np.abs(states[-1] - reference(y, h, c)) / sizes).max() < 1e-14


DECLARED = {"no gravity", "hanging closely", "hanging, negative gravity", "no vertical"}
"""Kinds of motion whose integrals need a projection over many plain steps, as the limits of the scheme say, and
gamma = 0, where gamma² is relative to nothing."""


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_long_runs_of_every_kind_of_motion(family: str) -> None:
    """2e3 steps up to the longest, plain, projected and with exact nodes; in sqrt(N) ulp 5, 0.2 and 0.3 are typical."""
    (y, c), N = FAMILIES[family], 2_000
    top = Kowalevski(c0=c)
    for method, most, bound in (
        (stepper(top), limit(y, c), 30.0),
        (stepper(top, project=16), limit(y, c), 1.0),
        (stepper(top, nodes="exact", project=16), longest(y, c), 10.0),
    ):
        for fraction in (0.3, 1.0):
            states, ending = ran(method, y, fraction * min(most, 20.0), N, 20, top)
            assert ending.outcome is Outcome.COMPLETED, ending.message
            assert family in DECLARED or max(deviations(states, top).values()) < bound * math.sqrt(N)
