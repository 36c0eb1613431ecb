"""Polynomials with rational coefficients, and the exact polynomial of a vector field.

A field is a plain Python function ``field(y, p)`` of the components of the state and the constants of the top. Called
with polynomials in place of the components, it returns its own polynomials, without any computer algebra. Constants are
taken as the decimal numbers that they print as: conditions on parameters, such as equal moments, hold for these and
fail for the binary fractions next to them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from topcli.arithmetic.sized import Operators
from topcli.contracts import Top
from topcli.errors import UsageError
from topcli.field.expression import in_arithmetic

Monomial = tuple[int, ...]
"""Indices of the factors of a product of variables, in order: (0, 0, 2) is the square of variable 0 times variable 2;
() is 1."""


MOST_PRODUCTS = 10**6
"""Products of terms in a product of two polynomials."""


class NotPolynomialError(ValueError):
    """Field that is not a polynomial of the state; the message gives the reason as a verb phrase."""


DECIDES = "makes a decision that depends on the state"


class Polynomial(Operators):
    """Polynomial with rational coefficients: ``terms`` maps each monomial to its coefficient, which is not zero.

    A polynomial can be used like a number if the result is a polynomial: the exponent of a power is a whole number,
    and a divisor is a constant. Anything else raises NotPolynomialError. A constant can be converted to a float.
    """

    __slots__ = ("terms",)

    def __init__(self, terms: Mapping[Monomial, Fraction]) -> None:
        self.terms = {monomial: c for monomial, c in terms.items() if c}

    @staticmethod
    def variable(index: int) -> Polynomial:
        """The variable with this index."""
        return Polynomial({(index,): Fraction(1)})

    @staticmethod
    def of(value: object) -> Polynomial:
        """A polynomial as it is, a number as a constant. Raises NotPolynomialError for anything else."""
        if isinstance(value, Polynomial):
            return value
        try:
            return Polynomial({(): decimal(value)})
        except (TypeError, ValueError, OverflowError):
            raise NotPolynomialError(f"computes with {type(value).__name__}, which is not a number") from None

    def __add__(self, other: object) -> Polynomial:
        terms = dict(self.terms)
        for monomial, c in Polynomial.of(other).terms.items():
            terms[monomial] = terms.get(monomial, Fraction(0)) + c
        return Polynomial(terms)

    def __mul__(self, other: object) -> Polynomial:
        terms: dict[Monomial, Fraction] = {}
        factor = Polynomial.of(other).terms.items()
        if len(self.terms) * len(factor) > MOST_PRODUCTS:
            raise NotPolynomialError(
                f"is too long as a polynomial: a product of {len(self.terms)} by {len(factor)} terms"
            )
        for left, a in self.terms.items():
            for right, b in factor:
                product = tuple(sorted(left + right))
                terms[product] = terms.get(product, Fraction(0)) + a * b
        return Polynomial(terms)

    def __neg__(self) -> Polynomial:
        return Polynomial({monomial: -c for monomial, c in self.terms.items()})

    def __truediv__(self, other: object) -> Polynomial:
        divisor = Polynomial.of(other)
        if divisor.degree > 0:
            raise NotPolynomialError("divides by the state")
        if not divisor.terms:
            raise NotPolynomialError("divides by zero")
        return Polynomial({monomial: c / divisor.terms[()] for monomial, c in self.terms.items()})

    def __rtruediv__(self, other: object) -> Polynomial:
        return Polynomial.of(other) / self

    def __pow__(self, exponent: object) -> Polynomial:
        if isinstance(exponent, int | float | Fraction):
            if exponent < 0:
                return Polynomial.of(1) / self**-exponent
            if not self.degree:
                return Polynomial.of(self.constant() ** exponent)
            if exponent == int(exponent):
                return math.prod([self] * int(exponent), start=Polynomial.of(1))
        raise NotPolynomialError(f"takes the power {exponent} of the state")

    def constant(self, otherwise: str = "calls a function of the state that is not a polynomial") -> Fraction:
        """Value of a constant. Raises NotPolynomialError with the reason ``otherwise`` for a function of the state."""
        if self.degree > 0:
            raise NotPolynomialError(otherwise)
        return self.terms.get((), Fraction(0))

    def __bool__(self) -> bool:
        return bool(self.constant(DECIDES))

    def __float__(self) -> float:
        return float(self.constant())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Polynomial | int | float | Fraction) and self.terms == Polynomial.of(other).terms

    def __hash__(self) -> int:
        return hash(frozenset(self.terms.items()))

    def __abs__(self) -> Polynomial:
        return Polynomial.of(abs(self.constant(DECIDES)))

    @property
    def degree(self) -> int:
        """Largest number of factors of a term; 0 for a constant."""
        return max(map(len, self.terms), default=0)

    def variables(self) -> set[int]:
        """Indices of the variables in the terms."""
        return {i for monomial in self.terms for i in monomial}

    def nonlinear(self) -> set[int]:
        """Indices of the variables in products of two factors and more."""
        return {i for monomial in self.terms if len(monomial) > 1 for i in monomial}

    def derivative(self, index: int) -> Polynomial:
        """Partial derivative with respect to a variable."""
        terms = {}
        for monomial, c in self.terms.items():
            if count := monomial.count(index):
                at = monomial.index(index)
                terms[monomial[:at] + monomial[at + 1 :]] = count * c
        return Polynomial(terms)

    def magnitudes(self) -> Polynomial:
        """The polynomial with the magnitudes of its coefficients."""
        return Polynomial({monomial: abs(c) for monomial, c in self.terms.items()})

    def text(self, names: Sequence[str]) -> str:
        """The polynomial as a formula of the variables' ``names``, the terms of the highest degree first."""
        text = ""
        for monomial in sorted(self.terms, key=lambda m: (-len(m), m)):
            c, counts = self.terms[monomial], Counter(monomial)
            powers = [names[i] if n == 1 else f"{names[i]}**{n}" for i, n in counts.items()]
            size = f"{float(abs(c)):g}"
            number = [size if Fraction(size) == abs(c) else f"({abs(c)})"] if abs(c) != 1 or not powers else []
            text += (" - " if c < 0 else " + ") + "*".join(number + powers)
        return text[3:] if text.startswith(" + ") else f"-{text[3:]}" if text else "0"

    def value(self, y: Sequence[Any]) -> Any:
        """Value at ``y``, in the arithmetic of its numbers."""
        return sum((math.prod((y[i] for i in monomial), start=c) for monomial, c in self.terms.items()), start=0)


