"""The Euler top: its steps against the paper's equations in rational arithmetic, its integrals, its round-off."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import GEN
from steppers import physical, rk2
from topcli.cli.app import app
from topcli.contracts import Invariant, Method, Outcome, Top
from topcli.engine.loop import Run
from topcli.schemes.euler.bs_midpoint import bs_increment
from topcli.schemes.euler.hk import hk_gamma_increment, hk_increment
from topcli.schemes.registry import find_scheme
from topcli.tops import top_class
from topcli.tops.euler import Euler, EulerGamma
from twins import exactly

EPS = 2.0**-52
BAR_STEPS = 100_000
rational = st.fractions(-3, 3, max_denominator=40)
moment = st.fractions(Fraction(1, 4), 4, max_denominator=20)
vectors = st.tuples(rational, rational, rational)
Rational = tuple[Fraction, Fraction, Fraction]


def random_tops(count: int, seed: int, cls: type[Euler] = EulerGamma) -> list[tuple[Euler, np.ndarray]]:
    """Tops with moments from 0.5 to 4 (some break the triangle inequality) and states with omega of size one."""
    random = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        A, B, C = random.uniform(0.5, 4.0, 3)
        omega, gamma = random.normal(size=(2, 3))
        y0 = np.concatenate([omega, gamma / np.linalg.norm(gamma)])
        top = cls(A=A, B=B, C=C)
        made.append((top, y0[: len(top.components)]))
    return made


def cross(a: Rational, b: Rational) -> Rational:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def quotients(moments: Rational) -> Rational:
    A, B, C = moments
    return ((B - C) / A, (C - A) / B, (A - B) / C)


def plus(a: Rational, b: Rational) -> Rational:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def times(a: Rational, b: Rational) -> Rational:
    return (a[0] * b[0], a[1] * b[1], a[2] * b[2])


def scaled(c: Fraction, a: Rational) -> Rational:
    return (c * a[0], c * a[1], c * a[2])


@pytest.mark.slow
@given(vectors, vectors, st.tuples(moment, moment, moment), st.fractions(-1, 1, max_denominator=50))
def test_hk_solves_the_papers_equations_exactly(w: Rational, g: Rational, moments: Rational, h: Fraction) -> None:
    """m' - m = h/2 (m' x omega + m x omega'), and the same for gamma (its last line without the misprint)."""
    d = h / 2
    try:
        x = tuple(exactly(hk_increment, *w, *scaled(d, quotients(moments))))
    except ZeroDivisionError:  # a singular step; h is large here
        return
    m, new = times(moments, w), plus(w, x)
    m_new = times(moments, new)
    assert times(moments, x) == scaled(d, plus(cross(m_new, w), cross(m, new)))
    y = tuple(exactly(hk_gamma_increment, *scaled(d, w), *scaled(d, x), *g))
    assert y == scaled(d, plus(cross(plus(g, y), w), cross(g, new)))


@pytest.mark.slow
@given(vectors, st.tuples(moment, moment, moment), st.fractions(-1, 1, max_denominator=50))
def test_bs_solves_the_papers_equation_exactly(w: Rational, moments: Rational, h: Fraction) -> None:
    """m' - m = h/2 (m' + m) x omega (EulerBS)."""
    d = h / 2
    x = tuple(exactly(bs_increment, *w, *moments, d, *scaled(d, quotients(moments))))
    m = times(moments, w)
    m_new = times(moments, plus(w, x))
    assert times(moments, x) == scaled(d, cross(plus(m_new, m), w))


