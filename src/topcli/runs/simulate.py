"""Python interface for single runs: from a config, a scene or keywords to a Trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from topcli.analysis.trajectory import Trajectory
from topcli.config.duration import changed
from topcli.config.load import experiment_from, load_experiment
from topcli.config.models import Experiment
from topcli.runs.prepare import run_of


def trajectory_of(experiment: Experiment) -> Trajectory:
    """Run an experiment in memory, in its precision."""
    if experiment.exact is not None:
        from topcli.runs.precise import precise_run, precise_trajectory

        prepared = precise_run(experiment)
        assert prepared is not None
        return precise_trajectory(experiment, prepared)
    run = run_of(experiment, experiment.method())
    return Trajectory.of_run(run, experiment.scheme.name, experiment.modified, experiment.output.attitude or "")


def simulate(
    config: str | Path | Mapping[str, Any] | None = None, *, overrides: Sequence[str] = (), **changes: Any
) -> Trajectory:
    """Run an experiment in memory.

    All quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file (YAML or TOML), name of a packaged scene such as ``"kowalevski_hybrid"``, or the content of a
        config as nested mappings.
    overrides : sequence of str
        Texts ``"key=value"`` as for ``--set`` on the command line, such as ``"output.every=10"``; applied after the
        ``changes``.
    **changes
        Values that replace whole top-level keys of the config: ``top``, ``initial``, ``scheme``, ``h``,
        ``N`` or ``T``, ``output``.

    Returns
    -------
    Trajectory
        Recorded states (m, d), one row for every ``output.every`` steps, starting with the initial state. A run that
        fails is returned up to its last finite state; ``outcome`` and ``ending`` describe the failure.

    Raises
    ------
    ConfigError
        If the config cannot be read or has a fault; the message names the key and, in a file, the line.
    UnknownNameError
        If there is no such scene or scheme.

    Examples
    --------
    >>> import topcli
    >>> trajectory = topcli.simulate("kowalevski_hybrid", h=0.01, N=5000)
    >>> trajectory.states.shape
    (5001, 6)
    >>> float(trajectory.t[-1])
    50.0
    >>> bool(abs(trajectory["k_sq"] - trajectory["k_sq"][0]).max() < 1e-12)
    True

    The same without a scene:

    >>> initial = {"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]}
    >>> topcli.simulate(top="kowalevski", initial=initial, scheme="hk", h=1e-3, N=100).outcome.value
    'completed'
    """
    if config is None or isinstance(config, Mapping):
        return trajectory_of(experiment_from({"name": "simulation", **changed(config or {}, changes)}, overrides))
    return trajectory_of(load_experiment(config, overrides, changes, any_precision=True))
