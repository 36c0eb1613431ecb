"""Types of the hard cases: an experiment without a scheme, a question, and a check that answers it.

A case has one of these outcomes. *held*: the scheme does what it declares. *degraded*: the scheme keeps its declared
properties but loses accuracy. *broke*: the scheme blew up, did not converge, refused the case, moved far from the exact
motion, or lost a declared property. *not tried*: the case asks for a property that the scheme does not declare, or it
would take too long in the interpreter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.order import OrderVerdict, convergence, is_consistent, judge_order, observed_order
from topcli.analysis.reference import reference_states
from topcli.analysis.series_report import invariant_report
from topcli.analysis.swings import minima_times
from topcli.analysis.trajectory import Trajectory
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Floats, Invariant, Outcome, Stepper, Top
from topcli.engine.machine import Machine
from topcli.engine.plan import Plan
from topcli.runs.plans import trajectory_along
from topcli.runs.references import closed_form_of

EPS = float(np.finfo(float).eps)
INTERPRETED_STEPS = 400
"""Approximate number of steps of a scheme that runs in the interpreter, which takes longer ones instead."""

CLAIM_ULPS = 50.0
"""Allowed deviation of a claimed invariant, in ulp of its terms times sqrt(steps)."""


class CaseOutcome(StrEnum):
    """Outcome of a case, from good to bad."""

    HELD = "held"
    NOT_TRIED = "not tried"
    DEGRADED = "degraded"
    BROKE = "broke"


@dataclass(frozen=True)
class Finding:
    """Result of a check.

    ``result`` is the outcome, ``why`` the reason in one short phrase with numbers, and ``step`` the step at which the
    scheme broke, if it did. ``figures`` contains measured numbers by name.
    """

    result: CaseOutcome
    why: str
    step: int | None = None
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """Hard case for the schemes of one form of a top.

    ``config()`` returns the experiment as a config without a scheme. ``check(trial)`` answers the ``question`` for a
    trial, which is one scheme in this case.
    """

    name: str
    form: str
    question: str
    config: Callable[[], Mapping[str, Any]]
    check: Callable[[Trial], Finding]
    origin: str = "topcli"
    """Distribution or file that registered the case."""

    def experiment(self, scheme: str, options: Mapping[str, Any] | None = None) -> Experiment:
        """Return the case as an experiment with ``scheme``. Raises UsageError for unknown names and options."""
        name = f"stress_{self.name}".replace("-", "_")
        return load_experiment({"name": name, "scheme": {"name": scheme, **(options or {})}, **self.config()})


class CaseCache:
    """Cache of compiled loops, by scheme and parameters of the top, and of references, by case."""

    def __init__(self) -> None:
        self._machines: dict[Any, Machine] = {}
        self._references: dict[Any, Array] = {}

    def machine(self, experiment: Experiment) -> Machine:
        """Return the machine code of an experiment."""
        top = experiment.top
        key = (experiment.scheme.name, top.form, repr(top), repr(experiment.options))
        if key not in self._machines:
            self._machines[key] = Machine(top, experiment.method())
        return self._machines[key]

    def reference(self, top: Top, y0: Floats, times: Array) -> Array:
        """Return the reference motion at ``times``, (m, d)."""
        key = (top.form, repr(top), y0, times.tobytes())
        if key not in self._references:
            self._references[key] = reference_states(top, y0, times)
        return self._references[key]


class Trial:
    """One scheme in one hard case, the argument of a check."""

    def __init__(self, case: Case, experiment: Experiment, cache: CaseCache) -> None:
        self.case, self.experiment = case, experiment
        self.scheme, self.top, self.y0 = experiment.scheme, experiment.top, experiment.y0
        self.order = self.scheme.order_for(experiment.options)
        self._machine = cache.machine(experiment)
        self.method = self._machine.method
        self._cache = cache
        self.plain = isinstance(self.method, Stepper) and self.method.plain
        factor = max(1, experiment.N // INTERPRETED_STEPS) if self.plain else 1
        self.h, self.N = experiment.h * factor, max(1, experiment.N // factor)
        self.counters: dict[str, int] = {}
        self.claim_ulps = CLAIM_ULPS

    def run(self, h: float | None = None, N: int | None = None, every: int = 1, y0: Floats | None = None) -> Trajectory:
        """Run the case and return the trajectory; arguments replace its step size, number of steps or initial state."""
        h, N = h or self.h, N or self.N
        with np.errstate(all="ignore"):
            start, invariants = np.array([y0 or self.y0]), self.top.invariants()
            plan = Plan(self.top, self._machine, start, h, N, every, invariants=invariants)
            motion = trajectory_along(plan, self.scheme.name)
        if not self.counters:
            self.counters = dict(motion.ending.counters)
        return motion

    def reference(self, times: Array) -> Array:
        """Return the reference solution of the case at ``times``, shape (m, d)."""
        return self._cache.reference(self.top, self.y0, times)

    def closed_form(self, n: NDArray[np.int64]) -> Array:
        """Return the states of the closed form of the top after ``n`` steps (m,), shape (m, d)."""
        closed = closed_form_of(self.top)
        assert closed is not None
        return closed.states(np.array(self.y0), self.h, n, self.top.constants())

    def claimed(self, h: float) -> list[Invariant]:
        """Return the invariants that the scheme declares to conserve to round-off at step size ``h``."""
        kept = [invariant for invariant in self.top.invariants() if invariant.name in self.scheme.conserves]
        modified = self.scheme.modified(self.top, h, self.experiment.options) if self.scheme.modified else ()
        return [*kept, *modified]


def ended_badly(motion: Trajectory) -> Finding | None:
    """Return the finding on a run that did not complete; None if it did."""
    ending = motion.ending
    if ending.outcome is Outcome.COMPLETED:
        return None
    if ending.outcome is Outcome.LEFT_MOTION:
        why = f"left its energy surface at step {ending.left} (t = {ending.left_t:.4g})"
        sizes = np.abs(motion.states).max(axis=1)
        return Finding(CaseOutcome.BROKE, why, ending.left, {"largest": float(sizes.max() / sizes[0])})
    what = {Outcome.BLEW_UP: "blew up", Outcome.NO_CONVERGENCE: "did not converge"}[ending.outcome]
    return Finding(CaseOutcome.BROKE, f"{what} at step {ending.step} (t = {ending.t:.4g})", ending.step)


def claim_violated(trial: Trial, motion: Trajectory) -> Finding | None:
    """Return the finding on a run that violates a claimed invariant; None if it keeps them all."""
    with np.errstate(all="ignore"):
        for invariant in trial.claimed(motion.h):
            values = invariant.value(motion.states)
            scale = np.maximum.accumulate(invariant.scale(motion.states))
            if not (np.isfinite(values).all() and np.isfinite(scale).all()):
                continue  # terms beyond the range of a double cannot be judged
            deviation = np.abs(values - values[0])
            bound = trial.claim_ulps * EPS * np.sqrt(np.maximum(motion.n, 1)) * scale
            # a denormal has an absolute error, which no relative bound covers
            over = deviation > np.maximum(bound, 1e-300)
            if over.any():
                at = int(np.argmax(over))
                why = f"{invariant.symbol} changes by {deviation[at]:.1e} (round-off: {bound[at]:.1e})"
                return Finding(CaseOutcome.BROKE, why, int(motion.n[at]), {"deviation": float(deviation.max())})
    return None


def fault(trial: Trial, motion: Trajectory) -> Finding | None:
    """Return the finding on a run that did not complete or violates a claim; None if neither."""
    return ended_badly(motion) or claim_violated(trial, motion)


Check = Callable[[Trial], Finding]

LEFT_ERROR = 0.5
"""Error relative to the state's size from which on the scheme has left the motion."""
ORDER_LOST = 0.35
"""Allowed shortfall of the observed order from the declared one."""
ROWS = 50
SHORT = 50
"""Number of steps, far too long for accuracy, of a scheme that runs in the interpreter."""
ADAPTIVE_ERROR = 1e-6
"""Largest error, relative to the state, of a scheme that chooses its own steps to a tolerance."""
EXACT_ERROR = 1e-10
"""Largest error, relative to the state, of a closed form."""
RIGHT, ROUGH = 0.01, 0.1
"""Largest relative errors of a time for the outcomes held and degraded."""