@pytest.mark.parametrize("h", [0.3, 0.05, -0.01])
def test_implicit_steps_solve_the_papers_equations_to_round_off(h: float) -> None:
    """The defect of each equation in exact arithmetic, in ulp of the change: Newton's method leaves nothing behind."""
    for name, axis in (("bs-implicit", (0.0, 1.0)), ("midpoint", (0.5, 0.5)), ("bs", (1.0, 0.0))):
        for top, y0 in random_tops(20, seed=21, cls=Euler):
            step = physical(find_scheme(name, "euler").build(top, None))
            new = step(tuple(map(float, y0)), h, top.constants())
            moments = [Fraction(x) for x in (top.A, top.B, top.C)]
            w, v = ([Fraction(float(x)) for x in state] for state in (y0, new))
            m = [a * (x + y) for a, x, y in zip(moments, w, v, strict=True)]
            turn = [Fraction(axis[0]) * x + Fraction(axis[1]) * y for x, y in zip(w, v, strict=True)]
            right = [Fraction(h) / 2 * r for r in cross(m, turn)]
            size = max(map(abs, (*w, *v)))
            for a, x, y, r in zip(moments, w, v, right, strict=True):
                assert abs(float((y - x) - r / a)) < 4 * EPS * float(size), (name, top, y0)


def test_bs_implicit_is_the_inverse_of_bs() -> None:
    for top, y0 in random_tops(10, seed=22):
        there = physical(find_scheme("bs-implicit", top.form).build(top, None))(tuple(y0), 0.2, top.constants())
        back = physical(find_scheme("bs", top.form).build(top, None))(there, -0.2, top.constants())
        assert back == pytest.approx(tuple(y0), abs=1e-14)


@pytest.mark.parametrize("name", ["hk", "bs", "bs-implicit", "midpoint"])
def test_omega_does_not_depend_on_gamma(name: str) -> None:
    """The six-component step moves omega as the three-component step does, bit for bit."""
    for top, y0 in random_tops(5, seed=23):
        free = Euler(A=top.A, B=top.B, C=top.C)
        six = physical(find_scheme(name, top.form).build(top, None))(tuple(y0), 0.1, top.constants())
        three = physical(find_scheme(name, "euler").build(free, None))(tuple(y0[:3]), 0.1, free.constants())
        assert six[:3] == three


@pytest.mark.parametrize("name", ["bs-implicit", "midpoint"])
@pytest.mark.parametrize("h", [1.0, 3.0, -10.0])
def test_implicit_steps_are_solved_far_beyond_useful_step_sizes(name: str, h: float) -> None:
    """A solution always exists (a map of a sphere to itself homotopic to a constant); the iteration finds one."""
    found = 0
    for top, y0 in random_tops(100, seed=24, cls=Euler):
        new = physical(find_scheme(name, "euler").build(top, None))(tuple(y0), h, top.constants())
        if math.isfinite(sum(new)):
            found += 1
            m, m_new = ((np.array(top.constants()[:3]) * state) for state in (y0, new))
            assert m_new @ m_new == pytest.approx(m @ m, rel=1e-12)
    assert found >= (100 if abs(h) <= 1.0 else 80)


def series(top: Top, method: Method, y0: np.ndarray, h: float, N: int) -> np.ndarray:
    run = Run(top, method, y0, h, N, 20)
    states = run.collect().states
    assert run.ending is not None
    assert run.ending.outcome is Outcome.COMPLETED
    return states


def over_bar(invariant: Invariant, states: np.ndarray, N: int) -> float:
    """Largest deviation in units of 50 ulp sqrt(N)."""
    values = invariant.value(states)
    return float(np.abs(values - values[0]).max() / (50 * EPS * math.sqrt(N) * invariant.scale(states).max()))


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.2, 0.05, 0.01])
def test_integrals_stay_within_round_off(h: float) -> None:
    """20 random tops, 1e5 steps: HK's modified integrals and all of midpoint's within 50 ulp sqrt(N)."""
    control = math.inf
    for top, y0 in random_tops(20, seed=30):
        for name in ("hk", "midpoint"):
            scheme = find_scheme(name, top.form)
            states = series(top, scheme.build(top, None), y0, h, BAR_STEPS)
            kept = scheme.modified(top, h, None) if scheme.modified else top.invariants()
            assert len(kept) == (7 if name == "hk" else 4)
            for invariant in kept:
                assert over_bar(invariant, states, BAR_STEPS) < 1.0, (name, invariant.name, top, y0)
            if name == "hk":  # the same measure finds the physical integrals not conserved
                control = min(control, over_bar(top.invariants()[0], states, BAR_STEPS))
    assert 8100.0 < control < 1.4e7


