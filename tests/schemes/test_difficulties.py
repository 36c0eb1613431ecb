"""Difficulties of schemes: counts and warnings, steps that do not converge, and the states that limits name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import topcli
from conftest import GEN, PAPER
from declared import Heavy
from topcli.contracts import Ending, Floats, Outcome, Top
from topcli.engine.drive import orbit
from topcli.runs.report import warning_of
from topcli.schemes.any_top.hk import NEAR_SINGULAR
from topcli.schemes.registry import find_scheme
from topcli.studies.stress import singular_step
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange


def carried_out(top: Top, name: str, y0: Floats, h: float, N: int) -> tuple[np.ndarray, Ending]:
    scheme = find_scheme(name, top.form)
    _, states, ending = orbit(top, scheme.build(top, scheme.options()), y0[: len(top.components)], h, N)
    return states, ending


@pytest.mark.slow
@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), Lagrange(), Euler(), EulerGamma()], ids=repr)
@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-6, 3e-4])
def test_a_singular_step_of_a_top_with_an_energy_is_seen(top: Top, off: float) -> None:
    """The step with det(1 - h/2 f'(y)) = 0, and close to it, leaves the energy surface or blows up within 50 steps."""
    y0 = GEN[: len(top.components)]
    h = singular_step(top, y0) * (1.0 + off)  # pyright: ignore
    initial = top.initial_section(y0)
    run = topcli.simulate({"top": top.section(), "initial": initial, "scheme": "hk", "h": h, "N": 50})
    assert run.outcome in (Outcome.LEFT_MOTION, Outcome.BLEW_UP)
    assert run.ending.counters == {}


def fast_and_free(y: Any, p: Any) -> Any:
    return (y[1] * y[2], -2.0 * y[2] * y[0], y[0] * y[1])


def test_a_singular_step_of_a_top_without_an_energy_is_counted(own_registry: None) -> None:
    @topcli.top
    class NoEnergy(Top):
        """A quadratic field that declares no integral."""

        kind = "no-energy"
        components = ("x", "y", "z")
        field = staticmethod(fast_and_free)

    top, y0 = NoEnergy.new(), (0.7, -0.4, 1.3)
    h = singular_step(top, y0)  # pyright: ignore
    assert carried_out(top, "hk", y0, h, 1)[1].counters == {NEAR_SINGULAR: 1}
    assert carried_out(top, "hk", y0, 0.05, 1000)[1].counters == {NEAR_SINGULAR: 0}
    method = find_scheme("hk", "no-energy")
    for compensated in (False, True):
        run = orbit(top, method.build(top, method.options(compensated=compensated)), y0, h, 1)
        assert run.ending.counters == {NEAR_SINGULAR: 1}


def test_a_run_warns_of_what_it_counted() -> None:
    """Iterations are the rule and no reason to warn."""
    report = {"name": "x", "scheme": "hk", "step": 9, "counters": {"iterations": 40, NEAR_SINGULAR: 0}}
    assert warning_of(report) == ""
    report["counters"] = {"iterations": 40, NEAR_SINGULAR: 3}
    assert warning_of(report) == "3 near singular solves in 9 steps; topcli show hk lists the limits of this scheme"


# steps that end a run


@pytest.mark.parametrize("y", [(0.0,) * 6, (0.0, 0.0, 0.0, 0.6, 0.0, 0.8), (0.0, 0.0, 2.0, 0.6, 0.0, 0.8), PAPER])
@pytest.mark.parametrize("h", [1e-9, 0.1])
def test_equilibria_and_special_states_settle(y: Floats, h: float) -> None:
    for A, C, x, z in ((1.0, 1.0, 0.6, 0.8), (2.0, 1.0, 0.0, 0.0), (2.0, 1.0, 1.0, 0.0)):
        top = Heavy(A=A, B=A, C=C, x0=x, y0=0.0, z0=z)
        assert carried_out(top, "midpoint", y, h, 3)[1].outcome is Outcome.COMPLETED


@pytest.mark.parametrize("compensated", [False, True])
def test_a_step_that_does_not_converge_ends_the_run_as_such(compensated: bool) -> None:
    """An h with no hope: the outcome, the step, and the rows before it."""
    top, y0 = Heavy(A=3.0, B=2.0, C=1.2, x0=40.0, y0=-30.0, z0=60.0), (9.0, -8.0, 7.0, 0.6, 0.48, 0.64)
    method = find_scheme("midpoint", "heavy")
    _, states, ending = orbit(top, method.build(top, method.options(compensated=compensated)), y0, 11.0, 1000)
    assert (ending.outcome, ending.step, len(states)) == (Outcome.NO_CONVERGENCE, 3, 3)
    assert np.isfinite(states).all()
    assert compensated or ending.counters["iterations"] == 57  # 32 in two steps, and 25 in the third
    assert ending.message.startswith("did not converge at step 3")
