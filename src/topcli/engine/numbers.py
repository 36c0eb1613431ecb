"""Steps in other numbers than doubles: binary floating point of any precision, and rational numbers.

There is no second implementation of a scheme. Its functions for doubles are copied, and the copies refer to constants,
``math``, ``fma`` and tolerances of the other numbers; they run in the interpreter.

A constant of the source code stands for what its author meant: 0.1 is one tenth, and 1/6, which Python's compiler
replaces by the nearest double, is one sixth. Any other double with many digits may have been computed, so that its
digits end where those of a double do. It is left as it is, and is refused as soon as it meets a number: it would bring
in an error of 1e-17 unnoticed. Short binary fractions (0.5, 2.0) mean the same in all numbers.
"""

from __future__ import annotations

import math
import sys
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.fused import FOLLOWING, double_of, fma
from topcli.arithmetic.vectors import sinc_cosc_polynomials
from topcli.contracts import Scheme, StepFunction, Stepper, Top, check_stop
from topcli.engine.loops import Loop, interpreted
from topcli.engine.reach import place_of, references
from topcli.errors import UsageError
from topcli.field.polynomial import polynomial_field

DOUBLE, RATIONAL = "double", "rational"
FEWEST_DIGITS, MOST_DIGITS = 18, 150
"""Range of ``precision``. Deviations are reported as doubles; the squares of those beyond it would underflow."""
MAX_DIGITS = 10_000
"""Default number of digits at which a run in rational numbers stops."""
DOUBLE_BITS = 53
_SHORT = 2**20
"""Bound on the odd part of the numerator of a short binary fraction."""
FEW_DIGITS = 12
"""Decimal digits up to which a constant is taken as written; a computed double has more."""
DENOMINATOR = 1000
"""Largest denominator of a constant that the compiler has folded."""
_LONG = 1 << 14
"""Binary digits from which on an operation takes so long that each one heeds a request to stop."""
ROOM = 4
"""Length of the longest number within a step, in units of ``max_digits``. The numbers of ``hk`` are at most 1.8 times
as long as those of the state after the step, those of ``rk4`` 1.05 times."""
_FUNCTIONS = (
    "acos", "asin", "atan", "atan2", "cos", "cosh", "exp", "hypot", "log", "sin", "sinh", "sqrt", "tan", "tanh"
)  # fmt: skip
"""Functions of ``math`` with the same name in mpmath."""
_LEFT = sys.stdlib_module_names | {"mpmath", "numba", "numpy", "scipy"}
"""Packages whose functions are not copied; the functions of ``math`` are replaced."""


class NotRationalError(UsageError):
    """A step that needs functions that its numbers do not have (exit code 2)."""


class StrayDoubleError(UsageError):
    """A double that is not a short binary fraction met a number of another kind (exit code 2)."""

    def __init__(self, value: float) -> None:
        super().__init__(
            f"precision: the double {float(value)!r} has no exact meaning: it is computed, or has too many digits"
        )


class TooLongError(ArithmeticError):
    """A rational number longer than its limit."""


def is_short(value: float) -> bool:
    """True if a double is a binary fraction with a short numerator, such as 0.5 or 2.0**-52."""
    if not math.isfinite(value):
        return False
    numerator = abs(value.as_integer_ratio()[0])
    return numerator < _SHORT or numerator // (numerator & -numerator) < _SHORT


def short_fraction(value: float) -> Fraction:
    """Exact value of a short double. Raises StrayDoubleError for any other."""
    if not is_short(value):
        raise StrayDoubleError(value)
    return Fraction(value)


@cache
def meaning(value: float) -> Fraction | None:
    """Rational number that a constant of the source code stands for; None if it may have been computed."""
    if not math.isfinite(value):
        return None
    if is_short(value):
        return Fraction(value)
    if len(Decimal(repr(value)).as_tuple().digits) <= FEW_DIGITS:
        return Fraction(repr(value))
    simple = Fraction(value).limit_denominator(DENOMINATOR)
    return simple if float(simple) == value else None