Field = tuple[Polynomial, ...]
"""Right-hand sides of the differential equations, one for each component of the state."""


def variational(field: Field) -> Field:
    """Return the field (f(y), f'(y) v) of a state y and a tangent vector v; the indices of v follow those of y."""
    d = len(field)
    tangent = (
        sum((rate.derivative(j) * Polynomial.variable(d + j) for j in range(d)), start=Polynomial({})) for rate in field
    )
    return (*field, *tangent)


def strongly_connected(links: Sequence[Iterable[int]], nodes: Sequence[int]) -> list[tuple[int, ...]]:
    """Strongly connected components of the ``nodes``, where i depends on ``links[i]``, in the order of computation."""
    reached = {i: {i} for i in nodes}
    for _ in nodes:
        for i in nodes:
            reached[i] = reached[i].union(*(reached[j] for j in links[i] if j in reached))
    groups = {tuple(j for j in nodes if j in reached[i] and i in reached[j]) for i in nodes}
    return sorted(groups, key=lambda group: (len(reached[group[0]]), group))


def decimal(value: Any) -> Fraction:
    """Number as a fraction; a float is taken as the decimal number that Python prints for it.

    Raises TypeError if ``value`` is not a number, and ValueError if it is not finite.
    """
    if isinstance(value, str):
        raise TypeError("a text is not a number")
    return Fraction(repr(float(value))) if isinstance(value, float) else Fraction(value)


def polynomial_field(field: Callable[..., Sequence[object]], d: int, constants: Iterable[object]) -> Field:
    """Polynomials of the ``d`` components of ``field(y, p)``, where p are the ``constants``.

    Numbers in the field's own code are exact too; functions of constants, such as roots, are doubles. Raises
    NotPolynomialError for a field that is not a polynomial of the state.
    """
    y = tuple(map(Polynomial.variable, range(d)))
    try:
        rates = tuple(map(Polynomial.of, in_arithmetic(field, decimal)(y, tuple(map(Polynomial.of, constants)))))
    except TypeError as error:
        raise NotPolynomialError(f"cannot be evaluated with polynomials: {error}") from None
    if len(rates) != d:
        raise NotPolynomialError(f"has {len(rates)} components; expected {d}")
    return rates


def exact_top(top: Top, exact: Callable[[float], Fraction] = decimal) -> Any:
    """Copy of a top with constant polynomials as parameters."""
    parameters = {name: Polynomial.of(exact(v)) if isinstance(v, float) else v for name, v in dict(top).items()}
    return type(top).model_construct(**parameters)  # pyright: ignore[reportArgumentType]


def field_of(top: Top, exact: Callable[[float], Fraction] = decimal) -> Field:
    """Return the polynomials of the field of a top. ``exact`` converts parameters; numbers in its code are decimals.

    Raises NotPolynomialError, also if the code of the top raises: it is reported where it is run with numbers.
    """
    try:
        return polynomial_field(top.field, len(top.components), exact_top(top, exact).constants())
    except NotPolynomialError:
        raise
    except Exception as error:
        raise NotPolynomialError(f"cannot be evaluated with exact parameters: {error}") from None


def required_field(
    top: Top, needed_by: str, degree: float = math.inf, exact: Callable[[float], Fraction] = decimal
) -> Field:
    """Return ``field_of(top, exact)`` for a user that needs a polynomial of at most this ``degree``.

    Raises UsageError with the reason; ``needed_by`` names the user of the field, for example "scheme 'hk'".
    """
    kind = "quadratic" if degree == 2 else "polynomial"
    needs = f"top {top.kind!r}: {needed_by} needs a {kind} field, but"
    place, code = "", getattr(top.field, "__code__", None)
    if code and not top.field.__module__.startswith("topcli."):
        place = f" ({code.co_filename}:{code.co_firstlineno})"
    try:
        field = field_of(top, exact)
    except NotPolynomialError as error:
        raise UsageError(f"{needs} this one {error}{place}") from None
    for name, rate in zip(top.components, field, strict=True):
        if rate.degree > degree:
            raise UsageError(f"{needs} {name}' has degree {rate.degree}{place}")
    return field
