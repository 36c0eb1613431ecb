"""Dual numbers in compiled code: a float and its derivative along a tangent vector.

A step that is compiled for dual numbers gives its tangent map, without other code: forward-mode differentiation
(Griewank and Walther, Evaluating Derivatives, 2008, chapter 3). The values keep their bits. The rules below teach the
compiler the arithmetic of the type; where a step branches, the value decides. A function that has no rule here is
refused by the compiler.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from topcli.arithmetic.fused import fma


def dual(value: float, slope: float) -> Any:
    """The dual number; in compiled code only."""
    raise NotImplementedError


def value_of(number: Any) -> float:
    """Value of a dual number, or a float itself; in compiled code only."""
    raise NotImplementedError


def slope_of(number: Any) -> float:
    """Derivative of a dual number, 0 of a float; in compiled code only."""
    raise NotImplementedError


@cache
def rules_digest() -> str:
    """Text that changes with the rules of this module."""
    return sha256(Path(__file__).read_bytes()).hexdigest()


class Builder:
    """Operations on doubles of a function that is being compiled; None stands for a slope that is zero."""

    def __init__(self, context: Any, builder: Any) -> None:
        self.context, self.ir = context, builder

    def constant(self, value: float) -> Any:
        """A number of the code."""
        from numba import types

        return self.context.get_constant(types.float64, value)

    def call(self, function: Callable[..., Any], *x: Any) -> Any:
        """Value of a function that the compiler knows for doubles."""
        from numba import types

        signature = types.float64(*[types.float64] * len(x))
        return self.context.get_function(function, signature)(self.ir, x)

    def times(self, a: Any, slope: Any) -> Any:
        """Product of a number and a slope."""
        return None if slope is None else self.ir.fmul(a, slope)

    def plus(self, a: Any, b: Any) -> Any:
        """Sum of two slopes."""
        return b if a is None else a if b is None else self.ir.fadd(a, b)

    def minus(self, a: Any, b: Any) -> Any:
        """Difference of two slopes."""
        return a if b is None else self.ir.fneg(b) if a is None else self.ir.fsub(a, b)

    def plus_product(self, a: Any, slope: Any, rest: Any) -> Any:
        """Slope a slope + rest."""
        if slope is None or rest is None:
            return self.times(a, slope) if rest is None else rest
        return self.ir.fma(a, slope, rest)


Rule = Callable[..., tuple[Any, Any]]
"""``rule(builder, *values, *slopes)`` returns the value and the slope of a result."""


def _product(o: Builder, a: Any, b: Any, da: Any, db: Any) -> tuple[Any, Any]:
    return o.ir.fmul(a, b), o.plus_product(a, db, o.times(b, da))


def _quotient(o: Builder, a: Any, b: Any, da: Any, db: Any) -> tuple[Any, Any]:
    found = o.ir.fdiv(a, b)
    return found, o.times(o.ir.fdiv(o.constant(1.0), b), o.minus(da, o.times(found, db)))


def _fused(o: Builder, a: Any, b: Any, c: Any, da: Any, db: Any, dc: Any) -> tuple[Any, Any]:
    return o.ir.fma(a, b, c), o.plus_product(a, db, o.plus_product(b, da, dc))


def _sqrt(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
    root = o.call(math.sqrt, a)
    return root, o.times(o.ir.fdiv(o.constant(0.5), root), da)


def _abs(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
    return o.call(abs, a), o.times(o.call(math.copysign, o.constant(1.0), a), da)


def _copysign(o: Builder, a: Any, b: Any, da: Any, _: Any) -> tuple[Any, Any]:
    one = o.constant(1.0)
    sign = o.ir.fmul(o.call(math.copysign, one, a), o.call(math.copysign, one, b))
    return o.call(math.copysign, a, b), o.times(sign, da)


def _atan2(o: Builder, y: Any, x: Any, dy: Any, dx: Any) -> tuple[Any, Any]:
    size = o.ir.fma(x, x, o.ir.fmul(y, y))
    turn = o.minus(o.times(x, dy), o.times(y, dx))
    return o.call(math.atan2, y, x), o.times(o.ir.fdiv(o.constant(1.0), size), turn)


def _hypot(o: Builder, a: Any, b: Any, da: Any, db: Any) -> tuple[Any, Any]:
    found = o.call(math.hypot, a, b)
    return found, o.times(o.ir.fdiv(o.constant(1.0), found), o.plus_product(a, da, o.times(b, db)))


def _exp(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
    found = o.call(math.exp, a)
    return found, o.times(found, da)


def _cos(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
    return o.call(math.cos, a), o.times(o.ir.fneg(o.call(math.sin, a)), da)


def _tan(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
    found = o.call(math.tan, a)
    return found, o.times(o.ir.fma(found, found, o.constant(1.0)), da)


def _tanh(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
    inverse = o.ir.fdiv(o.constant(1.0), o.call(math.cosh, a))
    return o.call(math.tanh, a), o.times(o.ir.fmul(inverse, inverse), da)


def _inverse(function: Callable[[float], float], sign: float) -> Rule:
    """Rule of asin or acos, whose slopes are 1/sqrt(1 - a^2) with this ``sign``."""

    def rule(o: Builder, a: Any, da: Any) -> tuple[Any, Any]:
        one = o.constant(1.0)
        root = o.call(math.sqrt, o.ir.fmul(o.ir.fsub(one, a), o.ir.fadd(one, a)))
        return o.call(function, a), o.times(o.ir.fdiv(o.constant(sign), root), da)

    return rule


def _chosen(sign: str) -> Rule:
    """Rule of ``min`` or ``max``, which return their first argument unless the second is beyond it."""

    def rule(o: Builder, a: Any, b: Any, da: Any, db: Any) -> tuple[Any, Any]:
        second = o.ir.fcmp_ordered(sign, b, a)
        slopes = [o.constant(0.0) if slope is None else slope for slope in (db, da)]
        return o.ir.select(second, b, a), o.ir.select(second, *slopes)

    return rule


RULES: dict[Callable[..., Any], tuple[int, Rule]] = {
    operator.add: (2, lambda o, a, b, da, db: (o.ir.fadd(a, b), o.plus(da, db))),
    operator.sub: (2, lambda o, a, b, da, db: (o.ir.fsub(a, b), o.minus(da, db))),
    operator.mul: (2, _product),
    operator.truediv: (2, _quotient),
    operator.neg: (1, lambda o, a, da: (o.ir.fneg(a), o.minus(None, da))),
    operator.pos: (1, lambda o, a, da: (a, da)),
    abs: (1, _abs),
    math.fabs: (1, _abs),
    min: (2, _chosen("<")),
    max: (2, _chosen(">")),
    math.sqrt: (1, _sqrt),
    math.sin: (1, lambda o, a, da: (o.call(math.sin, a), o.times(o.call(math.cos, a), da))),
    math.cos: (1, _cos),
    math.tan: (1, _tan),
    math.asin: (1, _inverse(math.asin, 1.0)),
    math.acos: (1, _inverse(math.acos, -1.0)),
    math.sinh: (1, lambda o, a, da: (o.call(math.sinh, a), o.times(o.call(math.cosh, a), da))),
    math.cosh: (1, lambda o, a, da: (o.call(math.cosh, a), o.times(o.call(math.sinh, a), da))),
    math.tanh: (1, _tanh),
    math.exp: (1, _exp),
    math.log: (1, lambda o, a, da: (o.call(math.log, a), o.times(o.ir.fdiv(o.constant(1.0), a), da))),
    math.atan2: (2, _atan2),
    math.hypot: (2, _hypot),
    math.copysign: (2, _copysign),
}
"""Differentiable functions, each with the number of its arguments and its rule."""
IN_PLACE = {
    operator.iadd: operator.add,
    operator.isub: operator.sub,
    operator.imul: operator.mul,
    operator.itruediv: operator.truediv,
}
COMPARISONS = (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne)
TESTS = (math.isfinite, math.isnan, math.isinf)


@cache
def dual_numbers() -> dict[int, Any]:
    """Teach numba the type; return what stands for the functions ``fma``, ``dual`` ... in compiled code, by ``id``."""
    from numba import types
    from numba.core.typeconv.castgraph import Conversion
    from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model, type_callable

    class DualType(types.Type):
        """Type of a dual number."""

        def __init__(self) -> None:
            super().__init__(name="Dual")

        def unify(self, typingctx: Any, other: Any) -> Any:
            return self if isinstance(other, types.Number) else None

        def can_convert_from(self, typingctx: Any, other: Any) -> Any:
            return Conversion.safe if isinstance(other, types.Number) else None

    kind = DualType()
    models_of = models.StructModel

    class DualModel(models_of):
        """Two doubles."""

        def __init__(self, manager: Any, fe_type: Any) -> None:
            super().__init__(manager, fe_type, [("value", types.float64), ("slope", types.float64)])

    register_model(DualType)(DualModel)

    def is_number(given: Any) -> bool:
        return given == kind or isinstance(given, types.Number)

    def has_dual(given: tuple[Any, ...]) -> bool:
        return kind in given and all(map(is_number, given))

    def split(o: Builder, given: Any, number: Any) -> tuple[Any, Any]:
        if given == kind:
            return o.ir.extract_value(number, 0), o.ir.extract_value(number, 1)
        return o.context.cast(o.ir, number, given, types.float64), None

    def joined(o: Builder, value: Any, slope: Any) -> Any:
        from llvmlite import ir

        pair = ir.Constant(o.context.get_value_type(kind), ir.Undefined)
        pair = o.ir.insert_value(pair, value, 0)
        return o.ir.insert_value(pair, o.constant(0.0) if slope is None else slope, 1)

    def code_of(rule: Rule) -> Callable[..., Any]:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            o = Builder(context, builder)
            parts = [split(o, *pair) for pair in zip(signature.args, arguments, strict=True)]
            return joined(o, *rule(o, *(x for x, _ in parts), *(slope for _, slope in parts)))

        return code

    def on_values(function: Callable[..., Any]) -> Callable[..., Any]:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            o = Builder(context, builder)
            values = [split(o, *pair)[0] for pair in zip(signature.args, arguments, strict=True)]
            plain = signature.return_type(*[types.float64] * len(values))
            return context.get_function(function, plain)(builder, values)

        return code

    def learn(function: Callable[..., Any], count: int, result: Any, code: Callable[..., Any]) -> None:
        def one(context: Any) -> Callable[[Any], Any]:
            return lambda a: result if a == kind else None

        def two(context: Any) -> Callable[[Any, Any], Any]:
            return lambda a, b: result if has_dual((a, b)) else None

        type_callable(function)(one if count == 1 else two)
        for given in [(kind,)] if count == 1 else [(kind, kind), (kind, types.Number), (types.Number, kind)]:
            lower_builtin(function, *given)(code)

    for function, (count, rule) in [*RULES.items(), *((own, RULES[plain]) for own, plain in IN_PLACE.items())]:
        learn(function, count, kind, code_of(rule))
    for function in COMPARISONS:
        learn(function, 2, types.boolean, on_values(function))
    for function in TESTS:
        learn(function, 1, types.boolean, on_values(function))

    def power(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        o, n = Builder(context, builder), signature.args[1].literal_value
        a, da = split(o, signature.args[0], arguments[0])

        def of(k: int) -> Any:
            """Power with the bits that the compiler gives it for doubles, but without an exception at 0."""
            result, square, left = o.constant(1.0), a, abs(k)
            while left:
                result = o.ir.fmul(result, square) if left % 2 else result
                square, left = o.ir.fmul(square, square), left // 2
            return o.ir.fdiv(o.constant(1.0), result) if k < 0 else result

        return joined(o, of(n), o.times(o.ir.fmul(o.constant(float(n)), of(n - 1)), da) if n else None)

    @type_callable(operator.pow)
    def _typed_power(context: Any) -> Callable[[Any, Any], Any]:
        return lambda a, n: kind if a == kind and isinstance(n, types.IntegerLiteral) else None

    lower_builtin(operator.pow, kind, types.IntegerLiteral)(power)

    @lower_cast(types.Number, kind)
    def _widened(context: Any, builder: Any, given: Any, wanted: Any, number: Any) -> Any:
        o = Builder(context, builder)
        return joined(o, *split(o, given, number))

    @intrinsic
    def fused(context: Any, a: Any, b: Any, c: Any) -> Any:
        if has_dual((a, b, c)):
            return kind(a, b, c), code_of(_fused)

        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.fma(*arguments)

        return types.float64(types.float64, types.float64, types.float64), build

    @intrinsic
    def made(context: Any, value: Any, slope: Any) -> Any:
        def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return joined(Builder(context, builder), *arguments)

        return kind(types.float64, types.float64), build

    def part(which: int) -> Any:
        @intrinsic
        def taken(context: Any, number: Any) -> Any:
            def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
                o = Builder(context, builder)
                found = split(o, signature.args[0], arguments[0])[which]
                return o.constant(0.0) if found is None else found

            return types.float64(number), build

        return taken

    return {id(fma): fused, id(dual): made, id(value_of): part(0), id(slope_of): part(1)}
