"""Equality of two maps: a scheme against the printed equations, or against another scheme."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.scenes import RATIONAL, ExactMap, Scene, exact_map, exact_maps

STEPS = 3
Residual = Callable[[Callable[[str], Fraction], Fraction, tuple[Any, ...], tuple[Any, ...]], Sequence[Any]]
"""Left minus right sides of an equation for the parameters of the top by name, h, the old state and the new one."""
EQUAL = Bound(0.0, 0.0, "two equal maps leave exactly 0 in rational numbers")


def _orbit(found: ExactMap, y: Any, h: Fraction) -> list[tuple[Fraction, ...]]:
    states = found.orbit(y, found.number(h), STEPS)
    return [tuple(found.run.arithmetic.fraction(x) for x in state) for state in states]


def satisfies(scene: Scene, residual: Residual) -> Finding:
    """Largest residual of an equation along steps of a scheme and of its variants, in rational numbers."""
    largest = 0.0
    for found in exact_maps(scene):
        h = found.run.arithmetic.fraction(found.run.h)
        for old, new in pairwise(_orbit(found, found.y0, h)):
            largest = max(largest, *(float(abs(x)) for x in residual(found.parameter, h, old, new)))
    return Finding(largest, EQUAL)


def same_map(scene: Scene, other: Callable[[ExactMap], Scene]) -> Finding:
    """Largest difference between the orbits of a scene, and of its variants, and those of other schemes.

    ``other`` gives the scene to compare with, which starts from the same state, in rational numbers.
    """
    largest = 0.0
    for first in exact_maps(scene):
        second = exact_map(other(first))
        h = first.run.arithmetic.fraction(first.run.h)
        there = _orbit(first, first.y0, h)
        start = [second.number(value) for value in there[0]]
        pairs = zip(there, _orbit(second, start, h), strict=True)
        largest = max(largest, *(float(abs(x - y)) for a, b in pairs for x, y in zip(a, b, strict=True)))
    return Finding(largest, EQUAL)


def _hk_of(found: ExactMap) -> Scene:
    """HK scheme of the same Euler top."""
    return Scene("euler_hk", (*RATIONAL, *(f"top.{name}={found.parameter(name)}" for name in "ABC")))


SAME_MAP = Kind(
    "equal maps",
    "largest difference over three steps of h = 0.1, in rational numbers",
    "the BS scheme of the Euler top against its HK scheme",
    lambda: same_map(Scene("euler_bs", RATIONAL), _hk_of),
)
