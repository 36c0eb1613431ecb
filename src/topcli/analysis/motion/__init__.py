"""Class, periods and frequencies of a motion, from its closed form."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from topcli.contracts import Floats, Top
from topcli.errors import UnknownNameError, nearest, quoted
from topcli.table import Table, ten_digits

if TYPE_CHECKING:
    import pandas as pd


class MotionQuantity(NamedTuple):
    """Number that characterizes a motion; the period of an asymptotic motion is infinite."""

    name: str
    value: float
    meaning: str


@dataclass(frozen=True, repr=False)
class Motion:
    """Class, periods and frequencies of one exact motion of a top.

    ``motion[name]`` is the value of a quantity such as ``frequency.s1``. The expression ``name in motion`` is true if
    the motion has this quantity.

    Attributes
    ----------
    top : str
        Name of the top (``Top.form``) whose closed-form solution was used. A heavy top with the moments and the centre
        of gravity of, for example, the Kowalevski top is treated as a Kowalevski top.
    kind : str
        Class of the motion, such as ``torus II``, ``separatrix`` or ``polhode about A`` (about the axis of the moment
        A); the pages on tops explain the classes.
    title : str
        Class of the motion in words.
    state : tuple of float
        Initial state.
    quantities : tuple of MotionQuantity
        Integrals, frequencies and periods of the motion, and its distance from a separatrix. Each quantity has
        ``name``, ``value`` and ``meaning``.

    Examples
    --------
    >>> import topcli
    >>> motion = topcli.motion("kowalevski_hk")
    >>> motion.kind
    'torus II'
    >>> round(motion["period.omega2"], 4)
    28.1716
    """

    top: str
    kind: str
    title: str
    state: tuple[float, ...]
    quantities: tuple[MotionQuantity, ...]

    def __iter__(self) -> Iterator[str]:
        return (quantity.name for quantity in self.quantities)

    def __contains__(self, name: object) -> bool:
        return any(quantity.name == name for quantity in self.quantities)

    def __getitem__(self, name: str) -> float:
        """Value of a quantity by name. Raises UnknownNameError with the nearest names."""
        for quantity in self.quantities:
            if quantity.name == name:
                return quantity.value
        raise UnknownNameError(f"this motion has no quantity {quoted(name)}; {nearest(name, list(self))}")

    def __repr__(self) -> str:
        return f"<Motion of the top {self.top}: {self.title}>"

    @property
    def table(self) -> pd.DataFrame:
        """Value and meaning of each quantity, indexed by the name of the quantity."""
        return motion_table(self).frame()

    def as_dict(self) -> dict[str, Any]:
        """Return the motion as plain data, ready for JSON; an infinite value is None."""
        return {
            "top": self.top,
            "kind": self.kind,
            "title": self.title,
            "state": list(self.state),
            "quantities": {
                quantity.name: quantity.value if math.isfinite(quantity.value) else None for quantity in self.quantities
            },
            "meanings": {quantity.name: quantity.meaning for quantity in self.quantities},
        }


def motion_table(motion: Motion) -> Table:
    """Table of the quantities of a motion."""
    rows = [quantity._asdict() for quantity in motion.quantities]
    return Table("Quantities", rows, {"value": _text}, names={"name": "quantity"})


def integrals_of(top: Top, y: Floats) -> tuple[MotionQuantity, ...]:
    """Integrals of ``top`` at the state ``y``."""
    import numpy as np

    row = np.array([y], dtype=float)
    return tuple(
        MotionQuantity(invariant.name, float(invariant.value(row)[0]), invariant.meaning)
        for invariant in top.invariants()
    )


def _text(value: float) -> str:
    return "∞" if value == math.inf else ten_digits(value)
