"""Equality of two maps: a scheme against the printed equations, or against another scheme."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from topcli.studies.claims.claim import Bound, Finding, Kind
from topcli.studies.claims.scenes import RATIONAL, ExactMap, Scene, exact_map

STEPS = 3
STEP = Fraction(1, 10)
Residual = Callable[[Fraction, tuple[Any, ...], tuple[Any, ...]], Sequence[Any]]
"""Left minus right sides of an equation for h, the old state and the new one."""
EQUAL = Bound(0.0, 0.0, "two equal maps leave exactly 0 in rational numbers")


def _orbit(found: ExactMap, y: Any) -> list[tuple[Fraction, ...]]:
    states = found.orbit(y, found.number(STEP), STEPS)
    return [tuple(found.run.arithmetic.fraction(x) for x in state) for state in states]


def satisfies(scene: Scene, residual: Residual) -> Finding:
    """Largest residual of an equation along steps of a scheme in rational numbers."""
    found = exact_map(scene)
    orbit = _orbit(found, found.y0)
    return Finding(max(float(abs(x)) for old, new in pairwise(orbit) for x in residual(STEP, old, new)), EQUAL)


def same_map(one: Scene, other: Scene) -> Finding:
    """Largest difference between the orbits of two schemes in rational numbers, from the initial state of ``one``."""
    first, second = exact_map(one), exact_map(other)
    there = _orbit(first, first.y0)
    start = [second.number(value) for value in there[0]]
    pairs = zip(there, _orbit(second, start), strict=True)
    return Finding(max(float(abs(x - y)) for a, b in pairs for x, y in zip(a, b, strict=True)), EQUAL)


SAME_MAP = Kind(
    "equal maps",
    "largest difference over three steps of h = 0.1, in rational numbers",
    "the BS scheme of the Euler top against its HK scheme",
    lambda: same_map(Scene("euler_bs", RATIONAL), Scene("euler_hk", RATIONAL)),
)
