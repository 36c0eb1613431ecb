"""Attitude of the body, carried along the rows that the time loop records.

The time loop of a method is used as it is: it records every step into a buffer, and ``carry`` turns the attitude from
row to row and passes on the rows that are wanted, each with its quaternion. States therefore have the bits of a run
without attitude, whose machine code is the same. The attitude is part of the working state, so that a run resumes bit
for bit.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.quaternions import (
    Quaternion,
    canonical,
    canonical_rows,
    conjugate,
    product,
    rotate,
    sum_turned,
    turn_upright,
    upright,
)
from topcli.contracts import Array, Floats, Method, Sampler, Scheme, StopAsked, Top, checked_equations
from topcli.engine.driver import Loop, loop_of
from topcli.engine.fingerprint import fingerprint
from topcli.schemes.attitude import BUFFER, CONSTANTS, TO_ROUND_OFF, fixed_direction, turn, turn_order

if TYPE_CHECKING:
    from topcli.engine.native import Native

NEEDED_BY = "the attitude"
NUMBERS = 4
"""Numbers of a recorded attitude, a unit quaternion."""
HEAD = 14
"""Slots of the working state before those of the method: the last state, the quaternion, its rounding errors."""
BLOCK = 2048
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
    code, rows = _compiled(), np.empty(BLOCK * d)
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
                size = min(BLOCK, steps - taken)
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
