"""Invariants that methods of a low degree conserve, and the tops that have hard cases of their own."""

from __future__ import annotations

import math
from functools import partial

from topcli.contracts import Top
from topcli.field.integrals import polynomial_value
from topcli.field.polynomial import NotPolynomialError
from topcli.tops import BUILT_IN, CATALOGUE


def has_own_cases(top: Top) -> bool:
    """True for the tops of the paper, which have hard cases of their own besides those of every top."""
    return top.form in BUILT_IN and top.form not in CATALOGUE


def polynomial_invariants(top: Top, degree: float = math.inf) -> tuple[str, ...]:
    """Return the names of the invariants of ``top`` that are polynomials of the state of at most ``degree``.

    One that only some motions conserve is left out, unless it is linear and its own level is the condition: then the
    motion remains on a hyperplane, and so do the stages of a method.
    """
    names = []
    for invariant in top.invariants():
        if invariant.on.keys() <= {invariant.name}:
            try:
                power = polynomial_value(invariant.value, len(top.components)).degree
            except NotPolynomialError:
                continue
            if power <= (1 if invariant.on else degree):
                names.append(invariant.name)
    return tuple(names)


linear_invariants = partial(polynomial_invariants, degree=1)
"""Names of the invariants of a top that every Runge-Kutta method conserves."""
quadratic_invariants = partial(polynomial_invariants, degree=2)
"""Names of the invariants of a top that the implicit midpoint rule conserves (Cooper 1987)."""


def all_invariants(top: Top) -> tuple[str, ...]:
    """Names of all invariants of ``top``."""
    return tuple(invariant.name for invariant in top.invariants())
