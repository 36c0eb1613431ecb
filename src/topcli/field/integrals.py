"""Test whether a field conserves a declared integral, by the exact rate of change of a polynomial."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from fractions import Fraction
from typing import Any, cast

import numpy as np

from topcli.arithmetic.elimination import linear_solution
from topcli.contracts import Array, Invariant, Top
from topcli.field.polynomial import Field, Monomial, NotPolynomialError, Polynomial, decimal, field_of

_ROUNDING = 1e-12
"""Size of a coefficient, relative to the terms of which it is the sum, that rounded parameters may leave."""


def polynomial_value(value: Callable[[Array], Array], d: int) -> Polynomial:
    """Polynomial of a function that maps states (n, d) to values (n,). Raises NotPolynomialError."""
    y: Any = np.array([[Polynomial.variable(i) for i in range(d)]], dtype=object)
    try:
        (polynomial,) = value(y)
    except Exception as error:  # numpy's functions and a user's code may raise anything
        raise NotPolynomialError(f"cannot be evaluated with polynomials: {error}") from None
    return Polynomial.of(polynomial)


def remainder(dividend: Polynomial, divisors: Sequence[Polynomial]) -> Polynomial:
    """Remainder of a polynomial divided by ``divisors``; if it is 0, the polynomial vanishes where they all do."""

    def rank(monomial: Monomial) -> tuple[int, Monomial]:
        return len(monomial), tuple(-i for i in monomial)

    leads = [(max(divisor.terms, key=rank), divisor) for divisor in divisors if divisor.terms]
    left, rest = dividend, Polynomial({})
    while left.terms:
        first = max(left.terms, key=rank)
        term = Polynomial({first: left.terms[first]})
        for lead, divisor in leads:
            if not Counter(lead) - Counter(first):
                factor = tuple(sorted((Counter(first) - Counter(lead)).elements()))
                left -= divisor * Polynomial({factor: left.terms[first] / divisor.terms[lead]})
                break
        else:
            left, rest = left - term, rest + term
    return rest


def derivative_along(field: Field, function: Polynomial) -> Polynomial:
    """Derivative of a function of the state along the motion."""
    return sum((function.derivative(i) * rate for i, rate in enumerate(field)), start=Polynomial({}))


def rate_of_change(field: Field, integral: Polynomial, zeros: Sequence[Polynomial] = ()) -> dict[Monomial, float]:
    """Coefficients of the derivative of ``integral`` along the motion where ``zeros`` vanish.

    Coefficients that are only rounding errors are left out.
    """
    exact = derivative_along(field, integral)
    sizes = derivative_along(tuple(map(Polynomial.magnitudes, field)), integral.magnitudes())
    rates = Polynomial({m: c for m, c in exact.terms.items() if abs(c) > _ROUNDING * sizes.terms[m]})
    if zeros:
        largest = max(map(abs, rates.terms.values()), default=Fraction(0))
        rates = remainder(rates, zeros)
        rates = Polynomial({m: c for m, c in rates.terms.items() if abs(c) > _ROUNDING * largest})
    return {m: float(c) for m, c in rates.terms.items()}


def exact_rate(field: Field, invariants: Sequence[Invariant], invariant: Invariant) -> dict[Monomial, float]:
    """Return ``rate_of_change`` of one of the ``invariants`` of a top, on the level that this invariant names.

    Raises NotPolynomialError.
    """
    d, values = len(field), {each.name: each.value for each in invariants}
    zeros = [polynomial_value(values[name], d) - Polynomial.of(level) for name, level in invariant.on.items()]
    return rate_of_change(field, polynomial_value(invariant.value, d), zeros)


_STATES = 12
"""Random states that test an integral that is not a polynomial; the majority decides, because it may have poles."""
RATE = 1e-6
"""Rate of change of an integral that differences may leave, relative to its gradient and the field."""


def slopes(top: Top, states: Array) -> Array:
    """Right-hand sides of the equations of motion at ``states`` (m, d); nan where they have no value."""
    rows, p = np.full(states.shape, math.nan), top.constants()
    for row, y in zip(rows, states.tolist(), strict=True):
        with suppress(ArithmeticError, ValueError):
            row[:] = top.field(tuple(y), p)
    return rows


def rates_along(top: Top, value: Callable[[Array], Array], states: Array) -> tuple[Array, Array]:
    """Rates of change (n,) of a function of the state along the field at ``states`` (n, d), by differences.

    And their sizes relative to the length of the gradient times that of the field: the cosine of the angle between
    them. Differences of order four with steps of 1e-3 have errors of about 1e-11; a function that is not an integral
    has rates of size one at most states. nan where the field or the function has no value.
    """
    fields, gradients = slopes(top, states), np.empty(states.shape)
    with np.errstate(all="ignore"):
        for row, y in zip(gradients, states, strict=True):
            step = 1e-3 * max(1.0, float(np.abs(y).max()))
            moved = [value(y + k * step * np.eye(len(y))) for k in (-2, -1, 1, 2)]
            row[:] = (moved[0] - 8.0 * moved[1] + 8.0 * moved[2] - moved[3]) / (12.0 * step)
        rates = (gradients * fields).sum(axis=1)
        sizes = np.linalg.norm(gradients, axis=1) * np.linalg.norm(fields, axis=1)
        return rates, np.abs(rates) / np.where(sizes == 0.0, 1.0, sizes)


def measured_change(top: Top, invariant: Invariant) -> str:
    """Return a text with the rate of change of an invariant at a random state; empty if it does not change."""
    states = np.random.default_rng(0).normal(size=(_STATES, len(top.components)))
    rates, sizes = rates_along(top, invariant.value, states)
    changing = np.flatnonzero(sizes > RATE)
    if 2 * len(changing) <= max(np.isfinite(sizes).sum(), 3):
        return ""
    at = ", ".join(f"{value:.3g}" for value in states[changing[0]])
    return f"its rate of change is {rates[changing[0]]:.3g} at ({at})"


def broken_integral(top: Top) -> str:
    """Name of a declared integral that the field of ``top`` does not conserve, and why; empty if there is none.

    Polynomials are tested exactly. Other functions are tested at random states, unless they are conserved only on a
    level. Code that raises an exception is not tested.
    """
    field: Field | None = None
    try:
        invariants = top.invariants()
        with suppress(NotPolynomialError):
            field = field_of(top)
    except Exception:  # a user's code may raise anything; it is reported where it is run with numbers
        return ""
    names = {invariant.name for invariant in invariants}
    for invariant in invariants:
        if unknown := invariant.on.keys() - names:
            return f"{invariant.name!r} holds on {min(unknown)!r}, which is not an integral of the top"
        try:
            if field is None:
                raise NotPolynomialError
            rates = exact_rate(field, invariants, invariant)
        except NotPolynomialError:
            change = ""
            if not invariant.on:
                with suppress(Exception):  # of a user's code, as above
                    change = measured_change(top, invariant)
            if change:
                return f"{invariant.name!r} is not an integral of the field: {change}"
            continue
        if rates:
            monomial, c = max(rates.items(), key=lambda item: abs(item[1]))
            term = "*".join([f"{c:.4g}", *(top.components[i] for i in monomial)])
            return f"{invariant.name!r} is not an integral of the field: its rate of change contains {term}"
    return ""


def hk_image(field: Field, y: Sequence[Fraction], h: Fraction) -> list[Fraction] | None:
    """State after a step of the HK map, exactly; None if the step has no solution.

    The change d solves (I - h/2 f'(y)) d = h f(y), where the field f has degree two at most.
    """
    n = len(field)
    rows = [
        [(i == j) - h / 2 * field[i].derivative(j).value(y) for j in range(n)] + [h * field[i].value(y)]
        for i in range(n)
    ]
    change = linear_solution(rows)
    return None if change is None else [a + d for a, d in zip(y, change, strict=True)]


def broken_hk_integral(top: Top) -> str:
    """Name of a declared integral of the HK map that a step changes, and by how much; empty if there is none.

    One step from each of several states is computed in rational numbers.
    """
    h = Fraction(1, 5)
    integrals: Mapping[str, Callable[[Any, Any], Any]] = top.integrals_of("hk", cast(Any, h))
    if not integrals:
        return ""
    try:
        field = field_of(top)
    except NotPolynomialError as error:
        return f"{min(integrals)!r} needs a field of degree two, for which the HK map is defined; this one {error}"
    if max(rate.degree for rate in field) > 2:
        return f"{min(integrals)!r} needs a field of degree two, for which the HK map is defined"
    p = tuple(map(decimal, top.constants()))
    for k in range(1, 5):
        before = [Fraction(2 * ((3 * i + 2) * k % 11) - 11, 14) for i in range(len(field))]
        after = hk_image(field, before, h)
        for name, integral in integrals.items() if after else ():
            with suppress(ZeroDivisionError):
                a, b = (integral(tuple(np.array([x], dtype=object) for x in y), p)[0] for y in (before, after or ()))
                if abs(a - b) > _ROUNDING * (abs(a) + abs(b)):
                    at = f"h = {h} from ({', '.join(map(str, before))})"
                    return f"{name!r} is not an integral of the HK map: a step of {at} changes it by {float(b - a):.3g}"
    return ""
