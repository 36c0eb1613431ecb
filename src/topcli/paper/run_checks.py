"""Checks of claims by runs in doubles: orders, ranges, levels between swings, pictures, neighbouring orbits.

A check takes the parameters that the ledger gives and returns what it measures. It knows neither the statement nor its
recorded verdict.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from topcli.analysis.lax import block_form, kowalevski_form, spectral_content
from topcli.analysis.order import observed_order
from topcli.analysis.reference import reference_states
from topcli.analysis.swings import first_swing_spacing, minima_times, spacing_law
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array, Top
from topcli.paper.claim import Measurement
from topcli.paper.exact_checks import Formula
from topcli.paper.scenes import LedgerScene, invariant_named
from topcli.runs.simulate import simulate
from topcli.tops import TOPS
from topcli.tops.bodies import checked_equations

# orders in h

ORDER_TIME = 10.0
"""Time over which errors are compared at several step sizes."""
LADDER = (0.02, 0.01, 0.005)
TOLERANCE = 0.1
"""Deviation of an observed order from a whole number that the next term of the expansion in h explains."""


def _order(errors: Sequence[float]) -> float:
    """Observed order of convergence over ``LADDER``; nan if rounding hides it."""
    order = observed_order(LADDER, errors, 1e-12)
    return math.nan if order is None else order


def _runs(scene: LedgerScene) -> list[Trajectory]:
    """Runs over a fixed time at the steps of ``LADDER``."""
    return [scene.with_sets(f"h={h:g}", f"N={round(ORDER_TIME / h)}").trajectory() for h in LADDER]


def deviation_order(scene: LedgerScene, invariant: str, order: int) -> Measurement:
    """Order in h of the largest deviation of an invariant over a fixed time."""
    errors = [float(np.abs(run[invariant] - run[invariant][0]).max()) for run in _runs(scene)]
    return Measurement(_order(errors), order, note=f"deviation {errors[-1]:.1e} at h = {LADDER[-1]:g}")


def convergence_order(scene: LedgerScene, order: int) -> Measurement:
    """Order in h of the error at t = 10 against the reference, which has to be ``order`` at least."""
    errors = []
    for run in _runs(scene):
        end = reference_states(run.top, run.states[0].tolist(), np.array([0.0, ORDER_TIME]))[-1]
        errors.append(float(np.abs(run.states[-1] - end).max()))
    return Measurement(_order(errors), order - TOLERANCE, note=f"error {errors[-1]:.1e} at h = {LADDER[-1]:g}")


def equation_order(scene: LedgerScene, equation: Formula, order: int) -> Measurement:
    """Exponent of h in the residual of an equation along the motion to t = 10, less one."""
    experiment = scene.experiment()
    residuals = []
    for h in LADDER:
        times = h * np.arange(round(ORDER_TIME / h) + 1)
        states = reference_states(experiment.top, experiment.y0, times).T
        residual = equation(experiment.top.constants()[0], h, states[:, :-1], states[:, 1:], np)
        residuals.append(float(np.abs(residual).max()))
    return Measurement(_order(residuals) - 1.0, order, note=f"residual {residuals[-1]:.1e} at h = {LADDER[-1]:g}")


# sizes of deviations

JACOBIANS = 200
"""States of a run at which the rates of change of the field are looked at."""


def stated_range(scene: LedgerScene, column: str, low: float, high: float, last_digit: float) -> Measurement:
    """Largest difference between the range of a column and a stated one, rounded to ``last_digit``."""
    values = scene.trajectory()[column]
    figure = max(abs(float(values.min()) - low), abs(float(values.max()) - high))
    return Measurement(figure, 0.5 * last_digit, note=f"{values.min():.9f} to {values.max():.9f}")


def rate_of_change(top: Top, states: Array) -> float:
    """Largest spectral norm of the Jacobian of the field along ``states`` (m, d); differences, exact for quadratics."""
    p, shifts = top.constants(), 0.5 * np.eye(len(top.components))
    norms = []
    for y in states[:: max(1, len(states) // JACOBIANS)]:
        columns = [np.subtract(top.field(tuple(y + shift), p), top.field(tuple(y - shift), p)) for shift in shifts]
        norms.append(float(np.linalg.norm(np.array(columns), 2)))
    return max(norms)


def small(scene: LedgerScene, invariants: list[str]) -> Measurement:
    """Largest relative deviation of several invariants, against what a step of order 2 may show."""
    run = scene.trajectory()
    figures = []
    for name in invariants:
        invariant = invariant_named(run.rows.plan.invariants, name)
        values = invariant.value(run.states)
        figures.append(float(np.abs(values - values[0]).max() / invariant.scale(run.states).max()))
    return Measurement(max(figures), (run.h * rate_of_change(run.top, run.states)) ** 2)


def quality(scenes: list[LedgerScene], invariants: list[str]) -> Measurement:
    """Largest ratio of the deviations of an invariant under several schemes."""
    ratios, notes = [], []
    runs = [scene.trajectory() for scene in scenes]
    for name in invariants:
        deviations = {run.scheme: float(np.abs(run[name] - run[name][0]).max()) for run in runs}
        ratios.append(max(deviations.values()) / min(deviations.values()))
        listed = ", ".join(f"{scheme} {value:.2g}" for scheme, value in deviations.items())
        notes.append(f"{invariant_named(runs[0].top.invariants(), name).symbol}: {listed}")
    return Measurement(max(ratios), note="; ".join(notes))


# levels between swings


def levels_between_swings(run: Trajectory, column: str) -> tuple[Array, float]:
    """Values of a column at the start, halfway between swings and at the end, and its range over the run.

    A swing is a deep minimum of gamma_1 with time before it: one in the first tenth of the run belongs to the start.
    """
    swings = minima_times(run.t, run["gamma1"])
    swings = swings[swings > run.t[-1] / 10]
    at = np.concatenate([[0.0], 0.5 * (swings[1:] + swings[:-1]), [run.t[-1]]])
    return np.interp(at, run.t, run[column]), float(np.ptp(run[column]))


def _listed(levels: Array) -> str:
    return "levels between swings " + ", ".join(f"{value:.10g}" for value in np.round(levels, 9))


def returns(scenes: list[LedgerScene], column: str) -> Measurement:
    """Largest deviation of the levels of a column between swings from the first, in units of its range."""
    figures, notes = [], []
    for scene in scenes:
        levels, size = levels_between_swings(scene.trajectory(), column)
        figures.append(float(np.abs(levels - levels[0]).max()) / size)
        notes.append(f"{scene.trajectory().scheme}: range {size:.1e}, {_listed(levels)}")
    return Measurement(max(figures), note="; ".join(notes))


def rises(scene: LedgerScene, column: str) -> Measurement:
    """Smallest rise of a column from one level between swings to the next, in units of the mean rise of its range."""
    levels, size = levels_between_swings(scene.trajectory(), column)
    return Measurement(float(np.diff(levels).min()) * (len(levels) - 1) / size, note=_listed(levels))


# pictures

WIDTH, HEIGHT = 45.0, 33.75
"""Size of a panel of the paper in millimetres: 4.5 cm wide, in the usual proportion of 4 to 3."""
LINE = 0.5 * 25.4 / 72.0
"""Width in millimetres of a line of 0.5 points, the thinnest usual one."""
SPACING = 0.1 * LINE
"""Distance between neighbouring points of a curve, which a distance between curves may be off by."""
PANELS = (("gamma1", "gamma2", "gamma3"), ("omega1", "omega2", "omega3"))


def curve_distance(a: Array, b: Array) -> float:
    """Largest distance of a point of one curve (m, 2) from the nearest point of the other, both ways."""
    from scipy.spatial import KDTree

    return max(float(KDTree(a).query(b)[0].max()), float(KDTree(b).query(a)[0].max()))


def resampled(x: Array, y: Array) -> Array:
    """Points (m, 2) on a curve, ``SPACING`` apart along it."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    at = np.arange(0.0, along[-1], SPACING)
    return np.column_stack([np.interp(at, along, x), np.interp(at, along, y)])


