"""What the tops with state (omega, gamma) in the body's frame share, and integrals with the size of their terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import ClassVar

import numpy as np

from topcli.contracts import Array, Invariant, Top

Value = Callable[[Array], Array]


class BodyTop(Top):
    """Top with the state (omega, gamma): angular velocity and vertical, both in the body's frame."""

    components: ClassVar[tuple[str, ...]] = ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"omega": (0, 3), "gamma": (3, 6)}
    unit_vectors: ClassVar[tuple[str, ...]] = ("gamma",)


def sum_of_products(name: str, symbol: str, tex: str, meaning: str, value: Value) -> Invariant:
    """Integral that is a sum of products of components with positive coefficients: its scale is that of ``|y|``."""
    return Invariant(name, symbol, tex, meaning, value, lambda y: value(np.abs(y)))


def length_sq(name: str, symbol: str, tex: str, meaning: str = "length of the vertical, squared") -> Invariant:
    """Square of the last three components."""

    def value(y: Array) -> Array:
        return y[:, 3] ** 2 + y[:, 4] ** 2 + y[:, 5] ** 2

    return Invariant(name, symbol, tex, meaning, value, value)


def energy(kinetic: Value, weight: float, component: int, meaning: str = "energy") -> Invariant:
    """Sum of the ``kinetic`` energy, which is positive, and ``weight`` times a component."""
    return Invariant(
        "energy",
        "E",
        r"E",
        meaning,
        lambda y: kinetic(y) + weight * y[:, component],
        lambda y: kinetic(y) + np.abs(weight * y[:, component]),
    )


VERTICAL = "angular momentum about the vertical"
