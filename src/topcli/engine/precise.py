"""Time loop over an interpreted step in another arithmetic, with the interface of the compiled loops.

The step is a copy of that for doubles, with constants, ``math``, ``fma`` and tolerances replaced; there is no second
implementation of a scheme.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.fused import fma, is_cap, power_of
from topcli.arithmetic.vectors import SMALL_ANGLE_SQ
from topcli.contracts import Outcome, Scheme, StepFunction, Stepper, Top, same_state
from topcli.engine.loop import Loop
from topcli.engine.precise_numbers import (
    IRRATIONAL,
    MAX_DIGITS,
    Arithmetic,
    NotRationalError,
    Rational,
    TooLongError,
    arithmetic_of,
    at_most,
    meaning,
)
from topcli.engine.source import Copier, names_in, plain_function
from topcli.errors import UsageError

DOUBLE_BITS = 53


def irrational_name(function: Callable[..., Any]) -> str:
    """First function of ``math`` in a plain function that rational numbers do not have; empty for none."""
    plain = plain_function(function)
    if plain is None or math not in plain.__globals__.values():
        return ""
    return next((name for name in names_in(plain) if name in IRRATIONAL), "")


class Rebuilder(Copier):
    """Copier of functions into an arithmetic."""

    def __init__(self, arithmetic: Arithmetic) -> None:
        super().__init__(lambda function: function, {id(fma): arithmetic.fma})
        self.arithmetic = arithmetic

    def number(self, value: float) -> Any:
        """Constant in this arithmetic."""
        if math.isfinite(value):
            return self.arithmetic.number(meaning(value))
        return getattr(self.arithmetic.math, "nan" if math.isnan(value) else "inf", value)

    def compiled(self, value: object, names: list[str]) -> Any:
        """Form of a constant, function or module in this arithmetic."""
        if value is math:
            return self.arithmetic.math
        if isinstance(value, float):
            return self.number(value)
        if isinstance(value, tuple):
            items = [self.compiled(item, names) for item in value]
            return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
        return super().compiled(value, names)

    def referred(self, function: types.FunctionType, name: str, value: object, names: list[str]) -> Any:
        """Form of a global or closed-over variable ``name`` of a function; tolerances follow the precision."""
        module = function.__module__
        if isinstance(value, int) and is_cap(module, name, value):
            return self.arithmetic.cap(value)
        if isinstance(value, float) and (power := power_of(module, name, value)) is not None:
            return self.arithmetic.tolerance(value, power)
        if value is SMALL_ANGLE_SQ and self.arithmetic.bits != DOUBLE_BITS:
            return self.number(0.0)  # the polynomials below it have the accuracy of doubles
        return super().referred(function, name, value, names)

    def code(self, code: types.CodeType) -> types.CodeType:
        """Code with its constants, and those of inner functions, in this arithmetic."""
        return code.replace(co_consts=tuple(self._constant(value) for value in code.co_consts))

    def _constant(self, value: Any) -> Any:
        if isinstance(value, types.CodeType):
            return self.code(value)
        return self.compiled(value, []) if isinstance(value, float | tuple) else value

    def copy(self, function: types.FunctionType) -> types.FunctionType:
        """Copy of a function. Raises NotRationalError if it needs a function that rational numbers do not have."""
        if not self.arithmetic.bits and (name := irrational_name(function)):
            raise NotRationalError(f"uses math.{name}, which rational numbers do not have")
        return super().copy(function)

    def function(self, function: Callable[..., Any] | None) -> Any:
        """Copy of a step function; None for None."""
        plain = None if function is None else plain_function(function)
        return None if plain is None else self.compiled(plain, [])


def obstacle(scheme: Scheme, top: Top, options: Any) -> str:
    """Reason why a scheme has no other precision than double, a verb phrase; empty if it has."""
    method = scheme.build(top, options)
    if not isinstance(method, Stepper):
        return "is a closed form or has a time loop of its own: there are no steps to interpret"
    return "calls library functions that compute with doubles" if method.plain else ""


def precise_top(top: Top, parameters: dict[str, Any]) -> Any:
    """Top whose parameters are numbers of another arithmetic; not validated again."""
    return type(top).model_construct(**{**top.model_dump(), **parameters})


def precise_method(
    scheme: Scheme, top: Top, options: Any, precise: Top, arithmetic: Arithmetic, exact: Top | None = None
) -> Stepper:
    """Method of a scheme in another arithmetic: for the top ``top`` in doubles, which is ``precise`` there.

    ``exact`` is the top in fractions, from which constants of a step are found. Raises UsageError, naming the scheme
    and the reason, if it has none.
    """
    reason = obstacle(scheme, top, options)
    built = None if reason else scheme.build(top, options)
    if isinstance(built, Stepper):
        built = scheme.build(exact or top if built.source else precise, options)
    if not isinstance(built, Stepper):
        raise refused(scheme, arithmetic, reason)
    if not arithmetic.bits and built.iterative:
        raise refused(scheme, arithmetic, "solves its equations by iteration, and the solution is not rational")
    if not arithmetic.bits and built.source and (name := irrational_name(top.field)):
        raise refused(scheme, arithmetic, f"has constants by math.{name}, which rational numbers do not have")
    rebuilder = Rebuilder(arithmetic)
    try:
        if built.stages is not None:
            step, weights = built.stages
            built = replace(built, step=composition_of(step, centred(weights, rebuilder)))
        step, enter, leave = map(rebuilder.function, (built.step, built.enter, built.leave))
    except NotRationalError as error:
        raise refused(scheme, arithmetic, str(error)) from None
    return replace(built, step=step, enter=enter, leave=leave, plain=True, stages=None)


def refused(scheme: Scheme, arithmetic: Arithmetic, reason: str) -> UsageError:
    """Error for a scheme that has no such precision."""
    return UsageError(
        f"{arithmetic.purpose}: scheme {scheme.name!r} cannot compute with {arithmetic.name}: it {reason}"
    )


def centred(weights: tuple[float, ...], rebuilder: Rebuilder) -> tuple[Any, ...]:
    """Weights of a composition whose sum is one in this arithmetic too; the middle one is adjusted."""
    half = [rebuilder.number(weight) for weight in weights[: len(weights) // 2]]
    return (*half, 1 - 2 * sum(half[1:], half[0]), *reversed(half))


def composition_of(step: StepFunction, weights: tuple[Any, ...]) -> StepFunction:
    """Composed step with weights of another arithmetic; it ends as that of ``compose.composed_step``."""

    def composed(s: Any, h: Any, p: Any) -> Any:
        for c in weights:
            s = step(s, c * h, p)
            broken = 0.0
            for x in s:
                broken += x - x
            if broken != 0.0:  # true for nan
                break
        return s

    return composed


BITS_PER_DIGIT = 3.3219280948873626
ROOM = 4
"""Length of the longest number within a step, in units of ``max_digits``. The numbers of ``hk`` are at most 1.8 times
as long as those of the state after the step, those of ``rk4`` 1.05 times."""


def longest(state: Any) -> int:
    """Binary digits of the longest numerator or denominator of a state in rational numbers; 0 for other numbers."""
    return max((x.length for x in state if isinstance(x, Rational)), default=0)


@dataclass(frozen=True)
class PreciseLoop(Loop):
    """Loop whose buffers hold objects; ``max_bits`` bounds the length of rational numbers."""

    max_bits: int = 0
    overlong: list[bool] = field(default_factory=list)
    """Not empty after a step whose numbers became too long before it ended."""

    def failure(self, work: NDArray[Any]) -> Outcome:
        """Outcome of a run whose failed step left ``work``."""
        if self.overlong or (self.max_bits and longest(work) > self.max_bits):
            return Outcome.DIGIT_LIMIT
        return super().failure(work)


def precise_loop(
    stepper: Stepper, d: int, constants: tuple[Any, ...], arithmetic: Arithmetic, max_digits: int = MAX_DIGITS
) -> PreciseLoop:
    """Loop over a rebuilt step for physical states of length ``d``, with the ``constants`` of the top."""
    step, enter, leave = stepper.step, stepper.enter or same_state, stepper.leave or same_state
    checked, nothing = stepper.checked or stepper.width, arithmetic.number(Fraction(0))
    max_bits = int(max_digits * BITS_PER_DIGIT) if arithmetic.bits == 0 else 0
    overlong: list[bool] = []

    def enter_state(y: Any, work: Any, p: Any, h: Any) -> int:
        # a counter or status that a scheme begins with a plain 0.0 is a number too
        with arithmetic.active():
            work[:] = [x + nothing for x in enter(tuple(y), h, constants)]
        return 0

    def drive(work: Any, out: Any, p: Any, h: Any, steps: int, every: int, until_record: int) -> int:
        with arithmetic.active(), at_most(ROOM * max_bits):
            return taken(work, out, h, steps, every, until_record)

    def taken(work: Any, out: Any, h: Any, steps: int, every: int, until_record: int) -> int:
        s, k, left = tuple(work), 0, until_record
        for i in range(steps):
            try:
                s = step(s, h, constants)
                good = all(map(arithmetic.finite, s[:checked]))
            except ZeroDivisionError:
                good = False
            except TooLongError:
                overlong.append(True)
                good = False
            if not good or (max_bits and longest(s) > max_bits):
                work[:] = s
                return -(i + 1)
            left -= 1
            if left == 0:
                out[k : k + d] = leave(s, h, constants)
                k += d
                left = every
        work[:] = s
        return steps

    width, counters, iterative = stepper.width, stepper.counters, stepper.iterative
    return PreciseLoop(
        enter_state, drive, width, counters, iterative=iterative, compiled=False, max_bits=max_bits, overlong=overlong
    )


@dataclass(frozen=True)
class PreciseRun:
    """All that a run in another arithmetic needs: its ``top`` with numbers of it, the ``loop``, ``h`` and ``y0``."""

    arithmetic: Arithmetic
    top: Top
    loop: PreciseLoop
    h: Any
    y0: NDArray[Any]


def prepared(
    scheme: Scheme,
    top: Top,
    options: Any,
    precision: int | str,
    numbers: tuple[Fraction, Mapping[str, Fraction], tuple[Fraction, ...]],
    max_digits: int = MAX_DIGITS,
) -> PreciseRun:
    """Prepare a run of a scheme; ``numbers`` are h, the parameters of the top and the initial state, exactly.

    Raises UsageError, naming the scheme and the reason, if it has no such precision.
    """
    arithmetic = arithmetic_of(precision)
    h, parameters, state = numbers
    with arithmetic.active():
        precise = precise_top(top, {name: arithmetic.number(value) for name, value in parameters.items()})
        exact = precise_top(top, dict(parameters))
        method = precise_method(scheme, top, options, precise, arithmetic, exact)
        constants = (*precise.constants(), *map(arithmetic.number, method.constants))
    y0 = np.array([arithmetic.number(value) for value in state], dtype=np.object_)
    loop = precise_loop(method, len(y0), constants, arithmetic, max_digits)
    return PreciseRun(arithmetic, precise, loop, arithmetic.number(h), y0)
