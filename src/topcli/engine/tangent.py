"""Steps with their tangent maps, for several orbits side by side.

The tangent map of a step is the step compiled for dual numbers, unless the scheme gives it (``Stepper.tangent``). Step
and tangent map together are a step of twice the width, which the ordinary time loops iterate (``engine.loops``).

Tangent vectors grow or shrink exponentially. After each call of the loop they are divided by powers of two: the tangent
map is linear, so this changes no digit, and neither growth nor direction depend on the lengths of the calls or on the
other orbits. A call after which a vector is too large or too small is repeated with fewer steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.fused import defined
from topcli.contracts import Array, Block, Method, Sampler, Scheme, StepFunction, Stepper, Top, same_state
from topcli.engine.duals import dual, primal_of, slope_of
from topcli.engine.loops import Loop, loop_code, loop_of, state_after
from topcli.errors import UsageError

NEAR, FAR = 2.0**128, 2.0**512
"""Growth of a vector in a call up to which the next call is longer, and up to which it counts; or their inverses."""
FIRST_CALL, MOST_STEPS = 1 << 10, 1 << 16
"""Steps of the first call, and most steps of a call."""
BLOCK_STEPS, BLOCK_TIME = 64, 4.0
"""The most for a method with its own time loop, which begins anew in each call, with units that fit the vector."""

_WITH_SLOPES = """
def with_slopes(x, h, p):
    y = function(({duals}), h, p)
    return ({values}{slopes})
