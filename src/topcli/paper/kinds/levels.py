"""Levels of a quantity between the swings of a top: whether it returns, rises at each swing, or grows in a long run."""

from __future__ import annotations

import numpy as np

from topcli.analysis.swings import minima_times
from topcli.contracts import Array
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.kinds.pictures import BOHLIN, HK
from topcli.paper.scenes import Scene, trajectory

TENTH = 10
"""Part of a run, one over this number, with whose range that of the whole run is compared."""


def levels_between_swings(scene: Scene, column: str) -> tuple[Array, float]:
    """Values of a column at the start, halfway between swings and at the end, and its range over the run.

    A swing is a deep minimum of gamma_1 with time before it: one in the first tenth of the run belongs to the start.
    """
    run = trajectory(scene)
    swings = minima_times(run.t, run["gamma1"])
    swings = swings[swings > run.t[-1] / TENTH]
    at = np.concatenate([[0.0], 0.5 * (swings[1:] + swings[:-1]), [run.t[-1]]])
    return np.interp(at, run.t, run[column]), float(np.ptp(run[column]))


def _listed(levels: Array) -> str:
    return "between swings " + ", ".join(f"{value:.10g}" for value in np.round(levels, 9))


def returns(column: str, *scenes: Scene) -> Finding:
    """Largest deviation of the levels of a column between swings from the first, in units of its range."""
    figures, notes = [], []
    for scene in scenes:
        levels, size = levels_between_swings(scene, column)
        figures.append(float(np.abs(levels - levels[0]).max()) / size)
        notes.append(f"{trajectory(scene).scheme}: range {size:.1e}, {_listed(levels)}")
    bound = Bound(0.0, 0.1, "an oscillation returns: between swings it is within a tenth of its range of its start")
    return Finding(max(figures), bound, note="; ".join(notes))


def rises(scene: Scene, column: str) -> Finding:
    """Smallest rise of a column from one level between swings to the next, in units of the mean rise of its range."""
    levels, size = levels_between_swings(scene, column)
    bound = Bound(0.5, reason="equal rises that fill the range make 1, an oscillation 0")
    return Finding(float(np.diff(levels).min()) * (len(levels) - 1) / size, bound, note=_listed(levels))


def _growth(scene: Scene, column: str) -> tuple[float, str]:
    """Range of a column over a run, in units of its range in the first tenth of the run, and its extremes."""
    values = trajectory(scene)[column]
    figure = float(np.ptp(values) / np.ptp(values[: len(values) // TENTH]))
    return figure, f"{values.min():.8g} to {values.max():.8g}"


def stays(scene: Scene, column: str) -> Finding:
    """Range of a column over a run, in units of that of the first tenth, of a quantity that does not grow."""
    figure, note = _growth(scene, column)
    reason = "a periodic function has one range; 1.5 allows for several frequencies, a drift would give 10"
    return Finding(figure, Bound(0.0, 1.5, reason), note=note)


def grows(scene: Scene, column: str) -> Finding:
    """Range of a column over a run, in units of that of the first tenth, of a quantity that grows."""
    figure, note = _growth(scene, column)
    return Finding(figure, Bound(5.0, reason="steady growth gives 10, a periodic function 1"), note=note)


RETURNS = Kind(
    "oscillation",
    "largest deviation of the levels between swings from the first, in units of the range",
    "the energy of Figure 3, which rises",
    lambda: returns("energy", BOHLIN),
)
RISES = Kind(
    "rise at each swing",
    "smallest rise from a level between swings to the next, in units of the range over the number of swings",
    "k² under HK, which returns",
    lambda: rises(HK, "k_sq"),
)
STAYS = Kind(
    "no growth",
    "range of the quantity over the run divided by that over its first tenth",
    "m·ω under the BS scheme of the Euler top, which grows",
    lambda: stays(Scene("euler_bs"), "m_omega"),
)
GROWS = Kind(
    "growth",
    "range of the quantity over the run divided by that over its first tenth",
    "m² under the HK scheme of the Euler top, which is periodic",
    lambda: grows(Scene("euler_hk"), "m_sq"),
)
