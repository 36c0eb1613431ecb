"""The checks: each answers the question of a case from runs of one scheme."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from topcli.analysis.order import OrderVerdict, convergence, is_consistent, judge_order, observed_order
from topcli.analysis.swings import minima_times
from topcli.analysis.tally import invariant_report
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array
from topcli.studies.stress.case import Finding, Result, Trial, ended_badly, fault

EPS = float(np.finfo(float).eps)
Check = Callable[[Trial], Finding]

LEFT = 0.5
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
    exact = trial.reference(motion.t)
    size = float(np.abs(exact).max()) or 1.0
    with np.errstate(all="ignore"):
        return np.abs(motion.states - exact).max(axis=1) / size, size


def keeps_order(trial: Trial) -> Finding:
    """Check that the error falls with the declared order when the step is halved twice."""
    found: list[float] = []
    for halvings in range(1 if trial.scheme.adaptive or trial.order is None else 3):
        factor = 2**halvings
        N = trial.N * factor
        motion = trial.run(trial.h / factor, N, _every(trial.N) * factor)
        wrong = fault(trial, motion)
        if wrong:
            return wrong
        errors, _ = _errors(trial, motion)
        worst = float(errors.max())
        if not worst < LEFT:
            at = int(np.argmax(~(errors < LEFT)))
            why = f"left the motion: error {errors[at]:.1g} of its size at t = {motion.t[at]:.3g}"
            return Finding(Result.BROKE, why, int(motion.n[at]), {"error": worst})
        found.append(worst)
    last = found[-1]
    if len(found) == 1:
        allowed = EXACT_ERROR if trial.order is None else ADAPTIVE_ERROR
        result = Result.HELD if last <= allowed else Result.DEGRADED
        return Finding(result, f"error {last:.1e}", figures={"error": last})
    floor = 64.0 * EPS * math.sqrt(4.0 * trial.N)
    order = observed_order([4.0, 2.0, 1.0], found, floor)
    figures = {"error": found[0], "error_quarter_step": last}
    if order is None:
        return Finding(Result.HELD, f"error {last:.1e}: round-off", figures=figures)
    assert trial.order is not None
    held = order >= trial.order - ORDER_LOST or last <= floor
    why = f"order {order:.2f}, error {found[0]:.1e}"
    return Finding(
        Result.HELD if held else Result.DEGRADED,
        why if held else f"{why}: falls short of its order {trial.order}",
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
            exact = trial.reference(motion.t)
            errors.append(float(np.abs(motion.states - exact).max()))
            size = float(np.abs(exact - exact[0]).max())
        found = convergence([4.0, 2.0, 1.0], errors)
        verdict, why = judge_order(trial.order, found, size, lambda: is_consistent(trial.top, trial.method, y0))
        if verdict is not OrderVerdict.UNDECIDED:
            return why
    return ""


def _timed(what: str, time: float, exact: float, trial: Trial, when: str = "at") -> Finding:
    off = abs(time - exact) / abs(exact)
    result = Result.HELD if off <= RIGHT else Result.DEGRADED if off <= ROUGH else Result.BROKE
    if result is Result.HELD:
        why = f"{what} {when} t = {time:.4f}, {off:.0e} off the theory"
    else:
        why = f"{what} {when} t = {time:.4f}, not {exact:.4f} ({100 * off:.0f}% off)"
    step = None if result is not Result.BROKE else round(min(time, exact) / abs(trial.h))
    return Finding(result, why, step, {"time": time, "exact": exact, "relative_error": off})


def swings_at(exact: float, spacing: bool = False) -> Check:
    """Return a check that the first deep minimum of the top's swinging component is at the time ``exact``.

    With ``spacing``, that the second minimum follows the first by ``exact``.
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
            why = f"no {'second ' * spacing}swing up to t = {motion.t[-1]:.3g}; due at {exact:.4f}"
            return Finding(Result.BROKE, why, round(exact / abs(trial.h)), {"exact": exact})
        return _timed("swings", float(times[0]), exact, trial, "after" if spacing else "at")

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
    exact = _crossing(n * trial.h, trial.closed_form(n)[:, 1])
    assert exact is not None
    motion = trial.run()
    wrong = fault(trial, motion)
    if wrong:
        return wrong
    time = _crossing(motion.t, motion.states[:, 1])
    if time is None:
        why = f"no flip up to t = {motion.t[-1]:.3g}; due at {exact:.4f}"
        return Finding(Result.BROKE, why, round(exact / abs(trial.h)), {"exact": exact})
    return _timed("flips", time, exact, trial)


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
        return Finding(Result.HELD, f"stays within {largest:.2g} times the motion's size", figures=figures)
    at = int(np.argmax(sizes > 2.0))
    why = f"grows to {largest:.1e} times the motion's size, beyond 2 at step {motion.n[at]}"
    if largest <= 100.0:
        return Finding(Result.DEGRADED, why, int(motion.n[at]), figures)
    return Finding(Result.BROKE, why, int(motion.n[at]), figures)


def returns(trial: Trial) -> Finding:
    """Check that N steps forward and N back miss the start only by the growth of round-off.

    On a regular motion independent rounding errors change the integrals by sqrt(N) ulp, and with them the rates of the
    phases: after N steps the phases are off by ulp h N^(3/2), and after the way back by a few times that.
    """
    if trial.plain:
        return Finding(Result.NOT_TRIED, "runs in the interpreter")
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
        return Finding(Result.HELD, why, figures=figures)
    if trial.scheme.self_adjoint:
        return Finding(Result.BROKE, f"claims to be self-adjoint, {why}", 2 * trial.N, figures)
    return Finding(Result.DEGRADED, f"{why}; not self-adjoint", figures=figures)


def does_not_drift(trial: Trial) -> Finding:
    """Check over a very long run that no claimed invariant has a slope beyond its uncertainty."""
    claimed = trial.claimed(trial.h)
    if not claimed:
        return Finding(Result.NOT_TRIED, "claims no invariant")
    if trial.plain:
        return Finding(Result.NOT_TRIED, "runs in the interpreter")
    motion = trial.run(every=max(1, trial.N // 8192))
    wrong = fault(trial, motion)
    if wrong:
        return wrong
    rows = invariant_report(claimed, motion.n, motion.h, motion.states)
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
        return Finding(Result.BROKE, f"drifts: {drifting[0]}", int(motion.n[-1]), figures)
    if biased:
        return Finding(Result.DEGRADED, f"round-off is biased: {biased[0]}", figures=figures)
    why = f"no slope; worst {worst.symbol}: {worst.max_deviation:.0e} after {motion.n[-1]:.0e} steps"
    return Finding(Result.HELD, why, figures=figures)