"""


def _with_slopes(function: StepFunction, width: int, length: int) -> StepFunction:
    """``function`` with its derivative: of ``width`` numbers and slopes each, ``length`` numbers and their slopes."""
    text = _WITH_SLOPES.format(
        duals="".join(f"dual(x[{i}], x[{width + i}]), " for i in range(width)),
        values="".join(f"value_of(y[{i}]), " for i in range(length)),
        slopes="".join(f"slope_of(y[{i}]), " for i in range(length)),
    )
    names = {"dual": dual, "value_of": primal_of, "slope_of": slope_of, "__name__": __name__}
    return defined(text, f"tangent map {width}/{length}", function=function, **names)["with_slopes"]


def _with_tangent(method: Stepper, d: int) -> Stepper:
    """The step with its tangent map by dual numbers: numbers of the working state, then their slopes."""
    return Stepper(
        _with_slopes(method.step, method.width, method.width),
        2 * method.width,
        method.enter and _with_slopes(method.enter, d, method.width),
        _with_slopes(method.leave or same_state, method.width, d),
        checked=method.checked or method.width - len(method.counters),
        constants=method.constants,
    )


@dataclass(frozen=True)
class TangentCode:
    """Step of a method with its tangent map, ready for ``lanes`` orbits at once.

    ``take_steps`` and ``enter`` are loops over steps and lanes. ``take_steps`` leaves state and vector in ``out``
    (lanes, 2 d); of the working state, in rows of lanes, the rows ``vector`` belong to the vector. ``enter`` makes the
    ``width`` rows of the working state in the same way; None if they are those of state and vector.
    """

    take_steps: Callable[..., int]
    enter: Callable[..., int] | None
    params: Array
    width: int
    vector: slice
    lanes: int
    restarts: bool = False
    """True for a method whose own time loop begins anew in each call."""


def tangent_obstacle(method: Method) -> str:
    """Reason why a method has no tangent map, a verb phrase; empty if it has one."""
    if (isinstance(method, Stepper) and not method.plain) or (isinstance(method, Block) and method.tangent):
        return ""
    if isinstance(method, Sampler):
        return "is a solution in closed form, which is not differentiated"
    if isinstance(method, Stepper):
        return "calls library functions, which are not differentiated"
    return "chooses its steps by itself"


def tangent_code(scheme: Scheme, top: Top, method: Method, lanes: int) -> TangentCode:
    """Machine code of the step of a ``method`` with its tangent map, for ``lanes`` orbits at once.

    Orbits of a method with its own time loop are computed one by one. Raises UsageError for a method without a tangent
    map.
    """
    reason = tangent_obstacle(method)
    if reason or isinstance(method, Sampler):
        raise UsageError(f"scheme {scheme.name!r} {reason}; use a scheme with steps of its own, such as hk or rk4")
    d, constants = len(top.components), len(top.constants())
    if isinstance(method, Block):
        assert method.tangent  # otherwise it is refused above
        params, loop = np.array(top.constants()), loop_of(method.tangent(), 2 * d, 0)
        return TangentCode(_one_by_one(loop), None, params, 2 * d, slice(d, 2 * d), 1, restarts=True)
    variational = method.tangent() if method.tangent else None
    if variational:
        step = replace(variational, checked=variational.checked or variational.width - len(variational.counters))
        vector = slice(d, 2 * d)
    else:
        step, vector = _with_tangent(method, d), slice(method.width, 2 * method.width)

    def loop_over(stepper: Stepper, length: int) -> Callable[..., int]:
        return loop_code(stepper, length, constants, lanes, differentiated=None if variational else method.step).checked

    take_steps, enter = loop_over(step, 2 * d), None
    if step.enter:  # what a step that moves nothing records of state and vector
        enter = loop_over(replace(step, step=same_state, width=2 * d, leave=step.enter, checked=d), step.width)
    params = np.array([*top.constants(), *step.doubles])
    return TangentCode(take_steps, enter, params, step.width, vector, lanes)


def _one_by_one(loop: Loop) -> Callable[..., int]:
    """Loop over orbits of a method with its own time loop, with the arguments of the loop over lanes."""

    def take_steps(work: Array, out: Array, params: Array, h: float, steps: int, *_: int) -> int:
        for j in np.flatnonzero(np.isfinite(work[-1])):
            end = state_after(loop, work[:-1, j].copy(), params, h, steps)
            if end is None:
                work[-1, j] = math.nan
            else:
                work[:-1, j] = out[j] = end
        return steps

    return take_steps


def _exponents(x: Array) -> NDArray[np.int64]:
    """Binary exponents of numbers; 0 of those that are not finite."""
    return np.where(np.isfinite(x), np.frexp(x)[1], 0).astype(np.int64)


class TangentRun:
    """Orbits with steps of ``h`` and a tangent vector each, from the states ``y`` (m, d) and ``vectors`` (m, d).

    There are at most ``code.lanes`` orbits, any number if the code ``restarts``.
    ``scales`` (m,) are the powers of two by which the vectors have been divided. An orbit of which a step failed has
    nan as state and vector from then on.
    """

    def __init__(self, code: TangentCode, h: float, y: Array, vectors: Array) -> None:
        self.code, self.h, (self.count, d) = code, h, y.shape
        columns = self.count if code.restarts else code.lanes
        self.scales = _exponents(np.abs(vectors).max(axis=1))
        self._out = np.full((columns, 2 * d), np.nan)
        self._out[: self.count] = np.hstack([y, np.ldexp(vectors, -self.scales[:, None])])
        self._out[self.count :] = self._out[:1]  # idle lanes copy the first, since extreme numbers are slow
        self._work = np.ascontiguousarray(np.vstack([self._out.T, np.zeros((1, columns))]))
        if code.enter:
            entered = np.full((columns, code.width), np.nan)
            self._call(code.enter, entered, 1)
            self._work = np.ascontiguousarray(np.vstack([entered.T, self._work[-1:]]))
        self._most = max(1, int(min(BLOCK_STEPS, BLOCK_TIME / abs(h)))) if code.restarts else MOST_STEPS
        self._call_steps = min(FIRST_CALL, self._most)

    def _call(self, loop: Callable[..., int], out: Array, steps: int) -> None:
        stride = (out.shape[1],) if self.code.lanes > 1 else ()
        if loop(self._work, out, self.code.params, self.h, steps, steps, steps, *stride) < 0:
            self._work[-1] = math.nan  # the loop of a single orbit says so, that of lanes by this row itself

    def advance(self, steps: int) -> None:
        """Take ``steps`` steps."""
        rows, d = self.code.vector, self._out.shape[1] // 2
        while steps > 0:
            before, size = self._work.copy(), min(steps, self._call_steps)
            self._call(self.code.take_steps, self._out, size)
            first, sizes = (np.abs(work[rows]).max(axis=0) for work in (before, self._work))
            # an infinite or zero vector remains so; a single step may do what it likes
            moves = np.isfinite(self._work[-1]) & np.isfinite(first) & (first > 0.0)
            if size > 1 and (moves & ~((sizes < FAR) & (sizes > 1.0 / FAR))).any():
                self._work, self._call_steps = before, size // 2
                continue
            if size == self._call_steps and ((sizes < NEAR) & (sizes > 1.0 / NEAR))[moves].all():
                self._call_steps = min(2 * size, self._most)
            exponents = _exponents(sizes)
            self._work[rows] = np.ldexp(self._work[rows], -exponents)
            self._out[:, d:] = np.ldexp(self._out[:, d:], -exponents[:, None])
            self.scales += exponents[: self.count]
            steps -= size

    @property
    def states(self) -> Array:
        """States (m, d)."""
        return self._living(self._out[: self.count, : self._out.shape[1] // 2])

    @property
    def vectors(self) -> Array:
        """Tangent vectors divided by ``2**scales`` (m, d)."""
        return self._living(self._out[: self.count, self._out.shape[1] // 2 :])

    @property
    def images(self) -> Array:
        """Tangent vectors (m, d), infinite or zero beyond the range of doubles."""
        with np.errstate(all="ignore"):
            return np.ldexp(self.vectors, self.scales[:, None])

    def _living(self, rows: Array) -> Array:
        return np.where(np.isfinite(self._work[-1, : self.count])[:, None], rows, np.nan)