@dataclass(frozen=True)
class Numbers:
    """Numbers of ``bits`` binary digits (0: rational numbers), with functions for what operators do not do.

    ``number(fraction)`` is the number nearest to a fraction, and ``math`` replaces the module of this name, with an
    ``fma``. ``purpose`` is the use of the numbers, for messages.
    """

    name: str
    bits: int
    library: str
    number: Callable[[Fraction], Any]
    math: Any
    purpose: str = "precision"

    @property
    def eps(self) -> float:
        """Rounding error, as ``sys.float_info.epsilon`` for doubles; 0 for rational numbers."""
        return 2.0 ** (1 - self.bits) if self.bits else 0.0

    def finite(self, x: Any) -> bool:
        """True if ``x`` is neither infinite nor nan nor complex, as powers of negative numbers may be."""
        return bool(x - x == 0 and x.imag == 0)

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        return Fraction(*map(int, x.as_integer_ratio()))  # mpmath may have integers of its own

    def rebuilt(self, value: Any, done: dict[Any, Any] | None = None) -> Any:
        """Copy of a function, constant, tuple or array in these numbers; anything else as it is.

        So is a double without exact meaning, infinity or nan. ``done`` are the copies of functions so far. Raises
        NotRationalError for a function that uses one of ``math`` that these numbers do not have.
        """
        if done is None:  # the polynomials have the digits of doubles; other numbers use them at 0 only
            done = {fma: self.math.fma, sinc_cosc_polynomials: lambda t: (1, self.number(Fraction(1, 2)))}
        if isinstance(value, float | Fraction):
            exact = meaning(value) if isinstance(value, float) else value
            return value if exact is None else self.number(exact)
        if isinstance(value, np.ndarray):
            return np.frompyfunc(lambda x: self.rebuilt(x, done), 1, 1)(value)
        if isinstance(value, tuple):
            items = [self.rebuilt(item, done) for item in value]
            return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
        if isinstance(value, types.ModuleType):
            left = value.__name__.partition(".")[0] in _LEFT
            return self.math if value is math else value if left else _Module(value, lambda x: self.rebuilt(x, done))
        if not isinstance(value, types.FunctionType):
            return value
        if value not in done:
            left = (value.__module__ or "").partition(".")[0] in _LEFT
            done[value] = value if left else self._copy(value, done)
        return done[value]

    def _copy(self, plain: types.FunctionType, done: dict[Any, Any]) -> types.FunctionType:
        """Copy of a function that refers to copies."""
        values = references(plain)
        code = self._code(plain.__code__, any(value is math for value in values.values()))
        new = {name: self._referred(name, value, done) for name, value in values.items()}
        cells = tuple(types.CellType(new[name]) for name in code.co_freevars)
        defaults = self.rebuilt(plain.__defaults__, done)
        return types.FunctionType(code, {**plain.__globals__, **new}, plain.__name__, defaults, cells)

    def _referred(self, name: str, value: Any, done: dict[Any, Any]) -> Any:
        """Form of a global or closed-over variable; tolerances and numbers of iterations follow the precision."""
        bits = self.bits or DOUBLE_BITS
        if not isinstance(value, int | float) or (name, value) not in FOLLOWING:
            return self.rebuilt(value, done)
        if (power := FOLLOWING[name, value]) is None:
            return math.ceil(value * bits / DOUBLE_BITS)
        return self.number(Fraction(repr(value)) / 2 ** round((bits - DOUBLE_BITS) * power))

    def _code(self, code: types.CodeType, uses_math: bool) -> types.CodeType:
        """Code with its constants, and those of inner functions, in these numbers."""
        for name in code.co_names if uses_math else ():
            if hasattr(math, name) and not hasattr(self.math, name):
                raise NotRationalError(f"uses math.{name}, which {self.name} do not have")
        inner = [self._code(x, uses_math) if isinstance(x, types.CodeType) else self.rebuilt(x) for x in code.co_consts]
        return code.replace(co_consts=tuple(inner))


class _Module:
    """Module whose functions and constants are rebuilt where they are used."""

    def __init__(self, module: types.ModuleType, rebuilt: Callable[[Any], Any]) -> None:
        self._module, self._rebuilt = module, rebuilt

    def __getattr__(self, name: str) -> Any:
        return self._rebuilt(getattr(self._module, name))


class Rational(Fraction):
    """Fraction that takes short binary fractions exactly, and refuses other doubles (StrayDoubleError).

    The numbers of a composed step may grow by a power of ten thousands within that step, so a limit that is tested
    after the step comes too late.
    """

    __slots__ = ()
    longest = 0
    """Binary digits that no number of the class may exceed (TooLongError); 0 for no limit."""

    def __new__(cls, *value: Any) -> Rational:
        """Rational number with this value, or numerator and denominator."""
        self = super().__new__(cls, *value)
        if (bits := max(self.numerator.bit_length(), self.denominator.bit_length())) > _LONG:
            check_stop()
        if cls.longest and bits > cls.longest:
            raise TooLongError(f"{bits} binary digits")
        return self

    def __float__(self) -> float:
        return double_of(Fraction(self))


