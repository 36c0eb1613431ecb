"""Copies of step functions for another arithmetic: constants, ``math``, ``fma`` and tolerances replaced.

The copies share the source of the originals; there is no second implementation of a scheme.
"""

from __future__ import annotations

import math
import types
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from topcli.arithmetic import rotations
from topcli.arithmetic.fused import fma
from topcli.arithmetic.tolerances import is_cap, power_of
from topcli.contracts import Scheme, Stepper, Top
from topcli.engine.precise.numbers import IRRATIONAL, RATIONAL, Arithmetic, NotRationalError, meaning
from topcli.engine.source import Copier, names_in, plain_function
from topcli.errors import UsageError

DOUBLE_BITS = 53


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
        if value is rotations.SMALL_ANGLE_SQ and self.arithmetic.bits != DOUBLE_BITS:
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
        if self.arithmetic.name == RATIONAL and math in function.__globals__.values():
            for name in names_in(function):
                if name in IRRATIONAL:
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


def precise_method(scheme: Scheme, top: Top, options: Any, precise: Top, arithmetic: Arithmetic) -> Stepper:
    """Method of a scheme in another arithmetic: for the top ``top`` in doubles, which is ``precise`` there.

    Raises UsageError, naming the scheme and the reason, if it has none.
    """
    reason = obstacle(scheme, top, options)
    built = None if reason else scheme.build(precise, options)
    if not isinstance(built, Stepper):
        raise refused(scheme, arithmetic, reason)
    if arithmetic.name == RATIONAL and built.iterative:
        raise refused(scheme, arithmetic, "solves its equations by iteration, and the solution is not rational")
    rebuilder = Rebuilder(arithmetic)
    try:
        if built.stages is not None:
            step, weights = built.stages
            built = replace(built, step=composition_of(built.step, step, centred(weights, rebuilder)))
        step, enter, leave = map(rebuilder.function, (built.step, built.enter, built.leave))
    except NotRationalError as error:
        raise refused(scheme, arithmetic, str(error)) from None
    return replace(built, step=step, enter=enter, leave=leave, plain=True, stages=None)


def refused(scheme: Scheme, arithmetic: Arithmetic, reason: str) -> UsageError:
    """Error for a scheme that has no such precision."""
    return UsageError(f"precision: scheme {scheme.name!r} cannot compute with {arithmetic.name}: it {reason}")


def centred(weights: tuple[float, ...], rebuilder: Rebuilder) -> tuple[Any, ...]:
    """Weights of a composition whose sum is one in this arithmetic too; the middle one is adjusted."""
    half = [rebuilder.number(weight) for weight in weights[: len(weights) // 2]]
    return (*half, 1 - 2 * sum(half[1:], half[0]), *reversed(half))


def composition_of(composed: Callable[..., Any], step: Callable[..., Any], weights: tuple[Any, ...]) -> Any:
    """Composed step with other weights."""
    plain = plain_function(composed)
    assert plain is not None
    cells = {"step": step, "weights": weights}
    closure = tuple(types.CellType(cells[name]) for name in plain.__code__.co_freevars)
    return types.FunctionType(plain.__code__, plain.__globals__, plain.__name__, plain.__defaults__, closure)
