"""Arithmetics other than doubles: binary floating point of any precision (MPFR or mpmath), and rational numbers.

A constant of the source code stands for what its author meant: 0.1 is one tenth, and 1/6, which Python's compiler
replaces by the nearest double, is one sixth. A double that meets such a number later is accepted only if it is a short
binary fraction (0.5, 2.0), which means the same in every arithmetic; any other double would bring in an error of 1e-17
unnoticed, and is refused.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from decimal import Decimal
from fractions import Fraction
from functools import cache, reduce
from importlib import import_module
from types import ModuleType
from typing import Any, cast

from topcli.arithmetic.fused import double_of
from topcli.contracts import check_stop
from topcli.errors import UsageError, shortened

DOUBLE, RATIONAL = "double", "rational"
FEWEST_DIGITS, MOST_DIGITS = 18, 150
"""Range of ``precision``. Deviations are reported as doubles; the squares of those beyond it would underflow."""
MAX_DIGITS = 10_000
"""Default number of digits at which a run in rational numbers stops."""
SHORT = 2**20
"""Bound on the odd part of the numerator of a short binary fraction."""
DENOMINATOR = 1000
"""Largest denominator of a constant that the compiler has folded."""
FUNCTIONS = frozenset(
    ("acos", "asin", "atan", "atan2", "cbrt", "cos", "cosh", "exp", "hypot", "log", "sin", "sinh", "tan", "tanh")
)
IRRATIONAL = FUNCTIONS | {"sqrt", "pow", "pi", "e", "nan", "inf", "isnan", "isfinite"}
"""Attributes of ``math`` that rational numbers do not have."""


class NotRationalError(UsageError):
    """A step that cannot be taken in rational numbers (exit code 2)."""


def is_short(value: float) -> bool:
    """True if a double is a binary fraction with a short numerator, such as 0.5 or 2.0**-52."""
    if not math.isfinite(value):
        return False
    numerator = abs(value.as_integer_ratio()[0])
    return numerator < SHORT or numerator // (numerator & -numerator) < SHORT


@cache
def meaning(value: float) -> Fraction:
    """Rational number that a constant of the source code stands for."""
    if is_short(value):
        return Fraction(value)
    simple = Fraction(value).limit_denominator(DENOMINATOR)
    return simple if float(simple) == value else Fraction(repr(value))


class StrayDoubleError(UsageError):
    """A double that is not a short binary fraction met a number of another arithmetic (exit code 2)."""

    def __init__(self, value: float) -> None:
        super().__init__(f"precision: the double {float(value)!r}, computed somewhere, has no exact meaning")


def integer_text(value: int) -> str:
    """Decimal text of an integer of any length; ``str`` refuses those of more than 4300 digits."""
    return format(Decimal(value), "f")


def fraction_from(text: str) -> Fraction:
    """Number of a decimal text or of a quotient of integers, of any length."""
    numerator, slash, denominator = text.partition("/")
    number = Fraction(Decimal(numerator))
    return number / Fraction(Decimal(denominator)) if slash else number


def decimal_text(value: Fraction, digits: int) -> str:
    """Decimal form of a number, correctly rounded to ``digits`` significant digits: ``-1.25e-1``."""
    if not value:
        return "0." + "0" * (digits - 1) + "e+0"
    size = abs(value)
    exponent = math.floor((size.numerator.bit_length() - size.denominator.bit_length()) * math.log10(2.0))
    while size >= Fraction(10) ** (exponent + 1):
        exponent += 1
    while size < Fraction(10) ** exponent:
        exponent -= 1
    whole = round(size / Fraction(10) ** (exponent - digits + 1))
    if whole == 10**digits:
        whole, exponent = whole // 10, exponent + 1
    text = integer_text(whole)
    return f"{'-' if value < 0 else ''}{text[0]}.{text[1:]}e{exponent:+d}"


_longest: ContextVar[int] = ContextVar("longest", default=0)
"""Binary digits that no number may exceed; 0 for no limit."""


class TooLongError(ArithmeticError):
    """A number longer than the limit of ``at_most``."""


@contextmanager
def at_most(bits: int) -> Iterator[None]:
    """Raise TooLongError for a number whose numerator or denominator has more than ``bits`` binary digits.

    The numbers of a composed step may grow by a power of ten thousands within that step, so a limit that is looked at
    after the step comes too late.
    """
    token = _longest.set(bits)
    try:
        yield
    finally:
        _longest.reset(token)


LONG = 1 << 14
"""Binary digits from which on an operation takes so long that each one heeds a request to stop."""


def gmpy2_if_installed() -> Any:
    """Module gmpy2; None if it is not installed."""
    try:
        return import_module("gmpy2")
    except ImportError:
        return None


class Arithmetic:
    """Operations that a run needs beside those of the numbers themselves."""

    root: Callable[[Any], Any]
    """Square root; raises NotRationalError if it is not rational."""
    purpose = "precision"
    """Use of the arithmetic, for messages."""

    def __init__(self, name: str, bits: int, library: str) -> None:
        self.name, self.bits, self.library = name, bits, library
        self.eps = 2.0 ** (1 - bits) if bits else 0.0
        """Rounding error, as ``sys.float_info.epsilon`` for doubles; 0 for rational numbers, which have no ``bits``."""
        self.math = ModuleType("math")
        """Replacement for the module ``math``."""

    def define(self, functions: Any, **others: Any) -> None:
        """Take the functions of ``math`` from those of a library."""
        self.math.__dict__.update({name: getattr(functions, name) for name in FUNCTIONS}, **others)
        self.math.__dict__.update(sqrt=self.root, fabs=abs, isfinite=self.finite)

    def active(self) -> AbstractContextManager[Any]:
        """Context in which the numbers compute with this precision."""
        return nullcontext()

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        raise NotImplementedError

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once."""
        return a * b + c

    def finite(self, x: Any) -> bool:
        """True if ``x`` is neither infinite nor nan."""
        return True

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        numerator, denominator = x.as_integer_ratio()
        return Fraction(int(numerator), int(denominator))

    def tolerance(self, value: float, power: float) -> Any:
        """Tolerance for doubles, scaled as the given power of the rounding error, if there is one."""
        return self.number(meaning(value) / (2 ** round((self.bits - 53) * power) if self.bits else 1))

    def cap(self, value: int) -> int:
        """Maximum number of iterations for doubles, scaled with the number of digits."""
        return math.ceil(value * self.bits / 53) if self.bits else value


