"""Independence of functions: the rank of their gradients in rational numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from topcli.paper.algebra import Draws
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.scenes import RATIONAL, Scene, exact_maps

POINTS = 5


def rank(rows: Sequence[Sequence[Any]]) -> int:
    """Rank of a matrix of rational numbers, by elimination."""
    left = [[Fraction(x) for x in row] for row in rows]
    found = 0
    for column in range(len(left[0])):
        pivot = next((row for row in left if row[column] != 0), None)
        if pivot is None:
            continue
        left.remove(pivot)
        left = [[x - row[column] / pivot[column] * p for x, p in zip(row, pivot, strict=True)] for row in left]
        found += 1
    return found


def independent(gradients: Callable[[Draws], Sequence[Sequence[Any]]], count: int) -> Finding:
    """Largest rank of the gradients of ``count`` functions at random states."""
    draws = Draws(1)
    figure = max(rank(gradients(draws)) for _ in range(POINTS))
    return Finding(float(figure), Bound(float(count), float(count), f"{count} independent functions have this rank"))


def _dependent(draws: Draws) -> Sequence[Sequence[Any]]:
    """Gradients of gamma², gamma_1 and the square of gamma_1."""
    c = draws.vector()
    return [tuple(2 * x for x in c), (1, 0, 0), (2 * c[0], 0, 0)]


ELLIPTIC_STEPS = 9


def elliptic(scene: Scene, component: int) -> Finding:
    """Largest rank of the symmetric biquadratic monomials of successive values u, v of a component, along some orbits.

    A translation on an elliptic curve, and a function of order 2 on it, obey one symmetric biquadratic relation
    between u and v (Euler's addition theorem), so that the 6 monomials have rank 5.
    """
    largest = 0
    for found in exact_maps(scene):
        states = found.orbit(found.y0, found.run.h, ELLIPTIC_STEPS)
        values = [found.run.arithmetic.fraction(state[component]) for state in states]
        rows = [(u * u * v * v, u * v * (u + v), u * u + v * v, u * v, u + v, 1) for u, v in pairwise(values)]
        largest = max(largest, rank(rows))
    return Finding(float(largest), Bound(0.0, 5.0, "one relation between the 6 monomials"))


RANK = Kind(
    "independence",
    "rank of the gradients, in rational numbers",
    "γ², γ₁ and γ₁², which are dependent",
    lambda: independent(_dependent, 3),
)
ELLIPTIC = Kind(
    "elliptic function",
    "rank of the symmetric biquadratic monomials of successive values, in rational numbers",
    "m_1 of the Lagrange top under the BS scheme, which follows the precession too",
    lambda: elliptic(Scene("lagrange_bs", RATIONAL), 0),
)
