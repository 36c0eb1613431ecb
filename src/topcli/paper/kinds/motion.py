"""Checks by runs in doubles: ranges, slopes, sizes of deviations, and orders of convergence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array, Top
from topcli.paper.claim import Bound, Finding, Kind
from topcli.paper.kinds.conservation import LADDER, TIME, TOLERANCE, order_of
from topcli.paper.scenes import Scene, trajectory
from topcli.runs.simulate_ensemble import simulate_ensemble

JACOBIANS = 200
"""States of a run at which the rates of change of the field are looked at."""


def stated_range(scene: Scene, column: str, low: float, high: float, last_digit: float) -> Finding:
    """Largest difference between the range of a column and a stated one, rounded to ``last_digit``."""
    values = trajectory(scene)[column]
    figure = max(abs(float(values.min()) - low), abs(float(values.max()) - high))
    bound = Bound(0.0, 0.5 * last_digit, "half a unit of the last digit stated", approximate=True)
    return Finding(figure, bound, note=f"{values.min():.9f} to {values.max():.9f}")


def rate_of_change(top: Top, states: Array) -> float:
    """Largest spectral norm of the Jacobian of the field along ``states`` (m, d); differences, exact for quadratics."""
    p, d = top.constants(), len(top.components)
    largest = 0.0
    for y in states[:: max(1, len(states) // JACOBIANS)]:
        columns = [
            np.subtract(top.field(tuple(y + e), p), top.field(tuple(y - e), p)) for e in 0.5 * np.eye(d, dtype=float)
        ]
        largest = max(largest, float(np.linalg.norm(np.array(columns), 2)))
    return largest


def _relative(run: Trajectory, invariant: str) -> float:
    one = next(one for one in (*run.top.invariants(), *run.modified) if one.name == invariant)
    values = one.value(run.states)
    return float(np.abs(values - values[0]).max() / one.scale(run.states).max())


def small(scene: Scene, invariants: Sequence[str]) -> Finding:
    """Largest relative deviation of several invariants, against what a step of order 2 may show."""
    run = trajectory(scene)
    size = (run.h * rate_of_change(run.top, run.states)) ** 2
    bound = Bound(0.0, size, "order 2: (h|J|)², J the Jacobian of the field", approximate=True)
    return Finding(max(_relative(run, name) for name in invariants), bound)


def same_quality(scenes: Sequence[Scene], invariants: Sequence[str]) -> Finding:
    """Largest ratio of the deviations of an invariant under schemes of one order."""
    ratios, notes = [], []
    for name in invariants:
        found = {}
        for scene in scenes:
            values = trajectory(scene)[name]
            found[trajectory(scene).scheme] = float(np.abs(values - values[0]).max())
        ratios.append(max(found.values()) / min(found.values()))
        symbol = next(one.symbol for one in trajectory(scenes[0]).top.invariants() if one.name == name)
        notes.append(f"{symbol}: " + ", ".join(f"{scheme} {value:.2g}" for scheme, value in found.items()))
    bound = Bound(0.0, 2.0, "schemes of one order whose error constants differ by less than a factor of 2")
    return Finding(max(ratios), bound, note="; ".join(notes))


def unequal_quality(scenes: Sequence[Scene], invariants: Sequence[str]) -> Finding:
    """Largest ratio of the deviations of an invariant under schemes that are said to differ."""
    found = same_quality(scenes, invariants)
    return replace(found, bound=Bound(2.0, reason="more than the difference of error constants"))


def slopes_differ(scheme: str, other: str) -> Finding:
    """Median ratio of the slopes of E(t) under two schemes, over random orbits at E = 5."""
    slopes = []
    for name in (scheme, other):
        runs = simulate_ensemble("kowalevski_hk", scheme=name, **SLOPES)
        series = [runs.trajectory(index) for index in range(len(runs))]
        slopes.append(np.array([abs(float(np.polyfit(run.t, run["energy"], 1)[0])) for run in series]))
    ratios = slopes[0] / slopes[1]
    note = f"{scheme} {np.median(slopes[0]):.1e}, {other} {np.median(slopes[1]):.1e} in the median"
    bound = Bound(10.0, reason="ten times what the error constants of two schemes without drift explain")
    return Finding(float(np.median(ratios)), bound, note=note)


SLOPES: dict[str, Any] = {
    "h": 0.1,
    "N": 50000,
    "output": {"every": 10},
    "ensemble": {
        "random": {"count": 64, "seed": 1, "gamma": "sphere", "omega": {"energy": 5.0}},
        "store": "trajectories",
    },
}


def convergence_order(scene: Scene, order: int) -> Finding:
    """Order in h of the error at t = 10 against the reference, which has to be ``order`` at least."""
    errors = []
    for h in LADDER:
        run = trajectory(scene.with_sets(f"h={h:g}", f"N={round(TIME / h)}"))
        end = reference_states(run.top, run.states[0].tolist(), np.array([0.0, TIME]))[-1]
        errors.append(float(np.abs(run.states[-1] - end).max()))
    bound = Bound(order - TOLERANCE, reason=f"an error of order {order} or higher")
    return Finding(order_of(errors, LADDER), bound, note=f"error {errors[-1]:.1e} at h = {LADDER[-1]:g}")


BOHLINS = tuple(Scene(f"kowalevski_bohlin_{letter}") for letter in "abc")
"""Bohlin's method with (A), (B) and (C) in the scene of Figure 2."""
BOHLIN = BOHLINS[0]
RANGE = Kind(
    "stated range",
    "largest difference of the extremes from the two stated numbers",
    "k² under HK with h = 0.002 instead of 0.001",
    lambda: stated_range(Scene("kowalevski_hk", ("h=0.002", "N=25000")), "k_sq", 9.000003, 9.000011, 1e-6),
)
SMALL = Kind(
    "small deviation",
    "largest deviation relative to the size of the terms",
    "m·ω under the BS scheme of the Euler top, of order 1",
    lambda: small(Scene("euler_bs"), ("m_omega",)),
)
UNEQUAL = Kind(
    "unequal quality",
    "largest ratio of the deviations among the schemes",
    "Bohlin A, B and C on Figure 2's run",
    lambda: unequal_quality(BOHLINS, ["energy", "two_l"]),
)
SLOPE = Kind(
    "different slopes",
    "median ratio of the slopes of E(t) under two schemes, over 64 random orbits",
    "HK against the reversible hybrid, neither of which drifts",
    lambda: slopes_differ("hk", "hybrid-sym"),
)
QUALITY = Kind(
    "equal quality",
    "ratio of the largest to the smallest deviation among the schemes",
    "the explicit midpoint rule and RK4",
    lambda: same_quality((Scene("heavy_rk2"), Scene("heavy_rk4")), ["energy"]),
)
CONVERGENCE = Kind(
    "order of convergence",
    "exponent of h in the error at t = 10, from h = 0.02, 0.01, 0.005",
    "the BS scheme of the Euler top, of order 1, as if of order 2",
    lambda: convergence_order(Scene("euler_bs"), 2),
)
