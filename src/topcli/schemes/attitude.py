"""The turn of the body in one step of a scheme, from the states at both ends of the step.

The attitude q carries vectors from the body's frame to the frame fixed in space, q' = q (0, omega)/2. Its turn over a
step is a function of both states, symmetric in them: exchanging the states and the sign of h inverts it. A scheme that
is self-adjoint therefore stays so with its attitude. Two such functions are used:

- up to order 2, the Cayley transform of the mean omega, tan(angle/2) = h |omega + omega'|/4;
- above, half a step of the exact motion through the first state, followed by half a step of that through the second,
  each by its Taylor series. With terms up to h^m, m even, the turn has the order m; a scheme without a fixed order
  gets as many terms and partial steps as leave round-off alone.

One direction, the vertical gamma or for a state of omega alone the angular momentum, is fixed in space. After each turn
the shortest rotation restores it, which is symmetric too: two of the three angles are those of the recorded state, and
only the angle about the fixed direction is summed up over the steps.
"""

from __future__ import annotations

import math
from typing import Any

from topcli.arithmetic.quaternions import IDENTITY, Quaternion, Vector, conjugate, product, turn_of, unit_turn

MAX_ORDER = 20
"""Order of the Taylor series of a turn to round-off."""
TO_ROUND_OFF = 0
"""In the place of an order: as accurate as rounding allows."""
CONSTANTS = 10
"""Numbers before the series in the buffer ``c``: moments (A, B, C), mg(x0, y0, z0), and four for the caller."""
BUFFER = CONSTANTS + 10 * (MAX_ORDER + 1)
"""Length of the buffer: the series are those of omega, gamma and the quaternion."""
RESOLVED = 2.0**-56
"""Size of the last terms of a series that is accurate to round-off."""
MOST_PARTS = 10_000
"""Partial steps after which half a step is given up; its turn is then nan."""

State = tuple[float, float, float, float, float, float]


def turn_order(order: int | None, adaptive: bool) -> int:
    """Order of the turns for a scheme of this ``order``: even, and at least 2."""
    if order is None or adaptive or order > MAX_ORDER:
        return TO_ROUND_OFF
    return max(2, order + order % 2)


def mean_turn(y: State, z: State, h: float) -> Quaternion:
    """Turn by the Cayley transform of the mean omega of the states ``y`` and ``z``."""
    f = 0.25 * h
    return unit_turn(f * (y[0] + z[0]), f * (y[1] + z[1]), f * (y[2] + z[2]))


def expand(y: State, order: int, span: float, c: Any) -> int:
    """Fill ``c`` with the Taylor coefficients of omega, gamma and the quaternion from the state ``y`` and identity.

    Coefficient k starts at ``CONSTANTS + 10 * k``. Return the order of the last one: ``order``, or less where two terms
    of the quaternion in succession are below ``RESOLVED`` at the time ``span``.
    """
    power, before = 1.0, math.inf
    b = CONSTANTS
    c[b], c[b + 1], c[b + 2], c[b + 3], c[b + 4], c[b + 5] = y[0], y[1], y[2], y[3], y[4], y[5]
    c[b + 6], c[b + 7], c[b + 8], c[b + 9] = 1.0, 0.0, 0.0, 0.0
    for k in range(order):
        w23 = w31 = w12 = p1 = p2 = p3 = r0 = r1 = r2 = r3 = 0.0
        for j in range(k + 1):
            a, b = CONSTANTS + 10 * j, CONSTANTS + 10 * (k - j)
            v1, v2, v3 = c[b], c[b + 1], c[b + 2]
            w23 += c[a + 1] * v3
            w31 += c[a + 2] * v1
            w12 += c[a] * v2
            p1 += c[a + 4] * v3 - c[a + 5] * v2
            p2 += c[a + 5] * v1 - c[a + 3] * v3
            p3 += c[a + 3] * v2 - c[a + 4] * v1
            r0 -= c[a + 7] * v1 + c[a + 8] * v2 + c[a + 9] * v3
            r1 += c[a + 6] * v1 + c[a + 8] * v3 - c[a + 9] * v2
            r2 += c[a + 6] * v2 + c[a + 9] * v1 - c[a + 7] * v3
            r3 += c[a + 6] * v3 + c[a + 7] * v2 - c[a + 8] * v1
        b, n, f = CONSTANTS + 10 * k, CONSTANTS + 10 * (k + 1), 1.0 / (k + 1.0)
        c[n] = f * ((c[1] - c[2]) * w23 + (c[b + 4] * c[5] - c[b + 5] * c[4])) / c[0]
        c[n + 1] = f * ((c[2] - c[0]) * w31 + (c[b + 5] * c[3] - c[b + 3] * c[5])) / c[1]
        c[n + 2] = f * ((c[0] - c[1]) * w12 + (c[b + 3] * c[4] - c[b + 4] * c[3])) / c[2]
        c[n + 3], c[n + 4], c[n + 5] = f * p1, f * p2, f * p3
        f *= 0.5
        c[n + 6], c[n + 7], c[n + 8], c[n + 9] = f * r0, f * r1, f * r2, f * r3
        power *= abs(span)
        term = f * (abs(r0) + abs(r1) + abs(r2) + abs(r3)) * power
        if span != 0.0 and term < RESOLVED and before < RESOLVED:
            return k + 1
        before = term
    return order


