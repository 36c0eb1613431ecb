"""Runs from nearly equal initial states, whose invariants show how round-off grows.

If a scheme claims no exact invariant, like HK for Kowalevski's top, those of the top are followed by means over long
windows, which remove their quasi-periodic oscillations. The remaining part that is common to all copies of a run is the
motion of the exact map, most accurate with compensated sums; the deviations of the copies from it are round-off.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import helmert

from topcli.analysis.roundoff import MIN_BLOCKS, BlockMeans, growth
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Ending, Invariant, Outcome, Sampler
from topcli.engine.consumer import Consumer
from topcli.engine.drive import drive
from topcli.engine.machine import nanoseconds_per_step
from topcli.engine.plan import Plan
from topcli.engine.rows import Rows
from topcli.errors import ConfigError, UsageError
from topcli.runs.plans import plans
from topcli.runs.report import finite
from topcli.schemes.registry import all_schemes
from topcli.studies.entries import under_scheme

SCENES = {
    "kowalevski": "kowalevski_hk",
    "lagrange": "lagrange_hk",
    "lagrange/inertial": "lagrange_bs",
    "euler": "euler_hk",
    "euler+gamma": "euler_gamma_hk",
    "heavy": "heavy_hk",
}
"""Default scene for each form of a top."""
GENERIC = "kowalevski_generic_hk"
"""Default scene for schemes of Kowalevski's top without exact invariants; near a separatrix windows are too short."""
DEFAULT_H = 0.01
BLOCKS = 1024
ROWS = 16
"""Rows recorded in each of the BLOCKS blocks of an exact invariant."""
WINDOW = 4000.0
"""Length in time of the blocks of other invariants."""
SAMPLING = 0.05
"""Time between the rows of other invariants, short enough that sums over a window are integrals."""
SHIFT = 1e-14
"""Relative differences between the initial states of the copies."""


@dataclass(frozen=True)
class Sampling:
    """``blocks`` of ``rows`` rows, one every ``stride`` steps."""

    blocks: int
    rows: int
    stride: int

    @property
    def block_steps(self) -> int:
        """Steps from one block to the next."""
        return self.rows * self.stride

    @property
    def steps(self) -> int:
        """Steps of a run."""
        return self.blocks * self.block_steps


