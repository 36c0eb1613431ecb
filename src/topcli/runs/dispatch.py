"""The choice between a run and an ensemble."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from topcli.config.models import Experiment
from topcli.runs.identity import Identity
from topcli.runs.plan import Plan, RunOptions, plan_run
from topcli.runs.resume import find_source
from topcli.runs.run import RunResult, prepared_precision, run_experiment

if TYPE_CHECKING:
    from topcli.config.ensemble import EnsembleExperiment


def plan_of(experiment: Experiment | EnsembleExperiment, out: Path, options: RunOptions) -> tuple[Identity, Plan]:
    """Identity and plan of an experiment or ensemble. Raises UsageError for one that would be refused."""
    if not isinstance(experiment, Experiment):
        from topcli.runs.ensemble import plan_ensemble

        return plan_ensemble(experiment, out, options)
    prepared_precision(experiment)
    identity = Identity.of(experiment, [experiment.method()])
    source = find_source(identity, out) if options.resume else None
    return identity, plan_run(identity, out, options, source)


def run_into(experiment: Experiment | EnsembleExperiment, out: Path, options: RunOptions = RunOptions()) -> RunResult:
    """Run an experiment or ensemble into the folder ``out/<name>``; see ``run_experiment`` and ``run_ensemble``."""
    if not isinstance(experiment, Experiment):
        from topcli.runs.ensemble import run_ensemble

        return run_ensemble(experiment, out, options)
    return run_experiment(experiment, out, options)