@pytest.mark.parametrize("h", [1e-4, 1e-3, 0.1, 0.5])
def test_modified_integrals_at_every_step_size(h: float) -> None:
    """Exact from h = 1e-4 to 0.5, all digits of them; the direct form of K1/K2 loses its digits at small h."""
    lost = 0.0
    for top, y0 in random_tops(4, seed=31, cls=Euler):
        scheme = find_scheme("hk", "euler")
        assert scheme.modified is not None
        states = series(top, scheme.build(top, None), y0, h, 20_000)
        integrals = {one.name: one for one in scheme.modified(top, h, None)}
        for one in integrals.values():
            assert over_bar(one, states, 20_000) < 0.2, (one.name, top, y0)
        a1, a2, a3 = top.constants()[3:]
        d2 = (0.5 * h) ** 2
        K1, K2 = (1.0 - d2 * a * b * states[:, i] ** 2 for i, (a, b) in enumerate(((a2, a3), (a3, a1))))
        naive = (K1 / K2 - 1.0) / (d2 * a3)
        assert np.abs(naive - integrals["modified_k12"].value(states)).max() < 1e-13 + 8 * EPS / (d2 * abs(a3))
        lost = max(lost, float(np.ptp(naive) / integrals["modified_k12"].scale(states).max() / EPS))
    assert h > 1e-3 or lost > 1e5


def test_the_corrections_are_of_second_order() -> None:
    """Halving h divides the swing of m² by four, and modified m² - m² likewise: O(h²), where the paper says O(h)."""
    top, y0 = Euler(), np.array(GEN[:3])
    scheme = find_scheme("hk", "euler")
    assert scheme.modified is not None
    swings, gaps = [], []
    for h in (0.08, 0.04, 0.02):
        states = series(top, scheme.build(top, None), y0, h, round(400 / h))
        m_sq = top.invariants()[0].value(states)
        swings.append(np.ptp(m_sq))
        gaps.append(abs(scheme.modified(top, h, None)[0].value(states[:1])[0] - m_sq[0]))
    assert np.array(swings[:-1]) / swings[1:] == pytest.approx(4.0, rel=0.02)
    assert np.array(gaps[:-1]) / gaps[1:] == pytest.approx(4.0, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "midpoint"])
def test_round_off_is_a_random_walk(name: str) -> None:
    """Over 100 times as many steps the error of m² (HK: of its modified m²) grows like their root, not like them."""
    grown = []
    for top, y0 in random_tops(12, seed=33, cls=Euler):
        scheme = find_scheme(name, "euler")
        one = scheme.modified(top, 0.02, None)[0] if scheme.modified else top.invariants()[0]
        values = one.value(series(top, scheme.build(top, None), y0, 0.02, 1_000_000))
        short = np.mean([np.ptp(part) for part in np.array_split(values[1:], 100)])
        grown.append(np.ptp(values) / short)
    assert np.median(grown) < 25.0  # 10 for a random walk, 100 for a drift


@pytest.mark.parametrize(("name", "extreme"), [("bs", min), ("bs-implicit", max)])
def test_bs_ends_at_a_principal_axis(name: str, extreme: Callable) -> None:
    """m² is kept and m.omega is not: the top ends turning about the axis of its smallest or largest moment."""
    top = Euler()
    states = series(top, find_scheme(name, "euler").build(top, None), np.array(GEN[:3]), 0.05, 40_000)
    m_sq, m_omega = (one.value(states) for one in top.invariants())
    assert m_omega[-1] == pytest.approx(m_sq[0] / extreme(top.A, top.B, top.C), rel=1e-6)


def test_bs_implicit_survives_vanishing_components() -> None:
    """omega1 and omega2 shrink below 1e-160, where their squares underflow; the iteration still ends."""
    top = Euler(A=2.05, B=2.49, C=3.68)
    states = series(top, find_scheme("bs-implicit", "euler").build(top, None), np.array((0.04, -1.6, 1.0)), 0.1, 60_000)
    assert np.abs(states[-1, :2]).max() < 1e-160
    assert over_bar(top.invariants()[0], states, 60_000) < 1.0


