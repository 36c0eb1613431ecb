"""Numbers other than doubles: binary floating point of any precision (mpmath) and rational numbers.

A constant of the source code stands for what its author meant: 0.1 is one tenth, and 1/6, which Python's compiler
replaces by the nearest double, is one sixth. A double that meets such a number later is accepted only if it is a short
binary fraction (0.5, 2.0), which means the same in every arithmetic; any other double would bring in an error of 1e-17
unnoticed, and is refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any, Protocol, cast

from topcli.errors import UsageError

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
    """A double that is no short binary fraction met a number of another arithmetic (exit code 2)."""

    def __init__(self, value: float) -> None:
        super().__init__(f"precision: the double {float(value)!r}, computed somewhere, has no exact meaning")


class Arithmetic(Protocol):
    """Operations that a run needs beside those of the numbers themselves."""

    name: str
    eps: float
    """Rounding error, as ``sys.float_info.epsilon`` for doubles; 0 for rational numbers."""
    bits: int
    """Binary digits; 0 for rational numbers."""
    math: ModuleType
    """Replacement for the module ``math``."""
    library: str
    """Package that computes, with its version."""

    def active(self) -> AbstractContextManager[Any]:
        """Context in which the numbers compute with this precision."""
        ...

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        ...

    @property
    def fma(self) -> Callable[[Any, Any, Any], Any]:
        """Function a b + c, rounded once."""
        ...

    @property
    def finite(self) -> Callable[[Any], bool]:
        """Function that is true of a number that is neither infinite nor nan."""
        ...

    @property
    def root(self) -> Callable[[Any], Any]:
        """Square root; raises NotRationalError if it is not rational."""
        ...

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        ...

    def tolerance(self, value: float, power: float) -> Any:
        """Tolerance for doubles, scaled as the given power of the rounding error."""
        ...

    def cap(self, value: int) -> int:
        """Maximum number of iterations for doubles, scaled with the number of digits."""
        ...


def gmpy2_if_installed() -> Any:
    """Module gmpy2; None if it is not installed."""
    try:
        return import_module("gmpy2")
    except ImportError:
        return None


class Exact:
    """Rational number that refuses doubles other than short binary fractions."""

    __slots__ = ("q",)

    def __init__(self, q: Any) -> None:
        self.q = q

    def _other(self, other: Any) -> Any:
        if type(other) is Exact:
            return other.q
        if isinstance(other, int):
            return other
        if isinstance(other, float):
            if not is_short(other):
                raise StrayDoubleError(other)
            return Fraction(other)
        return NotImplemented

    def __add__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q + value)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q - value)

    def __rsub__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(value - self.q)

    def __mul__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q * value)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(self.q / value)

    def __rtruediv__(self, other: Any) -> Any:
        value = self._other(other)
        return NotImplemented if value is NotImplemented else Exact(value / self.q)

    def __pow__(self, power: int) -> Exact:
        if not isinstance(power, int):
            raise NotRationalError(f"the power {power!r} of a rational number is not rational")
        return Exact(self.q**power)

    def __neg__(self) -> Exact:
        return Exact(-self.q)

    def __pos__(self) -> Exact:
        return self

    def __abs__(self) -> Exact:
        return Exact(abs(self.q))

    def __eq__(self, other: object) -> bool:
        return bool(self.q == self._other(other))

    def __hash__(self) -> int:
        return hash(self.q)

    def __lt__(self, other: Any) -> bool:
        return bool(self.q < self._other(other))

    def __le__(self, other: Any) -> bool:
        return bool(self.q <= self._other(other))

    def __gt__(self, other: Any) -> bool:
        return bool(self.q > self._other(other))

    def __ge__(self, other: Any) -> bool:
        return bool(self.q >= self._other(other))

    def __bool__(self) -> bool:
        return bool(self.q)

    def __float__(self) -> float:
        try:
            return float(self.q)
        except OverflowError:
            return math.inf if self.q > 0 else -math.inf

    def __int__(self) -> int:
        return int(self.q)

    def __repr__(self) -> str:
        return f"Exact({self.q})"

    @property
    def length(self) -> int:
        """Binary digits of the numerator or of the denominator, whichever is longer."""
        return max(self.q.numerator.bit_length(), self.q.denominator.bit_length())


class Rationals:
    """Arithmetic without rounding; the numbers are gmpy2's where it is installed, otherwise Python's fractions."""

    name = RATIONAL
    eps = 0.0
    bits = 0

    def __init__(self) -> None:
        gmpy2 = gmpy2_if_installed()
        self._made: Callable[[int, int], Any] = gmpy2.mpq if gmpy2 else Fraction
        self.library = f"gmpy2 {gmpy2.version()}" if gmpy2 else "fractions"
        self.math = ModuleType("math")
        self.math.__dict__.update(fabs=abs)

    def active(self) -> AbstractContextManager[Any]:
        """Context without effect."""
        return nullcontext()

    def number(self, value: Fraction) -> Exact:
        """The number itself."""
        return Exact(self._made(value.numerator, value.denominator))

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c."""
        return a * b + c

    def finite(self, x: Any) -> bool:
        """True: every rational number is finite."""
        return True

    def root(self, x: Any) -> Exact:
        """Square root of the square of a rational number; raises NotRationalError for any other."""
        value = self.fraction(x)
        parts = math.isqrt(max(value.numerator, 0)), math.isqrt(value.denominator)
        if Fraction(*parts) ** 2 != value:
            raise NotRationalError(f"the square root of {value} is not rational")
        return self.number(Fraction(*parts))

    def fraction(self, x: Any) -> Fraction:
        """Value as Python's fraction."""
        value = x.q if isinstance(x, Exact) else x
        return Fraction(int(value.numerator), int(value.denominator))

    def tolerance(self, value: float, power: float) -> Exact:
        """The tolerance itself: there is no rounding error that it could follow."""
        return self.number(meaning(value))

    def cap(self, value: int) -> int:
        """The same number of iterations."""
        return value


