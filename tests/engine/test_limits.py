"""Limits of time and size: requests to stop, budgets, and states and steps at the end of the range of numbers."""

from __future__ import annotations

from contextlib import suppress
from itertools import product

import numpy as np
import pytest

from conftest import GEN, PAPER
from declared import SCHEMES
from steppers import built
from topcli.analysis import reference
from topcli.contracts import Outcome, Sampler, Scheme, StopAsked, stopping_when
from topcli.engine import integration
from topcli.engine.drive import drive, orbit
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan
from topcli.errors import RunError
from topcli.schemes.any_top import dop853
from topcli.schemes.any_top.taylor import MAX_EXPANSIONS, SHORTEST_REACH
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


def test_taylor_stops_within_a_step(impatient: None) -> None:
    """h is far longer than the 50,000 series of a call reach."""
    asked = AskedAt(3)
    with stopping_when(asked):
        ending = orbit(Kowalevski(), built("taylor"), GEN, 1e6, 2).ending
    assert (ending.outcome, ending.step) == (Outcome.INTERRUPTED, 0)
    assert asked.count <= 4
    assert ending.counters["expansions"] in (MAX_EXPANSIONS, 2 * MAX_EXPANSIONS)


def test_taylor_refuses_a_step_of_too_many_series() -> None:
    """At |omega| of one a series reaches less than about one unit of time."""
    assert SHORTEST_REACH == 2.0**-26
    ending = orbit(Kowalevski(), built("taylor"), GEN, 1e8, 2).ending
    assert (ending.outcome, ending.step, ending.counters["expansions"]) == (Outcome.NO_CONVERGENCE, 1, 0)
    assert ending.message == "did not converge at step 1 (t = 1e+08)"


def test_dop853_gives_up_a_hopeless_step_early() -> None:
    """At 12 evaluations for some tenths of a unit of time, 1e9 would take 1e10 evaluations or more."""
    ending = orbit(Kowalevski(), built("dop853"), GEN, 1e9, 2).ending
    assert (ending.outcome, ending.step) == (Outcome.NO_CONVERGENCE, 1)
    assert dop853.TRIAL < ending.counters["evaluations"] < dop853.TRIAL + 15


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
    """A tiny step moves nothing, although scaled working states lose digits among denormal numbers."""
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
            run = drive(Plan(top, Machine(top, found), y0[None], h, 2))
            assert Outcome.INTERRUPTED not in run.endings.outcomes
            if size == 1.0 and 0.0 < h < 1e-200:
                if run.endings[0].outcome is Outcome.COMPLETED:
                    np.testing.assert_allclose(run.last[0], y0, rtol=0.0, atol=1e-15)
                else:
                    assert (one.name, run.endings[0].outcome) == ("backlund", Outcome.NO_CONVERGENCE)
        assert asked.count <= (PANELS if isinstance(found, Sampler) else QUESTIONS), (size, h)
