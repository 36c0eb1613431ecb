"""Errors of schemes over ladders (sequences) of step sizes, observed orders, and the plateau of round-off."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.conformance import completed, deviation
from topcli.analysis.order import convergence, is_consistent, judge_order
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Scheme
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.runs.report import finite
from topcli.schemes.registry import all_schemes
from topcli.store.provenance import environment
from topcli.studies.bench.contest import Problem, Rung, choose
from topcli.studies.bench.measure import Effort, Measurements, SchemeCompetitor, explore
from topcli.studies.entries import scheme_with
from topcli.studies.roundoff_copies import GENERIC, SCENES
from topcli.studies.study import LADDER_STEPS
from topcli.tops import CATALOGUE, gentle_scene

DEFAULT = ("bohlin-a", "hk", "hybrid", "rk4", "hk+kahan-li6", "hk+kahan-li8")
"""Schemes of the default study, on the generic motion of Kowalevski's top."""
DURATION = 10.0
"""Length of a run in time, unless a config gives it."""
INTERVALS = 20
"""Number of intervals between the evenly spaced times at which errors are measured."""
SECONDS = 5.0
"""CPU seconds that one run may take."""
CLAIM_STEPS = 2000
"""Largest number of steps of the run that shows whether declared invariants are conserved."""
SCHEMA_VERSION = 2