class Floating:
    """Binary floating point of ``bits`` binary digits, rounded to nearest (mpmath)."""

    def __init__(self, bits: int, name: str = "") -> None:
        from mpmath import __version__
        from mpmath.ctx_mp import MPContext

        self.library = f"mpmath {__version__}"

        self.bits, self.eps = bits, 2.0 ** (1 - bits)
        self.name = name or f"{bits} bits"
        self._context = context = cast("Any", MPContext())
        context.prec = bits
        convert = context.convert

        def converted(x: object, strings: bool = True) -> Any:
            if isinstance(x, float) and math.isfinite(x) and not is_short(x):
                raise StrayDoubleError(x)
            return convert(x, strings)

        context.convert = converted
        self.math = self._functions()

    def _functions(self) -> ModuleType:
        context = self._context
        nan = context.mpf("nan")
        made = ModuleType("math")
        for name in FUNCTIONS:
            made.__dict__[name] = getattr(context, name)
        made.__dict__.update(
            sqrt=self.root,
            fabs=abs,
            copysign=lambda x, y: abs(x) if y >= 0 else -abs(x),
            isnan=lambda x: x != x,
            isfinite=self.finite,
            nan=nan,
            inf=context.mpf("inf"),
            pi=+context.pi,
        )
        return made

    def active(self) -> AbstractContextManager[Any]:
        """Context without effect: every number knows its precision."""
        return nullcontext()

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        from mpmath.libmp import from_rational

        return self._context.make_mpf(from_rational(value.numerator, value.denominator, self.bits, "n"))

    def fma(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c, rounded once."""
        from mpmath.libmp import mpf_add, mpf_mul

        a, b, c = self._context.convert(a), self._context.convert(b), self._context.convert(c)
        return self._context.make_mpf(mpf_add(mpf_mul(a._mpf_, b._mpf_), c._mpf_, self.bits, "n"))

    def finite(self, x: Any) -> bool:
        """True if ``x`` is neither infinite nor nan."""
        return bool(self._context.isfinite(x))

    def root(self, x: Any) -> Any:
        """Square root; nan of a negative number."""
        return self._context.sqrt(x) if not x < 0 else self.math.nan

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        sign, mantissa, exponent, _ = self._context.convert(x)._mpf_
        value = -int(mantissa) if sign else int(mantissa)
        return Fraction(value) * Fraction(2) ** int(exponent)

    def tolerance(self, value: float, power: float) -> Any:
        """Tolerance for doubles, scaled as the given power of the rounding error."""
        return self._context.ldexp(self.number(meaning(value)), -round((self.bits - 53) * power))

    def cap(self, value: int) -> int:
        """Maximum number of iterations for doubles, scaled with the number of digits."""
        return math.ceil(value * self.bits / 53)


class Mpfr:
    """Binary floating point of ``bits`` binary digits, rounded to nearest (MPFR, by gmpy2).

    Ten times as fast as ``Floating``. The precision belongs to the context that is active, and doubles are not refused.
    """

    def __init__(self, gmpy2: Any, bits: int, name: str = "") -> None:
        self.bits, self.eps = bits, 2.0 ** (1 - bits)
        self.name, self.library = name or f"{bits} bits", f"gmpy2 {gmpy2.version()}"
        self._gmpy2 = gmpy2
        self._context = gmpy2.context(precision=bits)
        self.fma: Callable[[Any, Any, Any], Any] = gmpy2.fma
        self.finite: Callable[[Any], bool] = gmpy2.is_finite
        self.root: Callable[[Any], Any] = gmpy2.sqrt
        self.math = ModuleType("math")
        for name in FUNCTIONS:
            self.math.__dict__[name] = getattr(gmpy2, name)
        self.math.__dict__.update(
            sqrt=gmpy2.sqrt,
            fabs=abs,
            copysign=gmpy2.copy_sign,
            isnan=gmpy2.is_nan,
            isfinite=gmpy2.is_finite,
            nan=gmpy2.mpfr("nan"),
            inf=gmpy2.mpfr("inf"),
            pi=gmpy2.const_pi(bits),
        )

    def active(self) -> AbstractContextManager[Any]:
        """Context in which the numbers compute with this precision."""
        return self._context

    def number(self, value: Fraction) -> Any:
        """Number nearest to ``value``."""
        return self._gmpy2.mpfr(self._gmpy2.mpq(value.numerator, value.denominator), self.bits)

    def fraction(self, x: Any) -> Fraction:
        """Exact value of a finite number."""
        numerator, denominator = x.as_integer_ratio()
        return Fraction(int(numerator), int(denominator))

    def tolerance(self, value: float, power: float) -> Any:
        """Tolerance for doubles, scaled as the given power of the rounding error."""
        return self.number(meaning(value) / 2 ** round((self.bits - 53) * power))

    def cap(self, value: int) -> int:
        """Maximum number of iterations for doubles, scaled with the number of digits."""
        return math.ceil(value * self.bits / 53)


def arithmetic_of(precision: int | str) -> Arithmetic:
    """Arithmetic of a config's ``precision``, a number of decimal digits or "rational"; gmpy2's if it is installed."""
    if precision == RATIONAL:
        return Rationals()
    assert isinstance(precision, int)
    bits, name = math.ceil(precision * math.log2(10.0)) + 3, f"{precision} digits"
    gmpy2 = gmpy2_if_installed()
    return Mpfr(gmpy2, bits, name) if gmpy2 else Floating(bits, name)
