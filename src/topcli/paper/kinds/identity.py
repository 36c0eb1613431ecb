"""Identities between printed formulas, decided in rational numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import I_UNIT, Draws, Gauss, plus, size_of
from topcli.paper.claim import Bound, Finding, Kind

POINTS = 20
"""Points at which an identity is tried.

The formulas are rational, of a degree below 20 in each variable, which takes some hundred values: a wrong identity
passes all points with a probability below 1e-14.
"""
Difference = Callable[[Draws], Sequence[Any]]
"""Left minus right sides of an identity at a point drawn at random."""


def _largest(difference: Difference) -> float:
    draws = Draws(1)
    return max(size_of(value) for _ in range(POINTS) for value in difference(draws))


def identity(difference: Difference, corrected: Difference | None = None) -> Finding:
    """Largest difference between two sides, and that of a corrected reading."""
    return Finding(
        _largest(difference),
        Bound(0.0, 0.0, "an identity leaves exactly 0 in rational numbers"),
        None if corrected is None else _largest(corrected),
    )


def _wrong_turn(draws: Draws) -> Sequence[Any]:
    """The equation for xi, d/dt (omega² - c0 gamma) = -i omega_3 (...), with the opposite sign."""
    w, c, c0 = draws.vector(), draws.vector(), draws.number()
    omega, gamma = Gauss(w[0], w[1]), Gauss(c[0], c[1])
    rate = 2 * omega * printed.complex_omega(c0, omega, w[2], c[2])[0]
    rate -= c0 * printed.complex_gamma(omega, w[2], gamma, c[2])[0]
    return [rate - I_UNIT * w[2] * (omega * omega - c0 * gamma)]


IDENTITY = Kind(
    "identity",
    "largest difference of the two sides at 20 random points, in rational numbers",
    "(Kxi) with the opposite sign",
    lambda: identity(_wrong_turn),
)


def second_difference(residual: Callable[[tuple[Any, ...], Draws], Sequence[Any]], width: int, known: int) -> float:
    """Largest second difference of ``residual(new, draws)`` in the ``width`` new components; 0 if it is linear.

    The residual is called four times with the same draws, of which ``known`` seeds choose the rest of the point.
    """
    largest = 0.0
    for point in range(known):
        draws = Draws(100 + point)
        x, u, v = (tuple(draws.number() for _ in range(width)) for _ in range(3))
        at = [residual(new, Draws(point)) for new in (plus(plus(x, u), v), plus(x, u), plus(x, v), x)]
        for whole, first, second, base in zip(*at, strict=True):
            largest = max(largest, size_of(whole - first - second + base))
    return largest


def linear_in_new(residual: Callable[[tuple[Any, ...], Draws], Sequence[Any]], width: int) -> Finding:
    """Second difference of an equation in the new state, which is explicitly solvable if that is 0."""
    figure = second_difference(residual, width, POINTS)
    return Finding(figure, Bound(0.0, 0.0, "an equation linear in the new state has no second difference"))


def not_linear_in_new(residual: Callable[[tuple[Any, ...], Draws], Sequence[Any]], width: int) -> Finding:
    """Second difference of an equation in the new state, which needs an iteration if that is not 0."""
    figure = second_difference(residual, width, POINTS)
    return Finding(figure, Bound(0.0, reason="only a linear equation has no second difference", open_low=True))


def midpoint_residual(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """Last scheme of section 1.2 as an equation for the new m, with omega = m/I."""
    m, moments, h = draws.vector(), draws.moments(), draws.number()
    w, v = (tuple(a / b for a, b in zip(x, moments, strict=True)) for x in (m, new))
    return printed.midpoint(h, m, (new[0], new[1], new[2]), (w[0], w[1], w[2]), (v[0], v[1], v[2]))


def rotation_residual(new: tuple[Any, ...], draws: Draws) -> Sequence[Any]:
    """(EulerBS) as an equation for the new m."""
    m, w, h = draws.vector(), draws.vector(), draws.number()
    return printed.bs(h, m, (new[0], new[1], new[2]), w)


LINEAR = Kind(
    "explicit",
    "second difference of the equation in its unknowns, in rational numbers",
    "the midpoint rule, quadratic in the new m",
    lambda: linear_in_new(midpoint_residual, 3),
)
NOT_LINEAR = Kind(
    "implicit",
    "second difference of the equation in its unknowns, in rational numbers",
    "(EulerBS), linear in the new m",
    lambda: not_linear_in_new(rotation_residual, 3),
)