def _curves(runs: Sequence[Trajectory], columns: Sequence[str]) -> list[list[Array]]:
    """Curves of the columns of one panel, in millimetres, for each run."""
    values = np.concatenate([run[name] for run in runs for name in columns])
    span, height = max(float(run.t[-1]) for run in runs), HEIGHT
    return [[resampled(run.t / span * WIDTH, run[name] / np.ptp(values) * height) for name in columns] for run in runs]


def pictures(scene: LedgerScene, others: list[LedgerScene]) -> Measurement:
    """Largest distance in print between the curves of gamma and omega of one scene and of the others."""
    figure = 0.0
    for other in others:
        for panel in PANELS:
            for a, b in zip(*_curves((scene.trajectory(), other.trajectory()), panel), strict=True):
                figure = max(figure, curve_distance(a, b))
    return Measurement(figure, LINE)


def height(scene: LedgerScene, column: str, axis: float) -> Measurement:
    """Height in print of the range of a column, on an axis that covers ``axis``."""
    values = scene.trajectory()[column]
    note = f"{values.min():.6g} to {values.max():.6g}"
    return Measurement(float(np.ptp(values)) / axis * HEIGHT, LINE, note=note)


def period(scenes: list[LedgerScene]) -> Measurement:
    """Smallest relative difference between the time between swings and that of the motion."""
    runs = [scene.trajectory() for scene in scenes]
    law = float(spacing_law(runs[0]["gamma3"][:1])[0])
    spacings = {run.scheme: first_swing_spacing(run.t, run["gamma1"]) or math.nan for run in runs}
    figure = min(abs(spacing / law - 1.0) for spacing in spacings.values())
    listed = ", ".join(f"{name} {spacing:.4f}" for name, spacing in spacings.items())
    note = f"time between swings: {listed}; exact motion {law:.4f}"
    return Measurement(figure, LINE / WIDTH * float(runs[0].t[-1]) / law, note=note)