def value(c: Any, i: int, order: int, t: float) -> float:
    """Component ``i`` of the series in ``c`` at the time ``t``."""
    total = c[CONSTANTS + 10 * order + i]
    for k in range(order - 1, -1, -1):
        total = total * t + c[CONSTANTS + 10 * k + i]
    return total


def reach(c: Any, order: int) -> float:
    """Time up to which the last two terms of the quaternion in ``c`` are below ``RESOLVED``."""
    longest = math.inf
    for m in (order - 1, order):
        size = 0.0
        for i in range(6, 10):
            size += abs(c[CONSTANTS + 10 * m + i])
        if size > 0.0:
            longest = min(longest, math.exp(math.log(RESOLVED / size) / m))
    return longest


def flown(y: State, span: float, order: int, c: Any) -> Quaternion:
    """Rotation of the body in the time ``span`` of the exact motion from ``y``."""
    q, left = IDENTITY, span
    for _ in range(MOST_PARTS):
        terms = expand(y, order, 0.0, c) if order else expand(y, MAX_ORDER, left, c)
        t = left
        if terms == MAX_ORDER:
            longest = reach(c, terms)
            if longest < abs(left):
                t = math.copysign(longest, left)
        q = product(q, (value(c, 6, terms, t), value(c, 7, terms, t), value(c, 8, terms, t), value(c, 9, terms, t)))
        if t == left:
            size = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
            return (size * q[0], size * q[1], size * q[2], size * q[3])
        left -= t
        y = (
            value(c, 0, terms, t),
            value(c, 1, terms, t),
            value(c, 2, terms, t),
            value(c, 3, terms, t),
            value(c, 4, terms, t),
            value(c, 5, terms, t),
        )
    return (math.nan, math.nan, math.nan, math.nan)


def turn(y: State, z: State, h: float, order: int, c: Any) -> Quaternion:
    """Turn of a step of ``h`` from ``y`` to ``z``, of the ``order`` of ``turn_order``.

    ``c`` is a buffer (``BUFFER``) with the constants of the top. The states are omega and gamma.
    """
    if order == 2:
        return mean_turn(y, z, h)
    first = flown(y, 0.5 * h, order, c)
    return turn_of(product(first, conjugate(flown(z, -0.5 * h, order, c))))


def fixed_direction(y: State, c: Any, has_vertical: bool) -> Vector:
    """Unit vector in the body's frame that is fixed in space: gamma, or the angular momentum; zero if there is none."""
    a, b, d = (y[3], y[4], y[5]) if has_vertical else (c[0] * y[0], c[1] * y[1], c[2] * y[2])
    largest = max(abs(a), abs(b), abs(d))
    if not largest > 0.0:
        return (0.0, 0.0, 0.0)
    a, b, d = a / largest, b / largest, d / largest
    size = math.sqrt(a * a + b * b + d * d)
    return (a / size, b / size, d / size)
