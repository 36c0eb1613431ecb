"""Dual numbers in compiled code: a float and its derivative along a tangent vector.

A step that is compiled for dual numbers gives its tangent map, without other code: forward-mode differentiation
(Griewank and Walther, Evaluating Derivatives, 2008, chapter 3). The values keep their bits. The rules below teach the
compiler the arithmetic of the type; where a step branches, the value decides. A function that has no rule here is
refused by the compiler.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from topcli.arithmetic.fused import defined, fma


def dual(value: float, slope: float) -> Any:
    """The dual number; in compiled code only."""
    raise NotImplementedError


def primal_of(number: Any) -> float:
    """Value of a dual number, or a float itself; in compiled code only."""
    raise NotImplementedError


def slope_of(number: Any) -> float:
    """Derivative of a dual number, 0 of a float; in compiled code only."""
    raise NotImplementedError


_NAMES = "xyz"
"""Arguments of a function in its rule."""
RULES: dict[tuple[Callable[..., Any], ...], tuple[str, ...]] = {
    (operator.add, operator.iadd): ("x + y", "+", "+"),
    (operator.sub, operator.isub): ("x - y", "+", "-"),
    (operator.mul, operator.imul): ("x * y", "y", "x"),
    (operator.truediv, operator.itruediv): ("x / y", "1.0 / y", "-(x / y) * (1.0 / y)"),
    (operator.neg,): ("-x", "-"),
    (operator.pos,): ("x", "+"),
    (fma,): ("fma(x, y, z)", "y", "x", "+"),
    (abs, math.fabs): ("abs(x)", "math.copysign(1.0, x)"),
    (min,): ("y if y < x else x", "0.0 if y < x else 1.0", "1.0 if y < x else 0.0"),
    (max,): ("y if y > x else x", "0.0 if y > x else 1.0", "1.0 if y > x else 0.0"),
    (math.copysign,): ("math.copysign(x, y)", "math.copysign(1.0, x) * math.copysign(1.0, y)", "0.0"),
    (math.sqrt,): ("math.sqrt(x)", "0.5 / math.sqrt(x)"),
    (math.hypot,): ("math.hypot(x, y)", "x / math.hypot(x, y)", "y / math.hypot(x, y)"),
    (math.exp,): ("math.exp(x)", "math.exp(x)"),
    (math.log,): ("math.log(x)", "1.0 / x"),
    (math.sin,): ("math.sin(x)", "math.cos(x)"),
    (math.cos,): ("math.cos(x)", "-math.sin(x)"),
    (math.tan,): ("math.tan(x)", "1.0 + math.tan(x) * math.tan(x)"),
    (math.asin,): ("math.asin(x)", "1.0 / math.sqrt((1.0 - x) * (1.0 + x))"),
    (math.acos,): ("math.acos(x)", "-1.0 / math.sqrt((1.0 - x) * (1.0 + x))"),
    (math.atan2,): ("math.atan2(x, y)", "y / fma(y, y, x * x)", "-x / fma(y, y, x * x)"),
    (math.sinh,): ("math.sinh(x)", "math.cosh(x)"),
    (math.cosh,): ("math.cosh(x)", "math.sinh(x)"),
    (math.tanh,): ("math.tanh(x)", "1.0 / (math.cosh(x) * math.cosh(x))"),
}
"""Value of each differentiable function of x, y, z, then its derivative along each of them; ``+`` is one, ``-`` minus
one."""
TESTS: dict[Callable[..., bool], str] = {
    operator.lt: "x < y",
    operator.le: "x <= y",
    operator.gt: "x > y",
    operator.ge: "x >= y",
    operator.eq: "x == y",
    operator.ne: "x != y",
    math.isfinite: "math.isfinite(x)",
    math.isnan: "math.isnan(x)",
    math.isinf: "math.isinf(x)",
}
"""Functions of the values alone."""


def _power(n: int) -> str:
    """The text x**n with the bits that the compiler gives it for floats, but without an exception at 0."""
    factors, square, left = [], "x", abs(n)
    while left:
        factors += [square] if left % 2 else []
        square, left = f"({square} * {square})", left // 2
    product = " * ".join(factors) or "1.0"
    return f"1.0 / ({product})" if n < 0 else product


def _slope(derivatives: Sequence[str], duals: Sequence[bool]) -> str:
    """Text of the slope of a function; slopes that are zero, of arguments that are no ``duals``, do not appear."""
    slope = ""
    terms = [pair for pair, moves in zip(zip(derivatives, _NAMES, strict=False), duals, strict=False) if moves]
    for derivative, name in sorted(terms, key=lambda term: term[0] not in ("+", "-")):
        if derivative in ("+", "-"):
            slope = f"{slope} {derivative} d{name}"
        else:
            slope = f"fma({derivative}, d{name}, {slope})" if slope else f"({derivative}) * d{name}"
    return slope or "0.0"


def _dual_type() -> tuple[Any, Any, Any, Any]:
    """The type of numba, and the intrinsic functions that make a number, and take its value and its slope."""
    from llvmlite import ir
    from numba import types
    from numba.core.typeconv.castgraph import Conversion
    from numba.extending import intrinsic, lower_cast, models, register_model

    class DualType(types.Type):
        """Type of a dual number; other numbers convert to it."""

        def unify(self, typingctx: Any, other: Any) -> Any:
            return self if isinstance(other, types.Number) else None

        def can_convert_from(self, typingctx: Any, other: Any) -> Any:
            return Conversion.safe if isinstance(other, types.Number) else None

    kind, members = DualType("Dual"), [("value", types.float64), ("slope", types.float64)]
    register_model(DualType)(lambda manager, fe_type: models.StructModel(manager, fe_type, members))

    def joined(context: Any, builder: Any, value: Any, slope: Any) -> Any:
        pair = ir.Constant(context.get_value_type(kind), ir.Undefined)
        return builder.insert_value(builder.insert_value(pair, value, 0), slope, 1)

    @lower_cast(types.Number, kind)
    def _widened(context: Any, builder: Any, source: Any, to: Any, number: Any) -> Any:
        value = context.cast(builder, number, source, types.float64)
        return joined(context, builder, value, context.get_constant(types.float64, 0.0))

    @intrinsic
    def make(context: Any, value: Any, slope: Any) -> Any:
        return kind(types.float64, types.float64), lambda c, builder, signature, x: joined(c, builder, *x)

    def part(which: int) -> Any:
        @intrinsic
        def taken(context: Any, number: Any) -> Any:
            def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                if signature.args[0] == kind:
                    return builder.extract_value(arguments[0], which)
                return context.get_constant(types.float64, 0.0) if which else arguments[0]

            return types.float64(kind if number == kind else types.float64), build

        return taken

    return kind, make, part(0), part(1)


@cache
def dual_numbers(fused: Any) -> dict[Callable[..., Any], Any]:
    """Teach numba the type, with ``fused`` for ``fma``; return what stands for ``dual`` ... in compiled code."""
    from numba import types
    from numba.extending import overload

    kind, make, value, slope = _dual_type()
    options: Any = {"error_model": "numpy", "forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

    def learn(function: Callable[..., Any], text_for: Callable[..., str | None]) -> None:
        """Let ``text_for(*types)`` be the function of arguments of which one is a dual number."""

        def rule(*arguments: Any) -> Any:
            if kind not in arguments or not all(x == kind or isinstance(x, types.Number) for x in arguments):
                return None
            if (text := text_for(*arguments)) is None:
                return None
            names = _NAMES[: len(arguments)]
            lines = [f"    {x}, d{x} = value({x}_), slope({x}_)\n" for x in names]
            source = f"def rule({', '.join(f'{x}_' for x in names)}):\n{''.join(lines)}    return {text}\n"
            return defined(source, "rule", dual=make, value=value, slope=slope, fma=fused, math=math)["rule"]

        overload(function, jit_options=options, strict=False, prefer_literal=function is operator.pow)(rule)

    def differentiable(value: str, *derivatives: str) -> Callable[..., str]:
        return lambda *arguments: f"dual({value}, {_slope(derivatives, [x == kind for x in arguments])})"

    def power(x: Any, n: Any) -> str | None:
        if not isinstance(n, types.IntegerLiteral):
            return None
        k = n.literal_value
        return differentiable(_power(k), *([f"{float(k)} * ({_power(k - 1)})"] if k else []))(x)

    # functions of numbers, tests of their values, whole powers, and the fma of floats
    for functions, rule in RULES.items():
        for function in functions:
            learn(function, differentiable(*rule))
    for function, text in TESTS.items():
        learn(function, lambda *arguments, text=text: text)
    learn(operator.pow, power)

    @overload(fma, jit_options=options)
    def _of_floats(a: Any, b: Any, c: Any) -> Any:
        return None if kind in (a, b, c) else lambda a, b, c: fused(a, b, c)  # pyright: ignore[reportCallIssue]

    return {fma: fma, dual: make, primal_of: value, slope_of: slope}
