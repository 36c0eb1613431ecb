"""Conservation of a printed formula along a scheme, with 50 digits, and that of its corrected reading."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from topcli.paper import printed
from topcli.paper.algebra import Vector
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.kinds.integrability import GENERIC
from topcli.paper.scenes import DIGITS, FIFTY, ExactMap, Scene, exact_map

Formula = Callable[[Any, Vector, Vector], Any]
"""``formula(c0, omega, gamma)``."""


def _deviation(found: ExactMap, formula: Formula, states: Any) -> float:
    c0 = found.run.top.constants()[0]
    with found.run.arithmetic.active():
        values = [formula(c0, (y[0], y[1], y[2]), (y[3], y[4], y[5])) for y in states]
        return max(float(abs(value - values[0])) for value in values)


def formula_conserved(scene: Scene, formula: Formula, corrected: Formula | None = None) -> Finding:
    """Largest deviation of a printed formula along a run, and that of its corrected reading."""
    found = exact_map(scene)
    states = found.orbit(found.y0, found.run.h, found.experiment.N)
    bound = Bound(0.0, 1000.0 * found.eps * found.experiment.N, f"rounding with {DIGITS} digits")
    other = None if corrected is None else _deviation(found, corrected, states)
    return Finding(_deviation(found, formula, states), bound, other)


FORMULA = Kind(
    "printed formula",
    "largest deviation of the formula along a run with 50 digits",
    "k² along the HK scheme",
    lambda: formula_conserved(Scene("kowalevski_hk", (*FIFTY, "N=10", *GENERIC)), printed.k_squared),
)
