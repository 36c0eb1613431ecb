"""The adaptive methods: Taylor series against the motion, DOP853 against SciPy, and what limits both."""

from __future__ import annotations

import math

import numpy as np
import pytest

import topcli
from conftest import GEN, random_states
from declared import BODIES, Heavy
from fields import random_field, random_state, top_of
from topcli.analysis.order import one_step_back_and_forth
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Block, Outcome, Stepper, Top
from topcli.engine.drive import orbit
from topcli.schemes.any_top import taylor as loop_text
from topcli.schemes.any_top.taylor import ORDERS, Tolerance, build_taylor, order_for
from topcli.schemes.registry import find_scheme
from topcli.sweeps.batch import Measuring
from topcli.sweeps.measures import resolve_measures
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

TOPS_TRIED: list[Top] = [
    *(TOPS[form].new() for form in BODIES),
    Kowalevski(c0=-1.5),
    EulerGamma(A=1.0, B=1.0, C=1.0),
    Heavy(A=0.7, B=1.1, C=1.6, x0=-0.4, y0=1.2, z0=0.3),
    Lagrange(A=1.4, C=2.1, mu=-0.8),
]
of_every_top = pytest.mark.parametrize("top", TOPS_TRIED, ids=repr)


def taylor(top: Top, tol: float = 1e-17) -> Block:
    return build_taylor(top, Tolerance(tol=tol))


def gen(top: Top) -> np.ndarray:
    return np.array(GEN[: len(top.components)])


def after(top: Top, y0, h: float, N: int, every: int = 1, tol: float = 1e-17) -> np.ndarray:
    """The recorded states, the first one left out."""
    return orbit(top, taylor(top, tol), y0, h, N, every).states[1:]


