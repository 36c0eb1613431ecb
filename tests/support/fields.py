"""Random polynomial fields, and tops of them."""

from __future__ import annotations

import itertools
import random
from fractions import Fraction

from topcli.contracts import Top
from topcli.field.polynomial import Field, Polynomial
from topcli.tops import TOPS


def random_field(d: int, degree: int, seed: int, density: float = 0.5) -> Field:
    """Field of ``d`` components with coefficients of one decimal, of a size that keeps f(y) about one."""
    draw = random.Random(seed)
    monomials = [m for k in range(degree + 1) for m in itertools.combinations_with_replacement(range(d), k)]
    return tuple(
        Polynomial({m: Fraction(draw.randint(-20, 20), 10) for m in monomials if draw.random() < density})
        for _ in range(d)
    )


def random_state(d: int, seed: int) -> tuple[float, ...]:
    draw = random.Random(1000 + seed)
    return tuple(draw.uniform(-1.0, 1.0) for _ in range(d))


def top_of(polynomials: Field) -> Top:
    """A top with this field, for what is generated from it: the field cannot be compiled."""

    class Random(Top):
        """Random polynomials."""

        kind = "random"
        components = tuple(f"y{i}" for i in range(len(polynomials)))
        field = staticmethod(lambda y, p: tuple(rate.value(y) for rate in polynomials))

    TOPS.declared["random"] = Random
    return Random()
