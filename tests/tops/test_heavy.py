"""The general heavy top: its equations and integrals, and HK as the exact solution of the paper's equations."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from conftest import GEN, PAPER, random_states
from topcli.analysis.reference import reference_states
from topcli.arithmetic.vectors import resolvent, solve3
from topcli.contracts import Top
from topcli.engine.loop import Run
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.registry import find_scheme
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy, field
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.kowalevski import field as kowalevski_field
from twins import exactly
from twins_heavy import cross, d_euler_poisson, hk_general, hk_heavy, random_heavy_tops

EPS = 2.0**-52
TOP = Heavy(A=1.7, B=1.1, C=0.9, x0=0.4, y0=-0.9, z0=0.7)
rational = st.fractions(-3, 3, max_denominator=30)
positive = st.fractions(Fraction(1, 10), 3, max_denominator=30)
states = st.tuples(*[rational] * 6)
parameters = st.tuples(*[positive] * 3, *[rational] * 3)
steps = st.fractions(-1, 1, max_denominator=40)


@pytest.mark.slow
@given(states, parameters)
def test_field_is_the_papers_equation(y, p) -> None:
    w, g = y[:3], y[3:]
    m = [a * b for a, b in zip(p[:3], w, strict=True)]
    torque = [a + b for a, b in zip(cross(m, w), cross(g, p[3:]), strict=True)]
    f = exactly(field, y, p)
    assert [a * b for a, b in zip(p[:3], f[:3], strict=True)] == torque
    assert f[3:] == cross(g, w)


def gradient_along_flow(top: Top, name: str, y: np.ndarray) -> float:
    """d/dt of an invariant, by central differences along the field: exact for quadratic ones but for round-off."""
    invariant = next(i for i in top.invariants() if i.name == name)
    f = np.array(top.field(tuple(y), top.constants()))
    ahead, behind = invariant.value(np.array([y + f, y - f]))
    return float(ahead - behind) / 2.0


@pytest.mark.parametrize("name", ["gamma_sq", "m_gamma", "energy"])
def test_integrals_are_constant_along_the_flow(name: str) -> None:
    for top, y in zip(random_heavy_tops(20, seed=1), random_states(20, seed=2), strict=True):
        assert abs(gradient_along_flow(top, name, y)) < 1e-13
        changed = top.model_copy(update={"A": 2.0 * top.A})  # control: the integrals of one top are not another's
        if name != "gamma_sq":
            f = np.array(top.field(tuple(y), top.constants()))
            value = next(i for i in changed.invariants() if i.name == name).value
            assert 0.017 < abs(float(np.diff(value(np.array([y - f, y + f])))[0])) < 19.0


def test_integrals_along_the_reference() -> None:
    states = reference_states(TOP, GEN, np.linspace(0.0, 20.0, 41))
    for invariant in TOP.invariants():
        values = invariant.value(states)
        assert np.abs(values - values[0]).max() < 20 * EPS * invariant.scale(states).max()


def test_special_tops_have_the_same_equations() -> None:
    general = Heavy(A=3.0, B=3.0, C=1.5, x0=-0.8, y0=0.0, z0=0.0)
    special = Kowalevski(A=3.0, c0=-0.8)
    assert general.euler_poisson() == special.euler_poisson()
    for y in random_states(10, seed=3):
        f, k = field(tuple(y), general.constants()), kowalevski_field(tuple(y), special.constants())
        assert f == pytest.approx(k, rel=8 * EPS, abs=8 * EPS)
    for mine in general.invariants():
        theirs = next(i for i in special.invariants() if i.name == mine.name.replace("m_gamma", "two_l"))
        y = random_states(10, seed=3)
        assert mine.value(y) == pytest.approx(theirs.value(y), rel=1e-14, abs=1e-14)


@pytest.mark.slow
@given(states, steps, parameters)
def test_hk_is_the_solution_of_the_papers_equations_exactly(y, h, p) -> None:
    """No rounding: the closed form satisfies all six equations with equality."""
    try:
        new = exactly(hk_heavy, y, h, p)
    except ZeroDivisionError:  # a singular step; h is large here
        assume(False)
        raise
    assert d_euler_poisson(y, new, h, p) == [0] * 6


@pytest.mark.parametrize("h", [Fraction(1, 100), Fraction(-2, 7)])
def test_hk_is_the_general_solve_exactly(h: Fraction) -> None:
    y = [Fraction(x).limit_denominator(100) for x in GEN]
    for top in random_heavy_tops(5, seed=4):
        p = [Fraction(x).limit_denominator(100) for x in top.constants()]
        assert exactly(hk_heavy, y, h, p) == hk_general(y, h, p)


@pytest.mark.slow
@pytest.mark.parametrize("h", [1e-12, 1e-5, 1e-3, 0.1, -0.1, 0.3])
def test_hk_rounds_at_the_size_of_the_increment(h: float) -> None:
    for top in random_heavy_tops(5, seed=5):
        p = top.constants()
        for y in [GEN, *random_states(5, seed=6)]:
            old = tuple(map(float, y))
            exact = hk_general([Fraction(x) for x in old], Fraction(h), [Fraction(x) for x in p])
            size = max(abs(float(e - Fraction(x))) for x, e in zip(old, exact, strict=True))
            for got, want in zip(hk_heavy(old, h, p), exact, strict=True):
                # half an ulp for the last addition, and some ulp of the increment
                assert abs(float(Fraction(got) - want)) <= 0.51 * EPS * abs(float(want)) + 60 * EPS * size


def bias(step, n: int, h: float) -> np.ndarray:
    """Means of the local round-off errors of the integrals in units of their standard errors, over n single steps."""
    p = TOP.constants()
    fractions = [Fraction(x) for x in p]

    def integrals(s) -> np.ndarray:
        w, g = s[:3], s[3:]
        m = [i * a for i, a in zip(fractions[:3], w, strict=True)]
        weighed = sum(a * b for a, b in zip(fractions[3:], g, strict=True))
        return np.array([sum(x * x for x in g), np.dot(m, g), np.dot(m, w) / 2 + weighed])

    y, errors = GEN, []
    for _ in range(n):
        exact = hk_general([Fraction(x) for x in y], Fraction(h), fractions)
        y = step(y, h, p)
        errors.append((integrals([Fraction(x) for x in y]) - integrals(exact)).astype(float))
    measured = np.array(errors)
    return abs(measured.mean(axis=0)) / (measured.std(axis=0) / math.sqrt(n))


def towards_zero(state, h, p):
    """HK with the last digit rounded down in size: a biased form."""
    return tuple(math.nextafter(x, 0.0) for x in hk_heavy(state, h, p))


@pytest.mark.slow
def test_hk_round_off_is_unbiased() -> None:
    assert (bias(hk_heavy, 400, 0.01) < 4.0).all()
    assert bias(towards_zero, 200, 0.01)[0] == pytest.approx(56.4, rel=0.05)


@pytest.mark.parametrize("h", [1e-3, 0.1, -0.2])
def test_kowalevski_through_heavy_is_kowalevski(h: float) -> None:
    for y in [GEN, PAPER, *random_states(20, seed=7)]:
        special = hk_kowalevski(tuple(y), h, (-0.7,))
        assert hk_heavy(tuple(y), h, (2.0, 2.0, 1.0, -0.7, 0.0, 0.0)) == pytest.approx(special, rel=2e-15, abs=2e-15)
        scaled = hk_heavy(tuple(y), h, (6.0, 6.0, 3.0, -2.1, 0.0, 0.0))
        assert scaled == pytest.approx(special, rel=2e-15, abs=2e-15)


def test_kowalevski_run_through_heavy_is_the_kowalevski_run() -> None:
    ends = []
    for top in (Kowalevski(), Heavy(A=2.0, B=2.0, C=1.0, x0=1.0, y0=0.0, z0=0.0)):
        scheme = find_scheme("hk", top.form)
        made = scheme.build(top, scheme.options())
        ends.append(Run(top, made, GEN, 0.01, 2000).collect().states)
    assert np.abs(ends[0] - ends[1]).max() < 1e-12


@pytest.mark.slow
@given(st.tuples(*[rational] * 3), st.tuples(*[rational] * 3))
def test_resolvent_solves_its_equation(a, b) -> None:
    z = exactly(resolvent, *a, *b)
    assert [u - v for u, v in zip(z, cross(z, a), strict=True)] == list(b)


@pytest.mark.slow
@given(st.tuples(*[rational] * 9), st.tuples(*[rational] * 3))
def test_solve3_solves(m, r) -> None:
    try:
        x = exactly(solve3, m, *r)
    except ZeroDivisionError:
        assert np.linalg.matrix_rank(np.array(m, dtype=float).reshape(3, 3)) < 3
        return
    assert [sum(m[3 * i + j] * x[j] for j in range(3)) for i in range(3)] == list(r)


@pytest.mark.parametrize(
    ("moments", "named"),
    [
        ((2.0, 1.5, 1.0), ""),
        ((1.0, 1.0, 2.0), ""),
        ((0.1, 0.7, 0.8), ""),  # a flat body, although 0.1 + 0.7 < 0.8 in doubles
        ((0.8, 0.1, 0.7), ""),
        ((0.3, 0.1, 0.2), ""),
        ((0.1, 0.7, 0.8 * (1.0 + 0.9e-12)), ""),
        ((0.1, 0.7, 0.8 * (1.0 + 1.1e-12)), "C"),
        ((1.0, 3.1, 2.0), "B"),
        ((9.0, 1, 2), "A"),
    ],
)
@pytest.mark.parametrize("top", [Heavy, Euler, EulerGamma])
def test_impossible_moments_are_warned_of(top: type[Heavy | Euler], moments, named: str) -> None:
    A, B, C = moments
    found = top(A=A, B=B, C=C).warnings()
    assert len(found) == bool(named)
    for line in found:
        assert f"{named} = {max(moments):g} >" in line
