"""The seam of a sweep: ``evaluate_batch`` takes rows as plain data and returns their results as columns.

It has no state besides caches, and its arguments and results can be sent to another process: the local sweep calls it
in threads, another back end on its workers. The result of a row does not depend on the other rows of its batch, except
for the measure of its time.
"""

from __future__ import annotations

import json
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from topcli.config.document import Document
from topcli.config.models import Experiment, Output, read_scheme
from topcli.config.problems import Problems
from topcli.config.sweep.rows import Row
from topcli.contracts import Outcome, Scheme, Top
from topcli.errors import TopcliError
from topcli.schemes.user_code import users_error
from topcli.store.provenance import cpu_name
from topcli.studies.measures import BatchRun, Measure, batch_size, evaluate, resolve_measures
from topcli.tops import TOPS

FAILED = "failed"
"""Outcome of a row that an error ended before it became a run."""
LANE_STEPS, LANE_ROWS = 1 << 17, 32
"""Steps, all together, or rows that differ only in the initial state, from which on it pays to step them side by side,
which needs another piece of machine code."""
KEPT_RUNS = 16
"""Runs ready to start that a thread keeps for later batches."""


class Shared(NamedTuple):
    """Properties that rows must have in common to be stepped side by side: all but the initial state."""

    form: str
    top: str
    scheme: str
    h: float
    N: int
    every: int

    @classmethod
    def of(cls, row: Row) -> Shared:
        """Shared properties of ``row``."""
        return cls(row.form, row.top, row.scheme, row.h, row.N, row.every)


@dataclass
class Results:
    """Results of rows, by columns; ``values`` are the measures. Rows that were stopped are left out of ``done``."""

    outcome: list[str] = field(default_factory=list)
    message: list[str] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=dict)
    done: list[bool] = field(default_factory=list)
    cpu: str = ""


def evaluate_batch(
    rows: Sequence[Row],
    measures: Sequence[str],
    time_limit: float = 0.0,
    stop: Callable[[], bool] = lambda: False,
) -> Results:
    """Evaluate rows; the results are in their order.

    Parameters
    ----------
    rows : sequence of Row
        Rows, best with those of equal top, scheme, h, N and output next to each other.
    measures : sequence of str
        Names of the measures.
    time_limit : float, optional
        Seconds after which a row is stopped, 0 for never. Rows that are stepped side by side share their time.
    stop : callable, optional
        Asked between chunks; once it returns true, unfinished rows are given up and are not ``done``.

    Returns
    -------
    Results
        A row that fails has its outcome and message there; no error of a row is raised.
    """
    results = Results(
        [FAILED] * len(rows),
        ["not run"] * len(rows),
        {name: [float("nan")] * len(rows) for name in measures},
        [False] * len(rows),
        _cpu(),
    )
    groups: dict[Shared, list[int]] = {}
    for place, row in enumerate(rows):
        groups.setdefault(Shared.of(row), []).append(place)
    for shared, places in groups.items():
        if not stop():
            _Group(shared, tuple(measures), time_limit, stop, results).run([(at, rows[at].initial) for at in places])
    return results


@dataclass(frozen=True)
class Work:
    """``evaluate_batch`` with its options, as plain data that can be sent to another process; ``work(rows)`` calls it.

    Schemes and measures of plugin files must have been loaded there before.
    """

    measures: tuple[str, ...]
    time_limit: float = 0.0

    def __call__(self, rows: Sequence[Row], stop: Callable[[], bool] = lambda: False) -> Results:
        """Evaluate rows."""
        return evaluate_batch(rows, self.measures, self.time_limit, stop)


@cache
def _cpu() -> str:
    return cpu_name()


@lru_cache(maxsize=256)
def _scheme(text: str, form: str) -> tuple[Scheme, Any]:
    """Scheme and options of a resolved section."""
    problems = Problems(Document({}))
    found = read_scheme(json.loads(text), TOPS[form], problems)
    problems.raise_any()
    assert found is not None
    return found


@lru_cache(maxsize=256)
def _top(text: str, form: str) -> Top:
    """Top of a resolved section."""
    section = json.loads(text)
    del section["kind"]
    return TOPS[form].model_validate(section)


@lru_cache(maxsize=256)
def _measures(names: tuple[str, ...], top: str, scheme: str, form: str) -> tuple[Measure, ...]:
    """Measures of rows with this top and scheme."""
    return resolve_measures(names, _top(top, form), *_scheme(scheme, form), any_counter=True)


