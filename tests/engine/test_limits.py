"""Limits of time and size: requests to stop, budgets, and states and steps at the end of the range of numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest

from conftest import GEN, PAPER, ROOT
from declared import SCHEMES
from steppers import built
from topcli.analysis import reference
from topcli.config.load import load_experiment
from topcli.contracts import Ending, Outcome, Sampler, Scheme, Stepper, StopAsked, check_stop, stopping_when
from topcli.engine import integration
from topcli.engine.collect import Memory, orbit
from topcli.engine.drive import drive
from topcli.engine.machine import Machine
from topcli.engine.numbers import LONG, Rational
from topcli.engine.plan import Plan
from topcli.errors import RunError
from topcli.schemes.any_top import runge_kutta
from topcli.schemes.any_top.taylor import MAX_EXPANSIONS, SHORTEST_REACH
from topcli.schemes.kowalevski import exact
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski


class AskedAt:
    """A request to stop at question number ``last``, and ever after."""

    def __init__(self, last: int) -> None:
        self.last, self.count = last, 0

    def __call__(self) -> bool:
        self.count += 1
        return self.count >= self.last


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every call of compiled code is followed by the question whether to stop."""
    monkeypatch.setattr(integration, "CALL_SECONDS", 0.0)


def stopped(name: str, h: float, N: int, stop: Callable[[], bool], y0: Any = (GEN,)) -> tuple[Ending, np.ndarray]:
    """Ending of the first trajectory of a drive that is asked to stop, and its states."""
    memory, top = Memory(), Kowalevski()
    run = drive(Plan(top, Machine(top, built(name)), np.array(y0), h, N), [memory], stop=stop)
    return run.endings[0], memory.states[0]


def test_requests_of_all_levels_are_heeded_and_forgotten() -> None:
    check_stop()
    inner, outer = AskedAt(9), AskedAt(2)
    with stopping_when(outer):
        check_stop()
        with stopping_when(inner), pytest.raises(StopAsked):
            check_stop()
        assert (inner.count, outer.count) == (1, 2)
    with stopping_when(lambda: False), stopping_when(AskedAt(1)), pytest.raises(StopAsked):
        check_stop()
    check_stop()


@pytest.mark.parametrize("last", [1, 4])
def test_the_reference_stops_when_asked(last: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "BUDGET", 3)
    asked = AskedAt(last)
    with stopping_when(asked), pytest.raises(StopAsked):
        reference.reference_states(Kowalevski(), PAPER, np.array([100.0]))
    assert asked.count == last


TOO_LONG = [(2.0, [1e10], r"1e\+10"), (1e150, [-1e150], r"[\d.]+e\+299"), (1e306, [1e10], r"1\.8e\+308")]


