"""An ensemble under several schemes, options or steps: quantiles over the trajectories that reached the end."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from topcli.analysis.reference import reference_obstacle
from topcli.analysis.tally import quantiles
from topcli.config.ensemble import EnsembleExperiment, Group
from topcli.config.models import Experiment
from topcli.contracts import Array, Top
from topcli.runs.references import METHODS, TAYLOR, reference_form
from topcli.runs.report import EndingTally, finite
from topcli.studies.entries import Entry, Failed, few_rows, read_entries, users_code
from topcli.sweeps.batch_run import MAX_RUNS, BatchRun, evaluate
from topcli.sweeps.measures import Measure, names_of, resolve_measures

QUANTILES = {"10 %": 0.1, "median": 0.5, "90 %": 0.9}
MEASURED = ("error.max", "error.end", "reversal", "swing_spacing.first")
"""Measures of every entry that they fit, beside deviation and drift of its invariants."""


def compare_ensemble(
    experiment: EnsembleExperiment,
    entries: Sequence[str],
    options: Mapping[str, Any] | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    reference: str = TAYLOR,
    most: int = MAX_RUNS,
) -> dict[str, Any]:
    """Run an ensemble under each of the ``entries`` and measure the trajectories; plain data, ready for JSON.

    Parameters
    ----------
    experiment : EnsembleExperiment
        Ensemble, whose initial states all entries share.
    entries : sequence of str
        Names of schemes with their own settings, as ``read_entries`` takes them.
    options : mapping, optional
        Options of all schemes that have them.
    on_progress : callable, optional
        ``on_progress(done, total)`` is called with the number of steps taken.
    reference : str, optional
        Reference of the errors, as ``compare_schemes`` takes it. A top that it cannot follow has no errors.
    most : int, optional
        Largest number of trajectories at a time, which does not change the figures.

    Returns
    -------
    dict
        ``schemes`` holds for each entry the counted outcomes, the first failures, and the quantiles of each measure
        over the trajectories that took all their steps and have a value, with the ``count`` of these. ``failed`` lists
        the entries whose code fails.

    Raises
    ------
    UsageError
        As ``read_entries``, for a reference that the top does not have, for more rows than fit in memory, and if the
        code of all entries fails.
    """
    compared = read_entries(experiment.first, entries, options)
    known = reference_form(experiment.top, reference) is not None or not reference_obstacle(experiment.top)
    columns: list[_Column] = []
    failed: list[Failed] = []
    for entry in compared:
        with users_code(failed, entry.label):
            columns.append(_Column(entry, experiment.top, reference if known else None))
    done, total = 0, experiment.count * sum(column.experiment.N for column in columns)
    for group in experiment.members.groups:
        sizes = []
        for column in _working(columns, failed):
            with users_code(failed, column.entry.label):
                sizes.append(column.prepare(group))
        for initial in group.source.blocks(min(most, *sizes) if sizes else group.count):
            for column in _working(columns, failed):  # one block under all entries, so that they share its references
                with users_code(failed, column.entry.label):
                    column.add(initial)
                done += len(initial) * column.experiment.N
                on_progress(done, total)
    columns = _working(columns, failed)
    if not columns:
        raise failed[0].error
    first = compared[0]
    return finite(
        {
            "kind": "ensemble",
            "config": experiment.resolved(),
            "trajectories": experiment.count,
            "quantiles": QUANTILES,
            "reference": {"kind": reference, "method": METHODS[reference]} if known else None,
            "swing": getattr(experiment.top, "swing", None),
            "rows": first.experiment.N // first.stride + 1,
            "few_rows": few_rows(compared, experiment.first),
            "schemes": [column.figures() for column in columns],
            "failed": [one.as_dict() for one in failed],
        }
    )


def _working(columns: Sequence[_Column], failed: Sequence[Failed]) -> list[_Column]:
    """The ``columns`` whose code has not failed."""
    labels = {one.label for one in failed}
    return [column for column in columns if column.entry.label not in labels]


class _Column:
    """One entry, fed with blocks of initial states; without a ``reference`` it measures no errors."""

    def __init__(self, entry: Entry, top: Top, reference: str | None) -> None:
        one = entry.experiment
        output = one.output.model_copy(update={"every": entry.stride})
        self.entry, self.experiment = entry, one.model_copy(update={"top": top, "output": output})
        self._reference = reference
        self.measures = _measures(self.experiment, ("error",) if reference is None else ())
        self._values: dict[str, list[Array]] = {one.name: [] for one in self.measures}
        self._faults: dict[str, list[tuple[int, str]]] = defaultdict(list)
        self._endings = EndingTally(self.experiment.N)
        self._reached, self._steps, self._seconds = 0, 0, 0.0
        self._run: BatchRun | None = None

    def prepare(self, group: Group) -> int:
        """Get ready to run trajectories of a group; return the largest number of them at a time."""
        experiment = self.experiment.model_copy(update={"top": group.top})
        self._run = BatchRun(experiment, self.measures, count=group.count, reference=self._reference)
        return self._run.size

    def add(self, initial: Array) -> None:
        """Run the trajectories from ``initial`` (m, d) and measure them."""
        assert self._run is not None
        offset = self._endings.total
        batch = self._run.finished(initial)
        found = evaluate(self.measures, batch, lambda i, name, reason: self._faults[name].append((offset + i, reason)))
        for name, values in found.items():
            self._values[name].append(values)  # nan for those that failed
        self._reached += int(np.count_nonzero(batch.whole))
        self._endings.add(batch.endings)
        self._steps += int(batch.endings.step.sum())
        self._seconds += float(batch.seconds.sum())

    def figures(self) -> dict[str, Any]:
        """Outcomes and quantiles as plain data."""
        measured = {}
        for name, parts in self._values.items():
            values = np.concatenate(parts)
            measured[name] = {"count": int(np.count_nonzero(~np.isnan(values))), **quantiles(values, QUANTILES)}
        return {
            **self.entry.settings(),
            "outcomes": self._endings.outcomes,
            "message": self._endings.message,
            "reached_end": self._reached,
            "failures": [
                {"trajectory": i, "outcome": ending.outcome.value, "message": ending.message}
                for i, ending in self._endings.failures
            ],
            "faults": {
                name: {"count": len(found), "trajectory": found[0][0], "reason": found[0][1]}
                for name, found in self._faults.items()
            },
            "invariants": [
                {"name": one.name, "symbol": one.symbol}
                for one in (*self.experiment.top.invariants(), *self.experiment.modified)
            ],
            "measures": measured,
            "nanoseconds_per_step": 1e9 * self._seconds / max(self._steps, 1),
        }


def _measures(experiment: Experiment, without: Sequence[str]) -> tuple[Measure, ...]:
    """Measures of an entry: those of ``MEASURED`` that fit, and deviation and drift of each invariant.

    Those whose names begin with a word of ``without`` are left out.
    """
    top, scheme, options = experiment.top, experiment.scheme, experiment.options
    fitting = names_of(top, scheme, options)
    names = [name for name in MEASURED if name in fitting and name.partition(".")[0] not in without]
    names += [name for name in fitting if name.partition(".")[0] in ("deviation", "drift")]
    return resolve_measures(names, top, scheme, options)