class Floating(Arithmetic):
    """Binary floating point of ``bits`` binary digits, rounded to nearest (mpmath)."""

    def __init__(self, bits: int, name: str = "") -> None:
        from mpmath import __version__
        from mpmath.ctx_mp import MPContext

        super().__init__(name or f"{bits} bits", bits, f"mpmath {__version__}")
        self._context = context = cast("Any", MPContext())
        context.prec = bits
        convert = context.convert

        def converted(x: object, strings: bool = True) -> Any:
            if isinstance(x, float) and math.isfinite(x) and not is_short(x):
                raise StrayDoubleError(x)
            return convert(x, strings)

        def hypot(*values: Any) -> Any:
            with context.extraprec(16):
                length = context.sqrt(context.fsum(values, squared=True))
            return +length

        nan, inf, cbrt = context.mpf("nan"), context.mpf("inf"), context.cbrt

        def real(function: Callable[..., Any]) -> Callable[..., Any]:
            def value(*arguments: Any) -> Any:
                result = function(*arguments)
                return nan if isinstance(result, context.mpc) else result

            return value

        context.convert, context.hypot = converted, hypot
        context.cbrt = lambda x: -cbrt(-x) if x < 0 else cbrt(x)
        for name in (*FUNCTIONS, "sqrt"):  # as in doubles and in MPFR, the logarithm of -1 is nan
            setattr(context, name, real(getattr(context, name)))
        self.root = context.sqrt
        self.define(
            context,
            copysign=lambda x, y: abs(x) if y >= 0 else -abs(x),
            isnan=lambda x: x != x,
            nan=nan,
            inf=inf,
            pi=+context.pi,
        )

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        from mpmath.libmp import from_rational

        return self._context.make_mpf(from_rational(value.numerator, value.denominator, self.bits, "n"))

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once."""
        from mpmath.libmp import mpf_add, mpf_mul

        a, b, c = map(self._context.convert, (a, b, c))
        return self._context.make_mpf(mpf_add(mpf_mul(a._mpf_, b._mpf_), c._mpf_, self.bits, "n"))

    def finite(self, x: Any) -> bool:
        """True if ``x`` is a real number, neither infinite nor nan; a power of a negative number may be complex."""
        return not isinstance(x, self._context.mpc) and bool(self._context.isfinite(x))

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        sign, mantissa, exponent, _ = self._context.convert(x)._mpf_
        value = -int(mantissa) if sign else int(mantissa)
        return Fraction(value) * Fraction(2) ** int(exponent)


class Mpfr(Arithmetic):
    """Binary floating point of ``bits`` binary digits, rounded to nearest (MPFR, by gmpy2).

    Ten times as fast as ``Floating``. The precision belongs to the context that is active, and doubles are not refused.
    """

    def __init__(self, gmpy2: Any, bits: int, name: str = "") -> None:
        super().__init__(name or f"{bits} bits", bits, f"gmpy2 {gmpy2.version()}")
        self._gmpy2 = gmpy2
        self.fma, self.finite, self.root = gmpy2.fma, gmpy2.is_finite, gmpy2.sqrt
        self.define(
            gmpy2,
            hypot=lambda *values: reduce(gmpy2.hypot, values, gmpy2.mpfr(0)),
            copysign=gmpy2.copy_sign,
            isnan=gmpy2.is_nan,
            nan=gmpy2.mpfr("nan"),
            inf=gmpy2.mpfr("inf"),
            pi=gmpy2.const_pi(bits),
        )

    def active(self) -> AbstractContextManager[Any]:
        """Context in which the numbers compute with this precision."""
        return self._gmpy2.context(precision=self.bits)  # a new one: gmpy2 crashes where a context is entered twice

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        return self._gmpy2.mpfr(self._gmpy2.mpq(value.numerator, value.denominator), self.bits)


def _operators(operation: Callable[[Any, Any], Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Operator of rational numbers, and the one with exchanged operands."""

    def operator_of(number: Rational, other: Any) -> Any:
        value = number.other(other)
        return value if value is NotImplemented else Rational(operation(number.q, value))

    def exchanged(number: Rational, other: Any) -> Any:
        value = number.other(other)
        return value if value is NotImplemented else Rational(operation(value, number.q))

    return operator_of, exchanged


