"""Cost and accuracy of closed forms, as reports show them: the time of the set-up apart, bounds of the error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from topcli.contracts import Method, Sampler

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment
    from topcli.config.models import Experiment
    from topcli.engine.setups import SetupTime

SAMPLES = 200
"""Largest number of times at which the sensitivity of a motion is evaluated."""


class Timed(Protocol):
    """A run or an ensemble, with its times in seconds."""

    @property
    def compile_seconds(self) -> float:
        """Time to compile or load the code."""
        ...

    @property
    def cached(self) -> bool:
        """True if all code came from disk."""
        ...

    run_seconds: float
    setup: SetupTime | None


def seconds_of(run: Timed) -> dict[str, Any]:
    """Times of a run, as ``report.json`` holds them; that of the set-up only for closed forms that have one."""
    setup = run.setup
    return {
        "compile": run.compile_seconds,
        "compile_cached": run.cached,
        **({} if setup is None else {"setup": setup.seconds, "setup_cached": setup.cached}),
        "run": run.run_seconds,
    }


def seconds_note(seconds: Mapping[str, Any]) -> str:
    """Times of a run in a sentence."""
    parts = [f"Compiled or loaded in {seconds['compile']:.3g} s"]
    if "setup" in seconds:
        parts.append(f"{'loaded the set-up' if seconds['setup_cached'] else 'set up'} in {seconds['setup']:.3g} s")
    parts.append(f"ran in {seconds['run']:.3g} s")
    return f"{', '.join(parts)}."


def setup_message(experiment: EnsembleExperiment, threads: int | None = None) -> str:
    """Expected time of the set-ups of an ensemble, in one line; empty if it is below a second."""
    from topcli.engine.ensemble import default_threads
    from topcli.engine.setups import setup_estimate, setup_processes

    method = experiment.first.method()
    if not isinstance(method, Sampler) or method.setup is None:
        return ""
    count = experiment.count
    processes = setup_processes(method.setup, count, threads or default_threads())
    if processes == 0:
        return ""
    seconds = setup_estimate(method.setup, count) / processes
    where = "1 process" if processes == 1 else f"{processes} processes"
    return f"the set-up of {count} closed forms takes about {seconds:.0f} s in {where}, less if some are stored"


def accuracy_data(method: Method, experiment: Experiment, steps: int) -> dict[str, Any]:
    """Entry of ``report.json`` on the accuracy of a closed form over ``steps`` steps; none for other methods."""
    if not isinstance(method, Sampler) or method.accuracy is None:
        return {}
    n = np.unique(np.linspace(0, max(steps, 1), SAMPLES).astype(np.int64))
    found = method.accuracy(np.array(experiment.y0), experiment.h, n, experiment.top.constants())
    return {"accuracy": found._asdict()}


def accuracy_note(report: Mapping[str, Any]) -> str:
    """Accuracy of a closed form, in one line; empty for other methods."""
    found = report.get("accuracy")
    if not found:
        return ""
    change = found["sensitivity"]
    then = (
        "the sensitivity to the initial state is unknown, because a state one ulp away is not covered"
        if change is None
        else f"one ulp in the initial state, which is taken as exact, changes the states by up to {change:.0e}"
    )
    return f"round-off at most about {found['round_off']:.0e} ({found['reason']}); {then}"