def sampling_of(steps: int, h: float, exact: bool) -> Sampling:
    """Sampling of a run of about ``steps`` steps. Raises UsageError for too few."""
    if exact:
        least = MIN_BLOCKS * ROWS
        if steps < least:
            raise UsageError(f"--steps {steps}: too few for a fit of the growth; give at least {least}")
        blocks = min(BLOCKS, steps // ROWS)
        return Sampling(blocks, ROWS, steps // (blocks * ROWS))
    stride = max(1, int(SAMPLING / abs(h)))
    rows = int(WINDOW / (abs(h) * stride))
    blocks = min(BLOCKS, steps // (rows * stride))
    if blocks < MIN_BLOCKS:
        raise UsageError(
            f"--steps {steps}: the scheme has no exact invariant, and means over windows of length {WINDOW:g} "
            f"need at least {MIN_BLOCKS * rows * stride} steps at h = {h:g}"
        )
    return Sampling(blocks, steps // (blocks * stride), stride)


def roundoff_experiment(scheme: str, config: str | Path | None, overrides: Sequence[str] = ()) -> Experiment:
    """Experiment of ``config`` under ``scheme``; by default a packaged scene for the scheme, at h = 0.01.

    Raises UsageError, and UnknownNameError for an unknown scheme.
    """
    if config is not None:
        return under_scheme(load_experiment(config, overrides), scheme)
    if not any(text.partition("=")[0].strip() == "h" for text in overrides):
        overrides = [f"h={DEFAULT_H}", *overrides]
    base = scheme.lower().partition("+")[0]
    forms = {each.top for each in all_schemes() if each.name == base}
    form = next((form for form in SCENES if form in forms), "kowalevski")
    experiment = under_scheme(load_experiment(SCENES[form], overrides), scheme)
    if form == "kowalevski" and not experiment.scheme.conserves and not experiment.modified:
        return under_scheme(load_experiment(GENERIC, overrides), scheme)
    return experiment


def _watched(experiment: Experiment) -> tuple[tuple[Invariant, ...], bool]:
    """Invariants to follow; True if the scheme claims them as exact."""
    known = experiment.top.invariants()
    claimed = (
        tuple(invariant for invariant in known if invariant.name in experiment.scheme.conserves) + experiment.modified
    )
    return (claimed, True) if claimed else (known, False)


def _copies(experiment: Experiment, count: int) -> Array:
    """Initial states (count, d): that of the experiment, and others so close that only the rounding differs."""
    random = np.random.default_rng(1)
    y0 = np.array(experiment.y0)
    return np.array([y0, *(y0 * (1.0 + SHIFT * random.uniform(-1.0, 1.0, len(y0))) for _ in range(count - 1))])


class CopyMeans(Consumer):
    """Block means of the ``watched`` invariants along each trajectory of a plan."""

    def __init__(self, watched: Sequence[Invariant], sampling: Sampling) -> None:
        self._watched, self._sampling = watched, sampling

    def begin(self, plan: Plan) -> None:
        """Make room for the means of a plan."""
        self.each = [BlockMeans(self._watched, self._sampling.blocks, self._sampling.rows) for _ in plan.states]

    def add(self, rows: Rows) -> None:
        """Add rows to the means."""
        for means, states, length in zip(self.each[rows.first :], rows.states, rows.lengths.tolist(), strict=False):
            means.add(states[:length])


@dataclass(frozen=True)
class Copies:
    """Results of all copies of one form.

    ``means`` (invariants, copies, blocks) are block means; ``largest`` and ``scale`` (invariants,) are the largest
    deviation and the scale of each invariant.
    """

    ending: Ending
    means: Array
    largest: Array
    scale: Array


def copies_followed(experiment: Experiment, watched: Sequence[Invariant], sampling: Sampling, copies: int) -> Copies:
    """Run all copies of one form."""
    plan, means = next(plans(experiment)), CopyMeans(watched, sampling)
    states, N, every = _copies(experiment, copies), sampling.steps, sampling.stride
    run = drive(replace(plan, states=states, N=N, every=every, tallied=0, quantities=()), [means])
    failed = np.flatnonzero(~run.endings.is_(Outcome.COMPLETED))
    return Copies(
        run.endings[int(failed[0]) if len(failed) else 0],
        np.stack([tally.means for tally in means.each], axis=1),
        np.max([tally.largest for tally in means.each], axis=0),
        np.max([tally.scale for tally in means.each], axis=0),
    )


def _rows(
    watched: Sequence[Invariant], exact: bool, sampling: Sampling, runs: Copies, common: Array
) -> list[dict[str, Any]]:
    """Figures on the growth of each invariant; ``common`` (invariants, blocks) is the motion of the exact map."""
    rows = []
    for i, invariant in enumerate(watched):
        drift = runs.means[i] - common[i]
        own = not exact and np.array_equal(common[i], runs.means[i].mean(axis=0))
        if not exact:
            drift = drift - drift[:, :1]
        independent = drift
        if own:  # the mean of the copies absorbs a part of their scatter, and all of a bias
            drift = drift * np.sqrt(len(drift) / (len(drift) - 1.0))
            independent = helmert(len(drift)) @ runs.means[i]
        fitted = asdict(growth(independent, sampling.block_steps, float(runs.scale[i])))
        if own:
            fitted |= {"bias": None, "bias_error": None}
        scale = float(runs.scale[i])
        rows.append(
            {
                "name": invariant.name,
                "symbol": invariant.symbol,
                "claimed": exact,
                "drift": float(np.sqrt(np.mean(drift[:, -1] ** 2))),
                "max_drift": float(np.abs(drift).max()),
                "max_deviation": float(runs.largest[i]),
                "scale": scale,
                **fitted,
            }
        )
    return rows


def forms_of(experiment: Experiment) -> dict[str, Experiment]:
    """Experiment with plain and with compensated sums, by name; only the former if these options have no other form."""
    if "compensated" not in type(experiment.options).model_fields:
        return {"plain": experiment}
    resolved = experiment.resolved()

    def form(compensated: bool) -> Experiment:
        return load_experiment(resolved | {"scheme": resolved["scheme"] | {"compensated": compensated}})

    plain = form(False)
    try:
        return {"plain": plain, "compensated": form(True)}
    except ConfigError:  # an option that cannot be combined with it
        return {"plain": plain}


def roundoff_study(experiment: Experiment, steps: int, copies: int) -> dict[str, Any]:
    """Follow ``copies`` of the experiment over about ``steps`` steps each; plain data, ready for JSON.

    ``experiment.N`` is ignored. Raises UsageError for a scheme that takes no steps, and for too few steps.
    """
    if isinstance(experiment.method(), Sampler):
        raise UsageError(
            f"scheme {experiment.scheme.name!r} is a closed form, which has no steps with errors that add up"
        )
    watched, exact = _watched(experiment)
    least = 2 if exact else 3
    if copies < least:
        raise UsageError(f"--copies {copies}: must be at least {least}")
    sampling = sampling_of(steps, experiment.h, exact)
    variants = forms_of(experiment)
    methods = [variant.method() for variant in variants.values()]
    # before the runs, which heat the processor; thread time does not depend on other threads
    timed = nanoseconds_per_step(
        [(experiment.top, method, experiment.y0, experiment.h) for method in methods], clock=time.thread_time_ns
    )
    runs = {name: copies_followed(variant, watched, sampling, copies) for name, variant in variants.items()}
    finest = list(runs.values())[-1]
    common = np.zeros_like(finest.means[:, 0]) if exact else finest.means.mean(axis=1)
    forms = []
    for (name, variant), nanoseconds in zip(variants.items(), timed, strict=True):
        followed = runs[name]
        completed = followed.ending.outcome is Outcome.COMPLETED
        forms.append(
            {
                "form": name,
                "scheme": variant.scheme.name,
                "options": variant.options.model_dump(mode="json"),
                "outcome": followed.ending.outcome.value,
                "message": followed.ending.message,
                "nanoseconds_per_step": nanoseconds,
                "cost": nanoseconds / timed[0],
                "invariants": _rows(watched, exact, sampling, followed, common) if completed else [],
            }
        )
    return finite(
        {
            "config": experiment.resolved(),
            "top": experiment.top.title,
            "h": experiment.h,
            "steps": sampling.steps,
            "copies": copies,
            "claimed": exact,
            "forms": forms,
        }
    )
