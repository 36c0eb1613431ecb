"""Steps of the form old + change, with a plain or a compensated sum.

A change of size h has a rounding error of about h times the last bit of the state, whereas the addition old + change
has an error of the last bit itself. ``compensated_sum`` carries the error of this addition to the next step (Kahan,
Comm. ACM 8 (1965) 40). Only the errors of the changes remain, and round-off grows as h sqrt(N) instead of sqrt(N). The
change is still evaluated at the rounded state; the resulting error is smaller by a factor of h and as random as the
rounding.
"""

from __future__ import annotations

from collections.abc import Callable

from topcli.arithmetic.double_double import quick_two_sum

Floats = tuple[float, ...]
StepFunction = Callable[[Floats, float, Floats], Floats]
Change = StepFunction
"""``change(state, h, p)`` returns the new state minus the old one."""


def compensated_sum(y: float, e: float, d: float) -> tuple[float, float]:
    """Return ``(s, r)``: the rounded sum s of y + (e + d) and its rounding error r, so that s + r = y + (e + d).

    Exact for |y| >= |e + d| (Dekker). In the one or two steps in which a component passes zero, r itself may be
    rounded, with an error of at most the last bit of d, no larger than the error of d. Compensation adds one addition
    to the critical path of a step.
    """
    return quick_two_sum(y, d + e)


def compensated_sums(y: Floats, e: Floats, d: Floats) -> tuple[Floats, Floats]:
    """Return the compensated sums of six components and their rounding errors."""
    y1, e1 = compensated_sum(y[0], e[0], d[0])
    y2, e2 = compensated_sum(y[1], e[1], d[1])
    y3, e3 = compensated_sum(y[2], e[2], d[2])
    y4, e4 = compensated_sum(y[3], e[3], d[3])
    y5, e5 = compensated_sum(y[4], e[4], d[4])
    y6, e6 = compensated_sum(y[5], e[5], d[5])
    return (y1, y2, y3, y4, y5, y6), (e1, e2, e3, e4, e5, e6)


def plain3(change: Change) -> StepFunction:
    """Step old + change of three components."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        x1, x2, x3 = change(s, h, p)
        return (s[0] + x1, s[1] + x2, s[2] + x3)

    return step


def plain6(change: Change) -> StepFunction:
    """Step old + change of six components."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        x1, x2, x3, x4, x5, x6 = change(s, h, p)
        return (s[0] + x1, s[1] + x2, s[2] + x3, s[3] + x4, s[4] + x5, s[5] + x6)

    return step


def compensated3(change: Change) -> StepFunction:
    """Compensated step of three components, which are followed by the rounding errors of their sums."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        y1, y2, y3, e1, e2, e3 = s
        x1, x2, x3 = change((y1, y2, y3), h, p)
        y1, e1 = compensated_sum(y1, e1, x1)
        y2, e2 = compensated_sum(y2, e2, x2)
        y3, e3 = compensated_sum(y3, e3, x3)
        return (y1, y2, y3, e1, e2, e3)

    return step


def compensated6(change: Change) -> StepFunction:
    """Compensated step of six components, which are followed by the rounding errors of their sums."""

    def step(s: Floats, h: float, p: Floats) -> Floats:
        y = (s[0], s[1], s[2], s[3], s[4], s[5])
        y, e = compensated_sums(y, (s[6], s[7], s[8], s[9], s[10], s[11]), change(y, h, p))
        return (*y, *e)

    return step


def first3(s: Floats, h: float, p: Floats) -> Floats:
    """First three slots of the working state."""
    return (s[0], s[1], s[2])


def first6(s: Floats, h: float, p: Floats) -> Floats:
    """First six slots of the working state."""
    return (s[0], s[1], s[2], s[3], s[4], s[5])
