"""An experiment made ready to run: its methods, its identity, and the time loop and recorder in its precision."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from topcli.config.models import Experiment
from topcli.contracts import Method
from topcli.engine.loop import Position, Run
from topcli.errors import UsageError
from topcli.runs.identity import Identity
from topcli.runs.recorder import Recorder
from topcli.store.checkpoint import Checkpoint

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.engine.precise.loop import PreciseRun


@dataclass(frozen=True)
class Prepared:
    """An experiment made ready: its ``identity``, and, unless it is an ensemble, its method and its other precision."""

    identity: Identity
    method: Method
    precise: PreciseRun | None = None


def prepared(experiment: Experiment | EnsembleExperiment, resume: bool = False) -> Prepared:
    """Make an experiment ready. Raises UsageError if it cannot be computed, or not resumed."""
    if isinstance(experiment, Experiment):
        method, precise = experiment.method(), precise_of(experiment)
        return Prepared(Identity.of(experiment, [method]), method, precise)
    if resume:
        raise UsageError("--resume works for runs of one trajectory; run the ensemble again without it")
    methods = [experiment.of_group(group).method() for group in experiment.members.groups]
    return Prepared(Identity.of(experiment, methods), methods[0])


def precise_of(experiment: Experiment) -> PreciseRun | None:
    """Prepare a run in another precision than double; None for double. Raises UsageError if the scheme has none."""
    if experiment.exact is None:
        return None
    from topcli.runs.precise import precise_run

    return precise_run(experiment)


def run_of(
    experiment: Experiment,
    method: Method,
    precise: PreciseRun | None = None,
    stop: Callable[[], bool] = lambda: False,
    start: Position | None = None,
) -> Run:
    """Time loop of an experiment in its precision; ``output.attitude`` appends the quaternion to its states."""
    top, y0, h, N, every = experiment.top, experiment.y0, experiment.h, experiment.N, experiment.output.every
    if precise is not None:
        return Run(precise.top, precise.loop, precise.y0, precise.h, N, every, stop, start)
    if not experiment.output.attitude:
        return Run(top, method, y0, h, N, every, stop, start)
    from topcli.engine.attitude import attitude_loop, start_attitude

    loop = attitude_loop(top, experiment.scheme, experiment.options, method)
    return Run(top, loop, (*y0, *start_attitude(top, y0)), h, N, every, stop, start)


def recorder_of(
    experiment: Experiment,
    precise: PreciseRun | None,
    path: Path,
    metadata: Mapping[str, str],
    start: Checkpoint | None,
) -> Recorder:
    """Recorder of an experiment in its precision, for a series at ``path``; it continues from ``start``."""
    if precise is None:
        return Recorder(experiment, path, metadata, start)
    from topcli.runs.precise import PreciseRecorder

    return PreciseRecorder(experiment, precise, path, metadata, start)