def _every(N: int) -> int:
    return max(1, N // ROWS)


def _errors(trial: Trial, motion: Trajectory) -> tuple[Array, float]:
    """Return the largest error of each recorded state (m,) relative to the motion's size, and that size."""
    expected = trial.reference(motion.t)
    size = float(np.abs(expected).max()) or 1.0
    with np.errstate(all="ignore"):
        return np.abs(motion.states - expected).max(axis=1) / size, size


def keeps_order(trial: Trial) -> Finding:
    """Check that the error falls with the declared order when the step is halved twice."""
    worst_errors: list[float] = []
    for halvings in range(1 if trial.scheme.adaptive or trial.order is None else 3):
        factor = 2**halvings
        N = trial.N * factor
        motion = trial.run(trial.h / factor, N, _every(trial.N) * factor)
        wrong = fault(trial, motion)
        if wrong:
            return wrong
        errors, _ = _errors(trial, motion)
        worst = float(errors.max())
        if not worst < LEFT_ERROR:
            at = int(np.argmax(~(errors < LEFT_ERROR)))
            why = f"left the exact motion: error {errors[at]:.1g} times its size at t = {motion.t[at]:.3g}"
            return Finding(CaseOutcome.BROKE, why, int(motion.n[at]), {"error": worst})
        worst_errors.append(worst)
    last = worst_errors[-1]
    if len(worst_errors) == 1:
        allowed = EXACT_ERROR if trial.order is None else ADAPTIVE_ERROR
        result = CaseOutcome.HELD if last <= allowed else CaseOutcome.DEGRADED
        return Finding(result, f"error {last:.1e}", figures={"error": last})
    floor = 64.0 * EPS * math.sqrt(4.0 * trial.N)
    order = observed_order([4.0, 2.0, 1.0], worst_errors, floor)
    figures = {"error": worst_errors[0], "error_quarter_step": last}
    if order is None:
        return Finding(CaseOutcome.HELD, f"error {last:.1e}: round-off", figures=figures)
    assert trial.order is not None
    held = order >= trial.order - ORDER_LOST or last <= floor
    why = f"order {order:.2f}, error {worst_errors[0]:.1e}"
    return Finding(
        CaseOutcome.HELD if held else CaseOutcome.DEGRADED,
        why if held else f"{why}; the declared order is {trial.order}",
        figures={**figures, "order": order},
    )


def false_order(trial: Trial) -> str:
    """Reason why the declared order is false, from the errors of a generic motion; empty if it is not refuted."""
    assert trial.order is not None
    y0 = np.array(trial.y0)
    for finer in (1, 4, 16):  # until the steps are short enough to decide
        errors, size = [], 0.0
        for factor in (finer, 2 * finer, 4 * finer):
            motion = trial.run(trial.h / factor, trial.N * factor, _every(trial.N) * factor)
            expected = trial.reference(motion.t)
            errors.append(float(np.abs(motion.states - expected).max()))
            size = float(np.abs(expected - expected[0]).max())
        observed = convergence([4.0, 2.0, 1.0], errors)
        verdict, why = judge_order(trial.order, observed, size, lambda: is_consistent(trial.top, trial.method, y0))
        if verdict is not OrderVerdict.UNDECIDED:
            return why
    return ""


def _timed(what: str, time: float, due: float, trial: Trial, when: str = "at") -> Finding:
    off = abs(time - due) / abs(due)
    result = CaseOutcome.HELD if off <= RIGHT else CaseOutcome.DEGRADED if off <= ROUGH else CaseOutcome.BROKE
    if result is CaseOutcome.HELD:
        why = f"{what} {when} t = {time:.4f}, relative error {off:.0e}"
    else:
        why = f"{what} {when} t = {time:.4f}, not {due:.4f} ({100 * off:.0f}% off)"
    step = None if result is not CaseOutcome.BROKE else round(min(time, due) / abs(trial.h))
    return Finding(result, why, step, {"time": time, "exact": due, "relative_error": off})


def swings_at(due: float, spacing: bool = False) -> Check:
    """Return a check that the first deep minimum of the top's swinging component is at the time ``due``.

    With ``spacing``, that the second minimum follows the first by ``due``.
    """

    def check(trial: Trial) -> Finding:
        motion = trial.run()
        wrong = fault(trial, motion)
        if wrong:
            return wrong
        values = motion.states[:, trial.top.components.index(trial.top.swing)]
        times = minima_times(motion.t, values) if np.ptp(values) > 0.5 else np.empty(0)
        if spacing:
            times = np.diff(times)
        if not len(times):
            why = f"no {'second ' * spacing}swing up to t = {motion.t[-1]:.3g}; due at {due:.4f}"
            return Finding(CaseOutcome.BROKE, why, round(due / abs(trial.h)), {"exact": due})
        return _timed("swings", float(times[0]), due, trial, "after" if spacing else "at")

    return check


def _crossing(t: Array, values: Array) -> float | None:
    """Return the time of the first change of sign, by linear interpolation; None if there is none."""
    at = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    if not len(at):
        return None
    i = int(at[0])
    return float(t[i] + (t[i + 1] - t[i]) * values[i] / (values[i] - values[i + 1]))


def flips(trial: Trial) -> Finding:
    """Check that omega2 first changes sign at the time given by the closed form."""
    n = np.arange(trial.N + 1, dtype=np.int64)
    due = _crossing(n * trial.h, trial.closed_form(n)[:, 1])
    assert due is not None
    motion = trial.run()
    wrong = fault(trial, motion)
    if wrong:
        return wrong
    time = _crossing(motion.t, motion.states[:, 1])
    if time is None:
        why = f"no flip up to t = {motion.t[-1]:.3g}; due at {due:.4f}"
        return Finding(CaseOutcome.BROKE, why, round(due / abs(trial.h)), {"exact": due})
    return _timed("flips", time, due, trial)


def stays_bounded(trial: Trial) -> Finding:
    """Check that omega and gamma stay bounded with a step far too long for accuracy.

    The energy bounds the true motion's omega. Held: within twice the largest value of the true motion over ten of its
    time scales; degraded: within a hundred times; broke: beyond.
    """
    motion = trial.run(trial.experiment.h, SHORT) if trial.plain else trial.run()
    wrong = fault(trial, motion)
    if wrong:
        return wrong
    pace = 1.0 / max(1e-3, float(np.abs(np.array(trial.y0)).max()))
    size = float(np.abs(trial.reference(np.linspace(0.0, 10.0 * pace, 101))).max())
    sizes = np.abs(motion.states).max(axis=1) / size
    largest = float(sizes.max())
    figures = {"largest": largest}
    if largest <= 2.0:
        return Finding(CaseOutcome.HELD, f"stays within {largest:.2g} times the motion's size", figures=figures)
    at = int(np.argmax(sizes > 2.0))
    why = f"grows to {largest:.1e} times the motion's size, beyond 2 at step {motion.n[at]}"
    if largest <= 100.0:
        return Finding(CaseOutcome.DEGRADED, why, int(motion.n[at]), figures)
    return Finding(CaseOutcome.BROKE, why, int(motion.n[at]), figures)


def returns(trial: Trial) -> Finding:
    """Check that N steps forward and N back miss the start only by the growth of round-off.

    On a regular motion independent rounding errors change the integrals by sqrt(N) ulp, and with them the rates of the
    phases: after N steps the phases are off by ulp h N^(3/2), and after the way back by a few times that.
    """
    if trial.plain:
        return Finding(CaseOutcome.NOT_TRIED, "runs in the interpreter")
    there = trial.run(every=trial.N)
    wrong = ended_badly(there)
    if wrong:
        return wrong
    middle = tuple(there.states[-1].tolist())
    back = trial.run(h=-trial.h, every=trial.N, y0=middle)
    wrong = ended_badly(back)
    if wrong:
        return wrong
    size = float(np.abs(np.array(trial.y0)).max())
    missed = float(np.abs(back.states[-1] - np.array(trial.y0)).max()) / size
    bound = 4.0 * EPS * (math.sqrt(trial.N) + abs(trial.h) * trial.N**1.5)
    figures = {"missed": missed, "bound": bound}
    why = f"misses the start by {missed:.1e} (round-off: {bound:.1e})"
    if missed <= bound:
        return Finding(CaseOutcome.HELD, why, figures=figures)
    if trial.scheme.self_adjoint:
        return Finding(CaseOutcome.BROKE, f"declared self-adjoint, but {why}", 2 * trial.N, figures)
    return Finding(CaseOutcome.DEGRADED, f"{why}; not self-adjoint", figures=figures)


def does_not_drift(trial: Trial) -> Finding:
    """Check over a very long run that no claimed invariant has a slope beyond its uncertainty."""
    claimed = trial.claimed(trial.h)
    if not claimed:
        return Finding(CaseOutcome.NOT_TRIED, "declares no invariant")
    if trial.plain:
        return Finding(CaseOutcome.NOT_TRIED, "runs in the interpreter")
    motion = trial.run(every=max(1, trial.N // 8192))
    wrong = fault(trial, motion)
    if wrong:
        return wrong
    rows, _ = invariant_report(trial.top, claimed, motion.n, motion.h, motion.states)
    figures: dict[str, float] = {}
    biased, drifting = [], []
    for row in rows:
        # an ulp of the terms: the report's bound is 20 sqrt(N) of them
        ulp = row.round_off_bound / (20.0 * math.sqrt(motion.n[-1])) or EPS
        slope, error = row.drift_over_run or 0.0, abs((row.drift_error or 0.0) * float(motion.t[-1]))
        figures |= {
            f"{row.name}:ulp": row.max_deviation / ulp,
            f"{row.name}:sigma": abs(slope) / error if error else 0.0,
        }
        slope_text = f"{row.symbol} {slope:+.1e} ± {error:.0e} over t = {motion.t[-1]:.3g}"
        if row.verdict in ("drifting", "lost"):
            drifting.append(slope_text)
        elif error and abs(slope) > 5.0 * error and abs(slope) > 3.0 * math.sqrt(motion.n[-1]) * ulp:
            biased.append(slope_text)
    worst = max(rows, key=lambda row: row.max_deviation / (row.round_off_bound or 1.0))
    if drifting:
        return Finding(CaseOutcome.BROKE, f"drifts: {drifting[0]}", int(motion.n[-1]), figures)
    if biased:
        return Finding(CaseOutcome.DEGRADED, f"round-off is biased: {biased[0]}", figures=figures)
    why = f"no drift; largest deviation: {worst.symbol}, {worst.max_deviation:.0e} after {motion.n[-1]:.0e} steps"
    return Finding(CaseOutcome.HELD, why, figures=figures)