@pytest.mark.slow
@of_every_top
@pytest.mark.parametrize(("h", "N"), [(0.01, 2000), (-0.7, 30), (math.pi, 7)])
def test_taylor_follows_the_reference_to_round_off(top: Top, h: float, N: int) -> None:
    """Against the reference: a random walk of ulps, amplified by the motion no more than its own length."""
    y0 = gen(top)
    mine = after(top, y0, h, N, max(1, N // 50))
    n = np.arange(1, N + 1)[:: max(1, N // 50)] if N < 50 else np.arange(N // 50, N + 1, N // 50)
    exact = reference_states(top, y0, n * h)
    chaos = 50.0 if top.kind == "heavy" else 1.0
    assert np.abs(mine - exact).max() < 4e-14 * chaos * (1.0 + abs(N * h) / 10.0)


@pytest.mark.slow
@pytest.mark.parametrize(("d", "degree", "density"), [(1, 2, 1.0), (3, 3, 0.5), (2, 6, 0.5), (5, 2, 0.5), (9, 2, 0.2)])
def test_any_polynomial_field_is_followed_to_round_off(d: int, degree: int, density: float) -> None:
    """Constant, linear and higher terms, auxiliary components, and 16 lanes."""
    field, y0 = random_field(d, degree, 2, density), random_state(d, 2)
    top, times = top_of(field), 0.05 * np.arange(1, 5)
    exact = reference_states(top, y0, times)
    assert np.abs(after(top, y0, 0.05, 4) - exact).max() < 5e-16 * np.abs(exact).max()


@pytest.mark.slow
@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), Euler()], ids=repr)
def test_the_error_follows_the_tolerance(top: Top) -> None:
    y0, tolerances = gen(top), 10.0 ** -np.arange(3.0, 16.0)
    exact = reference_states(top, y0, np.array([5.0]))[0]
    errors = np.array([np.abs(after(top, y0, 5.0, 1, tol=tol)[0] - exact).max() for tol in tolerances])
    assert (errors < 300.0 * tolerances + 1e-13).all()
    assert 5e-5 < errors[0] < 0.0012  # a loose one is made use of
    counts = []
    for tol in tolerances:
        counts.append(orbit(top, taylor(top, tol), y0, 5.0, 1).ending.counters["expansions"])
    assert counts[-1] < 50
    per_order = [counts[i] for i in range(len(counts)) if order_for(tolerances[i]) == ORDERS[0]]
    assert sorted(per_order) == per_order


def tangent_images() -> np.ndarray:
    f = topcli.step("kowalevski_generic_hk", ["scheme=taylor", "h=20"])
    return np.array(f.tangent(f.initial, np.eye(6), 2))


def one_step() -> np.ndarray:
    experiment = load_experiment("kowalevski_generic_hk", ["scheme=taylor", "N=10"])
    measuring = Measuring(experiment, resolve_measures(["reversal_defect"], experiment.top, experiment.scheme))
    states = random_states(3, seed=4)
    return measuring.finished(states).one_step(states, 20.0)


LONG_STEPS = {
    "single step": lambda: np.array(one_step_back_and_forth(Kowalevski(), taylor(Kowalevski()), GEN, 20.0)),
    "map": lambda: topcli.step("kowalevski_generic_hk", ["scheme=taylor", "h=20"])(GEN, 2),
    "tangent map": tangent_images,
    "steps of a sweep": one_step,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG_STEPS)
def test_no_caller_takes_an_unfinished_step_for_done(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever drives a block goes on until its step is done: no result depends on the number of series per call."""
    whole = LONG_STEPS[name]()
    monkeypatch.setattr(loop_text, "MAX_EXPANSIONS", 5)
    assert np.isfinite(whole).all()
    assert np.array_equal(LONG_STEPS[name](), whole)


@pytest.mark.parametrize("scale", [1e-90, 1e-8, 1e8, 1e90])
def test_units_of_time_do_not_matter(scale: float) -> None:
    """A faster top is the same top in other units of time: powers of two give the same bits."""
    factor = 2.0 ** round(math.log2(scale))
    slow, fast = Heavy(), Heavy(x0=1.0 * factor**2, y0=0.5 * factor**2, z0=0.8 * factor**2)
    assert (slow.x0, slow.y0, slow.z0) == (1.0, 0.5, 0.8)
    y0 = np.array(GEN)
    quick = y0.copy()
    quick[:3] *= factor
    found = after(fast, quick, 0.3 / factor, 40)
    found[:, :3] /= factor
    assert (found == after(slow, y0, 0.3, 40)).all()


@pytest.mark.slow
def test_the_first_coefficient_is_to_more_than_a_double(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounded, as the others, it would make twice the error."""
    top, y0 = Lagrange(), random_states(24, seed=3)
    exact = [reference_states(top, y, np.array([100.0]))[0] for y in y0]

    def error() -> float:
        errors = [np.abs(after(top, y, 100.0, 1)[0] - true).max() for y, true in zip(y0, exact, strict=True)]
        return float(np.exp(np.mean(np.log(errors))))

    carefully = error()
    increment = loop_text.taylor_increment
    rounded = lambda o, order, d, missed: increment(o, order, d, o.constant((0.0,) * o.lanes))  # noqa: E731
    monkeypatch.setattr(loop_text, "taylor_increment", rounded)
    assert carefully < 0.7 * error()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("top", [Kowalevski(), Euler()], ids=repr)
def test_a_state_that_is_not_finite_ends_the_run(top: Top, bad: float) -> None:
    y0 = gen(top)
    y0[1] = bad
    ending = orbit(top, taylor(top), y0, 0.1, 5).ending
    assert (ending.outcome, ending.step) == (Outcome.BLEW_UP, 1)


# DOP853


def test_dop853_is_scipys_own_solution() -> None:
    """One step over the whole span is SciPy's solve_ivp over it, bit for bit."""
    from scipy.integrate import solve_ivp

    top = Heavy()
    made = find_scheme("dop853", "heavy").build(top, find_scheme("dop853", "heavy").options(rtol=1e-9, atol=1e-9))
    assert isinstance(made, Stepper)
    mine = orbit(top, made, GEN, 15.0, 1).states[-1]
    theirs = solve_ivp(
        lambda t, y: top.field(tuple(y.tolist()), top.constants()), (0.0, 15.0), GEN, "DOP853", rtol=1e-9, atol=1e-9
    )
    assert (mine == theirs.y[:, -1]).all()
