"""Time of a step of a method, without that of recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from topcli.contracts import Method, Sampler, Top
from topcli.engine.drive import drive
from topcli.engine.machine import Machine
from topcli.engine.rows import Plan

REPETITIONS = 9
"""Times that each step is timed."""
TRIAL, MOST_STEPS, SECONDS = 8, 200_000, 0.05
"""Steps of a first run, most steps of a run, and its approximate time."""
SAMPLED_STATES = 5000
"""States of a closed form that are timed together."""


def nanoseconds_per_step(runs: Sequence[tuple[Top, Method, Sequence[float], float]]) -> list[float]:
    """Median warm time of one step, in nanoseconds, for each (top, method, y0, h), measured in turn.

    The repetitions are interleaved, so that a change of the machine's speed affects all runs. A trajectory that blows
    up is timed up to that point. Of a closed form the time of one state is returned.
    """
    plans = []
    for top, method, y0, h in runs:
        plan = Plan(top, Machine(top, method), np.array([y0], dtype=np.float64), h, TRIAL, TRIAL)
        if isinstance(method, Sampler):
            plan = replace(plan, N=SAMPLED_STATES, every=1)
        else:
            for _ in range(2):  # a short run takes longer per step
                steps = min(MOST_STEPS, 1 + int(1e9 * SECONDS / max(_timed(plan), 1.0)))
                plan = replace(plan, N=steps, every=steps)
        plans.append(plan)
    times = [[_timed(plan) for plan in plans] for _ in range(REPETITIONS + 1)]
    return np.median(times[1:], axis=0).tolist()


def _timed(plan: Plan) -> float:
    """Nanoseconds per step of one run."""
    run = drive(plan)
    return 1e9 * float(run.seconds[0]) / max(int(run.endings.step[0]), 1)
