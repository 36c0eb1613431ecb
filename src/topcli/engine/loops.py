"""Time loops: over the steps of one orbit, over the lanes of a tile, and over parts of single steps.

numba needs tuples of known length, so each loop is a text for the lengths of the working state, the recorded state and
the constants. The same text runs in the interpreter.

Parts of steps are the states between two steps. A scheme is a family of maps, one for each length of the step: from the
state y after a step, the steps of length theta h, 0 <= theta <= 1, lead from y to the state after the next step.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.fused import defined, unlikely
from topcli.arithmetic.vectors import VECTOR_VARIANTS
from topcli.contracts import Array, Block, Method, Outcome, Sampler, StepFunction, Stepper, Top, check_stop, same_state
from topcli.engine.kernels import NO_VARIANTS, CompileError, Variants
from topcli.engine.native import Native, native, native_text
from topcli.engine.reach import place_of, reach
from topcli.errors import SchemeCodeError

SINGLE, LANES, PARTS = "pppdqqq", "pppdqqqq", "ppppdq"
"""Signatures of the machine code of the three loops."""

_SINGLE = """
def loop(work, out, params, h, steps, every, until_record):
    # returns the number of steps done, or minus the number of the first step whose result is not finite;
    # that result is left in work
    p = ({constants})
    begin = ({state})  # numba refuses more than 30 items for a variable with several values
    s = begin
    k, left = 0, until_record
    for i in range(steps):
        s = step(s, h, p)
        if unlikely(not ({total} * 0.0 == 0.0)):  # so for all that is not finite and for some that is huge
            if not ({finite} == 0.0):
                {state} = s
                return -(i + 1)
        left -= 1
        if left == 0:
            {row} = leave(s, h, p)[:{d}]
            k, left = k + {d}, every
    {state} = s
    return steps
"""
_LANES = """
def loop(work, out, params, h, steps, every, until_record, stride):
    p = ({constants})
    k, left = 0, until_record
    for i in range(steps):
        for stage in range({stages}):
            part = {part}
            for j in range({lanes}):
                s = step(({state}), part, p)
                {state} = s
                work[{width} * {lanes} + j] += {total}
        left -= 1
        if left == 0:
            for j in range({lanes}):
                {row} = leave(({state}), h, p)[:{d}]
            k, left = k + {d}, every
    return steps
"""
_PARTS = """
def loop(before, theta, out, params, h, count):
    p = ({constants})
    for k in range(count):
        part = theta[k] * h
        s = step(enter(({before}), part, p), part, p)
        {row} = leave(s, part, p)[:{d}]
        if not ({finite} == 0.0):
            {row} = ({failed})
    return 1