class _Ladder(SchemeCompetitor):
    """A scheme over its ladder of step sizes up to ``most`` steps a run, or over the step sizes that are given."""

    def __init__(self, scheme: Scheme, problem: Problem, most: int, rungs: Sequence[Rung]) -> None:
        super().__init__(scheme, problem)
        self._most, self._given = most, rungs

    def is_consistent(self) -> bool:
        """True if single steps from the problem's initial state are consistent with the equations of motion."""
        method = self._scheme.build(self._problem.top, self._defaults())
        return is_consistent(self._problem.top, method, self._y0)

    def false_claim(self, sizes: Sequence[float]) -> str | None:
        """Reason why an invariant that the scheme declares to conserve is not, at one of the coarser steps."""
        claimed = [one for one in self._problem.top.invariants() if one.name in self._scheme.conserves]
        if not claimed or not sizes:
            return None
        h, method = sizes[len(sizes) // 4], self._scheme.build(self._problem.top, self._defaults())
        steps = min(CLAIM_STEPS, max(1, round(self._problem.duration / h)))
        states = completed(self._problem.top, method, self._problem.experiment.y0, h, steps)
        off = {one.name: deviation(states, [one], steps) for one in claimed} if states is not None else {}
        worst = max(off, key=lambda name: off[name], default="")
        if not off or off[worst] <= 1.0:
            return None
        return f"does not conserve {worst}, as it declares: off by {off[worst]:.2g} times what round-off explains"

    def rungs(self) -> Iterator[Rung]:
        """Yield the rungs, coarse to fine."""
        for rung in self._given or super().rungs():
            if not self._given and rung.steps * self._problem.intervals > self._most:
                return
            yield rung


@dataclass(frozen=True)
class Ladders:
    """Plan of a study of orders: the ``schemes`` on a ``problem``, those left out with the reasons, the settings.

    ``sizes`` are the step sizes asked for, none for the ladder of each scheme, of at most ``steps`` steps a run.
    """

    problem: Problem
    schemes: tuple[Scheme, ...]
    left_out: tuple[tuple[str, str], ...]
    sizes: tuple[float, ...]
    steps: int

    @property
    def rungs(self) -> list[Rung]:
        """Settings of the ``sizes``, coarse to fine: the nearest steps that divide the time between comparisons."""
        interval = self.problem.interval
        counts = sorted({max(1, round(interval / size)) for size in self.sizes})
        return [Rung(interval / count, count) for count in counts]


def _default_config(names: Sequence[str], top: str | None) -> str:
    """Packaged scene of the form ``top``, or of the first one that all the schemes ``names`` fit."""
    scenes = {**SCENES, "kowalevski": GENERIC, **{form: gentle_scene(form) for form in CATALOGUE}}
    if top is not None:
        if top.lower() not in scenes:
            raise UnknownNameError(f"--top: no scene for the top {quoted(top)}; {nearest(top, scenes)}")
        return scenes[top.lower()]
    bases = [name.lower().partition(":")[0].partition("+")[0] for name in names]
    fits = {base: {scheme.top for scheme in all_schemes() if scheme.name == base} for base in bases}
    for form, scene in scenes.items():
        if all(form in forms for forms in fits.values()):
            return scene
    for name in names:
        scheme_with(name, "kowalevski")  # names the nearest, if one is unknown, and the tops that it fits
    raise UsageError(f"no top fits all of {', '.join(names)}; name schemes of one top")


def _require_sizes(sizes: Sequence[float], interval: float) -> None:
    for size in sizes:
        if not (math.isfinite(size) and 0.0 < size <= interval * (1.0 + 1e-12)):
            raise UsageError(f"--h {size:g}: must be positive and at most {interval:g}, the time between comparisons")


def ladders(
    names: Sequence[str],
    *,
    top: str | None = None,
    config: str | Path | Mapping[str, Any] | None = None,
    sets: Sequence[str] = (),
    sizes: Sequence[float] = (),
    duration: float | None = None,
    steps: int = LADDER_STEPS,
) -> Ladders:
    """Choose problem and schemes of a study; without ``names`` all schemes of fixed steps, or the default ones.

    Parameters
    ----------
    names : sequence of str
        Schemes. Without names, ``top`` and ``config`` they are those of ``DEFAULT``.
    top : str, optional
        Form of a top, whose packaged scene is run.
    config : str, Path or mapping, optional
        Config, scene or content of a config that gives the top, the initial state and, by N*h, the duration.
    sets : sequence of str
        Overrides of the config.
    sizes : sequence of float
        Step sizes; by default the ladder of each scheme.
    duration : float, optional
        Length of a run in time.
    steps : int
        Largest number of steps of a run on a ladder.

    Raises
    ------
    UsageError
        For an unknown or unfit scheme or top, a step size out of range, or if no scheme remains.
    """
    if top is not None and config is not None:
        raise UsageError("--top and --config both choose the scene; give one of them")
    wanted = names or (DEFAULT if top is None and config is None else ())
    experiment = load_experiment(_default_config(wanted, top) if config is None else config, sets)
    own = experiment.duration if config is not None else DURATION
    length = own if duration is None else duration
    if not (math.isfinite(length) and length > 0.0):
        raise UsageError(f"the duration {length:g} must be positive; give another with --duration")
    problem = Problem(experiment.name, experiment.top.title, experiment, length, INTERVALS)
    _require_sizes(sizes, problem.interval)
    for name in wanted:
        scheme_with(name, problem.top.form)
    line_up = choose(problem, wanted)
    adaptive = [
        (scheme.name, "it chooses its steps by a tolerance, not by h") for scheme in line_up.schemes if scheme.adaptive
    ]
    without_h = [(scheme.name, "is a closed form: its error does not depend on h") for scheme in line_up.closed_forms]
    without_h += [
        (scheme.name, "has no error that depends on h")
        for scheme in line_up.schemes
        if not (scheme.order or scheme.adaptive)
    ]
    schemes = tuple(scheme for scheme in line_up.schemes if scheme.order is not None and not scheme.adaptive)
    left_out = (*line_up.left_out, *adaptive, *without_h)
    if not schemes:
        raise UsageError(
            f"no scheme has an order that can be observed: {'; '.join(': '.join(left) for left in left_out)}"
        )
    return Ladders(problem, schemes, left_out if names else (), tuple(sizes), steps)


def _row(ladder: _Ladder, measured: Measurements, size: float) -> dict[str, Any]:
    """Errors of one scheme as plain data, with the observed order, the verdict on the declared one, and the plateau.

    ``size`` is the largest distance of the motion from its start.
    """
    sizes = [rung.rung.value for rung in measured.rungs]
    errors = [rung.error for rung in measured.rungs]
    observed = convergence(sizes, errors)
    verdict, why = None, ""
    if ladder.order is not None and not measured.broken:
        verdict, why = judge_order(ladder.order, observed, size, ladder.is_consistent)
    return {
        "scheme": ladder.name,
        "declared_order": ladder.order,
        "order": observed.order,
        "verdict": verdict,
        "why": why,
        "fitted": list(observed.fitted),
        "plateau": observed.plateau,
        "onset": observed.onset,
        "ended": measured.ended,
        "broken": measured.broken or None,
        "false_claim": None if measured.broken else ladder.false_claim([each.rung.value for each in measured.rungs]),
        "failed": [{"h": value, "reason": reason} for value, reason in measured.failed],
        "points": [
            {"h": rung.rung.value, "error": rung.error, "final_error": rung.final_error} for rung in measured.rungs
        ],
    }


def order_study(what: Ladders, on_progress: Callable[[int, int], None] = lambda done, total: None) -> dict[str, Any]:
    """Run each scheme over its step sizes and measure its errors; plain data, ready for JSON.

    Errors are the largest Euclidean norms of the difference of states from the Taylor reference in double-double
    arithmetic at the common times. Raises RunError if the reference cannot follow the motion.
    """
    problem = what.problem
    reference = reference_states(problem.top, problem.experiment.y0, problem.times)
    size = float(np.linalg.norm(reference - reference[0], axis=1).max())
    rows = []
    for i, scheme in enumerate(what.schemes):
        ladder = _Ladder(scheme, problem, what.steps, what.rungs)
        rows.append(_row(ladder, explore(ladder, problem, reference, Effort(SECONDS)), size))
        on_progress(i + 1, len(what.schemes))
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "name": problem.name,
            "top": problem.top.title,
            "config": problem.experiment.resolved(),
            "duration": problem.duration,
            "intervals": problem.intervals,
            "schemes": rows,
            "left_out": [{"scheme": name, "reason": reason} for name, reason in what.left_out],
            "environment": environment(),
        }
    )