def _comparison(operation: Callable[[Any, Any], bool]) -> Callable[[Rational, Any], bool]:
    """Comparison of rational numbers."""
    return lambda number, other: bool(operation(number.q, number.other(other)))


class Rational:
    """Rational number that refuses doubles other than short binary fractions."""

    __slots__ = ("q",)

    def __init__(self, q: Any) -> None:
        self.q = q
        if q.denominator.bit_length() > LONG:
            check_stop()
        if (limit := _longest.get()) and self.length > limit:
            raise TooLongError(f"{self.length} binary digits")

    def other(self, other: Any) -> Any:
        """Operand as a rational number; raises StrayDoubleError for a long double."""
        if type(other) is Rational:
            return other.q
        if isinstance(other, int | Fraction):
            return other
        if isinstance(other, float):
            if not is_short(other):
                raise StrayDoubleError(other)
            return Fraction(other)
        return NotImplemented

    __add__, __radd__ = _operators(operator.add)
    __sub__, __rsub__ = _operators(operator.sub)
    __mul__, __rmul__ = _operators(operator.mul)
    __truediv__, __rtruediv__ = _operators(operator.truediv)
    __eq__, __lt__, __le__, __gt__, __ge__ = map(
        _comparison, (operator.eq, operator.lt, operator.le, operator.gt, operator.ge)
    )

    def __pow__(self, power: int) -> Rational:
        if not isinstance(power, int):
            raise NotRationalError(f"the power {power!r} of a rational number is not rational")
        return Rational(self.q**power)

    def __neg__(self) -> Rational:
        return Rational(-self.q)

    def __pos__(self) -> Rational:
        return self

    def __abs__(self) -> Rational:
        return Rational(abs(self.q))

    def __hash__(self) -> int:
        return hash(self.q)

    def __bool__(self) -> bool:
        return bool(self.q)

    def __float__(self) -> float:
        return double_of(self.q)

    def __int__(self) -> int:
        return int(self.q)

    def __repr__(self) -> str:
        return f"Rational({self.q})"

    @property
    def length(self) -> int:
        """Binary digits of the numerator or of the denominator, whichever is longer."""
        return max(self.q.numerator.bit_length(), self.q.denominator.bit_length())


class Rationals(Arithmetic):
    """Arithmetic without rounding; the numbers are gmpy2's where it is installed, otherwise Python's fractions."""

    def __init__(self) -> None:
        gmpy2 = gmpy2_if_installed()
        super().__init__(RATIONAL, 0, f"gmpy2 {gmpy2.version()}" if gmpy2 else "fractions")
        self._made: Callable[[int, int], Any] = gmpy2.mpq if gmpy2 else Fraction
        self.root = self._root
        self.math.__dict__.update(fabs=abs)

    def number(self, value: Fraction) -> Rational:
        """The number itself."""
        return Rational(self._made(value.numerator, value.denominator))

    def _root(self, x: Any) -> Rational:
        """Square root of the square of a rational number; raises NotRationalError for any other."""
        value = self.fraction(x)
        parts = math.isqrt(max(value.numerator, 0)), math.isqrt(value.denominator)
        if Fraction(*parts) ** 2 != value:
            below = "" if value.denominator == 1 else f"/{integer_text(value.denominator)}"
            text = shortened(f"{integer_text(value.numerator)}{below}")
            raise NotRationalError(f"the square root of {text} is not rational")
        return self.number(Fraction(*parts))

    def fraction(self, x: Any) -> Fraction:
        """Value as Python's fraction."""
        value = x.q if isinstance(x, Rational) else x
        return Fraction(int(value.numerator), int(value.denominator))


def arithmetic_of(precision: int | str) -> Arithmetic:
    """Arithmetic of a config's ``precision``, a number of decimal digits or "rational"; gmpy2's if it is installed."""
    if precision == RATIONAL:
        return Rationals()
    assert isinstance(precision, int)
    bits, name = math.ceil(precision * math.log2(10.0)) + 3, f"{precision} digits"
    gmpy2 = gmpy2_if_installed()
    return Mpfr(gmpy2, bits, name) if gmpy2 else Floating(bits, name)
