"""The fast steps against their straightforward forms: HK exactly, in rational arithmetic; the others to round-off."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import twins
from conftest import GEN, PAPER, random_states
from steppers import physical
from topcli.contracts import Outcome, Scheme, Stepper
from topcli.engine.loop import Run
from topcli.schemes.kowalevski.bohlin import SWITCH_BELOW, method_b_single, method_b_switch
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.registry import find_scheme
from topcli.tops.kowalevski import Kowalevski, field

EPS = 2.0**-52
rational = st.fractions(-3, 3, max_denominator=40)
states = st.tuples(*[rational] * 6)
steps = st.fractions(-1, 1, max_denominator=50)


def scheme(name: str) -> Scheme:
    return find_scheme(name, "kowalevski")


def stepper(name: str, c: float = 1.0, **options) -> Stepper:
    found = scheme(name)
    return found.build(Kowalevski(c0=c), found.options(**options))


@pytest.mark.slow
@given(states, steps, rational)
def test_hk_is_the_solution_of_the_papers_equations_exactly(y, h, c) -> None:
    """No rounding: the closed form and the block form satisfy all six equations with equality."""
    for form in (hk_kowalevski, twins.hk_block):
        try:
            new = twins.exactly(form, y, h, (c,))
        except ZeroDivisionError:  # a singular step, or a pole of the form itself; h is large here
            continue
        assert twins.d_euler_poisson(y, new, h, c) == [0] * 6


@pytest.mark.parametrize("c", [Fraction(1), Fraction(-7, 3), Fraction(0)])
@pytest.mark.parametrize("h", [Fraction(1, 100), Fraction(-2, 7)])
def test_hk_is_the_general_solve_exactly(c: Fraction, h: Fraction) -> None:
    y = [Fraction(x).limit_denominator(100) for x in GEN]
    assert twins.exactly(hk_kowalevski, y, h, (c,)) == twins.hk_general(y, h, (c,))


def test_misprinted_equations_differ_from_hk() -> None:
    """Control: the paper's last line as printed is not solved by the HK step."""
    y = [Fraction(x).limit_denominator(100) for x in GEN]
    new = twins.hk_general(y, Fraction(1, 10), (Fraction(1),))
    assert twins.d_euler_poisson(y, new, Fraction(1, 10), Fraction(1), misprinted=True)[5] != 0


def test_hk_is_kahans_method_for_the_field() -> None:
    """(I - h/2 f'(y)) (y' - y) = h f(y), with the derivative of the top's own field by exact differences."""
    h, c = Fraction(1, 8), Fraction(3, 2)
    y = [Fraction(x).limit_denominator(100) for x in GEN]
    new = twins.exactly(hk_kowalevski, y, h, (c,))
    x = [b - a for a, b in zip(y, new, strict=True)]
    here = twins.exactly(field, y, (c,))
    there = twins.exactly(field, [a + b for a, b in zip(y, x, strict=True)], (c,))
    back = twins.exactly(field, [a - b for a, b in zip(y, x, strict=True)], (c,))
    # the field is quadratic: its central difference is its derivative
    assert [d - h / 4 * (p - m) for d, p, m in zip(x, there, back, strict=True)] == [h * f for f in here]


@pytest.mark.slow
@pytest.mark.parametrize("h", [1e-12, 1e-5, 1e-3, 0.1, -0.1, 0.5])
@pytest.mark.parametrize("c", [1.0, -2.0, 0.0, 1e-200, 50.0])
def test_hk_rounds_once_and_at_the_size_of_the_increment(h: float, c: float) -> None:
    for y in [GEN, PAPER, *random_states(10, seed=4)]:
        old = tuple(map(float, y))
        exact = twins.hk_general([Fraction(x) for x in old], Fraction(h), (Fraction(c),))
        size = max(abs(float(e - Fraction(x))) for x, e in zip(old, exact, strict=True))
        for got, want in zip(hk_kowalevski(old, h, (c,)), exact, strict=True):
            # half an ulp for the last addition, and some ulp of the increment
            assert abs(float(Fraction(got) - want)) <= 0.51 * EPS * abs(float(want)) + 25 * EPS * size * (
                1 + h * h * abs(c)
            )