# signs of integrability

NEAR = 1e-9
PARTING_STEPS = 2000
PAIRS = 32


def _decades(a: Trajectory, b: Trajectory) -> float:
    """Decades by which two motions have parted at the end."""
    return math.log10(float(np.abs(a.states[-1] - b.states[-1]).max()) / NEAR)


def neighbours(scene: LedgerScene) -> Measurement:
    """Decades by which two neighbouring motions part over a run."""
    experiment = scene.experiment()
    y0 = list(experiment.y0)
    y0[0] += NEAR
    vectors = {name: y0[slice(*span)] for name, span in experiment.top.vectors.items()}
    beside = scene.with_sets(*(f"initial.{name}={value!r}" for name, value in vectors.items()))
    return Measurement(_decades(scene.trajectory(), beside.trajectory()), math.log10(experiment.duration) + 2.0)


def map_neighbours(scheme: str, h: float) -> Measurement:
    """Largest number of decades by which neighbours part under a map, over random orbits that both complete."""
    draws = np.random.default_rng(1)
    states = []
    for _ in range(PAIRS):
        omega, gamma = draws.normal(scale=1.5, size=3), draws.normal(size=3)
        for shift in (0.0, NEAR):
            near = omega + np.array([shift, 0.0, 0.0])
            states.append({"omega": near.tolist(), "gamma": (gamma / np.linalg.norm(gamma)).tolist()})
    ensemble = {"states": states, "store": "trajectories"}
    runs = simulate("kowalevski_hk", scheme=scheme, h=h, N=PARTING_STEPS, ensemble=ensemble)
    pairs = [(runs[2 * index], runs[2 * index + 1]) for index in range(PAIRS)]
    decades = [_decades(a, b) for a, b in pairs if len(a) == len(b) == PARTING_STEPS + 1]
    least = math.log10(PARTING_STEPS) + 2.0
    note = f"more than the bound for {sum(value > least for value in decades)} of {len(decades)} pairs of orbits"
    return Measurement(max(decades), least, note=note)


def spectrum(top: str, form: str) -> Measurement:
    """Number of independent integrals in the spectrum of a Lax form, and in its block traces if it has blocks."""
    body: Any = TOPS[top].new()
    lax = {"block": block_form, "kowalevski": kowalevski_form}[form](checked_equations(body, "the ledger"))
    symbols = {invariant.name: invariant.symbol for invariant in body.invariants()}
    independent, notes = 0, []
    for traced in dict.fromkeys((replace(lax, blocks=1), lax)):
        independent, carried = spectral_content(traced, body.invariants(), len(body.components))
        notes.append(f"{traced.traced}: {', '.join(symbols[name] for name in carried)}")
    return Measurement(float(independent), note="; ".join(notes))
