"""Time loop: iterate a step, record every k-th state, stop at the first state that is not finite.

numba needs tuples of known length, so the loop is a template for the lengths of the working state, the recorded state
and the constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from topcli.arithmetic.fused import unlikely
from topcli.contracts import Array, Block, Method, Outcome, Sampler, Stepper, check_stop, same_state
from topcli.engine.native import CompileError, native, native_text
from topcli.engine.source import place_of
from topcli.errors import SchemeCodeError

SIGNATURE = "pppdqqq"

_TEMPLATE = """
def make(step, enter, leave):
    def enter_state(y, work, params, h):
        {set_p}
        s = enter(({y_items}), h, p)
        {store_s}
        return 0

    def drive(work, out, params, h, steps, every, until_record):
        # returns the number of steps done, or minus the number of the first step whose result is not finite;
        # that result is left in work
        {set_p}
        begin = ({work_items})  # numba refuses more than 30 items for a variable with several values
        s = begin
        k = 0
        left = until_record
        for i in range(steps):
            {advance}
            if unlikely(not (({sum}) * 0.0 == 0.0)):  # so for all that is not finite and for some that is huge
                if not ({finite} == 0.0):
                    {store_failed}
                    return -(i + 1)
            left -= 1
            if left == 0:
                y = leave(s, h, p)
                {record}
                k += {d}
                left = every
        {store_s}
        return steps

    return enter_state, drive