def _exactly(operator: Callable[..., Any]) -> Callable[..., Any]:
    """Operator of fractions for rational numbers."""

    def operation(self: Rational, *others: Any) -> Any:
        if others and isinstance(others[0], float):
            others = (short_fraction(others[0]),)
        result = operator(self, *others)
        if isinstance(result, float | complex):
            raise NotRationalError(f"the power {others[0]} of a rational number is not rational")
        return result if result is NotImplemented else type(self)(result)

    return operation


for _name in ("add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv", "pow", "neg", "pos", "abs"):
    setattr(Rational, f"__{_name}__", _exactly(getattr(Fraction, f"__{_name}__")))


def longest(state: Any) -> int:
    """Binary digits of the longest numerator or denominator of a state in rational numbers; 0 for other numbers."""
    lengths = [max(x.numerator.bit_length(), x.denominator.bit_length()) for x in state if isinstance(x, Fraction)]
    return max(lengths, default=0)


def _math(**functions: Any) -> types.SimpleNamespace:
    """Replacement for the module ``math``, with what operators do, and further ``functions``."""
    of_any = {
        "fabs": abs,
        "copysign": lambda x, y: abs(x) if y >= 0 else -abs(x),
        "fma": lambda a, b, c: a * b + c,
        "isnan": lambda x: x != x,
        "isfinite": lambda x: x - x == 0,
    }
    return types.SimpleNamespace(nan=math.nan, inf=math.inf, **(of_any | functions))


def rationals(longest: int = 0) -> Numbers:
    """Rational numbers, of at most ``longest`` binary digits (0: any)."""
    kind = type("Rational", (Rational,), {"__slots__": (), "longest": longest}) if longest else Rational
    return Numbers("rational numbers", 0, "fractions", kind, _math())


def decimals(count: int) -> Numbers:
    """Binary floating point of ``count`` decimal digits, rounded to nearest (mpmath)."""
    from mpmath import __version__
    from mpmath.ctx_mp import MPContext
    from mpmath.libmp import from_rational

    context: Any = MPContext()
    context.prec = bits = math.ceil(count * math.log2(10.0)) + 3
    convert = context.convert

    def converted(x: object, strings: bool = True) -> Any:
        if isinstance(x, float) and math.isfinite(x) and not is_short(x):
            raise StrayDoubleError(x)
        return convert(x, strings)

    def real(function: Callable[..., Any]) -> Callable[..., Any]:
        """The function with nan instead of complex numbers, as for doubles."""

        def value(*arguments: Any) -> Any:
            result = function(*arguments)
            return context.nan if isinstance(result, context.mpc) else result

        return value

    def fused(a: Any, b: Any, c: Any) -> Any:
        return context.fmul(a, b, exact=True) + converted(c)  # rounded once

    def number(x: Fraction) -> Any:
        return context.make_mpf(from_rational(x.numerator, x.denominator, bits, "n"))

    context.convert = converted
    functions = {name: real(getattr(context, name)) for name in _FUNCTIONS} | {"pi": +context.pi, "fma": fused}
    return Numbers(f"numbers of {count} digits", bits, f"mpmath {__version__}", number, _math(**functions))


