"""Attitude of the body, computed along the rows that the time loop records.

The time loop of a method is used as it is: it records every step into a buffer, and ``carry`` turns the attitude from
row to row; of these rows some are passed on, each with its quaternion. States therefore have the bits of a run
without attitude, whose machine code is the same. The attitude is part of the working state, so that a run resumes bit
for bit.

The attitude q carries vectors from the body's frame to the frame fixed in space, q' = q (0, omega)/2, where omega is
the ``angular_velocity`` of the top. Its turn over a step is a function of the states at both ends, symmetric in them:
exchanging the states and the sign of h inverts it. A scheme that is self-adjoint therefore stays so with its attitude.
Two such functions are used:

- up to order 2, the Cayley transform of the mean omega, tan(angle/2) = h |omega + omega'|/4;
- above, the rotation vector of order 4 from omega and its derivative at both ends (Magnus' series; Iserles, Norsett,
  Phil. Trans. R. Soc. A 357 (1999) 983, with Hermite's cubic for omega).

One direction, the ``vertical`` of the top, is fixed in space. After each turn the shortest rotation restores it, which
is symmetric too: two of the three angles are those of the recorded state, and only the angle about the fixed direction
is summed up over the steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.arithmetic.quaternions import (
    Quaternion,
    canonical_quaternion,
    conjugate,
    product,
    rotate,
    turn_upright,
    turned_by,
    unit_turn,
    upright,
)
from topcli.contracts import Array, Floats, Method, Scheme, StopAsked, Top
from topcli.engine.loops import Loop, loop_of
from topcli.field.expression import in_arithmetic
from topcli.tops.bodies import checked_rotation

if TYPE_CHECKING:
    from topcli.engine.native import Native


LARGEST_CORRECTION = 0.05
"""Largest difference, in radians, of the turn of a step from that by the mean omega; a longer step has no attitude."""
PROBE = 1.0 / 32.0
"""Time, in steps, over which omega is differentiated."""
NUMBERS = 4
"""Numbers of a recorded attitude, a unit quaternion."""
BLOCK_STEPS = 2048
"""Steps between two passes over the rows."""
CARRY = "ppppqq"
"""Signature of ``carry``."""


def carry(attitude: Any, moved: Any, fixed: Any, out: Any, in_space: int, steps: int) -> int:
    """Carry the quaternion ``attitude`` along ``steps`` steps; ``out`` gets those to be recorded after each step.

    ``moved`` are the turns of the steps as tan(angle/2) times the axis, ``fixed`` the unit vectors that are fixed in
    space, or zeros.
    """
    q = (attitude[0], attitude[1], attitude[2], attitude[3])
    for i in range(steps):
        k = 3 * i
        q = turned_by(q, product(q, unit_turn(moved[k], moved[k + 1], moved[k + 2])))
        v = (fixed[k], fixed[k + 1], fixed[k + 2])
        if v[0] != 0.0 or v[1] != 0.0 or v[2] != 0.0:
            q = turned_by(q, product(turn_upright(rotate(q, v)), q))
        r = canonical_quaternion(conjugate(q) if in_space else q)
        out[4 * i], out[4 * i + 1], out[4 * i + 2], out[4 * i + 3] = r[0], r[1], r[2], r[3]
    attitude[0], attitude[1], attitude[2], attitude[3] = q[0], q[1], q[2], q[3]
    return steps


@cache
def _compiled() -> Native:
    from topcli.engine.native import native

    return native(carry, CARRY)


def _columns(function: Callable[[Any, Floats], Any] | None, states: Array, p: Floats, width: int = 3) -> Array:
    """Values (m, width) of a function at the ``states`` (m, d); zero without a function."""
    values = np.zeros((len(states), width))
    if function is not None:
        try:
            for i, value in enumerate(in_arithmetic(function, float, np)(tuple(states.T), p)):
                values[:, i] = value
        except (TypeError, ValueError):  # a function of single numbers, or one that decides
            values[:] = [function(tuple(y), p) for y in states.tolist()]
    return values


def _fixed(top: Top, states: Array) -> Array:
    """Unit vectors (m, 3) in the body's frame that are fixed in space; zero where there is none."""
    vectors = _columns(type(top).vertical, states, top.constants())
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(size > 0.0, size, 1.0)


