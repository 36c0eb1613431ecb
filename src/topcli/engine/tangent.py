"""Steps with their tangent maps, compiled for several orbits side by side; tangent vectors are renormalised on the way.

The tangent map of a step is the step compiled for dual numbers, unless the scheme gives it (``Stepper.tangent``). The
logarithms of the factors by which a tangent vector grows add up to its growth, from which Lyapunov exponents follow.

The compiled loop goes over the steps and, within each, over the orbits, as in ``engine.tile``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from topcli.contracts import Array, Block, Method, Sampler, Scheme, Stepper, Top, same_state
from topcli.engine.duals import dual, slope_of, value_of
from topcli.engine.loop import Loop, loop_of, state_after
from topcli.engine.native import CompileError, Native, native
from topcli.engine.source import place_of
from topcli.errors import UsageError

SIGNATURE = "pppdqqqq"

_TEMPLATE = """
def make(step, enter, leave):
    def drive(work, out, params, h, blocks, every, begin, renormalise):
        p = ({parameters})
        if begin:
            for j in range({lanes}):
                s = enter(({entered}), h, p)
                {store}
        {advance}
        for j in range({lanes}):
            y = leave(({load}), h, p)
            {leave}
        return 1

    return drive
"""
_BLOCKS = """for b in range(blocks):
            {steps}
            if renormalise:
                {lane_loop}
                    y = leave(s, h, p)
                    size = math.sqrt({norm})
                    out[{log} + j] += math.log(size)
                    factor = 1.0 / size
                    {scale}"""
_ALONE = """j = 0
        loaded = ({load})  # numba refuses more than 30 items for a variable with several values
        s = loaded
        failed = 0.0
        {blocks}
        {store}
        {failed} += failed"""


@cache
def _template(
    width: int, d: int, constants: int, given: bool, checked: int, lanes: int
) -> Callable[..., Callable[..., int]]:
    """Maker of the loop for a working state of ``width`` slots, of which the first ``checked`` are tested.

    Each step is tested, since the next one may hide that it failed; the row after those of the working state has nan
    for an orbit of which one did. The slots are dual numbers unless the tangent map is ``given``: then they are the
    state and the tangent vector, of ``d`` components each, and whatever follows.
    """

    def slot(array: str, i: int) -> str:
        return f"{array}[{i * lanes} + j]"

    def stored(indent: int) -> str:
        texts = []
        for i in range(width):
            texts.append(f"{slot('work', i)} = " + (f"s[{i}]" if given else f"value_of(s[{i}])"))
            if not given:
                texts.append(f"{slot('work', width + i)} = slope_of(s[{i}])")
        return ("\n" + " " * indent).join(texts)

    if given:
        load = "".join(f"{slot('work', i)}, " for i in range(width))
        entered = "".join(f"{slot('out', i)}, " for i in range(2 * d))
        left = [f"{slot('out', i)} = y[{i}]" for i in range(2 * d)]
        norm = " + ".join(f"y[{d + i}] * y[{d + i}]" for i in range(d))
        scaled = "".join(f"s[{i}]{' * factor' * (d <= i < 2 * d)}, " for i in range(width))
        values = [f"s[{i}]" for i in range(width)]
    else:
        load = "".join(f"dual({slot('work', i)}, {slot('work', width + i)}), " for i in range(width))
        entered = "".join(f"dual({slot('out', i)}, {slot('out', d + i)}), " for i in range(d))
        left = [f"{slot('out', i)} = value_of(y[{i}])" for i in range(d)]
        left += [f"{slot('out', d + i)} = slope_of(y[{i}])" for i in range(d)]
        norm = " + ".join(f"slope_of(y[{i}]) * slope_of(y[{i}])" for i in range(d))
        scaled = "".join(f"dual(value_of(s[{i}]), slope_of(s[{i}]) * factor), " for i in range(width))
        values = [f"value_of(s[{i}])" for i in range(width)]
    halves = [" + ".join(part) for part in (values[: checked // 2], values[checked // 2 : checked]) if part]
    failed, test = slot("work", width if given else 2 * width), f"0.0 * (({') + ('.join(halves)}))"
    steps = "for i in range(every):\n                "
    if lanes == 1:
        steps += f"s = step(s, h, p)\n                failed += {test}"
        lane_loop, scale = "if True:", f"scaled = ({scaled})\n                    s = scaled"
    else:
        indent = "\n" + " " * 20
        steps += (
            f"for j in range({lanes}):{indent}s = step(({load}), h, p){indent}{stored(20)}{indent}{failed} += {test}"
        )
        lane_loop = f"for j in range({lanes}):{indent}loaded = ({load}){indent}s = loaded"
        scale = f"scaled = ({scaled}){indent}s = scaled{indent}{stored(20)}"
    blocks = _BLOCKS.format(
        steps=steps,
        lane_loop=lane_loop,
        norm=norm,
        log=2 * d * lanes,
        scale=scale,
    )
    text = _TEMPLATE.format(
        parameters="".join(f"params[{i}], " for i in range(constants)),
        lanes=lanes,
        entered=entered,
        store=stored(16),
        advance=_ALONE.format(load=load, blocks=blocks, store=stored(8), failed=failed) if lanes == 1 else blocks,
        load=load,
        leave=("\n" + " " * 12).join(left),
    )
    scope: dict[str, Any] = {"math": math, "dual": dual, "value_of": value_of, "slope_of": slope_of}
    exec(compile(text, f"<tangent loop {width}/{d}/{constants}/{lanes}>", "exec"), scope)
    return scope["make"]


@dataclass(frozen=True)
class TangentCode:
    """Machine code of a step and its tangent map for ``lanes`` orbits of a top at once."""

    stepper: Stepper
    given: bool
    code: Native
    params: Array
    d: int
    lanes: int

    def run(self, h: float, y: Array, vectors: Array) -> TangentRun:
        """Orbits with steps of ``h`` from the states ``y`` (m, d) and ``vectors`` (m, d), m <= lanes."""
        return TangentRun(self, h, y, vectors)


@dataclass(frozen=True)
class BlockCode:
    """Time loop of a method that has its own, for the state and a tangent vector; orbits are computed one by one."""

    loop: Loop
    params: Array
    d: int
    lanes: int

    def run(self, h: float, y: Array, vectors: Array) -> BlockRun:
        """Orbits with steps of ``h`` from the states ``y`` (m, d) and ``vectors`` (m, d)."""
        return BlockRun(self, h, y, vectors)


def obstacle(method: Method) -> str:
    """Reason why a method has no tangent map, a verb phrase; empty if it has one."""
    if (isinstance(method, Stepper) and not method.plain) or (isinstance(method, Block) and method.tangent):
        return ""
    if isinstance(method, Sampler):
        return "is a solution in closed form, which is not differentiated"
    if isinstance(method, Stepper):
        return "calls library functions, which are not differentiated"
    return "chooses its steps by itself"


def tangent_code(scheme: Scheme, top: Top, method: Method, lanes: int) -> TangentCode | BlockCode:
    """Machine code of the step of a ``method`` with its tangent map.

    Raises UsageError for a method that has none.
    """
    reason = obstacle(method)
    if reason or isinstance(method, Sampler):
        raise UsageError(f"scheme {scheme.name!r} {reason}; use a scheme with steps of its own, such as hk or rk4")
    d = len(top.components)
    if isinstance(method, Block):
        assert method.tangent  # otherwise it is refused above
        return BlockCode(loop_of(method.tangent(), 2 * d, 0), np.array(top.constants()), d, lanes)
    given = method.tangent() if method.tangent else None
    stepper = given or method
    params = np.array(stepper.parameters(top))
    checked = stepper.checked or stepper.width - len(stepper.counters)
    make = _template(stepper.width, d, len(params), given is not None, checked, lanes)
    try:
        code = native(
            make(stepper.step, stepper.enter or same_state, stepper.leave or same_state),
            SIGNATURE,
            duals=given is None,
        )
    except CompileError as error:
        where = place_of(stepper.step)
        raise UsageError(f"{where}: the step of {scheme.name!r} cannot be differentiated: {error}") from None
    return TangentCode(stepper, given is not None, code, params, d, lanes)


class TangentRun:
    """Orbits of a tile with a tangent vector each, from the states ``y`` (m, d) and ``vectors`` (m, d), m <= lanes.

    An orbit of which a step failed, in whichever block, has nan as state, vector and growth from then on.
    """

    def __init__(self, code: TangentCode, h: float, y: Array, vectors: Array) -> None:
        self.code, self.h, self.count = code, h, len(y)
        slots = code.stepper.width * (1 if code.given else 2)
        self._work = np.zeros((slots + 1, code.lanes))  # the last row is nan after a failed step, otherwise zero
        self._out = np.zeros((2 * code.d + 1, code.lanes))
        self._begin = True
        self._place(y, vectors)

    def _place(self, y: Array, vectors: Array) -> None:
        d = self.code.d
        for rows, values in ((self._out[:d], y), (self._out[d : 2 * d], vectors)):
            rows[:, : self.count] = values.T
            rows[:, self.count :] = values[:1].T  # idle lanes copy the first

    def advance(self, blocks: int, every: int, renormalise: bool = True) -> None:
        """Take ``blocks`` times ``every`` steps, after each block with vectors of length one if ``renormalise``."""
        with np.errstate(all="ignore"):
            code = self.code
            flags = int(self._begin), int(renormalise)
            code.code.checked(self._work, self._out, code.params, self.h, blocks, every, *flags)
        self._begin = False

    @property
    def states(self) -> Array:
        """Physical states (m, d)."""
        return self._reached(self._out[: self.code.d])

    @property
    def vectors(self) -> Array:
        """Tangent vectors (m, d)."""
        return self._reached(self._out[self.code.d : 2 * self.code.d])

    @property
    def growth(self) -> Array:
        """Sum of the logarithms by which the vectors have grown (m,)."""
        return self._reached(self._out[-1])

    def _reached(self, rows: Array) -> Array:
        """Values of the orbits (m, ...) from ``rows`` of the tile; nan after a failed step."""
        return np.where(np.isnan(self._work[-1]), np.nan, rows).T[: self.count]


class BlockRun:
    """As ``TangentRun``, by a method with its own time loop, which begins anew after each renormalisation."""

    def __init__(self, code: BlockCode, h: float, y: Array, vectors: Array) -> None:
        self.code, self.h = code, h
        self.states, self.vectors = np.array(y, dtype=float), np.array(vectors, dtype=float)
        self.growth = np.zeros(len(y))

    def advance(self, blocks: int, every: int, renormalise: bool = True) -> None:
        """As ``TangentRun.advance``."""
        loop, params, d = self.code.loop, self.code.params, self.code.d
        with np.errstate(all="ignore"):
            for i in range(len(self.states)):
                for _ in range(blocks):
                    end = state_after(loop, np.concatenate([self.states[i], self.vectors[i]]), params, self.h, every)
                    end = np.full(2 * d, np.nan) if end is None else end
                    self.states[i], self.vectors[i] = end[:d], end[d:]
                    if renormalise:
                        size = np.linalg.norm(end[d:])
                        self.growth[i] += np.log(size)
                        self.vectors[i] /= size