def local_errors(step, n: int, h: float) -> np.ndarray:
    """Round-off of gamma² in each of ``n`` single steps, in ulp: against the exact step from the same state."""
    y, errors = GEN, []
    for _ in range(n):
        exact = twins.hk_general([Fraction(x) for x in y], Fraction(h), (Fraction(1),))
        y = step(y, h, (1.0,))
        difference = sum(Fraction(g) ** 2 for g in y[3:]) - sum(g**2 for g in exact[3:])
        errors.append(float(difference) / EPS)
    return np.array(errors)


def towards_zero(state, h, p):
    """HK with gamma's last digit rounded down in size: a biased form."""
    new = hk_kowalevski(state, h, p)
    return (*new[:3], *(math.nextafter(g, 0.0) for g in new[3:]))


def bias(errors: np.ndarray) -> float:
    return abs(errors.mean()) / (errors.std() / math.sqrt(len(errors)))


@pytest.mark.slow
def test_hk_round_off_is_small_and_unbiased() -> None:
    errors = local_errors(hk_kowalevski, 1500, 0.01)
    assert errors.std() < 0.6
    assert bias(errors) < 4.0
    assert bias(local_errors(towards_zero, 300, 0.01)) == pytest.approx(67.8, rel=0.05)


def integrals(y) -> list[Fraction]:
    """Energy, area integral and gamma² of the top with c = 1, exactly."""
    w1, w2, w3, g1, g2, g3 = map(Fraction, y)
    return [
        (w1**2 + w2**2) + w3**2 / 2 + g1,
        2 * (w1 * g1 + w2 * g2) + w3 * g3,
        g1**2 + g2**2 + g3**2,
    ]


