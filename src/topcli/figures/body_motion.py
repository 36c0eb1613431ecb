"""The motion of the body in a stored run: its attitude, recorded or reconstructed from the rows."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import invariant_values, quaternions_of
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome
from topcli.errors import ConfigError, RunError, UsageError, nearest
from topcli.store.manifest import DamagedRun, StoredRun, all_runs, read_run
from topcli.store.parts import is_part, parts_of
from topcli.store.series import read_series

LARGEST_TURN = 0.5
"""Largest turn between two rows, in radians, from which an attitude is reconstructed."""
ASK = "--set output.attitude=quaternion"


@dataclass(frozen=True)
class BodyMotion:
    """Rows of a run: times (m,), attitudes as unit quaternions (m, 4), states (m, d) and invariants (m,) by name.

    ``states`` and ``invariants`` are empty if the run does not record the components. ``notes`` are messages about
    what is missing or reconstructed.
    """

    experiment: Experiment
    t: Array
    attitude: Array
    states: Array | None
    invariants: Mapping[str, Array]
    notes: tuple[str, ...]


def stored_body_motion(folder: Path) -> BodyMotion:
    """Motion of the finished or interrupted run in ``folder``.

    Raises UsageError if there is no run, or if its rows do not determine the attitude, and RunError if it is damaged.
    """
    run = _intact(folder)
    experiment = _experiment(run)
    series = read_series(run.series)
    name, notes = experiment.name, []
    if run.outcome is not Outcome.COMPLETED:
        notes.append(f"{name}: {run.manifest.get('message', run.outcome.value)}")
    states = _states(experiment, series)
    attitude = quaternions_of(series)
    if attitude is None:
        attitude = _reconstructed(experiment, states, folder)
        notes.append(f"{name}: no attitude is recorded; reconstructed from the rows ({ASK} records the scheme's own)")
    good: NDArray[np.bool_] = np.isfinite(attitude).all(axis=1).reshape(-1)
    if not good[0] or good.sum() < 2:
        raise UsageError(f"{folder}: the attitude is not finite or has a single row; there is no motion to show")
    last = len(good) if good.all() else int(np.argmin(good))
    if last < len(good):
        notes.append(f"{name}: the attitude is not finite after row {last}")
    return BodyMotion(
        experiment,
        _times(experiment, series, len(good))[:last],
        attitude[:last],
        None if states is None else states[:last],
        _invariants(experiment, series, states, last),
        tuple(notes),
    )


def _intact(folder: Path) -> StoredRun:
    """The run in ``folder``, with all its checksums compared."""
    run = read_run(folder)
    if isinstance(run, DamagedRun):
        raise RunError(f"{folder}: {run.reason}; run again with --force")
    if run is None:
        if is_part(folder) or parts_of(folder.parent, folder.name):
            raise UsageError(f"{folder}: the run is unfinished; topcli run --resume continues it")
        if not os.path.isdir(folder) and not folder.suffix and len(folder.parts) == 1:
            hint = "give the folder of a run, such as results/NAME"
        else:
            hint = nearest(folder.name, [one.folder.name for one in all_runs(folder.parent)])
        raise UsageError(f"{folder}: no run is stored here (manifest.json is missing); {hint}")
    for name, reason in run.damage().items():
        raise RunError(f"{folder / name}: damaged: {reason}; run again with --force")
    return run


def _experiment(run: StoredRun) -> Experiment:
    """Experiment of a run. Raises UsageError for an ensemble and for a scheme or top that is not known here."""
    config = run.manifest["config"]
    if "ensemble" in config:
        raise UsageError(f"{run.folder}: an ensemble of many trajectories; run a single one of them")
    try:
        return load_experiment(config, any_precision=True)
    except (UsageError, ConfigError) as error:
        raise UsageError(f"{run.folder}: its config cannot be read here: {error.lines[0]}", *error.lines[1:]) from None


def _states(experiment: Experiment, series: Mapping[str, NDArray[Any]]) -> Array | None:
    """States (m, d) of the rows; None if a component is not recorded."""
    names = experiment.top.components
    return np.column_stack([series[name] for name in names]) if all(name in series for name in names) else None


def _times(experiment: Experiment, series: Mapping[str, NDArray[Any]], rows: int) -> Array:
    """Times (m,) of the rows, whose steps are the multiples of ``every``."""
    return series["t"] if "t" in series else np.arange(rows) * experiment.output.every * experiment.h


def _reconstructed(experiment: Experiment, states: Array | None, folder: Path) -> Array:
    """Attitudes (m, 4) from the states of the rows. Raises UsageError if there are too few columns or rows."""
    top, every = experiment.top, experiment.output.every
    if states is None:
        raise UsageError(
            f"{folder}: records neither the attitude nor all of {', '.join(top.components)}", f"run it with {ASK}"
        )
    from topcli.engine.attitude import attitude_of_rows

    turn = float(np.nanmax(np.linalg.norm(states[:, :3], axis=1))) * abs(experiment.h) * every
    if not turn <= LARGEST_TURN:
        raise UsageError(
            f"{folder}: the body turns by up to {turn:.2g} radians from row to row, and no attitude is recorded",
            f"run it with {ASK}, or with rows at least {turn / LARGEST_TURN:.1f} times as dense (output.every)",
        )
    return attitude_of_rows(top, states, experiment.h * every)


def _invariants(
    experiment: Experiment, series: Mapping[str, NDArray[Any]], states: Array | None, rows: int
) -> dict[str, Array]:
    """Invariants of the top along the rows, recorded or evaluated."""
    known = experiment.top.invariants()
    values = {each.name: np.asarray(series[each.name], dtype=float) for each in known if each.name in series}
    if states is not None:
        values |= invariant_values([each for each in known if each.name not in values], states)
    return {each.name: values[each.name][:rows] for each in known if each.name in values}
