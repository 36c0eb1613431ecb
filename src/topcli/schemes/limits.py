"""Conditions that several schemes share: what low-degree methods conserve, and where steps are too long."""

from __future__ import annotations

import math

from topcli.contracts import Top
from topcli.field.integrals import polynomial_value
from topcli.field.polynomial import NotPolynomialError
from topcli.tops import BUILT_IN, CATALOGUE

SINGULAR = (
    "For certain step sizes of the order of 1/|omega| and larger, the determinant of HK's linear system vanishes, and "
    "the state jumps far away: the run ends as `left_motion` or `blew_up`. Choose h such that |h| |omega| is well "
    "below 1."
)
LONG_HK = (
    "If h is about the time of one revolution of the body, the determinant of HK's linear system changes sign along "
    "the motion. The state jumps far away whenever the determinant is close to zero."
)
NO_SOLUTION = (
    "If h is the time of one revolution of the body or longer, Newton's method may find no solution. The run then ends "
    "as `no_convergence`."
)
NEWTON_SINGULAR = (
    "The iteration for the step starts from a step of HK (the scheme `hk`), whose linear system is singular for the h "
    "of this case. The iteration does not converge, and the run ends as `no_convergence`."
)
OVERFLOW = (
    "|xi|² grows as |omega|⁴ and overflows if |omega| exceeds about 1e77. Choose a unit of time in which omega has a "
    "moderate size."
)


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
                found = polynomial_value(invariant.value, len(top.components)).degree
            except NotPolynomialError:
                continue
            if found <= (1 if invariant.on else degree):
                names.append(invariant.name)
    return tuple(names)


def linear_invariants(top: Top) -> tuple[str, ...]:
    """Names of the invariants that every Runge-Kutta method conserves."""
    return polynomial_invariants(top, 1)


def quadratic_invariants(top: Top) -> tuple[str, ...]:
    """Names of the invariants that the implicit midpoint rule conserves (Cooper 1987)."""
    return polynomial_invariants(top, 2)


def all_invariants(top: Top) -> tuple[str, ...]:
    """Names of all invariants of ``top``."""
    return tuple(invariant.name for invariant in top.invariants())
