"""Steps that count events: what could go wrong silently is told in the report's counters.

A counter is one more slot at the end of the working state. What an event looks at is what the step computes anyway:
once both are inlined the compiler merges the two, and what is left beside the step's chain of dependencies is a
comparison and an addition. The state is what it was, bit for bit.

Measured (ratio of times to the step without): HK 1.00 (Kowalevski), 1.02 (Euler, heavy), 1.03 (Lagrange), 1.08 (Euler
with gamma, 0.9 ns); the hybrids 1.01, Bohlin's methods 1.02. Where it shows, a slot that counts nothing costs as much.
A count is always finite and is not looked at for that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from topcli.arithmetic.branches import rarely
from topcli.contracts import Floats, Stepper

Event = Callable[[Floats, Floats, float, Floats], bool]
"""``event(old, new, h, p)``: whether to count the step from the working state ``old`` to ``new``."""
Prediction = Callable[[Floats, float, Floats], tuple[float, float]]

NEAR_SINGULAR = "near_singular_solves"
AMBIGUOUS = "ambiguous_roots"
SMALL = 2.0**-10
"""A determinant below this times the sum of its terms' magnitudes has lost three digits to cancellation."""


def counting(stepper: Stepper, name: str, event: Event, branch: bool = False) -> Stepper:
    """``stepper`` with a counter ``name`` of the steps that are an ``event``.

    With ``branch`` machine code jumps to the addition instead of selecting its result. That saves operations, and it
    cuts the step in two, which the compiler then orders apart: what is faster has to be measured.
    """
    inner_enter, inner_leave = stepper.enter, stepper.leave
    step = stepper.step

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
        if rarely(event(old, new, h, p)):
            count = count + 1.0
        return (*new, count)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*(inner_enter(y, h, p) if inner_enter else y), 0.0)

    if inner_leave is None:

        def leave(s: Floats, h: float, p: Floats) -> Floats:
            return s[:-1]
    else:

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
    """The event that ``determinant(state, h, p)``, which gives it and the size of its terms, is near zero."""

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        value, terms = determinant(old, h, p)
        return abs(value) < SMALL * terms

    return event


def two_roots(predict: Prediction) -> Event:
    """The event that both square roots lie about as near to the prediction of omega1 + i omega2.

    The distances of the root r and of -r from the prediction q differ by less than a factor of 1.3 where
    8 |r.q| <= r.r + q.q. Either the prediction is bad or both roots are near 0, where they merge.
    """

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        q1, q2 = predict(old, h, p)
        v1, v2 = new[0], new[1]
        return 8.0 * abs(v1 * q1 + v2 * q2) <= (v1 * v1 + v2 * v2) + (q1 * q1 + q2 * q2)

    return event
