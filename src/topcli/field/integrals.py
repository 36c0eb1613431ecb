"""Integrals of a field: whether a declared one is conserved, by its exact rate of change."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from topcli.contracts import Array, Top
from topcli.field.polynomial import Field, Monomial, NotPolynomialError, Polynomial, field_of

ROUNDING = 1e-12
"""Size of a coefficient, relative to the terms of which it is the sum, that rounded parameters may leave."""


def polynomial_value(value: Callable[[Array], Array], d: int) -> Polynomial:
    """Polynomial of a function that maps states (n, d) to values (n,). Raises NotPolynomialError."""
    y: Any = np.array([[Polynomial.variable(i) for i in range(d)]], dtype=object)
    try:
        (found,) = value(y)
    except Exception as error:  # numpy's functions and a user's code may raise anything
        raise NotPolynomialError(f"cannot be evaluated with polynomials: {error}") from None
    return Polynomial.of(found)


def rate_of_change(field: Field, integral: Polynomial) -> dict[Monomial, float]:
    """Coefficients of the derivative of ``integral`` along the motion, without those that are only rounding."""

    def along(change: Callable[[Polynomial], Polynomial]) -> Polynomial:
        terms = (change(integral.derivative(i)) * change(rate) for i, rate in enumerate(field))
        return sum(terms, start=Polynomial({}))

    exact, sizes = along(lambda one: one), along(Polynomial.magnitudes)
    return {m: float(c) for m, c in exact.terms.items() if abs(c) > ROUNDING * sizes.terms[m]}


def broken_integral(top: Top) -> str:
    """Name of a declared integral that the field of ``top`` does not conserve, and why; empty if there is none.

    Integrals and fields that are no polynomials are not judged, nor is code that raises.
    """
    d = len(top.components)
    try:
        field, invariants = field_of(top), top.invariants()
    except Exception:  # a user's code may raise anything; it is reported where it is run with numbers
        return ""
    for invariant in invariants:
        try:
            rates = rate_of_change(field, polynomial_value(invariant.value, d))
        except NotPolynomialError:
            continue
        if rates:
            monomial, c = max(rates.items(), key=lambda item: abs(item[1]))
            term = "*".join([f"{c:.4g}", *(top.components[i] for i in monomial)])
            return f"{invariant.name!r} is no integral of the field: its rate of change contains {term}"
    return ""