def start_attitude(top: Top, y0: Floats) -> Quaternion:
    """Quaternion of the attitude in the state ``y0``: the shortest rotation that puts the vertical upright."""
    x, y, z = _fixed(top, np.array([y0], dtype=float))[0].tolist()
    q = upright((x, y, z))
    return canonical_quaternion(conjugate(q) if top.in_space else q)


class Turning:
    """The attitude of a ``top`` along rows that are ``h`` apart, by turns of order 2 or 4.

    Raises UsageError for a top that does not declare its angular velocity.
    """

    def __init__(self, top: Top, order: int) -> None:
        checked_rotation(top, "the attitude")
        self.top, self.order, self.p = top, order, tuple(map(float, top.constants()))
        self.code = _compiled()

    def turns(self, states: Array, h: float) -> Array:
        """Turns (m - 1, 3) between successive ``states`` (m, d), as tan(angle/2) times the axis."""
        w = _columns(type(self.top).angular_velocity, states, self.p)
        mean = 0.5 * h * (w[1:] + w[:-1])
        if self.order == 2:
            return 0.5 * mean
        field = h * PROBE * _columns(type(self.top).field, states, self.p, states.shape[1])
        later, earlier = (_columns(type(self.top).angular_velocity, states + s * field, self.p) for s in (1.0, -1.0))
        slope = (later - earlier) / (2.0 * PROBE)  # h omega'
        correction = h / 12.0 * (slope[:-1] - slope[1:] + h * np.cross(w[:-1], w[1:]))
        turn = mean + correction
        turn[~(np.linalg.norm(correction, axis=1) < LARGEST_CORRECTION)] = np.nan
        angle = np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-100)
        return turn * (np.tan(0.5 * angle) / angle)

    @np.errstate(all="ignore")
    def along(self, q: Array, states: Array, h: float) -> Array:
        """Recorded quaternions (m - 1, 4) in the ``states`` (m, d) after the first one; carries ``q`` (4,) along."""
        steps, moved, fixed = len(states) - 1, self.turns(states, h), _fixed(self.top, states[1:])
        out = np.empty(steps * NUMBERS)
        self.code(q, moved.ravel(), fixed.ravel(), out, int(self.top.in_space), steps)
        return out.reshape(steps, NUMBERS)


def attitude_loop(top: Top, scheme: Scheme, options: Any, method: Method) -> Loop:
    """Time loop of a ``scheme`` with ``options``, made ready as ``method``, that records the attitude with the states.

    Its initial state is that of the top, followed by ``start_attitude``. Raises UsageError for a top that does not
    declare its angular velocity.
    """
    d, order = len(top.components), scheme.order_for(options)
    loop = loop_of(method, d, len(top.constants()))
    turning = Turning(top, 4 if order is None or scheme.adaptive or order > 2 else 2)
    block, head = np.empty((1 + BLOCK_STEPS, d)), NUMBERS + d

    # the working state is that of the loop, after the attitude and the state
    def enter(y: Array, work: Array, p: Array, h: float) -> int:
        work[:head] = *(y[d:] * [1.0, -1.0, -1.0, -1.0] if top.in_space else y[d:]), *y[:d]
        return loop.enter(y[:d], work[head:], p, h)

    def take_steps(work: Array, out: Array, p: Array, h: float, steps: int, every: int, until: int) -> int:
        taken, rows = 0, out[: len(out) // head * head].reshape(-1, head)
        while taken < steps:
            size = min(BLOCK_STEPS, steps - taken)
            try:
                went = loop.take_steps(work[head:], block[1:].reshape(-1), p, h, size, 1, 1)
            except StopAsked:  # none of these steps counts as taken
                break
            good = went if went >= 0 else -went - 1
            block[0] = work[NUMBERS:head]
            q = turning.along(work[:NUMBERS], block[: good + 1], h)
            work[NUMBERS:head] = block[good]

            # of all steps the first one that is recorded is number ``until``
            first = (until - 1 - taken) % every
            states, q = block[1 : good + 1][first::every], q[first::every]
            rows[: len(q), :d], rows[: len(q), d:] = states, q
            rows = rows[len(q) :]
            if went < 0:
                return went - taken
            taken += went
            if went < size:
                break
        return taken

    return replace(
        loop,
        enter=enter,
        take_steps=take_steps,
        width=loop.width + head,
        seconds=loop.seconds + turning.code.seconds,
        cached=loop.cached and turning.code.cached,
    )
