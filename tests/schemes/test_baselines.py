"""The general-purpose methods: rk2 and rk4 against other codes, and what an adaptive method declares."""

from __future__ import annotations

from fractions import Fraction
from typing import ClassVar

import numpy as np
import pytest

from conftest import GEN, random_states
from topcli.analysis.order import observed_order, one_step_back_and_forth
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Outcome, Scheme, Stepper, Top
from topcli.engine.loop import Run, nanoseconds_per_step
from topcli.schemes.any_top.rk2_rk4_dop853 import VECTOR_OPERATIONS, rk2_step, rk4_step
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.tops import TOPS
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski

ADAPTIVE = [scheme for scheme in all_schemes() if scheme.adaptive and scheme.order is not None]
adaptive = pytest.mark.parametrize("scheme", ADAPTIVE, ids=lambda s: f"{s.name}/{s.top}")
LOOSE = {"rtol": 1e6, "atol": 1e6}
"""Tolerances that accept every step, so that one step of the formula is taken a step h."""


def tableau_step(field, s, h, p, a, b):
    """One step of the explicit Runge-Kutta method with the coefficients a (below the diagonal) and b."""
    slopes = []
    for row in a:
        at = [x + h * sum(c * k[i] for c, k in zip(row, slopes, strict=True)) for i, x in enumerate(s)]
        slopes.append(field(tuple(at), p))
    return [x + h * sum(c * k[i] for c, k in zip(b, slopes, strict=True)) for i, x in enumerate(s)]


HALF = Fraction(1, 2)
SIXTH = Fraction(1, 6)
TABLEAUX = {
    "rk2": ([[], [HALF]], [0, 1]),
    "rk4": ([[], [HALF], [0, HALF], [0, 0, 1]], [SIXTH, 2 * SIXTH, 2 * SIXTH, SIXTH]),
}


@pytest.mark.parametrize("name", TABLEAUX)
@pytest.mark.parametrize("form", TOPS)
def test_runge_kutta_steps_are_their_tableaux(name: str, form: str) -> None:
    top = TOPS[form].new()
    made = find_scheme(name, form).build(top, None)
    assert isinstance(made, Stepper)
    a, b = TABLEAUX[name]
    for y in random_states(10, seed=1)[:, : len(top.components)]:
        for h in (0.3, -1e-3):
            want = tableau_step(top.field, tuple(y), h, top.constants(), a, b)
            assert made.step(tuple(y), h, top.constants()) == pytest.approx(want, rel=1e-14, abs=1e-14)


def free_rotation(s: Floats, p: Floats) -> Floats:
    """Euler's equations with A, B, C = p."""
    A, B, C = p
    return ((B - C) / A * s[1] * s[2], (C - A) / B * s[2] * s[0], (A - B) / C * s[0] * s[1])


class Free(Heavy):
    """Euler's top by angular velocity alone, to try states of length three with."""

    form: ClassVar[str] = "free"
    components: ClassVar[tuple[str, ...]] = ("omega1", "omega2", "omega3")
    field: ClassVar = staticmethod(free_rotation)

    def constants(self) -> Floats:
        return (self.A, self.B, self.C)


def test_runge_kutta_steps_serve_states_of_length_three() -> None:
    """The steps for three components, compiled, are those for six without gravity."""
    three, six = Free(), Heavy(x0=0.0, y0=0.0, z0=0.0)
    for build in (lambda d, f: rk2_step(f, VECTOR_OPERATIONS[d][0]), lambda d, f: rk4_step(f, *VECTOR_OPERATIONS[d])):
        ends = []
        for top, d in ((three, 3), (six, 6)):
            run = Run(top, Stepper(build(d, top.field), d), GEN[:d], 0.01, 500)
            ends.append(run.collect().states[:, :3])
        assert np.abs(ends[0] - ends[1]).max() < 1e-13


def last_state(top: Top, made: Stepper, y0, h: float, N: int) -> np.ndarray:
    return Run(top, made, y0, h, N, N).collect().states[-1]


@adaptive
def test_order_of_an_adaptive_formula(scheme: Scheme) -> None:
    """If the tolerance accepts every step, the formula is a fixed-step method of the declared order."""
    top = TOPS[scheme.top].new()
    y0 = GEN[: len(top.components)]
    made = scheme.build(top, scheme.options(**LOOSE))
    free = not any(top.euler_poisson().gravity)
    duration, counts = (16.0, (28, 40, 56, 80)) if free else (4.0, (20, 28, 40, 56))
    exact = reference_states(top, y0, np.array([duration]))[0]
    errors = [np.linalg.norm(last_state(top, made, y0, duration / N, N) - exact) for N in counts]
    order = observed_order([duration / N for N in counts], errors, 1e-13)
    assert order is not None
    assert order > scheme.order - 0.1
    if top.form in (
        "heavy",
        "kowalevski",
    ):  # the others, integrable by quadratures, are often solved with an order more
        assert order == pytest.approx(scheme.order, abs=0.1)
    counted = []
    for N in (20, 40):
        run = Run(top, made, y0, 0.1, N)
        list(run)
        assert run.ending is not None
        counted.append(run.ending.counters["evaluations"])
    assert counted[1] - counted[0] == 20 * 13  # 12 stages, and one to begin with: a single step each


