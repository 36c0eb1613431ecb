"""Quantities: the user's own formulas of the state, the parameters of the top, t and h, evaluated along a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Top
from topcli.field.expression import parse, value_of

TIME, STEP = "t", "h"
"""Names of the time and of the step size in a formula, unless the top has others of these names."""


@dataclass(frozen=True)
class Quantity:
    """Formula given in ``output.quantities`` of a config.

    ``name`` is the name of its column, and ``formula`` is its text. ``function(y, p)`` evaluates the formula. ``y``
    contains the components of the state and the time; ``p`` contains the parameters of the top, and h.
    """

    name: str
    formula: str
    function: Callable[[Sequence[Any], Sequence[Any]], Any]

    def values(self, top: Top, n: NDArray[Any], h: Any, states: Array) -> Array:
        """Return the values of the formula at given states of ``top``, shape (m,).

        ``states``, shape (m, d), are the states after ``n`` steps of ``h``; ``n`` has shape (m,).
        """
        parameters = (getattr(top, name) for name in type(top).model_fields)
        t = np.array([int(step) * h for step in n], dtype=object) if states.dtype.hasobject else n * h
        with np.errstate(all="ignore"):
            values = self.function((*states.T, t), (*parameters, h))
            return values + np.zeros(len(states), dtype=states.dtype)


def quantity_names(cls: type[Top]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names that change along a run and those that do not, in the order of the arguments of ``Quantity.function``."""
    taken = {*cls.components, *cls.model_fields}
    # one that the top uses itself is given a name that no formula can hold
    time, step = (name if name not in taken else f"({name})" for name in (TIME, STEP))
    return (*cls.components, time), (*cls.model_fields, step)


def usable_names(cls: type[Top]) -> tuple[str, ...]:
    """Names that the formula of a quantity may use."""
    moving, fixed = quantity_names(cls)
    return tuple(name for name in (*moving, *fixed) if not name.startswith("("))


def quantities_of(cls: type[Top], formulas: Mapping[str, str] | None) -> tuple[Quantity, ...]:
    """Quantities of tops of class ``cls`` by their formulas, in that order. Raises ExpressionError."""
    return _quantities(cls, tuple((formulas or {}).items()))


@cache
def _quantities(cls: type[Top], formulas: tuple[tuple[str, str], ...]) -> tuple[Quantity, ...]:
    usable = usable_names(cls)
    return tuple(Quantity(name, text, value_of(parse(text, usable), *quantity_names(cls))) for name, text in formulas)
