"""Binary floating point of any precision, by MPFR or mpmath, and the choice of an arithmetic."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from fractions import Fraction
from functools import reduce
from types import ModuleType
from typing import Any, cast

from topcli.engine.precise.numbers import (
    FUNCTIONS,
    RATIONAL,
    Arithmetic,
    StrayDoubleError,
    gmpy2_if_installed,
    is_short,
    meaning,
)
from topcli.engine.precise.rational import Rationals


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

        def hypot(*values: Any) -> Any:
            with context.extraprec(16):
                length = context.sqrt(context.fsum(values, squared=True))
            return +length

        made.__dict__.update(
            hypot=hypot,
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
            hypot=lambda *values: reduce(gmpy2.hypot, values, gmpy2.mpfr(0)),
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