@pytest.mark.parametrize(("omega", "times", "steps"), TOO_LONG)
def test_a_hopeless_reference_is_refused_before_its_first_step(
    omega: float, times: list[float], steps: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The longest step is four units of the shortest time scale, |omega| 2^-1 to |omega|."""
    monkeypatch.setattr(reference, "_compiled", lambda: pytest.fail("a step was taken"))
    with pytest.raises(
        RunError, match=f"^the reference would need at least {steps} Taylor steps to reach t = "
    ) as said:
        reference.reference_states(Kowalevski(), (omega, *PAPER[1:]), np.array(times))
    assert len(said.value.lines) == 1


def test_a_reference_ends_at_its_budget_of_steps() -> None:
    """A unit of time takes some 1.8 steps: refused after one call of 2000 steps, or not at all."""
    with pytest.raises(RunError, match=r"would need about 4\.\de\+03 Taylor steps to reach t = 2400; at most 2500 are"):
        reference.reference_states(Kowalevski(), PAPER, np.array([2.4e3]), 2500)
    assert reference.reference_states(Kowalevski(), PAPER, np.array([1.2e3]), 2500).shape == (1, 6)


def test_taylor_stops_within_a_step(impatient: None) -> None:
    """h is far longer than the 50,000 series of a call reach."""
    asked = AskedAt(3)
    ending, _ = stopped("taylor", 1e6, 2, asked)
    assert (ending.outcome, ending.step) == (Outcome.INTERRUPTED, 0)
    assert asked.count <= 4
    assert ending.counters["expansions"] in (MAX_EXPANSIONS, 2 * MAX_EXPANSIONS)


def test_taylor_refuses_a_step_of_too_many_series() -> None:
    """At |omega| of one a series reaches less than about one unit of time."""
    assert SHORTEST_REACH == 2.0**-26
    ending = orbit(Kowalevski(), built("taylor"), GEN, 1e8, 2).ending
    assert (ending.outcome, ending.step, ending.counters["expansions"]) == (Outcome.NO_CONVERGENCE, 1, 0)
    assert ending.message == "did not converge at step 1 (t = 1e+08); a step of 1e+08 would need 7e+07 series or more"


def test_dop853_stops_within_a_step() -> None:
    stepper = built("dop853")
    asked = AskedAt(7)
    with stopping_when(asked), pytest.raises(StopAsked):
        stepper.step((*GEN, 0.0, 0.0, 0.0), 1e3, Kowalevski().constants())
    assert asked.count == 7


def test_dop853_gives_up_a_hopeless_step_early() -> None:
    """At 12 evaluations for some tenths of a unit of time, 1e9 would take 1e10 evaluations or more."""
    ending = orbit(Kowalevski(), built("dop853"), GEN, 1e9, 2).ending
    assert (ending.outcome, ending.step) == (Outcome.NO_CONVERGENCE, 1)
    assert runge_kutta.TRIAL < ending.counters["evaluations"] < runge_kutta.TRIAL + 15


def test_the_set_up_of_a_closed_form_stops_when_asked(impatient: None) -> None:
    exact._motions.cache_clear()
    asked = AskedAt(3)
    with stopping_when(asked), pytest.raises(StopAsked):
        exact.exact_states(np.array(GEN), 0.1, np.array([1]), (1.0,))
    assert asked.count == 3
    ending, states = stopped("exact", 0.1, 10, AskedAt(3))
    assert (ending.outcome, np.isfinite(states).any(axis=1).sum()) == (Outcome.INTERRUPTED, 1)


def test_an_operation_on_long_rational_numbers_heeds_a_stop() -> None:
    short, long = Rational(Fraction(1, 3)), Fraction(1, 2 ** (LONG + 1))
    with stopping_when(AskedAt(1)):
        assert short + short == Rational(Fraction(2, 3))
        for operation in (lambda: Rational(long), lambda: short / Rational(1 / long)):
            with pytest.raises(StopAsked):
                operation()


def test_constants_beyond_the_range_of_doubles_are_infinite() -> None:
    constants = (Fraction(1, 3), Fraction(10) ** 400, -(Fraction(10) ** 400), Fraction(1, 10**400))
    assert Stepper(lambda s, h, p: s, 1, constants=constants).doubles == (1 / 3, math.inf, -math.inf, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("h", [5e-324, -1e-300])
@pytest.mark.parametrize(
    "one", [one for one in SCHEMES if "+" not in one.name], ids=lambda one: f"{one.top}-{one.name}"
)
def test_a_tiny_step_moves_nothing_or_is_refused(one: Scheme, h: float, impatient: None) -> None:
    """Scaled working states lose digits among denormal numbers; the motion over the run is far below round-off."""
    top = TOPS[one.top]()
    method = one.build(top, one.options())
    y0 = np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64][: len(top.components)])
    found = orbit(top, method, y0, h, 40)
    if found.ending.outcome is Outcome.COMPLETED:
        np.testing.assert_allclose(found.states, np.broadcast_to(y0, found.states.shape), rtol=0.0, atol=1e-15)
    else:
        assert (one.name, found.ending.outcome) == ("backlund", Outcome.NO_CONVERGENCE)


SIZES = (5e-324, 1.0, 1e150, 1e306)
STEPS = (5e-324, 1e-300, -0.01, 1.0, 1e150)
QUESTIONS = 100
"""Questions whether to stop that two steps of a scheme, or its refusal, may take; the most is 40."""
PANELS = 5000
"""Questions of a set-up of a closed form, each of less than a millisecond."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "one", [one for one in SCHEMES if "+" not in one.name], ids=lambda one: f"{one.top}-{one.name}"
)
def test_every_scheme_ends_or_refuses_extreme_values(one: Scheme, impatient: None) -> None:
    top = TOPS[one.top]()
    found = one.build(top, one.options())
    for size, h in product(SIZES, STEPS):
        y0 = np.zeros(len(top.components))
        y0[0] = size
        if len(y0) == 6:
            y0[3:] = 0.6, 0.0, 0.8
        asked = AskedAt(10**9)
        refused = [RunError] if isinstance(found, Sampler) else []
        with np.errstate(all="ignore"), stopping_when(asked), suppress(*refused):
            run = drive(Plan(top, Machine(top, found), y0[None], h, 2), stop=asked)
            assert Outcome.INTERRUPTED not in run.endings.outcomes
        assert asked.count <= (PANELS if isinstance(found, Sampler) else QUESTIONS), (size, h)


def test_a_step_of_too_many_evaluations_does_not_converge(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runge_kutta, "MAX_EVALUATIONS", 3000)
    experiment = load_experiment("heavy_hk", ["scheme=dop853", "h=100", "N=3"])
    run = orbit(experiment.top, experiment.method(), experiment.y0, 100.0, 3)
    assert (run.ending.outcome, run.ending.step) == (Outcome.NO_CONVERGENCE, 1)
    assert 3000 <= run.ending.counters["evaluations"] < 3020


def test_calls_of_any_length_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = load_experiment(ROOT / "configs" / "kowalevski_hk.yaml", ["N=5000", "output.every=7"])

    def rows() -> tuple[np.ndarray, np.ndarray]:
        memory, top = Memory(), experiment.top
        y0 = np.array([experiment.y0, GEN, GEN, GEN])
        machine = Machine(top, experiment.method())
        drive(Plan(top, machine, y0, experiment.h, 5000, 7), [memory])
        return orbit(top, machine, experiment.y0, experiment.h, 5000, 7).states, memory.states

    whole = rows()
    monkeypatch.setattr(integration, "CALL_SECONDS", 0.0)
    for states, expected in zip(rows(), whole, strict=True):
        assert (states == expected).all()