@pytest.mark.slow
@adaptive
def test_error_follows_the_tolerance_and_not_h(scheme: Scheme) -> None:
    top = TOPS[scheme.top].new()
    y0 = GEN[: len(top.components)]
    exact = reference_states(top, y0, np.array([20.0]))[0]
    tolerances = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
    errors = []
    for rtol in tolerances:
        made = scheme.build(top, scheme.options(rtol=rtol, atol=rtol))
        at_h = [np.linalg.norm(last_state(top, made, y0, 20.0 / N, N) - exact) for N in (1, 3, 10)]
        assert max(at_h) < 2e3 * rtol
        errors.append(max(at_h))
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.8 < slope < 1.25  # tolerance proportionality


REVERSAL_DEFECTS = {
    "euler": 2.366e-7,
    "euler+gamma": 2.360e-6,
    "heavy": 1.285e-5,
    "kowalevski": 1.077e-5,
    "lagrange": 1.397e-5,
    "lagrange/inertial": 2.966e-6,
}
"""Largest component missed by one step of DOP853 with h = 0.8 and one back, over the six states of the test."""


@adaptive
def test_adaptive_formula_is_not_self_adjoint(scheme: Scheme) -> None:
    top = TOPS[scheme.top].new()
    made = scheme.build(top, scheme.options(**LOOSE))
    states = random_states(6, seed=3)[:, : len(top.components)]
    defect = max(one_step_back_and_forth(top, made, y, 0.8) for y in states)
    assert defect == pytest.approx(REVERSAL_DEFECTS[scheme.top], rel=0.01)


def test_dop853_is_scipys_own_solution() -> None:
    """One step over the whole span is SciPy's solve_ivp over it, bit for bit."""
    from scipy.integrate import solve_ivp

    top = Heavy()
    made = find_scheme("dop853", "heavy").build(top, find_scheme("dop853", "heavy").options(rtol=1e-9, atol=1e-9))
    assert isinstance(made, Stepper)
    mine = last_state(top, made, GEN, 15.0, 1)
    theirs = solve_ivp(
        lambda t, y: top.field(tuple(y.tolist()), top.constants()), (0.0, 15.0), GEN, "DOP853", rtol=1e-9, atol=1e-9
    )
    assert (mine == theirs.y[:, -1]).all()


def test_dop853_reports_no_convergence() -> None:
    """Rates beyond double precision: no convergence, reported as such, with the rows before it."""
    top = Kowalevski()
    scheme = find_scheme("dop853", "kowalevski")
    run = Run(top, scheme.build(top, scheme.options()), (1e200, 1e200, 1e200, 0.6, 0.48, 0.64), 1.0, 5)
    states = run.collect().states
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step) == (Outcome.NO_CONVERGENCE, 1)
    assert len(states) == 1


def test_times_of_steps_are_medians_without_the_first_and_over_the_steps_taken() -> None:
    """With a clock made up here: 50,000 compiled steps, 512 interpreted ones, 5,000 states of a closed form.

    A run that ends by itself is timed up to its end.
    """
    top, exploding = Kowalevski(), (3.0, -2.0, 6.0, 0.6, 0.48, 0.64)
    names = ("hk", "dop853", "exact", "rk4")
    schemes = [find_scheme(name, "kowalevski") for name in names]
    methods = [scheme.build(top, scheme.options()) for scheme in schemes]
    ended = Run(top, methods[3], exploding, 1.0, 50_000).collect().ending.step
    assert 1 < ended < 100
    elapsed = [[9e9, 1e3, 9e9, 9e9], [7e6, 5e6, 1e6, 3e6], [1e6, 9e6, 5e6, 3e6], [4e6, 2e6, 3e6, 3e6]]
    ticks = iter([tick for row in elapsed for one in row for tick in (0, int(one))])
    runs = [(top, method, GEN, 0.01) for method in methods[:3]] + [(top, methods[3], exploding, 1.0)]
    found = nanoseconds_per_step(runs, 50_000, repetitions=3, clock=lambda: next(ticks))
    assert found == pytest.approx([4e6 / 50_000, 5e6 / 512, 3e6 / 5_000, 3e6 / ended], rel=1e-12)
    assert next(ticks, None) is None
