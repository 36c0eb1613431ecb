"""The problems of the benchmarks: packaged scenes, or any config."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Top
from topcli.errors import UnknownNameError, UsageError, nearest, quoted

INTERVALS = 100
"""Number of intervals between the evenly spaced times at which errors are measured."""


@dataclass(frozen=True)
class Scene:
    """A packaged ``config`` run for ``duration``; ``goal`` is the speed to reach, as a multiple of the best peer's."""

    name: str
    title: str
    config: str
    duration: float
    goal: float


SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        Scene("kowalevski-generic", "Kowalevski top, generic", "kowalevski_generic_hk", 1000.0, 2.0),
        Scene("kowalevski-paper", "Kowalevski top, near the homoclinic orbit", "kowalevski_hk", 50.0, 1.5),
        Scene("euler", "Euler top", "euler_hk", 100.0, 1.5),
        Scene("lagrange", "Lagrange top", "lagrange_hk", 100.0, 1.5),
    )
}


@dataclass(frozen=True)
class Problem:
    """The problem to solve: the motion of a config's top for ``duration``, compared at ``intervals`` + 1 times."""

    name: str
    title: str
    experiment: Experiment
    duration: float
    intervals: int
    goal: float | None = None

    @property
    def top(self) -> Top:
        """Top of the experiment."""
        return self.experiment.top

    @property
    def interval(self) -> float:
        """Time between two comparisons."""
        return self.duration / self.intervals

    @property
    def times(self) -> Array:
        """Times of the comparisons, from zero, shape (intervals + 1,)."""
        return np.arange(self.intervals + 1) * self.interval


def bench_problems(
    scenes: Sequence[str], configs: Sequence[str], sets: Sequence[str] = (), intervals: int = INTERVALS
) -> list[Problem]:
    """Return the problems of the named ``scenes`` and of ``configs``; of all scenes if neither is given.

    A config gives its top, its initial state and its duration N*h; ``sets`` are overrides of configs. Raises
    UnknownNameError with the nearest names, and UsageError for a name given twice or a run backwards in time.
    """
    if sets and not configs:
        raise UsageError("--set changes a --config, and none is given; scenes cannot be changed")
    names = list(scenes) if scenes or configs else list(SCENES)
    problems = []
    for name in names:
        scene = SCENES.get(name.lower().replace("_", "-"))
        if scene is None:
            raise UnknownNameError(f"--scene: unknown scene {quoted(name)}; {nearest(name, SCENES)}")
        experiment = load_experiment(scene.config)
        problems.append(Problem(scene.name, scene.title, experiment, scene.duration, intervals, scene.goal))
    for config in configs:
        experiment = load_experiment(config, sets)
        if experiment.duration < 0.0:
            raise UsageError(f"--config {config}: h = {experiment.h:g} runs backwards; speed is measured forwards")
        problems.append(Problem(experiment.name, experiment.top.title, experiment, experiment.duration, intervals))
    named = [problem.name for problem in problems]
    if repeated := sorted({name for name in named if named.count(name) > 1}):
        raise UsageError(f"scene {repeated[0]!r} is named twice")
    return problems
