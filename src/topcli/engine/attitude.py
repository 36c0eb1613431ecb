"""Attitude of the body, carried along the rows that the time loop records.

The time loop of a method is used as it is: it records every step into a buffer, and ``carry`` turns the attitude from
row to row and passes on the rows that are wanted, each with its quaternion. States therefore have the bits of a run
without attitude, whose machine code is the same. The attitude is part of the working state, so that a run resumes bit
for bit.

The attitude q carries vectors from the body's frame to the frame fixed in space, q' = q (0, omega)/2. Its turn over a
step is a function of the states at both ends, symmetric in them: exchanging the states and the sign of h inverts it. A
scheme that is self-adjoint therefore stays so with its attitude. Two such functions are used:

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
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.quaternions import (
    IDENTITY,
    Quaternion,
    Vector,
    canonical,
    canonical_rows,
    conjugate,
    product,
    rotate,
    sum_turned,
    turn_of,
    turn_upright,
    unit_turn,
    upright,
)
from topcli.contracts import Array, Floats, Method, Sampler, Scheme, StopAsked, Top, checked_equations
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Loop, loop_of

if TYPE_CHECKING:
    from topcli.engine.native import Native


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


NEEDED_BY = "the attitude"
NUMBERS = 4
"""Numbers of a recorded attitude, a unit quaternion."""
HEAD = 14
"""Slots of the working state before those of the method: the last state, the quaternion, its rounding errors."""
BLOCK_STEPS = 2048
"""Steps between two passes over the rows."""


def carry(work: Any, states: Any, out: Any, c: Any, h: float, steps: int, every: int, until: int) -> int:
    """Carry the attitude in ``work`` along ``steps`` rows of ``states``; return the number of rows written to ``out``.

    The first row is written after ``until`` steps, then every ``every``-th. ``c`` are ``constants_of`` the run.
    """
    d, order, sign, in_space = int(c[6]), int(c[7]), c[8], c[9] != 0.0
    y = (work[0], work[1], work[2], work[3], work[4], work[5])
    q = (work[6], work[7], work[8], work[9])
    low = (work[10], work[11], work[12], work[13])
    written = 0
    for i in range(steps):
        k = i * d
        g1, g2, g3 = (states[k + 3], states[k + 4], states[k + 5]) if d == 6 else (0.0, 0.0, 0.0)
        z = (sign * states[k], sign * states[k + 1], sign * states[k + 2], g1, g2, g3)
        q, low = sum_turned(q, low, product(q, turn(y, z, h, order, c)))
        v = fixed_direction(z, c, d == 6)
        if v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0:
            q, low = sum_turned(q, low, product(turn_upright(rotate(q, v)), q))
        y = z
        until -= 1
        if until == 0:
            until = every
            n = written * (d + 4)
            for j in range(d):
                out[n + j] = states[k + j]
            shown = canonical(conjugate(q) if in_space else q)
            out[n + d], out[n + d + 1], out[n + d + 2], out[n + d + 3] = shown[0], shown[1], shown[2], shown[3]
            written += 1
    work[0], work[1], work[2], work[3], work[4], work[5] = y[0], y[1], y[2], y[3], y[4], y[5]
    work[6], work[7], work[8], work[9] = q[0], q[1], q[2], q[3]
    work[10], work[11], work[12], work[13] = low[0], low[1], low[2], low[3]
    return written


@cache
def _compiled() -> Native:
    from topcli.engine.native import native

    return native(carry, "ppppdqqq")


def constants_of(top: Top, order: int) -> Array:
    """Buffer with the constants of ``carry`` for turns of this ``order``.

    Raises UsageError for a top whose motion is not described by Euler-Poisson equations.
    """
    equations = checked_equations(top, NEEDED_BY)
    settings = (float(len(top.components)), float(order), equations.omega_sign, float(top.in_space))
    buffer = np.zeros(BUFFER)
    buffer[:CONSTANTS] = (*equations.moments, *equations.gravity, *settings)
    return buffer


def start_attitude(top: Top, y0: Floats) -> Quaternion:
    """Quaternion of the attitude in the state ``y0``: the shortest rotation that puts the fixed direction upright."""
    c = constants_of(top, 2)
    w1, w2, w3 = (c[8] * float(value) for value in y0[:3])
    g1, g2, g3 = (float(value) for value in y0[3:6]) if len(y0) == 6 else (0.0, 0.0, 0.0)
    q = upright(fixed_direction((w1, w2, w3, g1, g2, g3), c.tolist(), len(y0) == 6))
    return canonical(conjugate(q) if top.in_space else q)


def with_attitude(loop: Loop, d: int, constants: Array) -> Loop:
    """Time loop that records the attitude behind each state of ``d`` components.

    The first state passed to ``enter`` holds the attitude too.
    """
    code, rows = _compiled(), np.empty(BLOCK_STEPS * d)
    sign, in_space = constants[8], bool(constants[9])

    def enter(y: Array, work: Array, p: Array, h: float) -> int:
        work[:HEAD] = 0.0
        work[:d] = y[:d]
        work[:3] *= sign
        work[6:10] = conjugate(tuple(y[d:].tolist())) if in_space else y[d:]
        return loop.enter(y[:d], work[HEAD:], p, h)

    def drive(work: Array, out: Array, p: Array, h: float, steps: int, every: int, until: int) -> int:
        taken = written = 0
        begun = work.copy()
        try:
            while taken < steps:
                size = min(BLOCK_STEPS, steps - taken)
                went = loop.drive(work[HEAD:], rows, p, h, size, 1, 1)
                good = went if went >= 0 else -went - 1
                left, rest = until + written * every - taken, out[written * (d + NUMBERS) :]
                written += code(work, rows, rest, constants, h, good, every, left)
                if went < 0:
                    return went - taken
                taken += went
                if went < size:
                    break
        except StopAsked:  # no step of this call counts as taken
            work[:] = begun
            raise
        return taken

    return replace(
        loop,
        enter=enter,
        drive=drive,
        width=loop.width + HEAD,
        seconds=loop.seconds + code.seconds,
        cached=loop.cached and code.cached,
        prepare=None,
        sampled=False,
    )


def _closed(sampler: Sampler, d: int) -> Sampler:
    """Closed form whose states (m, d + 4) hold the attitude, which has a closed form too."""
    attitude = sampler.attitude
    assert attitude is not None

    def states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
        if len(n) == 0:  # between two recorded rows
            return np.empty((0, d + NUMBERS))
        return np.hstack([sampler.states(y0[:d], h, n, p), canonical_rows(attitude(y0[:d], y0[d:], h, n, p))])

    return Sampler(states)


def attitude_loop(top: Top, scheme: Scheme, options: Any, method: Method) -> Loop:
    """Time loop of a ``scheme`` with ``options``, made ready as ``method``, that records the attitude with the states.

    Its initial state is that of the top, followed by ``start_attitude``. Raises UsageError for a top without
    Euler-Poisson equations.
    """
    d, constants = len(top.components), len(top.constants())
    turns = constants_of(top, turn_order(scheme.order_for(options), scheme.adaptive))
    if isinstance(method, Sampler) and method.attitude is not None:
        return loop_of(_closed(method, d), d + NUMBERS, constants)
    return with_attitude(loop_of(method, d, constants), d, turns)


def attitude_of_rows(top: Top, states: Array, span: float) -> Array:
    """Attitudes (m, 4) reconstructed from ``states`` (m, d) at equal intervals ``span`` of time.

    From row to row the body turns like the exact motion through both states.
    """
    d, rows = states.shape[1], len(states)
    constants, start = constants_of(top, TO_ROUND_OFF), start_attitude(top, tuple(states[0].tolist()))
    work, out = np.zeros(HEAD), np.empty((rows, d + NUMBERS))
    work[:d], out[0] = states[0], (*states[0], *start)
    work[:3] *= constants[8]
    work[6:10] = conjugate(start) if top.in_space else start
    later = np.ascontiguousarray(states[1:], dtype=np.float64)
    _compiled()(work, later.ravel(), out[1:].ravel(), constants, span, rows - 1, 1, 1)
    return out[:, d:]


def attitude_code(method: Method) -> str:
    """Digest of the code that makes the attitude of a run of ``method``."""
    if isinstance(method, Sampler) and method.attitude is not None:
        return fingerprint(method.attitude, compiled=False)
    return fingerprint(carry)