"""


def _items(text: str, count: int) -> str:
    """Items of a tuple, or targets of an assignment: ``text`` for each number below ``count``."""
    return "".join(text.format(i) + ", " for i in range(count))


def _sum(terms: Sequence[str]) -> str:
    """Sum of ``terms`` in pairs, of which a processor adds several at a time."""
    half = len(terms) // 2
    return f"({_sum(terms[:half])} + {_sum(terms[half:])})" if half else terms[0]


def _function(template: str, stepper: Stepper, d: int, constants: int, lanes: int = 1) -> Callable[..., int]:
    """The loop of a ``template`` for a step; its parameters are the constants of the top and ``more_parameters``."""
    width, checked, count = stepper.width, stepper.checked or stepper.width, constants + len(stepper.constants)
    staged = stepper.stages if template == _LANES else None
    rows = {_SINGLE: "out[k + {}]", _LANES: "out[k + j * stride + {}]", _PARTS: f"out[{d} * k + {{}}]"}
    text = template.format(
        constants=_items("params[{}]", count),
        state=_items("work[{}]" if lanes == 1 else f"work[{{}} * {lanes} + j]", width),
        before=_items(f"before[{d} * k + {{}}]", d),
        row=_items(rows[template], d),
        total=_sum([f"s[{i}]" for i in range(checked)]),
        finite=" + ".join(f"(s[{i}] - s[{i}])" for i in range(checked)),
        failed=_items("nan", d),
        stages=f"int(params[{count}])" if staged else "1",
        # without stages, terms of h alone are computed before the loop; otherwise every step would wait for them
        part=f"params[{count} + 1 + stage] * h" if staged else "h",
        width=width,
        lanes=lanes,
        d=d,
    )
    functions = {"enter": stepper.enter or same_state, "leave": stepper.leave or same_state, "unlikely": unlikely}
    step = staged[0] if staged else stepper.step
    return defined(text, "time loop", step=step, nan=math.nan, __name__=__name__, **functions)["loop"]


def more_parameters(stepper: Stepper) -> tuple[float, ...]:
    """Parameters of the loop over lanes that follow the constants of the top.

    These are the constants of the step, then the number of stages of a composition and their fractions of h. Tops
    whose steps differ in constants only, and all compositions of a scheme, thus share their code.
    """
    stages = (len(stepper.stages[1]), *stepper.stages[1]) if stepper.stages else ()
    return (*stepper.doubles, *map(float, stages))


def loop_code(
    stepper: Stepper,
    d: int,
    constants: int,
    lanes: int = 1,
    *,
    variants: Variants = NO_VARIANTS,
    differentiated: StepFunction | None = None,
) -> Native:
    """Machine code of the loop over steps and ``lanes`` for states of length ``d``, with ``variants`` of kernels.

    With several lanes, ``work`` holds ``width`` rows of ``lanes`` numbers and one more, which gathers the sums of the
    checked numbers: the loop cannot stop for one lane, but an infinity or a nan in any step makes its sum infinite or
    nan. ``out`` gets ``d`` numbers for every recorded step of a lane; the rows of a lane follow each other and begin
    ``stride`` numbers after those of the lane before. The step may be the one ``differentiated``, in dual numbers.
    Raises SchemeCodeError, with file and line of the step, if it cannot be compiled.
    """
    template, signature = (_SINGLE, SINGLE) if lanes == 1 else (_LANES, LANES)
    plain, duals = _function(template, stepper, d, constants, lanes), differentiated is not None
    try:
        return native(plain, signature, variants=variants, duals=duals)
    except CompileError as error:
        what = "differentiated" if duals else f"compiled for a state of length {d} (working state {stepper.width})"
        place = place_of(differentiated or stepper.step)
        raise SchemeCodeError(f"{place}: the step cannot be {what}: {error}") from None


def lanes_code(stepper: Stepper, d: int, constants: int, width: int) -> Native:
    """Machine code of ``loop_code`` over ``width`` lanes of a scheme's step, as vector instructions can take it.

    A lane whose sum is not finite is to repeat its steps alone: a step of it failed or took a rare branch, of which
    vector code makes nan.
    """
    # the nan of a rare branch may be in any number but the counters
    lane = replace(stepper, checked=stepper.width - len(stepper.counters))
    # it is noticed in the working state only, so what is recorded must not come from a variant
    recorded = reach(stepper.leave)[1] if stepper.leave else ()
    variants = NO_VARIANTS if VECTOR_VARIANTS.keys() & recorded else VECTOR_VARIANTS
    return loop_code(lane, d, constants, width, variants=variants)


@dataclass(frozen=True)
class Loop:
    """A method ready to run: ``enter(y, work, p, h)``, then ``take_steps(work, out, p, h, steps, every, until)``.

    ``work`` has ``width`` slots, the last ones counting the events named in ``counters``; with ``iterative`` the one
    before them is nan after a step that did not converge. ``seconds`` is the time to compile or load; ``cached`` is
    true if the machine code came from disk. A call of any length may be interrupted if it ``returns_early``.
    """

    enter: Callable[..., int]
    take_steps: Callable[..., int]
    width: int
    counters: tuple[str, ...] = ()
    seconds: float = 0.0
    cached: bool = True
    iterative: bool = False
    returns_early: bool = False
    too_long: Sequence[Exception] = ()
    """Not empty after a step whose numbers became longer than a run allows."""

    def failure(self, work: Array) -> Outcome:
        """Outcome of a run whose failed step left ``work``."""
        if self.too_long:
            return Outcome.DIGIT_LIMIT
        status = work[len(work) - len(self.counters) - 1]
        return Outcome.NO_CONVERGENCE if self.iterative and status != status else Outcome.BLEW_UP  # nan


def _loop_over(code: Callable[..., int], method: Stepper, **about: Any) -> Loop:
    """Loop of a step with the ``code`` for all parameters; ``enter`` runs once and remains plain Python."""
    inner, more = method.enter or same_state, method.doubles

    def enter(y: Array, work: Array, params: Any, h: Any) -> int:
        work[:] = inner(tuple(y), h, tuple(params))
        return 0

    def take_steps(work: Array, out: Array, params: Any, *rest: Any) -> int:
        return code(work, out, np.concatenate([params, more]), *rest)

    return Loop(enter, take_steps if more else code, **_traits(method), **about)


def _traits(method: Stepper | Block) -> dict[str, Any]:
    return {name: getattr(method, name) for name in ("width", "counters", "iterative")}


def _sampled_loop(sampler: Sampler, d: int) -> Loop:
    """Loop for a closed form: the working state is the initial state and the number of steps done."""

    def enter(y: Array, work: Array, params: Array, h: float) -> int:
        work[:d] = y
        work[d] = 0.0
        return 0

    def take_steps(work: Array, out: Array, params: Array, h: float, steps: int, every: int, until_record: int) -> int:
        done = int(work[d])
        n = np.arange(done + until_record, done + steps + 1, every, dtype=np.int64)
        states = sampler.states(work[:d], h, n, tuple(params))
        good = np.isfinite(states).all(axis=1)
        count = len(n) if good.all() else int(np.argmin(good))
        out[: count * d] = states[:count].ravel()
        if count < len(n):
            return done - int(n[count])
        work[d] = done + steps
        return steps

    return Loop(enter, take_steps, d + 1, returns_early=True)


def loop_of(method: Method, d: int, constants: int) -> Loop:
    """Time loop of a method for states of length ``d``, as machine code unless the method is a plain one.

    Raises SchemeCodeError for a step that cannot be compiled.
    """
    if isinstance(method, Sampler):
        return _sampled_loop(method, d)
    if isinstance(method, Block):
        code = native_text(method.text(), "advance", SINGLE)
        about = {"seconds": code.seconds, "cached": code.cached, "returns_early": True}
        return Loop(method.enter, code, **_traits(method), **about)
    if method.plain:
        return interpreted(method, d, constants)
    code = loop_code(method, d, constants)
    return _loop_over(code.checked, method, seconds=code.seconds, cached=code.cached)


def interpreted(method: Method, d: int, constants: int) -> Loop:
    """Time loop of a method without compiling, which is quicker for single steps.

    A step that does not return as many numbers as it takes raises SchemeCodeError.
    """
    if not isinstance(method, Stepper):
        return loop_of(method, d, constants)

    def step(s: Any, h: Any, p: Any) -> Any:
        after = method.step(s, h, p)
        if len(after) != method.width:
            message = f"the step returns {len(after)} numbers; expected {method.width}"
            raise SchemeCodeError(f"{place_of(method.step)}: {message}")
        return after

    whole = replace(method, step=step)
    return _loop_over(_function(_SINGLE, whole, d, constants), whole)


def state_after(loop: Loop, y: Array, p: Array, h: Any, steps: int = 1) -> Array | None:
    """State after some steps of ``h`` from ``y`` (d,), in the numbers of ``y``; None if a step fails."""
    work, end, left = np.zeros(loop.width, dtype=y.dtype), np.full_like(y, math.nan), steps
    try:
        with np.errstate(all="ignore"):
            loop.enter(y, work, p, h)
            while left > 0:
                check_stop()
                taken = loop.take_steps(work, end, p, h, left, left, left)  # a block may return before all are done
                if taken < 0:
                    return None
                left -= taken
        return end
    except (ArithmeticError, ValueError):  # where machine code gives inf or nan, the interpreter may raise
        return None


PartSteps = Callable[[Array, NDArray[np.int64], Array, Array], Array]
"""``part_steps(y0, n, before, theta)``: states (k, d) a fraction ``theta`` (k,) of a step after the states ``before``
(k, d), which orbits from ``y0`` (k, d) have after ``n`` (k,) steps. A step that fails gives nan."""


def part_steps_of(method: Method, top: Top, h: float) -> PartSteps:
    """Parts of the steps of ``h`` of a method for ``top``; compiled, if the method is a step that can be compiled."""
    p, d, code = top.constants(), len(top.components), None
    if isinstance(method, Stepper) and not method.plain:
        with suppress(CompileError):  # of the way to or from the working state
            code = native(_function(_PARTS, method, d, len(p)), PARTS)
    params = np.array(method.parameters(top) if isinstance(method, Stepper) and code else p, dtype=float)
    loop = None if code else loop_of(method, d, len(p))

    def part_steps(y0: Array, n: NDArray[np.int64], before: Array, theta: Array) -> Array:
        out = before.copy()
        if isinstance(method, Sampler):
            for start in np.unique(y0, axis=0):
                here = (y0 == start).all(axis=1)
                out[here] = method.states(start, h, (n + theta)[here], p)
        elif code:
            code.checked(np.ascontiguousarray(before), np.ascontiguousarray(theta), out, params, h, len(theta))
        elif loop:
            for k in np.flatnonzero(theta):
                end = state_after(loop, before[k], params, float(theta[k]) * h)
                out[k] = np.nan if end is None else end
        return out

    return part_steps
