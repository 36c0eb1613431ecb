"""Shared parts of schemes: declarations (limits, formulas in LaTeX, low-degree invariants), working states, counters.

Conventions of the formulas are those of ``contracts.Scheme``. Every Runge-Kutta method conserves linear invariants; the
implicit midpoint rule also conserves quadratic ones (Cooper 1987).

**Working states.** A scheme gives the change of its state; ``stepper`` writes the step for the compiler. The slots of
the working state are the state, the kept quantities, the rounding errors of the sums, the status of an iteration, and
the counters.

**Compensated sums.** A change of size h has a rounding error of about h times the last bit of the state, whereas the
addition state + change has an error of the last bit itself (``arithmetic.increments``). Its rounding error starts at
zero, is not recorded, and does not depend on h, so that a compensated scheme can be composed like a plain one. Cost:
one addition more on the critical path of a step; the rest overlaps with the next step. The errors are not tested for
finiteness, because one that is not finite makes the state non-finite. Measured: 1.03 to 1.25 times the plain step; 0.71
times the straightforward HK step, including the compensation of the change of gamma.

**Counters** report failures that would otherwise be silent. An event uses quantities that the step computes anyway:
once both are inlined, the compiler merges them, and only a comparison and an addition are added, off the critical path.
The state is unchanged, bit for bit. Measured (ratio to the time of a step without counter): HK 1.00 (Kowalevski), 1.02
(Euler, heavy), 1.03 (Lagrange), 1.08 (Euler with gamma, 0.9 ns); the hybrids 1.01, Bohlin's methods 1.02. A slot that
counts nothing has the same cost. Counters are always finite and are not tested for finiteness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import comb
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.fused import compensated_sum, unlikely
from topcli.contracts import Floats, Invariant, StepFunction, Stepper, Top, same_state
from topcli.tops import BUILT_IN, CATALOGUE

SINGULAR = (
    "For certain step sizes of the order of 1/|omega| and larger, the determinant of HK's linear system vanishes, and "
    "only round-off keeps the new state finite. The counter `near_singular_solves` counts such steps. Choose h such "
    "that |h| |omega| is well below 1."
)
LONG_HK = (
    "If h is about the time of one revolution of the body, the determinant of HK's linear system changes sign along "
    "the motion. The state jumps far away whenever the determinant is close to zero."
)
NO_SOLUTION = (
    "If h is the time of one revolution of the body or longer, Newton's method, which starts from a step of HK (the "
    "scheme `hk`), may find no solution. The run then ends as `no_convergence`."
)
FAR_OVERFLOW = (
    "The determinant of the linear system in Newton's method grows as |omega|³ and overflows if |omega| exceeds about "
    "1e103. The run then ends as `no_convergence`."
)
LONG_NEWTON = (
    "With steps of several units of time the equation of the step may have no solution near the old state. Newton's "
    "method then does not converge, and the run ends as `no_convergence`."
)
NO_LONG_STEP = (
    "If h is longer than about 1/|omega|, the equation for the rotation of the body in a step has no solution. "
    "The run then ends as `no_convergence`, and its message names the largest h that works."
)
LONG_SPLITTING = (
    "If the body turns by several radians in a step, the kicks and rotations no longer approximate the exact motion: "
    "the energy deviates by several times its first value."
)
NEWTON_SINGULAR = (
    "The iteration for the step starts from a step of HK (the scheme `hk`), whose linear system is singular for the h "
    "of this case. The iteration does not converge, and the run ends as `no_convergence`."
)
OVERFLOW = (
    "|xi|² grows as |omega|⁴ and overflows if |omega| exceeds about 1e77. Choose a unit of time in which omega has a "
    "moderate size."
)
NO_FAR_STEPS = (
    "The method is explicit and does not conserve the energy. If h is about the time of one revolution of the body, "
    "the state grows without bound within a few steps."
)


def has_own_cases(top: Top) -> bool:
    """True for the tops of the paper, which have hard cases of their own besides those of every top."""
    return top.form in BUILT_IN and top.form not in CATALOGUE


def explicit_limits(top: Top) -> Mapping[str, str]:
    """Limits of explicit Runge-Kutta methods."""
    if not has_own_cases(top):
        return {}
    limits = {"resonance": NO_FAR_STEPS}
    if top.form != "lagrange/inertial":
        limits["singular-step"] = NO_FAR_STEPS
    return limits


def rk2_limits(top: Top) -> Mapping[str, str]:
    """Limits of the explicit midpoint rule."""
    limits = dict(explicit_limits(top))
    if top.kind == "lagrange":
        limits["drift"] = (
            "The energy grows steadily, at a rate of about h³. With h = 0.1 the run ends as `blew_up` after about 1e4 "
            "steps, and the linear integral is lost as well."
        )
    return limits


HIROTA_KIMURA = r"""
J\,\frac{\omega' - \omega}{h} = \tfrac12\,(J\omega\times\omega' + J\omega'\times\omega) + \bar\gamma\times r, \qquad
\frac{\gamma' - \gamma}{h} = \tfrac12\,(\gamma\times\omega' + \gamma'\times\omega)
"""
XI = r"\xi = (\omega_1 + i\omega_2)^2 - c\,(\gamma_1 + i\gamma_2)"
BOHLIN = rf"""
\omega_3' - \omega_3 = -h c\,\bar\gamma_2, \qquad
(\omega_1' + i\omega_2')^2 = e^{{-ih\bar\omega_3}}\,\xi + c\,(\gamma_1' + i\gamma_2'), \qquad {XI}
"""
HYBRID = r"""
\gamma' - \gamma = h\,\bar\gamma\times\frac{\omega + \omega^{\mathrm{HK}}}{2}, \qquad
\omega_3' = \omega_3^{\mathrm{HK}}, \qquad
(\omega_1' + i\omega_2')^2 = e^{-ih\bar\omega_3}\,\xi + c\,(\gamma_1' + i\gamma_2')
"""
LAGRANGE_AXIS = r"""
\dot u^2 = (2E - s^2 - 2u)(1 - u^2) - (l - su)^2, \qquad
u = u_1 + (u_2 - u_1)\,\mathrm{sn}^2\Bigl(\sqrt{\tfrac{u_3 - u_1}{2}}\;(t + t_0)\,;\ k\Bigr), \quad
k^2 = \frac{u_2 - u_1}{u_3 - u_1}

u = \gamma_3 = a\cdot p, \quad s = m\cdot e_3 = m\cdot a, \quad l = m\cdot\gamma = m\cdot p, \quad
E = \tfrac12 m^2 + u, \qquad u_1 \leq u_2 \leq u_3 \text{ the zeros of } \dot u^2; \quad A = \mu = 1
"""


LINES = 3


def polynomial_invariants(top: Top, degree: int) -> tuple[str, ...]:
    """Return the names of the invariants of ``top`` that are polynomials of the state of at most ``degree``.

    One that only some motions conserve is left out, unless it is linear and its own level is the condition: then the
    motion remains on a hyperplane, and so do the stages of a method.
    """
    d = len(top.components)
    return tuple(
        invariant.name
        for invariant in top.invariants()
        if invariant.on.keys() <= {invariant.name} and _is_polynomial(invariant, d, 1 if invariant.on else degree)
    )


def _is_polynomial(invariant: Invariant, d: int, degree: int) -> bool:
    """True if an invariant of ``d`` components is a polynomial of at most ``degree``, determined numerically.

    Along a line, the finite difference of order ``degree + 1`` of such a polynomial vanishes. Three lines in general
    position are used, with a tolerance for round-off. A formula without a value on them, such as a logarithm of a
    negative number, is no polynomial.
    """
    orders = np.arange(degree + 2.0)
    weights = np.array([(-1.0) ** k * comb(degree + 1, k) for k in range(degree + 2)])
    excess = 0.0
    for line in range(LINES):
        start, along = np.cos(np.arange(2.0 * d) + 2.0 * d * line + 1.0).reshape(2, d)
        states = start + orders[:, None] * along
        with np.errstate(all="ignore"):
            scale = float(invariant.scale(states).max()) or 1.0
            excess = float(np.maximum(excess, abs(weights @ invariant.value(states)) / scale))  # nan stays
    return excess < 1e-13 * 2.0 ** (degree + 1)


Change = StepFunction
"""``change(state, h, p)``: change of the state, then the status and the events to be counted, if there are any."""
Event = Callable[[Floats, Floats, float, Floats], bool]
"""``event(old, new, h, p)`` is true if the step from working state ``old`` to ``new`` is to be counted."""
Prediction = Callable[[Floats, float, Floats], tuple[float, float]]

NEAR_SINGULAR = "near_singular_solves"
AMBIGUOUS = "ambiguous_roots"
SMALL = 2.0**-10
"""A determinant below this fraction of the sum of the magnitudes of its terms has lost three digits to cancellation."""


class CompensatedOption(BaseModel):
    """Option to compensate the rounding errors of the sums old + change."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    compensated: bool = Field(
        default=False,
        description="compensated summation: round-off is multiplied by about h",
    )


def linear_invariants(top: Top) -> tuple[str, ...]:
    """Names of the invariants that every Runge-Kutta method conserves."""
    return polynomial_invariants(top, 1)


def all_invariants(top: Top) -> tuple[str, ...]:
    """Names of all invariants of ``top``."""
    return tuple(invariant.name for invariant in top.invariants())


def is_compensated(options: object) -> bool:
    """True if ``options`` have the option ``compensated`` and it is set."""
    return isinstance(options, CompensatedOption) and options.compensated


@cache
def _writer(moved: int, kept: int, lost: tuple[int, ...], iterative: bool, counters: int, adds: bool) -> Any:
    """Function that makes a step of a change; see ``stepper``."""
    state, constants = [f"y{i}" for i in range(moved)], [f"c{i}" for i in range(kept)]
    errors, counts, status = [f"e{i}" for i in lost], [f"n{i}" for i in range(counters)], ["status"] * iterative
    changes = [f"x{i}" for i in range(moved)] if adds else state
    lines = [
        f"{', '.join([*state, *constants, *errors, *status, *counts])}, = s",
        f"{', '.join([*changes, *status, *(f'more_{n}' for n in counts)])}, = change"
        f"(({', '.join([*state, *constants])},), h, p)",
        *(f"y{i}, e{i} = compensated_sum(y{i}, e{i}, x{i})" for i in lost),
        *(f"y{i} = y{i} + x{i}" for i in range(moved) if adds and i not in lost),
        f"return ({', '.join([*state, *constants, *errors, *status, *(f'{n} + more_{n}' for n in counts)])},)",
    ]
    text = "def make(change):\n    def step(s, h, p):\n        " + "\n        ".join(lines) + "\n    return step"
    scope: dict[str, Any] = {"compensated_sum": compensated_sum, "__name__": __name__}
    exec(compile(text, f"<step {moved}/{kept}/{lost}>", "exec"), scope)
    return scope["make"]


def summed(change: Change, count: int) -> StepFunction:
    """Step state + change of ``count`` components."""
    return _writer(count, 0, (), False, 0, True)(change)


def first(count: int) -> StepFunction:
    """``leave`` of a working state that begins with the ``count`` components of the physical one."""

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return s[:count]

    return leave


def stepper(
    change: Change,
    moved: int,
    kept: int = 0,
    *,
    lost: Iterable[int] = (),
    adds: bool = True,
    counters: tuple[str, ...] = (),
    iterative: bool = False,
    checked: int = 0,
    enter: StepFunction | None = None,
    leave: StepFunction | None = None,
    advice: Callable[[Sequence[float], float], str] | None = None,
) -> Stepper:
    """Stepper that adds ``change`` to the first ``moved`` slots of its state.

    ``kept`` slots that do not change follow. The rounding errors of the sums of the slots ``lost`` are carried. After
    the changes, ``change`` returns the status if it is ``iterative``, and an addition to each of the ``counters``; it
    returns the new slots themselves instead of changes if not ``adds``. ``enter`` gives the moved and kept slots, by
    default the physical state; ``leave`` is by default that of a state of all that is moved, or of 6 components at most
    where others are kept.
    """
    errors = tuple(lost)
    tail = (0.0,) * (len(errors) + iterative + len(counters))
    begin = enter or same_state

    def enter_slots(y: Floats, h: float, p: Floats) -> Floats:
        return (*begin(y, h, p), *tail)

    width = moved + kept + len(tail)
    return Stepper(
        _writer(moved, kept, errors, iterative, len(counters), adds)(change),
        width,
        enter_slots if enter or tail else None,
        leave or (first(min(moved, 6) if kept else moved) if width > 6 or tail else None),
        counters,
        iterative=iterative,
        checked=checked,
        advice=advice,
    )


def increment_stepper(change: Change, d: int, options: object, iterative: bool = False) -> Stepper:
    """Stepper of d components from their ``change``, compensated if ``options`` say so."""
    compensated = is_compensated(options)
    return stepper(change, d, lost=range(d * compensated), checked=d * compensated, iterative=iterative)


def with_counter(stepper: Stepper, name: str, event: Event, branch: bool = False) -> Stepper:
    """Add to ``stepper`` a counter ``name`` of the steps for which ``event`` is true.

    With ``branch`` the machine code branches to the addition instead of selecting its result. This saves operations but
    splits the step into two parts that the compiler schedules separately; which is faster has to be measured.
    """
    step, inner_enter, inner_leave = stepper.step, stepper.enter or same_state, stepper.leave or same_state

    def counted(s: Floats, h: float, p: Floats) -> Floats:
        old = s[:-1]
        new = step(old, h, p)
        count = s[-1]
        if event(old, new, h, p):
            count = count + 1.0
        return (*new, count)

    def branching(s: Floats, h: float, p: Floats) -> Floats:
        old = s[:-1]
        new = step(old, h, p)
        count = s[-1]
        if unlikely(event(old, new, h, p)):
            count = count + 1.0
        return (*new, count)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*inner_enter(y, h, p), 0.0)

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return inner_leave(s[:-1], h, p)

    return replace(
        stepper,
        step=branching if branch else counted,
        width=stepper.width + 1,
        enter=enter,
        leave=leave,
        counters=(*stepper.counters, name),
        checked=stepper.checked or stepper.width - len(stepper.counters),
    )


def small_determinant(determinant: Callable[[Floats, float, Floats], tuple[float, float]]) -> Event:
    """Event: a determinant is near zero; ``determinant(state, h, p)`` returns it and the size of its terms."""

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        value, terms = determinant(old, h, p)
        return abs(value) < SMALL * terms

    return event


def ambiguous_root(predict: Prediction) -> Event:
    """Event: both square roots are about equally close to the prediction of omega1 + i omega2.

    The distances of the root r and of -r from the prediction q differ by less than a factor of 1.3 if
    8 |r.q| <= r.r + q.q. Either the prediction is bad, or both roots are near 0, where they coincide.
    """

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        q1, q2 = predict(old, h, p)
        v1, v2 = new[0], new[1]
        return 8.0 * abs(v1 * q1 + v2 * q2) <= (v1 * v1 + v2 * v2) + (q1 * q1 + q2 * q2)

    return event
