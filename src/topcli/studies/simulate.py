"""The Python interface: a config, a scene's name or keywords in, a Trajectory out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.analysis.leaving import step_of_leaving
from topcli.analysis.trajectory import Trajectory
from topcli.config.load import experiment_from, load_experiment
from topcli.config.models import Experiment
from topcli.engine.loop import Run


def trajectory_of(experiment: Experiment) -> Trajectory:
    """Run an experiment in memory."""
    run = Run(experiment.top, experiment.method(), experiment.y0, experiment.h, experiment.N, experiment.output.every)
    n, states, ending = run.collect()
    left = step_of_leaving(experiment.top, n, states)
    return Trajectory(
        top=experiment.top,
        scheme=experiment.scheme.name,
        h=experiment.h,
        n=n,
        states=states,
        ending=ending.having_left(left, experiment.h),
        compile_seconds=run.compile_seconds,
        run_seconds=run.run_seconds,
        modified=experiment.modified,
    )


def simulate(
    config: str | Path | Mapping[str, Any] | None = None, *, overrides: Sequence[str] = (), **changes: Any
) -> Trajectory:
    """Run an experiment in memory and return its Trajectory.

    ``config`` is a config file, the name of a packaged scene (``"kowalevski_hybrid"``), or the config itself as
    a mapping; ``overrides`` are ``key=value`` texts as for ``--set``; ``changes`` replace whole top-level keys::

        simulate("kowalevski_hybrid", h=0.01, N=5000)
        simulate(top="kowalevski", initial={"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]},
                 scheme="hk", h=1e-3, N=50_000)

    Raises ConfigError and its kin for what is wrong with the config. A trajectory that blows up is returned
    with what came before; its ``ending`` says so.
    """
    if config is None or isinstance(config, Mapping):
        return trajectory_of(experiment_from({"name": "simulation", **(config or {}), **changes}, overrides))
    experiment = load_experiment(config, overrides)
    if changes:
        experiment = experiment_from({**experiment.resolved(), **changes})
    return trajectory_of(experiment)