@pytest.mark.slow
def test_hk_round_off_is_unbiased_in_every_integral() -> None:
    """From states all over the sphere: the mean of the error over its standard deviation, and a biased control."""

    def biases(step) -> list[float]:
        errors = []
        for y in random_states(400, seed=8).tolist():
            exact = twins.hk_general([Fraction(x) for x in y], Fraction(0.01), (Fraction(1),))
            got = step(tuple(y), 0.01, (1.0,))
            errors.append([float(a - b) / EPS for a, b in zip(integrals(got), integrals(exact), strict=True)])
        return [bias(column) for column in np.array(errors).T]

    def truncated(state, h, p):
        return tuple(math.nextafter(x, 0.0) for x in hk_kowalevski(state, h, p))

    assert max(biases(hk_kowalevski)) < 4.0
    control = biases(truncated)
    assert control[0] == pytest.approx(22.1, rel=0.05)
    assert control[2] == pytest.approx(75.9, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("c", [1.0, -0.7, 0.0])
@pytest.mark.parametrize("h", [1e-3, 0.1, -0.2])
def test_hybrid_is_its_straightforward_form(c: float, h: float) -> None:
    fast = physical(stepper("hybrid", c))
    for y in [GEN, PAPER, *random_states(30, seed=6)]:
        for plain in (twins.hybrid_polar, twins.hybrid_cmath):
            assert fast(tuple(y), h, (c,)) == pytest.approx(plain(tuple(y), h, (c,)), rel=1e-12, abs=1e-12)


ROOTS = {"nearest": twins.polar_root, "sign": twins.polar_root_sign}


@pytest.mark.slow
@pytest.mark.parametrize("branch", ROOTS)
@pytest.mark.parametrize("method", ["a", "b", "c"])
def test_bohlin_is_its_straightforward_form(method: str, branch: str) -> None:
    options = {"branch": branch} | ({"chart": "single"} if method == "b" else {})
    gamma = getattr(twins, f"gamma_{method}")
    for c, h in ((1.0, 1e-3), (-0.7, 0.05), (0.0, -0.1)):
        fast = physical(stepper(f"bohlin-{method}", c, **options))
        for y in [GEN, *random_states(30, seed=7)]:
            plain = twins.bohlin_plain(tuple(y), h, (c,), gamma, ROOTS[branch])
            assert fast(tuple(y), h, (c,)) == pytest.approx(plain, rel=1e-11, abs=1e-11)


def test_bohlin_b_on_the_other_chart_is_its_mirror_image() -> None:
    """gamma3 -> -gamma3 with (omega1, omega2) -> -(omega1, omega2) takes one chart's gamma to the other's."""
    for y in random_states(20, seed=8):
        w1, w2, w3, g1, g2, g3 = map(float, y)
        shrink = 0.5 / math.hypot(g1, g2)
        g1, g2, g3 = shrink * g1, shrink * g2, math.sqrt(0.75)
        up = method_b_single(w1, w2, w3, g1, g2, g3, 0.01)
        down = method_b_switch(-w1, -w2, w3, g1, g2, -g3, 0.01)
        assert (down[0], down[1], -down[2]) == up


def test_bohlin_b_keeps_the_papers_chart_on_the_papers_scene() -> None:
    states, loop = run(stepper("bohlin-b"), PAPER, 1e-3, 50_000)
    assert loop.ending is not None
    assert loop.ending.counters == {"chart_switches": 0, "ambiguous_roots": 0}
    assert np.array_equal(states, run(stepper("bohlin-b", chart="single"), PAPER, 1e-3, 50_000)[0])


def run(made: Stepper, y0, h: float, N: int):
    loop = Run(Kowalevski(), made, y0, h, N)
    states = loop.collect().states
    return states, loop


def test_bohlin_b_passes_the_south_pole() -> None:
    """Through gamma3 = -1 with chart switches; the paper's single chart does not survive the same orbit."""
    y0 = (1.5, 0.0, 0.0, 0.0, -math.sin(3.0), math.cos(3.0))
    h, N = 1e-3, 20_000
    states, loop = run(stepper("bohlin-b"), y0, h, N)
    assert loop.ending is not None
    assert loop.ending.outcome is Outcome.COMPLETED
    crossings = np.count_nonzero(np.diff(states[:, 5] < SWITCH_BELOW))
    assert crossings > 2
    assert loop.ending.counters == {"chart_switches": crossings, "ambiguous_roots": 0}
    assert states[:, 5].min() < -0.999
    assert np.abs((states[:, 3:] ** 2).sum(axis=1) - 1.0).max() < 8 * EPS
    assert np.abs(np.diff(states, axis=0)).max() < 5 * h  # no jump, at the pole or at a switch
    _, single = run(stepper("bohlin-b", chart="single"), (0.01, 0.0, 3.0, 1e-8, 0.0, -1.0), 0.1, 1000)
    assert single.ending is not None
    assert single.ending.outcome is Outcome.BLEW_UP


def test_bohlin_c_at_rest_is_exact() -> None:
    """omega = 0: gamma does not turn, to the last bit, and omega3 falls by h c gamma2."""
    new = physical(stepper("bohlin-c"))((0.0, 0.0, 0.0, 0.6, 0.48, 0.64), 0.01, (1.0,))
    assert new[3:] == (0.6, 0.48, 0.64)
    assert new[2] == pytest.approx(-0.01 * 0.48, rel=4 * EPS)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "hybrid", "bohlin-a", "bohlin-b", "bohlin-c"])
def test_steps_at_rest_and_without_gravity_stay_finite(name: str) -> None:
    for c in (0.0, 1.0):
        made = stepper(name, c)
        for y in ((0.0, 0.0, 0.0, 0.6, 0.0, 0.8), (0.0, 0.0, 2.0, 0.6, 0.0, 0.8), (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)):
            state = made.enter(y, 0.1, (c,)) if made.enter else y
            for _ in range(100):
                state = made.step(state, 0.1, (c,))
            assert all(map(math.isfinite, state))
            assert c != 0.0 or state[:3] == pytest.approx(y[:3], abs=1e-15)
