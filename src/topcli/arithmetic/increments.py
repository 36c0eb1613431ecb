"""From the change that a step makes to the step: old + change, plainly or with the rounding error carried along.

A change of size h is known with an error of h times the last bit; the one addition old + change rounds at the last bit
itself. ``carried_sum`` keeps what that addition loses and gives it to the next one (Kahan, Comm. ACM 8 (1965) 40), so
that only the errors of the changes are left, and round-off grows as h sqrt(N) instead of sqrt(N). The change is still
taken at the rounded state: what that makes of the lost part is smaller by h, and as random as the rounding.
"""

from __future__ import annotations

from collections.abc import Callable

from topcli.arithmetic.double_double import quick_two_sum

Floats = tuple[float, ...]
StepFunction = Callable[[Floats, float, Floats], Floats]
Change = StepFunction
"""``change(state, h, p)``: new state minus old, a tuple of the state's length."""


def carried_sum(y: float, e: float, d: float) -> tuple[float, float]:
    """``(s, r)``: s is y + (e + d) rounded, r what the rounding lost, so that s + r = y + (e + d).

    Exact for |y| >= |e + d| (Dekker). In the step or two in which a component passes zero r itself may be rounded, by
    no more than the last bit of d, which d is wrong by anyway. An addition is all that the next step waits for.
    """
    return quick_two_sum(y, d + e)


def carried_sums(y: Floats, e: Floats, d: Floats) -> tuple[Floats, Floats]:
    """``carried_sum`` of each of six components: the sums, and what each of them lost."""
    y1, e1 = carried_sum(y[0], e[0], d[0])
    y2, e2 = carried_sum(y[1], e[1], d[1])
    y3, e3 = carried_sum(y[2], e[2], d[2])
    y4, e4 = carried_sum(y[3], e[3], d[3])
    y5, e5 = carried_sum(y[4], e[4], d[4])
    y6, e6 = carried_sum(y[5], e[5], d[5])
    return (y1, y2, y3, y4, y5, y6), (e1, e2, e3, e4, e5, e6)


def plain3(change: Change) -> StepFunction:
    """The step of three components."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        x1, x2, x3 = change(s, h, p)
        return (s[0] + x1, s[1] + x2, s[2] + x3)

    return step


def plain6(change: Change) -> StepFunction:
    """The step of six components."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        x1, x2, x3, x4, x5, x6 = change(s, h, p)
        return (s[0] + x1, s[1] + x2, s[2] + x3, s[3] + x4, s[4] + x5, s[5] + x6)

    return step


def compensated3(change: Change) -> StepFunction:
    """The step of three components, followed by what their sums have lost so far."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        y1, y2, y3, e1, e2, e3 = s
        x1, x2, x3 = change((y1, y2, y3), h, p)
        y1, e1 = carried_sum(y1, e1, x1)
        y2, e2 = carried_sum(y2, e2, x2)
        y3, e3 = carried_sum(y3, e3, x3)
        return (y1, y2, y3, e1, e2, e3)

    return step


def compensated6(change: Change) -> StepFunction:
    """The step of six components, followed by what their sums have lost so far."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        y = (s[0], s[1], s[2], s[3], s[4], s[5])
        y, e = carried_sums(y, (s[6], s[7], s[8], s[9], s[10], s[11]), change(y, h, p))
        return (*y, *e)

    return step


def first3(s: Floats, h: float, p: Floats) -> Floats:
    """The three components of a working state that begins with them."""
    return (s[0], s[1], s[2])


def first6(s: Floats, h: float, p: Floats) -> Floats:
    """The six components of a working state that begins with them."""
    return (s[0], s[1], s[2], s[3], s[4], s[5])
