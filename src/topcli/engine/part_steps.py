"""States between two steps, by a shorter step of the scheme or by the closed form.

A scheme is a family of maps, one for each length of the step. From the state y after a step, the states of the steps
of length theta h, 0 <= theta <= 1, lead from y to the state after the next step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Floats, Method, Sampler, Stepper, Top, same_state
from topcli.engine.loop import Loop, loop_of, state_after
from topcli.engine.native import CompileError, Native, native

SIGNATURE = "ppppdq"

PartSteps = Callable[[Array, NDArray[np.int64], Array, Array], Array]
"""``part_steps(y0, n, before, theta)``: states (k, d) a fraction ``theta`` (k,) of a step after the states ``before``
(k, d), which orbits from ``y0`` (k, d) have after ``n`` (k,) steps. A step that fails gives nan."""

_TEMPLATE = """
def make(step, enter, leave):
    def part_steps(before, theta, out, params, h, count):
        p = ({constants})
        for k in range(count):
            part = theta[k] * h
            s = step(enter(({entered}), part, p), part, p)
            y = leave(s, part, p)
            good = {finite} == 0.0
            {stored}
        return 1

    return part_steps
"""


@cache
def _template(d: int, constants: int, checked: int) -> Callable[..., Callable[..., int]]:
    text = _TEMPLATE.format(
        constants="".join(f"params[{i}], " for i in range(constants)),
        entered="".join(f"before[{d} * k + {i}], " for i in range(d)),
        finite=" + ".join(f"(s[{i}] - s[{i}])" for i in range(checked)),
        stored=("\n" + " " * 12).join(f"out[{d} * k + {i}] = y[{i}] if good else nan" for i in range(d)),
    )
    scope: dict[str, Any] = {"nan": math.nan}
    exec(compile(text, f"<parts of steps {d}/{constants}/{checked}>", "exec"), scope)
    return scope["make"]


def part_steps_of(method: Method, top: Top, h: float) -> PartSteps:
    """Parts of the steps of ``h`` of a method for ``top``; compiled, if the method is a step that can be compiled."""
    if isinstance(method, Sampler):
        return _by_closed_form(method, tuple(top.constants()), h)
    code = _compiled(method, top) if isinstance(method, Stepper) and not method.plain else None
    if isinstance(method, Stepper) and code is not None:
        return _by_code(code, np.array(method.parameters(top), dtype=float), h)
    constants = np.array(top.constants(), dtype=float)
    return _one_by_one(loop_of(method, len(top.components), len(constants)), constants, h)


def _by_closed_form(sampler: Sampler, p: Floats, h: float) -> PartSteps:
    def part_steps(y0: Array, n: NDArray[np.int64], before: Array, theta: Array) -> Array:
        out = np.full_like(before, np.nan)
        for start in np.unique(y0, axis=0):
            here = (y0 == start).all(axis=1)
            out[here] = sampler.states(start, h, (n + theta)[here], p)
        return out

    return part_steps


def _compiled(method: Stepper, top: Top) -> Native | None:
    """Machine code of ``part_steps``; None if the way to or from the working state cannot be compiled."""
    make = _template(len(top.components), len(method.parameters(top)), method.checked or method.width)
    try:
        return native(make(method.step, method.enter or same_state, method.leave or same_state), SIGNATURE)
    except CompileError:
        return None


def _by_code(code: Native, params: Array, h: float) -> PartSteps:
    def part_steps(y0: Array, n: NDArray[np.int64], before: Array, theta: Array) -> Array:
        out = np.full_like(before, np.nan)
        code.checked(np.ascontiguousarray(before), np.ascontiguousarray(theta), out, params, h, len(theta))
        return out

    return part_steps


def _one_by_one(loop: Loop, params: Array, h: float) -> PartSteps:
    def part_steps(y0: Array, n: NDArray[np.int64], before: Array, theta: Array) -> Array:
        out = before.copy()
        for k, part in enumerate(theta.tolist()):
            if part:
                found = state_after(loop, before[k], params, part * h)
                out[k] = np.nan if found is None else found
        return out

    return part_steps
