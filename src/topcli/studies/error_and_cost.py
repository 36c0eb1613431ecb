"""Errors of schemes over the step size and over the time they take, for the integrable map and others around it.

The motion is that of the generic scene of the Kowalevski top; errors and times are measured as by ``topcli bench``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Scheme
from topcli.engine.fingerprint import fingerprint
from topcli.runs.identity import method_fingerprint
from topcli.runs.report import finite
from topcli.store.provenance import environment
from topcli.store.study import stored_study, write_study
from topcli.studies.bench.competitors import SchemeCompetitor
from topcli.studies.bench.measure import Effort, as_rows, explore, time_all
from topcli.studies.bench.scenes import Problem
from topcli.studies.entries import scheme_with

SCENE = "kowalevski_generic_hk"
DURATION, INTERVALS = 100.0, 20
OTHERS = ("hk", "hybrid", "midpoint4", "splitting")
FAMILY = ("backlund", "backlund+suzuki4", "backlund+kahan-li6", "backlund+kahan-li8")
"""The integrable map and its compositions of orders 4, 6 and 8."""
NODES = "backlund:nodes=exact"
"""The integrable map with steps of several lengths that add up to the motion itself."""
EFFORT = Effort(budget=0.04, repetitions=3)
FILE = Path("error-and-cost") / "error-and-cost.json"
SCHEMA_VERSION = 1


def compared_schemes() -> list[Scheme]:
    """Schemes of the study, in the order of the figure."""
    form = problem().top.form
    return [scheme_with(name, form) for name in (*OTHERS, *FAMILY, NODES)]


def problem() -> Problem:
    """Motion and times of the comparison."""
    experiment = load_experiment(SCENE)
    return Problem(experiment.name, experiment.top.title, experiment, DURATION, INTERVALS)


def error_and_cost(
    what: Problem, schemes: Sequence[Scheme], on_progress: Callable[[int, int], None] = lambda done, total: None
) -> dict[str, Any]:
    """Measure errors and times of the ``schemes`` over their ladders of step sizes; plain data, ready for JSON.

    Errors are the largest Euclidean norms of the difference of states from the Taylor reference in double-double
    arithmetic at the common times, times CPU seconds per unit of simulated time.
    """
    reference = reference_states(what.top, what.experiment.y0, what.times)
    measured = [explore(SchemeCompetitor(one, what), what, reference, EFFORT) for one in schemes]
    time_all(measured, EFFORT, on_progress)
    rows = [
        {
            "scheme": one.competitor.name,
            "ended": one.ended,
            "failed": [{"h": value, "reason": reason} for value, reason in one.failed],
            "points": [{"h": row["value"], **row} for row in as_rows(one, what.duration)],
        }
        for one in measured
    ]
    return finite(
        {
            "schema_version": SCHEMA_VERSION,
            "name": what.name,
            "top": what.title,
            "config": what.experiment.resolved(),
            "duration": what.duration,
            "intervals": what.intervals,
            "schemes": rows,
            "environment": environment(),
        }
    )


def study_source() -> str:
    """Digest of everything that the errors of a study depend on."""
    what = problem()
    codes = [method_fingerprint(one.build(what.top, one.options())) for one in compared_schemes()]
    code = fingerprint(error_and_cost, explore, time_all, reference_states, compiled=False)
    text = json.dumps([what.experiment.digest, what.duration, what.intervals, codes, code])
    return hashlib.sha256(text.encode()).hexdigest()


def current_study(out: Path, force: bool, on_progress: Callable[[int, int], None]) -> tuple[dict[str, Any], str]:
    """Return the study stored in ``out``, measured if it is missing or out of date, and the digest of its source."""
    source = study_source()
    study = stored_study(out / FILE, SCHEMA_VERSION, "topcli plot error-and-cost")
    if study is None or study.get("source") != source or force:
        study = error_and_cost(problem(), compared_schemes(), on_progress)
        write_study(out / FILE, study, source)
    return study, source
