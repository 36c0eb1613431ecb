"""Attitude of the body, computed along the rows that the time loop records.

The time loop of a method is used as it is: it records every step into a buffer, and ``carry`` turns the attitude from
row to row and passes on the rows that are wanted, each with its quaternion. States therefore have the bits of a run
without attitude, whose machine code is the same. The attitude is part of the working state, so that a run resumes bit
for bit.

The attitude q carries vectors from the body's frame to the frame fixed in space, q' = q (0, omega)/2, where omega is
the ``angular_velocity`` of the top. Its turn over a step is a function of the states at both ends, symmetric in them:
exchanging the states and the sign of h inverts it. A scheme that is self-adjoint therefore stays so with its attitude.
Two such functions are used:

- up to order 2, the Cayley transform of the mean omega, tan(angle/2) = h |omega + omega'|/4;
- above, half a step of the exact motion through the first state, followed by half a step of that through the second,
  each integrated with the quaternion by Gragg's extrapolation. With m/2 columns, m even, the turn has the order m; a
  scheme without a fixed order gets as many columns and partial steps as leave round-off alone.

One direction, the ``vertical`` of the top, is fixed in space. After each turn the shortest rotation restores it, which
is symmetric too: two of the three angles are those of the recorded state, and only the angle about the fixed direction
is summed up over the steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.arithmetic.quaternions import (
    IDENTITY,
    Quaternion,
    Vector,
    canonical,
    conjugate,
    product,
    rotate,
    sum_turned,
    turn_of,
    turn_upright,
    unit_turn,
    upright,
)
from topcli.contracts import Array, Floats, Method, Scheme, StopAsked, Top
from topcli.engine.fingerprint import fingerprint
from topcli.engine.loop import Loop, loop_of
from topcli.schemes.any_top.runge_kutta import vector_operations
from topcli.tops.bodies import checked_rotation

if TYPE_CHECKING:
    from topcli.engine.native import Native


MAX_ORDER = 20
"""Largest order of an extrapolation."""
TO_ROUND_OFF = 0
"""In the place of an order: as accurate as rounding allows."""
RESOLVED = 2.0**-52
"""Size of the last correction of an extrapolation that is accurate to round-off."""
FEW_COLUMNS = 6
"""Columns up to which the next partial step is twice as long."""
MOST_PARTS = 10_000
"""Partial steps after which half a step is given up; its turn is then nan."""
NEEDED_BY = "the attitude"
NUMBERS = 4
"""Numbers of a recorded attitude, a unit quaternion."""
BLOCK_STEPS = 2048
"""Steps between two passes over the rows."""
HEAD = 2 * NUMBERS
"""Slots of the working state for the quaternion and its rounding errors, before those of the last state."""
CARRY, TURNS = "pppppdqqqqqq", "pppdqq"
"""Signatures of ``carry`` and ``turns``."""


def turn_order(order: int | None, adaptive: bool) -> int:
    """Order of the turns for a scheme of this ``order``: even, and at least 2."""
    if order is None or adaptive or order > MAX_ORDER:
        return TO_ROUND_OFF
    return max(2, order + order % 2)


@cache
def turns_of(top: type[Top], constants: int) -> Callable[..., int]:
    """Function ``turns(states, out, c, h, order, steps)`` for a top with this number of ``constants``.

    It writes the turns of ``steps`` steps of h between successive rows of ``states``. ``c`` holds the constants, and
    then room for the extrapolation. State and quaternion are integrated together, by Gragg's method in 2, 4, 6, ...
    steps, whose results are extrapolated to infinitely many steps by the scheme of Aitken and Neville; all are
    increments, so that their rounding errors are small.
    """
    field, velocity, d = top.field, top.angular_velocity, len(top.components)
    assert velocity is not None
    axpy, add = vector_operations(d + NUMBERS)
    (constants_in, _), (state_in, _), (load, store) = _access(constants), _access(d), _access(d + NUMBERS)
    zero = (0.0,) * (d + NUMBERS)

    def rates(x: Any, p: Floats) -> Any:
        y, q0, q1, q2, q3 = x[:d], x[d], x[d + 1], x[d + 2], x[d + 3]
        w1, w2, w3 = velocity(y, p)
        turning = (
            -0.5 * (q1 * w1 + q2 * w2 + q3 * w3),
            0.5 * (q0 * w1 + q2 * w3 - q3 * w2),
            0.5 * (q0 * w2 + q3 * w1 - q1 * w3),
            0.5 * (q0 * w3 + q1 * w2 - q2 * w1),
        )
        return field(y, p) + turning

    def gragg(x: Any, t: float, n: int, p: Floats) -> Any:
        before, now = zero, axpy(zero, t / n, rates(x, p))
        for _ in range(n - 1):
            before, now = now, axpy(before, 2.0 * t / n, rates(add(x, now), p))
        return now

    def flown(y: Any, span: float, order: int, c: Any) -> Quaternion:
        p = constants_in(c, 0)
        x: Any = y + IDENTITY
        left = t = span
        for _ in range(MOST_PARTS):
            now, last, column = zero, math.inf, 0
            while column < (order or MAX_ORDER) // 2 and not (last <= RESOLVED and order == 0):
                now = gragg(x, t, 2 * column + 2, p)
                for i in range(column):
                    at, ratio = constants + i * (d + NUMBERS), (column + 1.0) / (column - i)
                    before = load(c, at)
                    store(c, at, now)
                    change = axpy(zero, 1.0 / (ratio * ratio - 1.0), axpy(now, -1.0, before))
                    now = add(now, change)
                    last = abs(change[d]) + abs(change[d + 1]) + abs(change[d + 2]) + abs(change[d + 3])
                store(c, constants + column * (d + NUMBERS), now)
                column += 1
            if order or last <= RESOLVED:
                x = add(x, now)
                left -= t
                if left == 0.0:
                    q = x[d:]
                    size = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
                    return (size * q[0], size * q[1], size * q[2], size * q[3])
                t = math.copysign(min(abs(left), abs(t) if column > FEW_COLUMNS else 2.0 * abs(t)), left)
            else:
                t *= 0.5
        return (math.nan, math.nan, math.nan, math.nan)

    def turns(states: Any, out: Any, c: Any, h: float, order: int, steps: int) -> int:
        for i in range(steps):
            first = flown(state_in(states, i * d), 0.5 * h, order, c)
            second = flown(state_in(states, (i + 1) * d), -0.5 * h, order, c)
            w, x, y, z = turn_of(product(first, conjugate(second)))
            out[4 * i], out[4 * i + 1], out[4 * i + 2], out[4 * i + 3] = w, x, y, z
        return steps

    return turns


@cache
def _access(n: int) -> tuple[Callable[[Any, int], Floats], Callable[[Any, int, Floats], int]]:
    """Functions that return the ``n`` numbers of a buffer from a place on, and that write them there."""
    places = [f"a[k + {i}]" for i in range(n)]
    text = (
        f"def load(a, k):\n    return ({''.join(f'{one}, ' for one in places)})\n"
        f"def store(a, k, v):\n    {'; '.join(f'{one} = v[{i}]' for i, one in enumerate(places)) or 'pass'}\n"
        "    return 0\n"
    )
    scope: dict[str, Any] = {"__name__": __name__}
    exec(compile(text, f"<access {n}>", "exec"), scope)
    return scope["load"], scope["store"]


def unit(a: float, b: float, c: float) -> Vector:
    """Unit vector in the direction of (a, b, c); zero if that is zero."""
    largest = max(abs(a), abs(b), abs(c))
    if not largest > 0.0:
        return (0.0, 0.0, 0.0)
    a, b, c = a / largest, b / largest, c / largest
    size = math.sqrt(a * a + b * b + c * c)
    return (a / size, b / size, c / size)


def carry(
    q_low: Any,
    states: Any,
    moved: Any,
    fixed: Any,
    out: Any,
    h: float,
    d: int,
    order: int,
    in_space: int,
    steps: int,
    every: int,
    until: int,
) -> int:
    """Carry the attitude ``q_low`` (8) along ``steps`` rows of ``states``; return how many of them ``out`` gets.

    The quaternion is followed by its rounding errors. ``moved`` are the turns of the steps; for order 2 they are the
    angular velocities of all rows, the first one included. ``fixed`` are the vectors that are fixed in space. The first
    row is written after ``until`` steps, then every ``every``-th, and begins with the ``d`` numbers of a state.
    """
    q = (q_low[0], q_low[1], q_low[2], q_low[3])
    low = (q_low[4], q_low[5], q_low[6], q_low[7])
    f = 0.25 * h
    written = 0
    for i in range(steps):
        if order == 2:
            k = 3 * i
            a, b, c = moved[k] + moved[k + 3], moved[k + 1] + moved[k + 4], moved[k + 2] + moved[k + 5]
            turn = unit_turn(f * a, f * b, f * c)
        else:
            turn = (moved[4 * i], moved[4 * i + 1], moved[4 * i + 2], moved[4 * i + 3])
        q, low = sum_turned(q, low, product(q, turn))
        v = unit(fixed[3 * i], fixed[3 * i + 1], fixed[3 * i + 2])
        if v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0:
            q, low = sum_turned(q, low, product(turn_upright(rotate(q, v)), q))
        until -= 1
        if until == 0:
            until = every
            n = written * (d + 4)
            for j in range(d):
                out[n + j] = states[i * d + j]
            shown = canonical(conjugate(q) if in_space else q)
            out[n + d], out[n + d + 1], out[n + d + 2], out[n + d + 3] = shown[0], shown[1], shown[2], shown[3]
            written += 1
    q_low[0], q_low[1], q_low[2], q_low[3] = q[0], q[1], q[2], q[3]
    q_low[4], q_low[5], q_low[6], q_low[7] = low[0], low[1], low[2], low[3]
    return written


@cache
def _compiled(function: Callable[..., int], signature: str) -> Native:
    from topcli.engine.native import native

    return native(function, signature)


def _vectors(function: Callable[[Any, Floats], Any] | None, states: Array, p: Floats) -> Array:
    """Vectors (m, 3) of the ``states`` (m, d); zero without a function."""
    vectors = np.zeros((len(states), 3))
    if function is not None:
        try:
            for i, values in enumerate(function(tuple(states.T), p)):
                vectors[:, i] = values
        except (TypeError, ValueError):  # a function of single numbers, or one that decides
            vectors[:] = [function(tuple(y), p) for y in states.tolist()]
    return vectors


def velocities(top: Top, states: Array) -> Array:
    """Angular velocities (m, 3) in the body's frame at ``states`` (m, d)."""
    checked_rotation(top, NEEDED_BY)
    return _vectors(type(top).angular_velocity, states, top.constants())