@pytest.mark.parametrize("name", ["hk", "bs", "bs-implicit", "midpoint"])
def test_steady_rotations_are_exact(name: str) -> None:
    """About a principal axis, or for A = B = C, omega does not move by a single bit."""
    for top, omega in ((Euler(), (0, 0, 2)), (Euler(A=1.7, B=1.7, C=1.7), (0.3, -1.1, 2)), (Euler(), (0, 0, 0))):
        states = series(top, find_scheme(name, "euler").build(top, None), np.array(omega, dtype=float), 0.1, 1000)
        assert np.array_equal(states, np.tile(np.array(omega, dtype=float), (len(states), 1)))


def test_rk2_control_drifts() -> None:
    top, y0 = EulerGamma(), np.array(GEN)
    states = series(top, rk2(top), y0, 0.05, 20_000)
    assert min(over_bar(one, states, 20_000) for one in top.invariants()) == pytest.approx(2.22e09, rel=0.05)


def test_the_initial_vectors_choose_the_form() -> None:
    assert top_class("Euler") is Euler
    assert top_class("euler", ["omega"]) is Euler
    assert top_class("euler", ["gamma", "omega"]) is EulerGamma


def write(path, moments: str, scheme: str = "hk"):
    path.write_text(
        f"top: {{kind: euler, {moments}}}\ninitial: {{omega: [0.7, -0.4, 1.3]}}\nscheme: {scheme}\nh: 0.01\nN: 10\n"
    )
    return path


def run_cli(*arguments: object):
    from typer.testing import CliRunner

    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.slow
@pytest.mark.parametrize("command", [("run",), ("run", "--json"), ("compare", "hk", "bs", "--config")])
def test_moments_violating_the_triangle_inequality_warn(in_tmp, command) -> None:
    """A warning on stderr, and the run goes on; a rigid body's moments are not warned about, nor a flat body's."""
    done = run_cli(*command, write(in_tmp / "odd.yaml", "A: 5, B: 1, C: 1.5"))
    assert done.exit_code == 0
    assert "warning: odd: the moments (5, 1, 1.5) violate the triangle inequality: A = 5 > 1 + 1.5" in done.stderr
    assert "warning" not in done.stdout
    for moments in ("A: 3, B: 2, C: 1.5", "A: 3, B: 2, C: 1", "A: 0.3, B: 0.1, C: 0.2"):
        assert "warning" not in run_cli(*command, write(in_tmp / "fine.yaml", moments), *_fresh(command)).stderr


def _fresh(command: tuple[str, ...]) -> tuple[str, ...]:
    return ("--force",) if command[0] == "run" else ()


@pytest.mark.parametrize("value", ["0", "-2", ".nan", ".inf", "'two'"])
def test_bad_moments_are_refused(in_tmp, value: str) -> None:
    done = run_cli("run", write(in_tmp / "bad.yaml", f"B: {value}"))
    assert done.exit_code == 2
    assert "bad.yaml:1" in done.stderr
    assert "B" in done.stderr
    assert not (in_tmp / "results").exists()


def test_a_scheme_of_another_top_is_refused_with_those_that_fit(in_tmp) -> None:
    done = run_cli("run", write(in_tmp / "odd.yaml", "A: 3", "hybrid"))
    assert done.exit_code == 2
    assert "does not fit top 'euler'" in done.stderr
    assert "bs-implicit" in done.stderr


def test_a_step_that_full_corrections_miss_is_solved_by_halved_ones() -> None:
    """The midpoint rule with a very long step: Newton's method alone does not converge from here."""
    moments, h = np.array([3.0, 2.0, 1.0]), 5.0
    w = np.array([1.3342143375511515, 1.7247667469661203, -0.0030943871338332323])
    new = Run(Euler(), find_scheme("midpoint", "euler").build(Euler(), None), w, h, 1, 1).collect().states[-1]
    mean = 0.5 * (w + new)
    turned = h * np.cross(moments * mean, mean)
    np.testing.assert_allclose(moments * (new - w), turned, atol=1e-13)  # typically 1e-15
    assert np.abs(new - w).max() > 0.1
