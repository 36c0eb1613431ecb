"""The time loop of an experiment in double precision, with the attitude if it is recorded."""

from __future__ import annotations

from collections.abc import Callable

from topcli.config.models import Experiment
from topcli.contracts import Method
from topcli.engine.loop import Position, Run


def run_of(
    experiment: Experiment,
    method: Method,
    stop: Callable[[], bool] = lambda: False,
    start: Position | None = None,
) -> Run:
    """Run of an experiment by ``method``; with ``output.attitude`` its states are followed by the quaternion."""
    top, y0, h, N, every = experiment.top, experiment.y0, experiment.h, experiment.N, experiment.output.every
    if not experiment.output.attitude:
        return Run(top, method, y0, h, N, every, stop, start)
    from topcli.engine.attitude import attitude_loop, start_attitude

    loop = attitude_loop(top, experiment.scheme, experiment.options, method)
    return Run(top, loop, (*y0, *start_attitude(top, y0)), h, N, every, stop, start)
