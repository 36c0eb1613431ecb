"""Simulations in memory: from a config, a scene or keywords to a Trajectory."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topcli.analysis.trajectory import Trajectory
from topcli.config.document import Document
from topcli.config.ensemble import SOURCES, Ensemble
from topcli.config.load import load, read_config, read_top
from topcli.config.models import Experiment
from topcli.config.states import UNIT_LIMIT
from topcli.contracts import Array, Top
from topcli.errors import UsageError
from topcli.runs.plans import trajectory_of
from topcli.tops import CUSTOM, TOPS


def simulate(
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    *,
    states: ArrayLike | None = None,
    threads: int | None = None,
    **changes: Any,
) -> Trajectory:
    """Run an experiment in memory.

    All quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file (YAML or TOML), name of a scene (a packaged config) such as ``"kowalevski_hybrid"``, or the content
        of a config as nested mappings. Its section ``ensemble`` defines many initial states: by a list, a grid, or
        random draws.
    overrides : sequence of str
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line, such as
        ``"output.every=10"``. They are applied after ``changes``.
    states : array_like, shape (B, d), optional
        Initial states of many trajectories, instead of those that the config defines.
    threads : int, optional
        Number of threads for many trajectories, by default one per CPU. The results do not depend on this number.
    **changes
        Values that replace whole top-level keys of the config: ``top``, ``initial``, ``scheme``, ``h``,
        ``N`` or ``T``, ``output``, ``ensemble``. With ``ensemble={"store": "final"}`` only the last states are stored,
        and with ``{"store": "statistics"}`` only the deviations of the invariants.

    Returns
    -------
    Trajectory
        Recorded states of shape (m, d): m rows of d components. The first row is the initial state. One row follows for
        every ``output.every`` steps. If a run fails, the rows end with its last finite state, and ``outcome`` and
        ``ending`` describe the failure. The states of many trajectories have the shape (B, m, d).

    Raises
    ------
    ConfigError
        If the config cannot be read or is invalid. The message names the key and, for a file, the line.
    UnknownNameError
        If no scene or scheme has the given name.
    UsageError
        If ``states`` are unsuitable, or if the rows would not fit in memory.

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

    An experiment that keyword arguments describe completely, without a scene:

    >>> initial = {"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]}
    >>> topcli.simulate(top="kowalevski", initial=initial, scheme="hk", h=1e-3, N=100).outcome.value
    'completed'

    Many trajectories:

    >>> random = {"count": 50, "seed": 7, "gamma": "sphere"}
    >>> many = topcli.simulate("kowalevski_hk", ensemble={"random": random}, N=100)
    >>> many.states.shape
    (50, 101, 6)
    >>> single = topcli.simulate("kowalevski_hk", N=100)
    >>> same = topcli.simulate("kowalevski_hk", states=single.states[:1], N=100)
    >>> bool((same.states[0] == single.states).all())
    True
    """
    if threads is not None and threads < 1:
        raise UsageError(f"threads must be at least 1, not {threads}")
    if config is None or isinstance(config, Mapping):
        config = {"name": "simulation", **(config or {})}
    if states is not None:
        document, name = read_config(config, overrides, changes)
        experiment = _from_states({"name": name, **document.data}, states)
    else:
        experiment = load(config, overrides, changes)
    for line in experiment.state_warnings():
        warnings.warn(line, stacklevel=2)
    return trajectory_of(experiment, threads)


def _from_states(data: dict[str, Any], states: Any) -> Experiment:
    """Ensemble from an array of states; the section ``ensemble`` may only say what to store."""
    section = dict(data.pop("ensemble", None) or {})
    if sources := [key for key in SOURCES if section.get(key) is not None]:
        raise UsageError(f"simulate: initial states are given by states= and by ensemble.{sources[0]}; keep one")
    try:
        array = np.array(states, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"simulate: states must be an array of numbers: {error}") from None
    if array.ndim != 2 or not len(array) or not np.isfinite(array).all():
        raise UsageError("simulate: states must be finite numbers of shape (trajectories, components)")
    raw = data.get("top")
    kind = raw.get("kind") if isinstance(raw, dict) else raw
    initial = data.get("initial")
    named = [key for key in initial if key != "normalize"] if isinstance(initial, dict) else None
    declared = type(read_top(raw, (), Document({}))) if kind == CUSTOM else None
    classes = [declared] if declared else TOPS.values()
    fits = [top for top in classes if top.kind == str(kind).lower() and len(top.components) == array.shape[1]]
    top = next((top for top in fits if named is None or set(top.vectors) == set(named)), fits[0] if fits else None)
    if top is not None:
        _check_units(top, array)
        data["initial"] = top.initial_section(array[0].tolist())
    # an ensemble of the first state alone, so that ``store`` is checked like any other key
    single = load({**data, "ensemble": {**section, "states": [{}]}})
    assert single.ensemble is not None
    d = len(single.top.components)
    if array.shape[1] != d:
        raise UsageError(f"simulate: a state of {single.top.kind} has {d} components, not {array.shape[1]}")
    section = {**single.ensemble.section, "states": []}
    ensemble = Ensemble(single.ensemble.tops, array, section, single.ensemble.initial)
    return single.model_copy(update={"ensemble": ensemble})


def _check_units(top: type[Top], states: Array) -> None:
    for name in top.unit_vectors:
        excess = (states[:, slice(*top.vectors[name])] ** 2).sum(axis=1) - 1.0
        worst = int(np.argmax(np.abs(excess)))
        if abs(excess[worst]) > UNIT_LIMIT:
            raise UsageError(
                f"simulate: states[{worst}]: {name} must be a unit vector; {name}² is off by "
                f"{excess[worst]:.3g} (allowed: {UNIT_LIMIT:g})"
            )
