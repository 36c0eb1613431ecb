"""Tests of the declarations of schemes and tops, for plugin authors, ``topcli check`` and topcli's own tests.

::

    from topcli.testing import check_scheme, check_top

    def test_heun():
        assert all(trait.holds for trait in check_scheme("heun", "gyrostat"))
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from topcli.analysis.order import OrderVerdict, convergence, is_consistent, judge_order, one_step_back_and_forth
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Array, Invariant, Method, Outcome, Scheme, Stepper, Top
from topcli.engine.drive import drive, orbit
from topcli.engine.loops import interpreted, loop_of
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan
from topcli.field.integrals import RATE, exact_rate, rates_along
from topcli.field.polynomial import NotPolynomialError, field_of
from topcli.schemes.registry import find_scheme
from topcli.tops import CATALOGUE, TOPS, gentle_scene

GENERIC = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
"""State in general position."""
INTERVALS, FINEST = 8, 10
"""Times at which errors are compared, and octaves of step sizes."""
SIZES = (0.2, 0.1, 0.05)
"""Step sizes of one step there and back."""
REVERSED = 1e-13
"""Largest component missed by one step there and back, relative to the state; schemes of topcli miss 1e-14."""
_EXACT = 1e-13
"""Largest error of a solution in closed form, relative to the state."""
STEPS, FEW = 5000, 400
"""Steps of the runs that show invariants; in the interpreter fewer."""
_LONG = 0.05
"""Step size of these runs."""
ULPS = 50.0
"""Deviation of an exact invariant that round-off may cause, in ulp of its terms times the square root of the steps."""


class Trait(NamedTuple):
    """Declared trait: the ``measured`` deviation from it, nan if it is undecided, and the largest ``allowed`` one.

    ``why`` says what was observed.
    """

    trait: str
    measured: float
    allowed: float
    why: str = ""

    @property
    def holds(self) -> bool:
        """True if the declaration was not refuted."""
        return not self.measured > self.allowed


def generic_state(top: Top) -> tuple[float, ...]:
    """State of a top in general position, in which every scheme has its order."""
    if top.form in CATALOGUE:
        return load_experiment(gentle_scene(top.form)).y0
    return tuple(GENERIC[i % len(GENERIC)] for i in range(len(top.components)))


def check_scheme(
    scheme: Scheme | str, top: Top | str, options: Any = None, y0: Sequence[float] | None = None
) -> list[Trait]:
    """Measure every trait that a scheme declares.

    Parameters
    ----------
    scheme : Scheme or str
        Scheme, or its name.
    top : Top or str
        Top, or its form with the default parameters.
    options : BaseModel, optional
        Options of the scheme; by default, its defaults.
    y0 : sequence of float, optional
        Initial state (d,); by default, one in general position.

    Returns
    -------
    list of Trait
        Order, or error of a closed form; self-adjointness; exact and modified invariants; differences of machine code
        and of ensembles from plain steps. The declaration is false if a trait does not hold.

    Raises
    ------
    UsageError
        For an unknown scheme or top, and for options that the scheme refuses.
    SchemeCodeError
        If the code of the scheme fails, or if a counter is not finite.
    """
    top = TOPS[top].new() if isinstance(top, str) else top
    scheme = find_scheme(scheme, top.form) if isinstance(scheme, str) else scheme
    options = scheme.options() if options is None else options
    method = scheme.build(top, options)
    with np.errstate(all="ignore"):
        return list(_traits(scheme, top, options, method, np.array(generic_state(top) if y0 is None else y0)))


def _traits(scheme: Scheme, top: Top, options: Any, method: Method, y0: Array) -> Iterator[Trait]:
    plain = isinstance(method, Stepper) and method.plain
    start = tuple(y0.tolist())
    if not scheme.adaptive:
        yield _order(scheme.order_for(options), top, method, y0, plain)
    if scheme.self_adjoint:
        states = states_near(start, 4 if plain else 12)
        defects = [reversal_defect(top, method, h, states) for h in SIZES]
        defect = max(filter(math.isfinite, defects), default=math.nan)  # a long step may fail
        yield Trait("self-adjoint", defect, REVERSED * max(1.0, float(np.abs(states).max())))
    exact = [each for each in top.invariants() if each.name in scheme.conserves]
    modified = scheme.modified(top, _LONG, options) if scheme.modified else ()
    if exact or modified:
        N = FEW if plain else STEPS
        states = _completed(top, method, start, _LONG, N)
        for trait, invariants in (("exact invariants", exact), ("modified invariants", modified)):
            if not invariants:
                continue
            if states is None:
                yield Trait(trait, math.nan, 1.0, f"a run of {N} steps of {_LONG:g} does not complete")
            else:
                yield _conserved(trait, states, invariants, N)

    # the same bits from machine code, in ensembles and in plain Python
    few = states_near(start, 3 if plain else 9)
    yield Trait("ensembles equal single runs", differing_lanes(top, method, few, few, 0.02, 20 if plain else 100), 0.0)
    if isinstance(method, Stepper) and not plain:
        python, compiled = _working_states(top, method, start, 0.02, 100)
        differing = sum(a.hex() != b.hex() for a, b in zip(python, compiled, strict=True))
        yield Trait("machine code equals Python", differing, 0.0)


def _conserved(trait: str, states: Array, invariants: Sequence[Invariant], N: int) -> Trait:
    """Largest deviation of invariants in units of what round-off explains."""
    off = {each.name: deviation(states, each, N) for each in invariants}
    worst = max(off, key=lambda name: math.inf if math.isnan(off[name]) else off[name])
    measured = math.inf if math.isnan(off[worst]) else off[worst]
    return Trait(trait, measured, 1.0, f"{worst} is off by {measured:.2g} times what round-off explains")


def _order(declared: int | None, top: Top, method: Method, y0: Array, plain: bool) -> Trait:
    """Observed order, from errors at step sizes that fall until round-off; or the error of a closed form."""
    size = max(1.0, float(np.abs(y0).max()))
    t = np.arange(1, INTERVALS + 1) * (4.0 / INTERVALS)
    reference = reference_states(top, tuple(y0.tolist()), t)
    moved = float(np.linalg.norm(reference - y0, axis=1).max())
    sizes: list[float] = []
    errors: list[float] = []
    observed = convergence(sizes, errors)
    for k in range(2 * FINEST + 1 if declared else 3):
        steps = round(2.0 ** (k / 2))
        if t[0] / steps in sizes or (plain and steps > 64):
            continue
        _, states, _ = orbit(top, method, y0, t[0] / steps, INTERVALS * steps, steps)
        sizes.append(t[0] / steps)
        whole = len(states) == INTERVALS + 1
        errors.append(float(np.linalg.norm(states[1:] - reference, axis=1).max()) if whole else math.inf)
        observed = convergence(sizes, errors)
        if observed.plateau is not None:
            break
    if declared is None:
        return Trait("solution in closed form", max(errors), _EXACT * size)
    verdict, why = judge_order(declared, observed, moved, lambda: is_consistent(top, method, y0))
    if verdict is OrderVerdict.UNDECIDED or observed.order is None:
        return Trait(f"order {declared}", math.nan, 0.1, why)
    return Trait(f"order {declared}", declared - observed.order, 0.1, why or f"observed: {observed.order:.2f}")


def check_top(top: Top | str, y0: Sequence[float] | None = None) -> list[Trait]:
    """Measure whether the field and the integrals of a top are what it declares.

    Parameters
    ----------
    top : Top or str
        Top, or its form with the default parameters.
    y0 : sequence of float, optional
        State (d,) whose neighbourhood is tried; by default, one in general position.

    Returns
    -------
    list of Trait
        States at which the field returns no vector of finite numbers, and two rates of change of each integral along
        the field: the number of terms of the exact rate, for polynomials, and the rate by differences on random states.
    """
    top = TOPS[top].new() if isinstance(top, str) else top
    states = states_near(generic_state(top) if y0 is None else y0, 20)
    p = top.constants()
    wrong = sum(not _is_vector_of(top.field(tuple(y.tolist()), p), top) for y in states)
    traits = [Trait("field", wrong, 0.0)]
    for each in top.invariants():
        try:
            terms = len(exact_rate(field_of(top), top.invariants(), each))
            traits.append(Trait(f"{each.name}: exact rate", terms, 0.0))
        except NotPolynomialError:
            pass
        if not each.on:  # an integral on a level of another one
            _, sizes = rates_along(top, each.value, states[1:])
            traits.append(Trait(f"{each.name}: rate on random states", float(sizes.max()), RATE))
    return traits


def states_near(y0: Sequence[float], count: int) -> Array:
    """States (count, d) of the size of ``y0``, the first of which is ``y0``; components of zero are moved too."""
    y, number = np.array(y0, dtype=float), np.arange(count)[:, None]
    size = max(float(np.abs(y).max()), 1e-3)
    return y + 0.3 * size * (number > 0) * np.cos(1.0 + 2.0 * number + 3.0 * np.arange(len(y)))


def reversal_defect(top: Top, method: Method, h: float, states: Array) -> float:
    """Largest component missed by one step there and one back, over the ``states`` (n, d)."""
    return max(one_step_back_and_forth(top, method, y, h) for y in states)


def deviation(states: Array, invariant: Invariant, steps: int) -> float:
    """Largest deviation of an invariant from its first value, in units of what round-off explains.

    The unit is ``ULPS`` ulp of its terms times the square root of the number of ``steps`` taken.
    """
    values, scale = invariant.value(states), float(invariant.scale(states).max())
    return float(np.abs(values - values[0]).max()) / (ULPS * np.finfo(float).eps * math.sqrt(steps) * scale or 1.0)


def _working_states(top: Top, method: Stepper, y0: Sequence[float], h: float, N: int) -> list[list[float]]:
    """Working state after N steps of the interpreter, and of machine code."""
    start, p, states = np.array(y0, dtype=float), np.array(top.constants()), []
    for make in (interpreted, loop_of):
        loop, work = make(method, len(start), len(p)), np.zeros(method.width)
        loop.enter(start, work, p, h)
        loop.take_steps(work, work[:0], p, h, N, N + 1, N + 1)
        states.append(work.tolist())
    return states


def differing_lanes(top: Top, method: Method, alone: Array, together: Array, h: float, N: int) -> int:
    """Number of states (n, d) whose trajectory ``alone`` ends on other bits than that ``together`` with the others."""
    machine = Machine(top, method)
    last = drive(Plan(top, machine, np.ascontiguousarray(together), h, N, N)).last
    ends = [orbit(top, machine, y, h, N, N).states[-1] for y in alone]
    return sum(end.tobytes() != other.tobytes() for end, other in zip(ends, last, strict=True))


def _completed(top: Top, method: Method, y0: Sequence[float], h: float, N: int) -> Array | None:
    """States of every tenth step of a run; None if it does not complete."""
    _, states, ending = orbit(top, method, y0, h, N, 10)
    return states if ending.outcome in (Outcome.COMPLETED, Outcome.LEFT_MOTION) else None


def _is_vector_of(rates: Any, top: Top) -> bool:
    """True if ``rates`` are as many finite floats as the top has components."""
    return (
        isinstance(rates, tuple)
        and len(rates) == len(top.components)
        and all(isinstance(x, int | float) and math.isfinite(x) for x in rates)
    )
