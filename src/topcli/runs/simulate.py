"""Simulations in memory: from a config, a scene or keywords to a Trajectory or an Ensemble."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.trajectory import Ensemble, Trajectory
from topcli.config.document import Document, Problems
from topcli.config.ensemble import SOURCES, EnsembleExperiment, Group, Listed, Members
from topcli.config.load import load, load_experiment, read_config
from topcli.config.models import UNIT_LIMIT, Experiment
from topcli.config.sections import read_top
from topcli.contracts import Array, Top
from topcli.engine.ensemble import Piece
from topcli.engine.run import Endings
from topcli.errors import UsageError
from topcli.runs.ensemble import GroupRun, varied_parameters
from topcli.runs.recorder import run_of
from topcli.tops import CUSTOM, TOPS


def trajectory_of(experiment: Experiment) -> Trajectory:
    """Return the trajectory of an experiment, computed in memory and in the precision of the experiment."""
    if experiment.written is not None:
        from topcli.runs.precise import precise_run, precise_trajectory

        prepared = precise_run(experiment)
        assert prepared is not None
        return precise_trajectory(experiment, prepared)
    method = experiment.method()
    run, search = run_of(experiment, method), experiment.search(method=method)
    attitude = experiment.output.attitude or ""
    return Trajectory.of_run(run, experiment.scheme.name, experiment.modified, attitude, experiment.quantities, search)


def simulate(
    config: str | Path | Mapping[str, Any] | None = None, overrides: Sequence[str] = (), **changes: Any
) -> Trajectory:
    """Run an experiment in memory.

    All quantities are dimensionless, as in configs.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file (YAML or TOML), name of a scene (a packaged config) such as ``"kowalevski_hybrid"``, or the content
        of a config as nested mappings.
    overrides : sequence of str
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line, such as
        ``"output.every=10"``. They are applied after ``changes``.
    **changes
        Values that replace whole top-level keys of the config: ``top``, ``initial``, ``scheme``, ``h``,
        ``N`` or ``T``, ``output``.

    Returns
    -------
    Trajectory
        Recorded states of shape (m, d): m rows of d components. The first row is the initial state. One row follows for
        every ``output.every`` steps. If a run fails, the rows end with its last finite state, and ``outcome`` and
        ``ending`` describe the failure.

    Raises
    ------
    ConfigError
        If the config cannot be read or is invalid. The message names the key and, for a file, the line.
    UnknownNameError
        If no scene or scheme has the given name.

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
    """
    if config is None or isinstance(config, Mapping):
        config = {"name": "simulation", **(config or {})}
    experiment = load_experiment(config, overrides, changes, any_precision=True, crossings=True)
    _warn(experiment)
    return trajectory_of(experiment)


def _warn(experiment: Experiment | EnsembleExperiment) -> None:
    """Issue the warnings about initial states, to the caller of the calling function."""
    for line in experiment.state_warnings():
        warnings.warn(line, stacklevel=3)


MAX_NUMBERS = 5 * 10**8
"""Largest count of numbers in the recorded states: four gigabytes."""


def ensemble_of(experiment: EnsembleExperiment, threads: int | None = None) -> Ensemble:
    """Run an ensemble in memory. Raises UsageError if its rows would not fit."""
    first, d = experiment.first, len(experiment.top.components)
    if first.section is not None:
        raise UsageError(
            "simulate_ensemble: `topcli run` records the crossings of an ensemble, in a file; leave out section"
        )
    each = first.N // first.output.every + 1 if experiment.store == "trajectories" else 0
    if experiment.count * each * d > MAX_NUMBERS:
        raise UsageError(
            f"{experiment.count} trajectories of {each} rows do not fit in memory; record fewer with output.every, "
            "or keep less with store: final or statistics"
        )
    states = np.full((experiment.count, each, d), np.nan)

    def keep(group: GroupRun[None], piece: Piece, values: object) -> None:
        if each and len(piece.n):
            where = group.offset + piece.first
            start = int(piece.n[0]) // first.output.every
            for i, kept in enumerate(piece.kept):
                states[where + i, start : start + kept] = piece.states[i, :kept]

    parts: list[GroupRun[None]] = []
    offset = 0
    for group in experiment.members.groups:
        part = GroupRun(experiment, group, offset, keep, lambda: False, threads)
        for _ in part.block(group.states):
            pass
        parts.append(part)
        offset += group.count
    varied = varied_parameters(experiment)
    tables = [part.trajectories(varied) for part in parts]
    return Ensemble(
        tops=tuple(part.group.top for part in parts for _ in range(part.group.count)),
        scheme=first.scheme.name,
        h=first.h,
        n=np.arange(each, dtype=np.int64) * first.output.every,
        states=states,
        initial=np.concatenate([part.run.y0 for part in parts]),
        last=np.concatenate([part.run.last for part in parts]),
        last_n=np.concatenate([part.run.last_n for part in parts]),
        endings=Endings.joined([part.run.endings for part in parts]),
        tallies=tuple(part.tally for part in parts),
        table={name: np.concatenate([table[name] for table in tables]) for name in tables[0]},
        modified=tuple(part.modified for part in parts for _ in range(part.group.count)),
        quantities=first.quantities,
        compile_seconds=sum(part.run.compile_seconds for part in parts),
        run_seconds=sum(part.run.run_seconds for part in parts),
    )


def simulate_ensemble(
    config: str | Path | Mapping[str, Any] | None = None,
    overrides: Sequence[str] = (),
    *,
    states: Array | Sequence[Sequence[float]] | None = None,
    threads: int | None = None,
    **changes: Any,
) -> Ensemble:
    """Run one experiment from many initial states in memory.

    Each trajectory is identical to a single run from its initial state.

    Parameters
    ----------
    config : path, str or mapping, optional
        Config file, name of a scene (a packaged config), or the content of a config, as for ``topcli.simulate``.
    overrides : sequence of str
        Texts ``"key=value"`` that replace keys of the config, as for ``--set`` on the command line. They are applied
        after ``changes``.
    states : array_like of float, shape (trajectories, d), optional
        Initial states, with components in the order of ``top.components``. By default, the section ``ensemble`` of the
        config defines the initial states: by a list (``states``), a grid (``grid``), or random draws (``random``).
    threads : int, optional
        Number of threads, by default one per CPU. The results do not depend on this number.
    **changes
        Values that replace whole top-level keys of the config. ``ensemble={"store": "final"}`` keeps only the last
        states, and ``{"store": "statistics"}`` only the deviations of the invariants.

    Returns
    -------
    Ensemble
        Recorded states of shape (trajectories, m, d); initial and last states of shape (trajectories, d); endings,
        which say how each trajectory ended; and a table of the deviations of all invariants. A trajectory that fails
        does not affect the others.

    Raises
    ------
    ConfigError
        If the config is invalid.
    UsageError
        If initial states are missing or unsuitable, or if the rows would not fit in memory.

    Examples
    --------
    >>> import topcli
    >>> random = {"count": 50, "seed": 7, "gamma": "sphere"}
    >>> ensemble = topcli.simulate_ensemble("kowalevski_hk", ensemble={"random": random}, N=100)
    >>> ensemble.states.shape
    (50, 101, 6)
    >>> single = topcli.simulate("kowalevski_hk", N=100)
    >>> same = topcli.simulate_ensemble("kowalevski_hk", states=single.states[:1], N=100)
    >>> bool((same.states[0] == single.states).all())
    True
    """
    if threads is not None and threads < 1:
        raise UsageError(f"threads must be at least 1, not {threads}")
    experiment = _experiment(config, states, overrides, changes)
    _warn(experiment)
    return ensemble_of(experiment, threads)


def _experiment(
    config: str | Path | Mapping[str, Any] | None, states: Any, overrides: Sequence[str], changes: Mapping[str, Any]
) -> EnsembleExperiment:
    if config is None or isinstance(config, Mapping):
        config = {"name": "simulation", **(config or {})}
    if states is None:
        return _ensemble(load(config, overrides, changes))
    document, name = read_config(config, overrides, changes)
    return _from_states({"name": name, **document.data}, states)


def _ensemble(experiment: Experiment | EnsembleExperiment) -> EnsembleExperiment:
    if isinstance(experiment, EnsembleExperiment):
        return experiment
    raise UsageError(
        "simulate_ensemble: no initial states; give states=..., or ensemble={'states' or 'grid' or 'random': ...}"
    )


def _from_states(data: dict[str, Any], states: Any) -> EnsembleExperiment:
    """Ensemble from an array of states; the section ``ensemble`` may only say what to store."""
    section = dict(data.pop("ensemble", None) or {})
    if given := [key for key in SOURCES if section.get(key) is not None]:
        raise UsageError(f"simulate_ensemble: initial states are given by states= and by ensemble.{given[0]}; keep one")
    try:
        array = np.array(states, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"simulate_ensemble: states must be an array of numbers: {error}") from None
    if array.ndim != 2 or not len(array) or not np.isfinite(array).all():
        raise UsageError("simulate_ensemble: states must be finite numbers of shape (trajectories, components)")
    given = data.get("top")
    kind = given.get("kind") if isinstance(given, dict) else given
    initial = data.get("initial")
    named = [key for key in initial if key != "normalize"] if isinstance(initial, dict) else None
    declared, _ = read_top(given, None, Problems(Document({}))) if kind == CUSTOM else (None, None)
    known = [declared] if declared else TOPS.values()
    fits = [top for top in known if top.kind == str(kind).lower() and len(top.components) == array.shape[1]]
    top = next((top for top in fits if named is None or set(top.vectors) == set(named)), fits[0] if fits else None)
    if top is not None:
        _check_units(top, array)
        data["initial"] = top.initial_section(array[0].tolist())
    # an ensemble of the first state alone, so that ``store`` is checked like any other key
    single = load({**data, "ensemble": {**section, "states": [{}]}})
    assert isinstance(single, EnsembleExperiment)
    d = len(single.top.components)
    if array.shape[1] != d:
        raise UsageError(f"simulate_ensemble: a state of {single.top.kind} has {d} components, not {array.shape[1]}")
    members = Members(
        (Group(single.top, Listed(array)),), {**single.members.section, "states": []}, single.members.initial
    )
    return EnsembleExperiment(single.first, members, single.top)


def _check_units(top: type[Top], states: Array) -> None:
    for name in top.unit_vectors:
        excess = (states[:, slice(*top.vectors[name])] ** 2).sum(axis=1) - 1.0
        worst = int(np.argmax(np.abs(excess)))
        if abs(excess[worst]) > UNIT_LIMIT:
            raise UsageError(
                f"simulate_ensemble: states[{worst}]: {name} must be a unit vector; {name}² is off by "
                f"{excess[worst]:.3g} (allowed: {UNIT_LIMIT:g})"
            )
