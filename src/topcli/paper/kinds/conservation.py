"""Conservation laws and reversal, decided in rational numbers or with 50 digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from topcli.analysis.order import observed_order
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.scenes import DIGITS, FIFTY, RATIONAL, ExactMap, Scene, exact_map, exact_maps, trajectory

ROUNDINGS = 1000.0
"""Rounding errors of a step that an exact law may show: an upper bound for all schemes of the ledger."""


def _round_off(found: ExactMap, steps: int) -> float:
    """Bound on what rounding does to an exact law in a number of steps."""
    return found.eps * ROUNDINGS * steps


def _reason(found: ExactMap) -> str:
    return f"rounding with {DIGITS} digits" if found.eps else "rational numbers: no rounding"


def conserved(scene: Scene, invariant: str) -> Finding:
    """Largest relative deviation of an invariant over a scene and its variants, which has to be that of rounding."""
    maps = exact_maps(scene)
    figure = max(_deviation(found, invariant) for found in maps)
    return Finding(figure, Bound(0.0, _round_off(maps[0], maps[0].experiment.N), _reason(maps[0])))


def broken(scene: Scene, *invariants: str) -> Finding:
    """Smallest of the relative deviations of some invariants, which has to exceed that of rounding."""
    found = exact_map(scene)
    figure = min(_deviation(found, invariant) for invariant in invariants)
    bound = Bound(_round_off(found, found.experiment.N), reason=_reason(found), open_low=True)
    return Finding(figure, bound)


def _deviation(found: ExactMap, invariant: str) -> float:
    """Largest relative deviation of an invariant over the steps of a scene."""
    h = found.run.h
    return float(found.deviations(invariant, found.orbit(found.y0, h, found.experiment.N), h).max())


CONTROL_HK = Scene("euler_hk", (*RATIONAL, "N=10"))
CONTROL_MIDPOINT = Scene("euler_midpoint", (*FIFTY, "N=10"))
CONSERVED = Kind(
    "conserved exactly",
    "largest relative deviation of the quantity, in rational numbers or with 50 digits",
    "m² under the HK scheme of the Euler top",
    lambda: conserved(CONTROL_HK, "m_sq"),
)
BROKEN = Kind(
    "not conserved",
    "largest relative deviation of the quantity, in rational numbers or with 50 digits",
    "m² under the midpoint rule of the Euler top",
    lambda: broken(CONTROL_MIDPOINT, "m_sq"),
)


def _return_defect(found: ExactMap, h: Fraction, y: Any = None) -> float:
    """Largest component of the error after a step of h and one of -h, by default from the initial state."""
    start = found.y0 if y is None else y
    there = found.step(start, found.number(h))
    back = found.step(there, found.number(-h))
    with found.run.arithmetic.active():
        return max(float(abs(value)) for value in back - start)


def _exponent(found: ExactMap, h: Fraction, figure: float) -> str:
    """Order of the defect in h, from steps of h and h/2; empty without a defect."""
    if figure <= _round_off(found, 2):
        return ""
    return f"of order {math.log2(figure / _return_defect(found, h / 2)):.2f} in h"


STEP = Fraction(1, 10)
ALONG = 100
"""States along a run of the paper at which the defect of reversal is measured too."""


def reversible(scene: Scene, paper: Scene | None = None) -> Finding:
    """Largest defect of a step of 0.1 and one of -0.1 over a scene and its variants, which has to be that of rounding.

    The note adds the order in h, and the largest defect at states along the scene ``paper``, in doubles, with its h.
    """
    maps = exact_maps(scene)
    figures = [_return_defect(found, STEP) for found in maps]
    notes = [_exponent(maps[0], STEP, figures[0])]
    if paper is not None:
        run, one = trajectory(paper), exact_map(paper.with_sets(*FIFTY))
        states = [np.array([one.number(Fraction(x)) for x in y.tolist()]) for y in run.states[:: len(run) // ALONG]]
        largest = max(_return_defect(one, Fraction(str(run.h)), y) for y in states)
        notes.append(f"{largest:.1e} along the paper's run at h = {run.h:g}")
    bound = Bound(0.0, _round_off(maps[0], 2), _reason(maps[0]))
    return Finding(max(figures), bound, note="; ".join(filter(None, notes)))


def irreversible(scene: Scene) -> Finding:
    """Defect of one step of 0.1 and one of -0.1, which has to exceed that of rounding."""
    found = exact_map(scene)
    figure = _return_defect(found, STEP)
    bound = Bound(_round_off(found, 2), reason=_reason(found), open_low=True)
    return Finding(figure, bound, note=_exponent(found, STEP, figure))


CONTROL_RK2 = Scene("heavy_rk2", RATIONAL)
REVERSIBLE = Kind(
    "reversible",
    "largest component of the error after a step of h = 0.1 and one of -0.1",
    "the explicit midpoint rule of the heavy top",
    lambda: reversible(CONTROL_RK2),
)
IRREVERSIBLE = Kind(
    "not reversible",
    "largest component of the error after a step of h = 0.1 and one of -0.1",
    "the HK scheme of the Euler top",
    lambda: irreversible(CONTROL_HK),
)

TIME = 10.0
"""Time over which deviations are compared at several step sizes."""
LADDER = (0.02, 0.01, 0.005)
TOLERANCE = 0.1
"""Deviation of an observed order from a whole number that the next term of the expansion in h explains."""


def order_of(errors: Sequence[float], sizes: Sequence[float]) -> float:
    """Observed order of convergence; nan if rounding hides it."""
    found = observed_order(sizes, errors, 1e-12)
    return math.nan if found is None else found


def deviation_order(scene: Scene, invariant: str, order: int) -> Finding:
    """Order in h of the largest deviation of an invariant over a fixed time."""
    errors = []
    for h in LADDER:
        run = trajectory(scene.with_sets(f"h={h:g}", f"N={round(TIME / h)}"))
        values = run[invariant]
        errors.append(float(np.abs(values - values[0]).max()))
    bound = Bound(order - TOLERANCE, order + TOLERANCE, f"a deviation of order {order} scales as h^{order}")
    return Finding(order_of(errors, LADDER), bound, note=f"deviation {errors[-1]:.1e} at h = {LADDER[-1]:g}")


DEVIATION_ORDER = Kind(
    "order of a deviation",
    "exponent of h in the largest deviation over t = 10, from h = 0.02, 0.01, 0.005",
    "the energy under the BS scheme of the Euler top, of order 1, as if of order 2",
    lambda: deviation_order(Scene("euler_bs"), "m_omega", 2),
)
