"""A hard case: an experiment without a scheme, a question about it, and a check that answers it.

Outcomes: *held*: the scheme does what it claims. *degraded*: it keeps every claim but loses its accuracy. *broke*: it
blew up, did not converge, refused the case, left the motion altogether, or violated a claim. *not tried*: the case
asks something that the scheme does not claim, or would take too long in the interpreter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import reference_states
from topcli.analysis.trajectory import Trajectory
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Floats, Invariant, Method, Outcome, Sampler, Stepper, Top
from topcli.engine.driver import Loop, loop_of
from topcli.engine.loop import Run
from topcli.schemes.registry import find_scheme

PLAIN_STEPS = 400
"""Approximate number of steps of a scheme that runs in the interpreter, which takes longer ones instead."""

CLAIM_ULPS = 50.0
"""Allowed deviation of a claimed invariant, in ulp of its terms times sqrt(steps)."""


class Result(StrEnum):
    """Outcome of a case, from good to bad."""

    HELD = "held"
    NOT_TRIED = "not tried"
    DEGRADED = "degraded"
    BROKE = "broke"


@dataclass(frozen=True)
class Finding:
    """The answer: the result, the reason in one short phrase with figures, and the step at which it broke."""

    result: Result
    why: str
    step: int | None = None
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Case:
    """One hard case for the schemes of one form of a top.

    ``config`` gives the experiment as a config without a scheme; ``check`` answers the ``question`` for a trial.
    """

    name: str
    form: str
    question: str
    config: Callable[[], Mapping[str, Any]]
    check: Callable[[Trial], Finding]

    def experiment(self, scheme: str, options: Mapping[str, Any] | None = None) -> Experiment:
        """Return the case as an experiment with ``scheme``. Raises UsageError for unknown names and options."""
        name = f"stress_{self.name}".replace("-", "_")
        return load_experiment({"name": name, "scheme": {"name": scheme, **(options or {})}, **self.config()})


class CaseCache:
    """Cache of compiled loops, by scheme and parameters of the top, and of references, by case."""

    def __init__(self) -> None:
        self._methods: dict[Any, tuple[Method, Loop]] = {}
        self._references: dict[Any, Array] = {}

    def method(self, experiment: Experiment) -> tuple[Method, Loop]:
        """Return the method of an experiment and its loop."""
        top = experiment.top
        key = (experiment.scheme.name, top.form, repr(top), repr(experiment.options))
        if key not in self._methods:
            method = experiment.method()
            self._methods[key] = (method, loop_of(method, len(top.components), len(top.constants())))
        return self._methods[key]

    def reference(self, top: Top, y0: Floats, times: Array) -> Array:
        """Return the reference motion at ``times``, (m, d)."""
        key = (top.form, repr(top), y0, times.tobytes())
        if key not in self._references:
            self._references[key] = reference_states(top, y0, times)
        return self._references[key]


class Trial:
    """One scheme in one case, as the checks use it."""

    def __init__(self, case: Case, experiment: Experiment, cache: CaseCache) -> None:
        self.case, self.experiment = case, experiment
        self.scheme, self.top, self.y0 = experiment.scheme, experiment.top, experiment.y0
        self.order = self.scheme.order_for(experiment.options)
        self.method, self._loop = cache.method(experiment)
        self._cache = cache
        self.plain = isinstance(self.method, Stepper) and self.method.plain
        factor = max(1, experiment.N // PLAIN_STEPS) if self.plain else 1
        self.h, self.N = experiment.h * factor, max(1, experiment.N // factor)
        self.counters: dict[str, int] = {}
        self.claim_ulps = CLAIM_ULPS

    def run(self, h: float | None = None, N: int | None = None, every: int = 1, y0: Floats | None = None) -> Trajectory:
        """Run the case, or with another step, another number of steps, or from another state."""
        h, N = h or self.h, N or self.N
        with np.errstate(all="ignore"):
            motion = Trajectory.of_run(Run(self.top, self._loop, y0 or self.y0, h, N, every), self.scheme.name)
        if not self.counters:
            self.counters = dict(motion.ending.counters)
        return motion

    def reference(self, times: Array) -> Array:
        """Return the reference motion of the case at ``times``, (m, d)."""
        return self._cache.reference(self.top, self.y0, times)

    def closed_form(self, n: NDArray[np.int64]) -> Array:
        """Return the states of the closed form of the top after ``n`` (m,) steps, (m, d)."""
        method = find_scheme("exact", self.top.form).build(self.top, None)
        assert isinstance(method, Sampler)
        return method.states(np.array(self.y0), self.h, n, self.top.constants())

    def claimed(self, h: float) -> list[Invariant]:
        """Invariants that the scheme claims to conserve to round-off at the step ``h``."""
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
        return Finding(Result.BROKE, why, ending.left, {"largest": float(sizes.max() / sizes[0])})
    what = {Outcome.BLEW_UP: "blew up", Outcome.NO_CONVERGENCE: "did not converge"}[ending.outcome]
    return Finding(Result.BROKE, f"{what} at step {ending.step} (t = {ending.t:.4g})", ending.step)


def claim_violated(trial: Trial, motion: Trajectory) -> Finding | None:
    """Return the finding on a run that violates a claimed invariant; None if it keeps them all."""
    with np.errstate(all="ignore"):
        for invariant in trial.claimed(motion.h):
            values = invariant.value(motion.states)
            scale = np.maximum.accumulate(invariant.scale(motion.states))
            if not (np.isfinite(values).all() and np.isfinite(scale).all()):
                continue  # terms beyond the range of a double cannot be judged
            deviation = np.abs(values - values[0])
            bound = trial.claim_ulps * float(np.finfo(float).eps) * np.sqrt(np.maximum(motion.n, 1)) * scale
            # a denormal has an absolute error, which no relative bound covers
            over = deviation > np.maximum(bound, 1e-300)
            if over.any():
                at = int(np.argmax(over))
                why = f"claims {invariant.symbol}, off by {deviation[at]:.1e} (round-off: {bound[at]:.1e})"
                return Finding(Result.BROKE, why, int(motion.n[at]), {"deviation": float(deviation.max())})
    return None


def fault(trial: Trial, motion: Trajectory) -> Finding | None:
    """Return the finding on a run that did not complete or violates a claim; None if neither."""
    return ended_badly(motion) or claim_violated(trial, motion)


def state_before(top: Top, state: Floats, t: float) -> list[float]:
    """Return the state from which the motion of ``top`` reaches ``state`` after the time ``t``."""
    return _state_before(top, tuple(state), t)  # pyright: ignore[reportArgumentType] (frozen, hence hashable)


@cache
def _state_before(top: Top, state: Floats, t: float) -> list[float]:
    return reference_states(top, state, np.array([-t]))[0].tolist()


def initial(top: Top, state: Floats) -> dict[str, list[float]]:
    """Return the ``initial`` section of a config for ``state``, with its unit vectors normalized to the last bit."""
    section: dict[str, list[float]] = {}
    for name, (start, stop) in top.vectors.items():
        vector = list(state[start:stop])
        if name in top.unit_vectors:
            length = math.hypot(*vector)
            vector = [value / length for value in vector]
        section[name] = vector
    return section


def config(top: Top, state: Floats, h: float, N: int) -> dict[str, Any]:
    """Return a config without a scheme."""
    return {"top": {"kind": top.kind, **top.model_dump(mode="json")}, "initial": initial(top, state), "h": h, "N": N}