"""


_STAGES = """for stage in range(int(params[{constants}])):
                s = step(s, params[{constants} + 1 + stage] * h, p)
                if unlikely(not ({finite} == 0.0)):
                    break"""


@cache
def _template(width: int, d: int, constants: int, checked: int, staged: bool) -> Callable[..., tuple[Any, Any]]:
    newline = "\n        "
    all_finite = " + ".join(f"(s[{i}] - s[{i}])" for i in range(width))
    text = _TEMPLATE.format(
        advance=_STAGES.format(constants=constants, finite=all_finite) if staged else "s = step(s, h, p)",
        set_p=f"p = ({''.join(f'params[{i}], ' for i in range(constants))})",
        y_items="".join(f"y[{i}], " for i in range(d)),
        work_items="".join(f"work[{i}], " for i in range(width)),
        store_s=newline.join(f"work[{i}] = s[{i}]" for i in range(width)),
        store_failed=(newline + " " * 12).join(f"work[{i}] = s[{i}]" for i in range(width)),
        sum=" + ".join(f"s[{i}]" for i in range(checked)),
        finite=" + ".join(f"(s[{i}] - s[{i}])" for i in range(checked)),
        record=(newline + " " * 8).join(f"out[k + {i}] = y[{i}]" for i in range(d)),
        d=d,
    )
    scope: dict[str, Any] = {"unlikely": unlikely}
    exec(compile(text, f"<time loop {width}/{d}/{constants}{' in stages' if staged else ''}>", "exec"), scope)
    return scope["make"]


def _functions(stepper: Stepper, d: int, constants: int, staged: bool) -> tuple[Callable[..., int], Callable[..., int]]:
    """``(enter, drive)`` that expect all parameters; if ``staged``, ``drive`` takes the stages of a composition."""
    make = _template(stepper.width, d, constants + len(stepper.constants), stepper.checked or stepper.width, staged)
    step = stepper.stages[0] if staged and stepper.stages else stepper.step
    return make(step, stepper.enter or same_state, stepper.leave or same_state)


def plain_loop(stepper: Stepper, d: int, constants: int) -> tuple[Callable[..., int], Callable[..., int]]:
    """``(enter, drive)`` as plain Python functions over indexable buffers."""
    enter, drive = _functions(stepper, d, constants, False)
    own = stepper.doubles
    if not own:
        return enter, drive

    def enter_state(y: Array, work: Array, params: Sequence[float], h: float) -> int:
        return enter(y, work, (*params, *own), h)

    def drive_on(work: Array, out: Array, params: Sequence[float], *rest: Any) -> int:
        return drive(work, out, (*params, *own), *rest)

    return enter_state, drive_on


def more_parameters(stepper: Stepper) -> tuple[float, ...]:
    """Parameters of compiled loops that follow the constants of the top.

    These are the constants of the step, then the number of stages of a composition and their fractions of h. Tops
    whose steps differ in constants only, and all compositions of a scheme, thus share their code.
    """
    stages = (len(stepper.stages[1]), *stepper.stages[1]) if stepper.stages else ()
    return (*stepper.doubles, *map(float, stages))


def _sampled_loop(sampler: Sampler, d: int) -> tuple[Callable[..., int], Callable[..., int]]:
    """``(enter, drive)`` for a closed form: the working state is the initial state and the number of steps done."""

    def enter(y: Array, work: Array, params: Array, h: float) -> int:
        work[:d] = y
        work[d] = 0.0
        return 0

    def drive(work: Array, out: Array, params: Array, h: float, steps: int, every: int, until_record: int) -> int:
        done = int(work[d])
        n = np.arange(done + until_record, done + steps + 1, every, dtype=np.int64)
        states = sampler.states(work[:d], h, n, tuple(params))
        good = np.isfinite(states).all(axis=1)
        kept = len(n) if good.all() else int(np.argmin(good))
        out[: kept * d] = states[:kept].ravel()
        if kept < len(n):
            return done - int(n[kept])
        work[d] = done + steps
        return steps

    return enter, drive


@dataclass(frozen=True)
class _Extended:
    """Machine code of a time loop that reads ``more`` parameters after the constants of the top."""

    code: Callable[..., int]
    more: Array

    def __call__(self, work: Array, out: Array, params: Array, *rest: Any) -> int:
        return self.code(work, out, np.concatenate([params, self.more]), *rest)


@dataclass(frozen=True)
class Loop:
    """A method ready to run: ``enter(y, work, p, h)``, then ``drive(work, out, p, h, steps, every, until_record)``.

    ``work`` has ``width`` slots, the last ones counting the events named in ``counters``; with ``iterative`` the one
    before them is nan after a step that did not converge. ``seconds`` is the time to compile or load; ``cached`` is
    true if the machine code came from disk, ``compiled`` if there is machine code at all. A call of any length may be
    interrupted if it ``returns_early``.
    """

    enter: Callable[..., int]
    drive: Callable[..., int]
    width: int
    counters: tuple[str, ...] = ()
    seconds: float = 0.0
    cached: bool = True
    iterative: bool = False
    compiled: bool = True
    returns_early: bool = False
    advice: Callable[[Sequence[float], float], str] | None = None
    sampled: bool = False
    """True for a closed form: the time of a call is that of the states that it records."""

    def of(self, stepper: Stepper) -> Loop:
        """The same loop for a method that differs in the constants of its step."""
        if not isinstance(self.drive, _Extended):
            return self
        return replace(self, drive=_Extended(self.drive.code, np.array(more_parameters(stepper))))

    def failure(self, work: Array) -> Outcome:
        """Outcome of a run whose failed step left ``work``."""
        status = work[len(work) - len(self.counters) - 1]
        return Outcome.NO_CONVERGENCE if self.iterative and status != status else Outcome.BLEW_UP  # nan


def step_refused(method: Stepper, d: int, error: CompileError) -> SchemeCodeError:
    """Error for a step that the compiler refuses, with its file and line."""
    return SchemeCodeError(
        f"{place_of(method.step)}: the step cannot be compiled for a state of length {d} "
        f"(working state {method.width}): {error}"
    )


def _checked_length(method: Stepper) -> Stepper:
    """Copy of a plain method whose step must return as many numbers as it takes."""
    inner = method.step

    def step(s: Any, h: float, p: Any) -> Any:
        new = inner(s, h, p)
        if len(new) != len(s):
            raise SchemeCodeError(f"{place_of(inner)}: the step returns {len(new)} numbers; expected {len(s)}")
        return new

    return replace(method, step=step)


def loop_of(method: Method, d: int, constants: int) -> Loop:
    """Time loop of a method for states of length ``d``, as machine code unless the method is a plain one.

    ``enter`` runs once and remains plain Python. Raises SchemeCodeError for a step that cannot be compiled.
    """
    if isinstance(method, Sampler):
        enter, sample = _sampled_loop(method, d)
        return Loop(enter, sample, d + 1, returns_early=True, sampled=True)  # it takes no steps
    traits: dict[str, Any] = {
        "width": method.width,
        "counters": method.counters,
        "iterative": method.iterative,
        "advice": method.advice,
    }
    if isinstance(method, Block):
        code = native_text(method.text(), "advance", SIGNATURE)
        return Loop(method.enter, code, seconds=code.seconds, cached=code.cached, returns_early=True, **traits)
    if method.plain:
        return Loop(*plain_loop(_checked_length(method), d, constants), compiled=False, **traits)
    enter, _ = plain_loop(method, d, constants)
    try:
        code = native(_functions(method, d, constants, bool(method.stages))[1], SIGNATURE)
    except CompileError as error:
        raise step_refused(method, d, error) from None
    more = more_parameters(method)
    drive = _Extended(code.checked, np.array(more)) if more else code.checked
    return Loop(enter, drive, seconds=code.seconds, cached=code.cached, **traits)


def interpreted(method: Method, d: int, constants: int) -> Loop:
    """Time loop of a method without compiling, which is quicker for single steps."""
    if isinstance(method, Stepper):
        return Loop(*plain_loop(method, d, constants), method.width)
    return loop_of(method, d, constants)


def state_after(loop: Loop, y: Array, p: Array | None, h: Any, steps: int = 1) -> Array | None:
    """State after some steps of ``h`` from ``y`` (d,), in the numbers of ``y``; None if a step fails."""
    work, end, left = np.zeros(loop.width, dtype=y.dtype), np.full_like(y, math.nan), steps
    try:
        with np.errstate(all="ignore"):
            loop.enter(y, work, p, h)
            while left > 0:
                check_stop()
                taken = loop.drive(work, end, p, h, left, left, left)  # a block may return before all are done
                if taken < 0:
                    return None
                left -= taken
        return end
    except (ArithmeticError, ValueError):  # where machine code gives inf or nan, the interpreter may raise
        return None
