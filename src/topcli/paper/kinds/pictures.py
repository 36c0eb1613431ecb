"""Content of the paper's pictures: curves that coincide or differ in print, and the time between swings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from topcli.analysis.swings import swing_spacing
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.kinds.motion import BOHLIN, BOHLINS
from topcli.paper.scenes import Scene, trajectory
from topcli.paper.swing_period import EPS, TIME, spacing_law

WIDTH, HEIGHT = 45.0, 33.75
"""Size of a panel of the paper in millimetres: 4.5 cm wide, in the usual proportion of 4 to 3."""
LINE = 0.5 * 25.4 / 72.0
"""Width in millimetres of a line of 0.5 points, the thinnest usual one."""
SPACING = 0.1 * LINE
"""Distance between neighbouring points of a curve, which a distance between curves may be off by."""
VECTORS = ("gamma1", "gamma2", "gamma3", "omega1", "omega2", "omega3")
HK = Scene("kowalevski_hk")


def _apart(a: Array, b: Array) -> float:
    """Largest distance of a point of one curve (m, 2) from the nearest point of the other, both ways."""
    from scipy.spatial import KDTree

    return max(float(KDTree(a).query(b)[0].max()), float(KDTree(b).query(a)[0].max()))


def _curves(runs: Sequence[Trajectory], columns: Sequence[str]) -> list[list[Array]]:
    """Curves of the columns of one panel, in millimetres, for each run."""
    values = [[run[name] for name in columns] for run in runs]
    low, high = (float(bound([bound(v) for group in values for v in group])) for bound in (np.min, np.max))
    span = max(float(run.t[-1]) for run in runs)
    return [
        [_resampled(run.t / span * WIDTH, v / (high - low) * HEIGHT) for v in group]
        for run, group in zip(runs, values, strict=True)
    ]


def _resampled(x: Array, y: Array) -> Array:
    """Points (m, 2) on a curve, ``SPACING`` apart along it."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.arange(0.0, along[-1], SPACING)
    return np.column_stack([np.interp(at, along, x), np.interp(at, along, y)])


def _largest(one: Scene, other: Scene) -> float:
    runs = (trajectory(one), trajectory(other))
    largest = 0.0
    for panel in (VECTORS[:3], VECTORS[3:]):
        for a, b in zip(*_curves(runs, panel), strict=True):
            largest = max(largest, _apart(a, b))
    return largest


def same_picture(one: Scene, others: Sequence[Scene]) -> Finding:
    """Largest distance in print between the curves of gamma and omega of ``one`` and of the ``others``."""
    bound = Bound(0.0, LINE, "the width of a line of 0.5 pt in a panel of 45 mm", "mm", approximate=True)
    return Finding(max(_largest(one, other) for other in others), bound)


def other_picture(one: Scene, other: Scene) -> Finding:
    """Largest distance in print between two pictures that are said to differ."""
    return Finding(_largest(one, other), Bound(LINE, reason="the width of a line of 0.5 pt", unit="mm"))


def constant_line(scene: Scene, column: str, span: float) -> Finding:
    """Height in print of the range of a column on an axis that covers ``span``."""
    values = trajectory(scene)[column]
    bound = Bound(0.0, LINE, "the width of a line of 0.5 pt in a panel of 34 mm", "mm", approximate=True)
    return Finding(float(np.ptp(values)) / span * HEIGHT, bound, note=f"{values.min():.6g} to {values.max():.6g}")


def invisible_change(scenes: Sequence[Scene], column: str, model: Scene) -> Finding:
    """Largest height in print of the range of a column, on the axis that the range of ``model`` fills."""
    span = float(np.ptp(trajectory(model)[column]))
    heights = {s: float(np.ptp(trajectory(s)[column])) / span * HEIGHT for s in scenes}
    note = ", ".join(f"{trajectory(s).scheme} {height:.2g}" for s, height in heights.items())
    return Finding(max(heights.values()), Bound(0.0, LINE, "the width of a line of 0.5 pt", "mm"), note=note)


def _spacing(scene: Scene) -> float:
    run = trajectory(scene)
    found = swing_spacing(run.t, run["gamma1"])
    return math.nan if found is None else found


def other_period(scenes: Sequence[Scene]) -> Finding:
    """Smallest relative difference between the time between swings and that of the motion."""
    law = float(spacing_law(np.array(EPS)))
    found = {trajectory(scene).scheme: _spacing(scene) for scene in scenes}
    figure = min(abs(spacing / law - 1.0) for spacing in found.values())
    visible = LINE / WIDTH * TIME / law
    note = ", ".join(f"{name} {spacing:.4f}" for name, spacing in found.items()) + f"; motion {law:.4f}"
    return Finding(figure, Bound(visible, reason="a line's width on the paper's axis 0 to 50"), note=note)


SAME_PICTURE = Kind(
    "equal pictures",
    "largest distance between the curves in panels of 45 mm by 34 mm",
    "Figure 2 against Figure 1",
    lambda: same_picture(HK, [BOHLIN]),
)
OTHER_PICTURE = Kind(
    "different pictures",
    "largest distance between the curves in panels of 45 mm by 34 mm",
    "RK4 against HK",
    lambda: other_picture(HK, Scene("kowalevski_rk4")),
)
CONSTANT_LINE = Kind(
    "straight line",
    "height of the curve on an axis from 0 to 6",
    "omega_3 of Figure 2",
    lambda: constant_line(BOHLIN, "omega3", 6.0),
)
INVISIBLE = Kind(
    "invisible change",
    "largest height of the curve on the axis of Figure 3, right",
    "the energy under Bohlin B",
    lambda: invisible_change([BOHLINS[1]], "energy", BOHLIN),
)
OTHER_PERIOD = Kind(
    "different period",
    "smallest relative difference of the time between swings from that of the motion",
    "HK, which has the right period",
    lambda: other_period([HK]),
)