def _composition(step: StepFunction, weights: tuple[float, ...]) -> StepFunction:
    """Composed step whose weights are decimal numbers with the sum one; it ends as that of ``compose``."""
    half = [Fraction(repr(weight)) for weight in weights[: len(weights) // 2]]
    exact = (*half, 1 - 2 * sum(half), *reversed(half))

    def composed(s: Any, h: Any, p: Any) -> Any:
        for c in exact:
            s = step(s, c * h, p)
            if any(x - x != 0 for x in s):  # true for nan
                break
        return s

    return composed


def precise_top(top: Top, parameters: Mapping[str, Any]) -> Any:
    """Top whose parameters are numbers of another kind; not validated again."""
    return type(top).model_construct(**{**top.model_dump(), **parameters})


def refused(scheme: Scheme, numbers: Numbers, reason: str) -> UsageError:
    """Error for a scheme that has no such precision."""
    return UsageError(f"{numbers.purpose}: scheme {scheme.name!r} cannot compute with {numbers.name}: it {reason}")


def precise_scheme(
    scheme: Scheme, top: Top, options: Any, parameters: Mapping[str, Fraction], numbers: Numbers
) -> tuple[Any, Stepper]:
    """The top with exact ``parameters``, and the method of the scheme with all its constants, in other numbers.

    Raises UsageError, naming the scheme and the reason, if it has none.
    """
    method = scheme.build(top, options)
    if not isinstance(method, Stepper):
        reason = "is a closed form or has a time loop of its own: there are no steps to interpret"
        raise refused(scheme, numbers, reason)
    if method.plain:
        raise refused(scheme, numbers, "calls library functions that compute with doubles")
    if method.iterative and not numbers.bits:
        raise refused(scheme, numbers, "solves its equations by iteration, and the solution is not rational")
    # the scheme is built from rational numbers, which are not rounded at all
    exact = precise_top(top, {name: Rational(x) for name, x in parameters.items()})
    other = precise_top(top, {name: numbers.number(x) for name, x in parameters.items()})
    built = scheme.build(exact, options)
    assert isinstance(built, Stepper)
    p = (*map(numbers.rebuilt, other.constants()), *map(numbers.number, built.constants))

    def in_numbers(function: StepFunction | None) -> Any:
        copy = numbers.rebuilt(function)

        def with_constants(s: Any, h: Any, _: Any) -> Any:
            try:
                return copy(s, h, p)
            except (AttributeError, TypeError) as error:
                place = place_of(copy)
                raise UsageError(f"{numbers.purpose}: {place}: no step in {numbers.name}: {error}") from error

        return copy and with_constants

    try:
        if built.source:
            _check_field(exact, p, numbers)
        step = _composition(*built.stages) if built.stages else built.step
        step, enter, leave = map(in_numbers, (step, built.enter, built.leave))
    except NotRationalError as error:
        raise refused(scheme, numbers, str(error)) from None
    return other, replace(built, step=step, enter=enter, leave=leave, plain=True, constants=())


def _check_field(exact: Any, p: tuple[Any, ...], numbers: Numbers) -> None:
    """Raise NotRationalError unless the polynomials of generated code are the field in these numbers.

    They are made by other means than the copies of functions: a constant that passes through a double shows here.
    """
    d, constants = len(exact.components), exact.constants()
    state = [numbers.number(Fraction(j + 2, 2 * j + 7)) for j in range(d)]
    rates = numbers.rebuilt(type(exact).field)(tuple(state), p[: len(constants)])
    for rate, polynomial in zip(rates, polynomial_field(type(exact).field, d, constants), strict=True):
        terms = [numbers.number(c) * math.prod(state[j] for j in monomial) for monomial, c in polynomial.terms.items()]
        if abs(float(rate - sum(terms))) > 100.0 * numbers.eps * float(sum(map(abs, terms))):
            raise NotRationalError("has constants that are computed in doubles")


def precise_loop(method: Stepper, d: int, numbers: Numbers, max_bits: int = 0) -> Loop:
    """Loop over a method in other numbers for states of length ``d``.

    It stops when a rational number of the state has more than ``max_bits`` binary digits (0: any number). Raises
    StrayDoubleError if the state after a step has a double.
    """
    too_long, checked = list[TooLongError](), method.checked or method.width

    def step(s: Any, h: Any, p: Any) -> Any:
        """State after a step; its first number is infinite if the step failed."""
        too_long.clear()
        after = s
        try:
            after = method.step(s, h, p)
            if stray := [x for x in after if isinstance(x, float) and math.isfinite(x)]:
                raise StrayDoubleError(stray[0])
            if max_bits and longest(after) > max_bits:
                raise TooLongError
            if all(map(numbers.finite, after[:checked])):
                return after
        except TooLongError as error:
            too_long.append(error)
        except ZeroDivisionError:
            pass
        return (math.inf, *after[1:])

    return replace(interpreted(replace(method, step=step, checked=1), d, 0), too_long=too_long)


@dataclass(frozen=True)
class PreciseRun:
    """All that a run in other numbers needs: its ``top`` with these numbers, the ``loop``, ``h`` and ``y0``."""

    arithmetic: Numbers
    top: Top
    loop: Loop
    h: Any
    y0: NDArray[Any]


def prepared(
    scheme: Scheme,
    top: Top,
    options: Any,
    precision: int | str,
    values: tuple[Fraction, Mapping[str, Fraction], tuple[Fraction, ...]],
    max_digits: int = MAX_DIGITS,
) -> PreciseRun:
    """Prepare a run of a scheme; ``values`` are h, the parameters of the top and the initial state, exactly.

    Raises UsageError, naming the scheme and the reason, if it has no such precision.
    """
    h, parameters, state = values
    max_bits = int(max_digits * math.log2(10.0)) if precision == RATIONAL else 0
    numbers = decimals(precision) if isinstance(precision, int) else rationals(ROOM * max_bits)
    try:
        step, y0 = numbers.number(h), np.array([numbers.number(value) for value in state], dtype=np.object_)
        other, method = precise_scheme(scheme, top, options, parameters, numbers)
    except TooLongError as error:
        raise refused(scheme, numbers, f"needs numbers of {error}, more than max_digits allows") from None
    return PreciseRun(numbers, other, precise_loop(method, len(y0), numbers, max_bits), step, y0)
