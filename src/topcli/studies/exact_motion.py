"""The exact motion of an experiment: by the independent reference, or by the closed form where that does not apply."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from topcli.analysis.reference import reference_obstacle, reference_states
from topcli.config.models import Experiment
from topcli.contracts import Array
from topcli.errors import UnknownNameError, UsageError
from topcli.runs.simulate import trajectory_of
from topcli.schemes.registry import find_scheme
from topcli.studies.entries import under_scheme

CLOSED_FORM = "exact"
"""Name of the schemes that evaluate a closed form."""


def exact_names(experiment: Experiment) -> frozenset[str]:
    """Columns that ``exact_columns`` knows: components of the state and integrals of the motion."""
    return frozenset((*experiment.top.components, *(one.name for one in experiment.top.invariants())))


def exact_columns(experiment: Experiment, columns: Sequence[str]) -> dict[str, Array]:
    """Exact values (m,) of ``columns`` at the recorded times. Raises UsageError if the motion is not known exactly."""
    top = experiment.top
    states = _states(experiment)
    first = np.array([experiment.y0])
    integrals = {one.name: one for one in top.invariants()}
    found: dict[str, Array] = {}
    for name in columns:
        if name in top.components:
            found[name] = states[:, top.components.index(name)]
        else:
            found[name] = np.full(len(states), float(integrals[name].value(first)[0]))
    return found


def _states(experiment: Experiment) -> Array:
    """Exact states (m, d) at the recorded times."""
    obstacle = reference_obstacle(experiment.top)
    if not obstacle:
        times = np.arange(0, experiment.N + 1, experiment.output.every) * experiment.h
        return reference_states(experiment.top, experiment.y0, times)
    try:
        find_scheme(CLOSED_FORM, experiment.top.form)
    except UnknownNameError:
        raise UsageError(f"{experiment.name}: no exact motion: {obstacle}, and there is no closed form") from None
    return trajectory_of(under_scheme(experiment, CLOSED_FORM)).states
