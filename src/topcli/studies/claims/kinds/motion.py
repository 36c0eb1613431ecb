"""Checks by runs in doubles: ranges, drifts, sizes of deviations, and orders of convergence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array, Outcome, Top
from topcli.studies.claims.claim import Bound, Finding, Kind
from topcli.studies.claims.kinds.conservation import LADDER, TIME, TOLERANCE, order_of
from topcli.studies.claims.scenes import Scene, trajectory

JACOBIANS = 200
"""States of a run at which the rates of change of the field are looked at."""


def stated_range(scene: Scene, column: str, low: float, high: float, last_digit: float) -> Finding:
    """Largest difference between the range of a column and a stated one, rounded to ``last_digit``."""
    values = trajectory(scene)[column]
    figure = max(abs(float(values.min()) - low), abs(float(values.max()) - high))
    bound = Bound(0.0, 0.5 * last_digit, "half a unit of the last digit stated", approximate=True)
    return Finding(figure, bound, note=f"{values.min():.9f} to {values.max():.9f}")


def periodic(scene: Scene, column: str) -> Finding:
    """Range of a column over a run, in units of its range in the first tenth of the run."""
    run = trajectory(scene)
    values = run[column]
    figure = float(np.ptp(values) / np.ptp(values[: len(values) // 10]))
    reason = "a periodic function has one range; 1.5 allows for several frequencies, a drift would give 10"
    return Finding(figure, Bound(0.0, 1.5, reason), note=f"{values.min():.8g} to {values.max():.8g}")


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


def worse(one: Scene, other: Scene, invariant: str) -> Finding:
    """Deviation of an invariant under one scheme, in units of that under another."""
    sizes = [float(np.abs(trajectory(s)[invariant] - trajectory(s)[invariant][0]).max()) for s in (one, other)]
    note = ", ".join(f"{trajectory(s).scheme} {size:.2g}" for s, size in zip((one, other), sizes, strict=True))
    bound = Bound(2.0, reason="more than the difference of error constants")
    return Finding(sizes[0] / sizes[1], bound, note=note)


def complete(scenes: Sequence[Scene]) -> Finding:
    """Smallest part of the steps of a run that is completed by each of several methods."""
    parts = {}
    for scene in scenes:
        run = trajectory(scene)
        done = run.ending.step if run.outcome is Outcome.COMPLETED else run.ending.step - 1
        parts[scene] = done / scene.experiment().N
    note = "; ".join(
        f"{trajectory(s).scheme} {trajectory(s).ending.message}" for s, part in parts.items() if part < 1.0
    )
    return Finding(min(parts.values()), Bound(1.0, 1.0, "a method defined at every state completes the run"), note=note)


def convergence_order(scene: Scene, order: int) -> Finding:
    """Order in h of the error at t = 10 against the reference."""
    errors = []
    for h in LADDER:
        run = trajectory(scene.with_sets(f"h={h:g}", f"N={round(TIME / h)}"))
        end = reference_states(run.top, run.states[0].tolist(), np.array([0.0, TIME]))[-1]
        errors.append(float(np.abs(run.states[-1] - end).max()))
    bound = Bound(order - TOLERANCE, order + TOLERANCE, f"the error of order {order} scales as h^{order}")
    return Finding(order_of(errors, LADDER), bound, note=f"error {errors[-1]:.1e} at h = {LADDER[-1]:g}")


BOHLIN = Scene("kowalevski_bohlin_a")
RANGE = Kind(
    "stated range",
    "largest difference of the extremes from the two stated numbers",
    "k² under HK with h = 0.002 instead of 0.001",
    lambda: stated_range(Scene("kowalevski_hk", ("h=0.002", "N=25000")), "k_sq", 9.000003, 9.000011, 1e-6),
)
PERIODIC = Kind(
    "periodic change",
    "range of the quantity over the run divided by that over its first tenth",
    "m·ω under the BS scheme of the Euler top, which grows",
    lambda: periodic(Scene("euler_bs"), "m_omega"),
)
SMALL = Kind(
    "small deviation",
    "largest deviation relative to the size of the terms",
    "m·ω under the BS scheme of the Euler top, of order 1",
    lambda: small(Scene("euler_bs"), ("m_omega",)),
)
WORSE = Kind(
    "unequal quality",
    "ratio of the deviations under the two schemes",
    "Bohlin A and Bohlin C",
    lambda: worse(BOHLIN, Scene("kowalevski_bohlin_c"), "energy"),
)
COMPLETE = Kind(
    "completed run",
    "smallest part of the steps that the methods complete",
    "the explicit midpoint rule of a heavy top at h = 10, which blows up",
    lambda: complete((Scene("euler_hk"), Scene("heavy_rk2", ("h=10",)))),
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