def start_attitude(top: Top, y0: Floats) -> Quaternion:
    """Quaternion of the attitude in the state ``y0``: the shortest rotation that puts the vertical upright."""
    q = upright(unit(*_vectors(type(top).vertical, np.array([y0], dtype=float), top.constants())[0].tolist()))
    return canonical(conjugate(q) if top.in_space else q)


class Turning:
    """The attitude of a ``top`` along rows that are ``h`` apart, by turns of an ``order``.

    Raises UsageError for a top that does not declare its angular velocity.
    """

    def __init__(self, top: Top, order: int) -> None:
        checked_rotation(top, NEEDED_BY)
        self.top, self.order, self.p = top, order, tuple(map(float, top.constants()))
        self.codes = [_compiled(carry, CARRY)]
        if order != 2:
            self.codes.append(_compiled(turns_of(type(top), len(self.p)), TURNS))
            self.buffer = np.array([*self.p, *[0.0] * (MAX_ORDER // 2 * (len(top.components) + NUMBERS))])

    def along(self, q_low: Array, states: Array, out: Array, h: float, every: int, until: int) -> int:
        """Call ``carry`` for the ``states`` (1 + steps, d), of which the first has the attitude ``q_low``."""
        steps, d = len(states) - 1, states.shape[1]
        with np.errstate(all="ignore"):
            fixed = _vectors(type(self.top).vertical, states[1:], self.p)
            if self.order == 2:
                moved = _vectors(type(self.top).angular_velocity, states, self.p)
            else:
                moved = np.full((steps, NUMBERS), np.nan)
                self.codes[1](states.ravel(), moved.ravel(), self.buffer, h, self.order, steps)
        later, moved, fixed, in_space = states[1:].ravel(), moved.ravel(), fixed.ravel(), int(self.top.in_space)
        return self.codes[0](q_low, later, moved, fixed, out, h, d, self.order, in_space, steps, every, until)

    def upto(self, q: Floats) -> Array:
        """Attitude that ``carry`` takes, from a recorded quaternion."""
        return np.array([*(conjugate((q[0], q[1], q[2], q[3])) if self.top.in_space else q), *[0.0] * NUMBERS])


def with_attitude(loop: Loop, top: Top, order: int) -> Loop:
    """Time loop that records the attitude, by turns of this ``order``, behind each state of ``top``.

    The first state passed to ``enter`` holds the attitude too.
    """
    d, turning = len(top.components), Turning(top, order)
    block, head = np.empty((1 + BLOCK_STEPS, d)), HEAD + d
    rows = block[1:].reshape(-1)

    def enter(y: Array, work: Array, p: Array, h: float) -> int:
        work[:HEAD], work[HEAD:head] = turning.upto(y[d:].tolist()), y[:d]
        return loop.enter(y[:d], work[head:], p, h)

    def drive(work: Array, out: Array, p: Array, h: float, steps: int, every: int, until: int) -> int:
        taken = written = 0
        begun = work.copy()
        try:
            while taken < steps:
                size = min(BLOCK_STEPS, steps - taken)
                went = loop.drive(work[head:], rows, p, h, size, 1, 1)
                good = went if went >= 0 else -went - 1
                block[0] = work[HEAD:head]
                left, rest = until + written * every - taken, out[written * (d + NUMBERS) :]
                written += turning.along(work[:HEAD], block[: good + 1], rest, h, every, left)
                work[HEAD:head] = block[good]
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
        width=loop.width + head,
        seconds=loop.seconds + sum(code.seconds for code in turning.codes),
        cached=loop.cached and all(code.cached for code in turning.codes),
        sampled=False,
    )


def attitude_loop(top: Top, scheme: Scheme, options: Any, method: Method) -> Loop:
    """Time loop of a ``scheme`` with ``options``, made ready as ``method``, that records the attitude with the states.

    Its initial state is that of the top, followed by ``start_attitude``. Raises UsageError for a top that does not
    declare its angular velocity.
    """
    d, constants = len(top.components), len(top.constants())
    return with_attitude(loop_of(method, d, constants), top, turn_order(scheme.order_for(options), scheme.adaptive))


def attitude_of_rows(top: Top, states: Array, span: float) -> Array:
    """Attitudes (m, 4) reconstructed from ``states`` (m, d) at equal intervals ``span`` of time.

    From row to row the body turns like the exact motion through both states.
    """
    turning, start = Turning(top, TO_ROUND_OFF), start_attitude(top, tuple(states[0].tolist()))
    d, out = states.shape[1], np.empty((len(states), states.shape[1] + NUMBERS))
    out[0, d:] = start
    turning.along(turning.upto(start), np.ascontiguousarray(states, dtype=np.float64), out[1:].ravel(), span, 1, 1)
    return out[:, d:]


def attitude_code(top: Top) -> str:
    """Digest of the code that makes the attitude of a run."""
    return fingerprint(carry, turns_of(type(top), len(top.constants())), type(top).vertical)