@lru_cache(maxsize=256)
def shared_experiment(shared: Shared) -> Experiment:
    """Experiment of rows that share these values; its initial state has no meaning."""
    scheme, options = _scheme(shared.scheme, shared.form)
    top = _top(shared.top, shared.form)
    return Experiment.model_construct(
        name="row",
        top=top,
        y0=(0.0,) * len(top.components),
        scheme=scheme,
        options=options,
        h=shared.h,
        N=shared.N,
        output=Output.model_construct(format="parquet", every=shared.every, columns=None),
    )


class _Ready:
    """A batch run that is kept, with the ``stop`` of its latest call."""

    def __init__(self, shared: Shared, measures: tuple[str, ...], count: int) -> None:
        one = shared_experiment(shared)
        self.measures = _measures(measures, shared.top, shared.scheme, shared.form)
        self.size = batch_size(one, self.measures)
        self.stop: Callable[[], bool] = lambda: False
        self.run = BatchRun(one, self.measures, count=min(count, self.size), threads=1, stop=lambda: self.stop())


class _Kept(threading.local):
    """The runs that a thread keeps; a batch run is not safe to share."""

    def __init__(self) -> None:
        self._runs: OrderedDict[Any, _Ready] = OrderedDict()

    def ready(self, shared: Shared, measures: tuple[str, ...], count: int) -> _Ready:
        """Run for ``count`` rows, taken from the kept ones if possible."""
        count = 64 if count > 32 else 8 if count > 1 else 1
        key = (shared, measures, count)
        found = self._runs.get(key)
        if found is None:
            found = self._runs[key] = _Ready(shared, measures, count)
            if len(self._runs) > KEPT_RUNS:
                self._runs.popitem(last=False)
        self._runs.move_to_end(key)
        return found


_kept = _Kept()


def forget() -> None:
    """Forget what is kept for later batches, after the registered schemes or measures have changed."""
    global _kept
    for cached in (_scheme, _top, _measures, shared_experiment):
        cached.cache_clear()
    _kept = _Kept()


@dataclass
class _Group:
    """Rows that differ only in their initial states; a row is its place in the results and its state."""

    shared: Shared
    measures: tuple[str, ...]
    time_limit: float
    stop: Callable[[], bool]
    results: Results

    def run(self, rows: list[tuple[int, tuple[float, ...]]]) -> None:
        """Run the rows in pieces that fit into memory, and store their results."""
        together = len(rows) >= LANE_ROWS or len(rows) * self.shared.N >= LANE_STEPS
        try:
            ready = _kept.ready(self.shared, self.measures, len(rows) if together else 1)
        except Exception as error:
            self._failed([place for place, _ in rows], error)
            return
        for start in range(0, len(rows), ready.size):
            self._piece(ready, rows[start : start + ready.size])

    def _piece(self, ready: _Ready, rows: list[tuple[int, tuple[float, ...]]]) -> None:
        deadline = time.perf_counter() + self.time_limit * len(rows) if self.time_limit else float("inf")
        ready.stop = lambda: time.perf_counter() > deadline or self.stop()
        faults: dict[int, list[str]] = {}
        try:
            batch = ready.run.finished(np.array([state for _, state in rows]))
            found = evaluate(
                ready.measures, batch, lambda i, name, reason: faults.setdefault(i, []).append(f"{name}: {reason}")
            )
        except Exception as error:
            if len(rows) > 1:  # so that only the rows that fail are lost
                for row in rows:
                    self._piece(ready, [row])
            else:
                self._failed([rows[0][0]], error)
            return
        columns = {name: values.tolist() for name, values in found.items()}
        results = self.results
        for i, (place, _) in enumerate(rows):
            ending = batch.endings[i]
            message = "; ".join([ending.message, *faults.get(i, ())])
            if ending.outcome is Outcome.INTERRUPTED:
                if time.perf_counter() <= deadline:
                    continue
                message += f"; the time limit is {self.time_limit:g} s"
            results.outcome[place], results.message[place] = ending.outcome.value, message
            results.done[place] = True
            for name, values in columns.items():
                results.values[name][place] = values[i]

    def _failed(self, places: list[int], error: Exception) -> None:
        """Store the failure of rows that did not become runs."""
        known = error if isinstance(error, TopcliError) else users_error(error)
        text = str(known) if known else f"internal error: {type(error).__name__}: {error}"
        for place in places:
            self.results.message[place] = " ".join(text.split())
            self.results.done[place] = True
