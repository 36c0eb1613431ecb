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
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from topcli.config.document import Document, Problems
from topcli.config.models import Experiment, Output
from topcli.config.rows import Row
from topcli.config.sections import read_scheme
from topcli.contracts import Outcome, Scheme, StopAsked, Top, stopping_when
from topcli.errors import RunError, TopcliError
from topcli.schemes.user_code import users_error
from topcli.store.provenance import cpu_name
from topcli.sweeps.measures import BatchRun, Measure, batch_size, evaluate, resolve_measures
from topcli.tops import TOPS

FAILED = "failed"
"""Outcome of a row that an error ended before it became a run."""
LANE_STEPS, LANE_ROWS = 1 << 17, 32
"""Steps, all together, or rows that differ only in the initial state, from which on it pays to step them side by side,
which needs another piece of machine code."""
FIRST_PIECE = 64
"""Rows of the first piece of a group that is stepped side by side; one by one, a first piece has one row."""
PIECE_SECONDS = 2.0
"""Time of later pieces. The results of a call are handed over after the first piece that ends later than this."""
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
    """Results of rows, by columns; ``values`` are the measures. Rows that were not finished are not ``done``."""

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
    seconds: float = float("inf"),
) -> Results:
    """Evaluate rows; the results are in their order.

    Parameters
    ----------
    rows : sequence of Row
        Rows, best with those of equal top, scheme, h, N and output next to each other.
    measures : sequence of str
        Names of the measures.
    time_limit : float, optional
        Seconds after which a row is stopped, 0 for never. Rows that are stepped side by side share their time. The
        reference of a row, which other rows may need too, has as many for itself.
    stop : callable, optional
        Asked between chunks; once it returns true, unfinished rows are given up and are not ``done``.
    seconds : float, optional
        Time after which no other rows are begun; these are not ``done``. At least one is.

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
    began = time.perf_counter()

    def ended() -> bool:
        return stop() or time.perf_counter() - began > seconds

    for shared, places in groups.items():
        group = _Group(shared, tuple(measures), time_limit, stop, results)
        group.run([(at, rows[at].initial) for at in places], ended)
        if ended():
            break
    return results


@dataclass(frozen=True)
class Work:
    """``evaluate_batch`` with its options, as plain data that can be sent to another process; ``work(rows)`` calls it.

    So that finished rows need not wait for others, it hands over what it has after some seconds; ``unfinished`` rows
    have to be sent again. Schemes and measures of plugin files must have been loaded there before.
    """

    measures: tuple[str, ...]
    time_limit: float = 0.0

    def __call__(self, rows: Sequence[Row], stop: Callable[[], bool] = lambda: False) -> Results:
        """Evaluate rows."""
        return evaluate_batch(rows, self.measures, self.time_limit, stop, PIECE_SECONDS)


def unfinished(rows: Sequence[Row], results: Results) -> list[Row]:
    """Rows of a call that are not done; none if the call was stopped before the first one."""
    return [row for row, done in zip(rows, results.done, strict=True) if not done] if any(results.done) else []


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


class _Limit:
    """Time limit of some rows, ``seconds`` for each; 0 for none. Once it is reached, ``over`` and ``stop`` are true."""

    def __init__(self, seconds: float, rows: int, stop: Callable[[], bool]) -> None:
        self.seconds, self._stop = seconds, stop
        self._deadline = time.perf_counter() + seconds * rows if seconds else float("inf")

    @property
    def over(self) -> bool:
        """True once the time has passed."""
        return time.perf_counter() > self._deadline

    def stop(self) -> bool:
        """True once the rows are to stop, for whatever reason."""
        return self.over or self._stop()

    @contextmanager
    def apart(self) -> Iterator[None]:
        """Limit the block by as many seconds for itself, which do not count for the rows. Raises RunError."""
        began, deadline = time.perf_counter(), self._deadline
        self._deadline = began + self.seconds if self.seconds else float("inf")
        try:
            yield
        except StopAsked:
            if self._stop():
                raise
            raise RunError(f"the reference takes more than the time limit of {self.seconds:g} s") from None
        finally:
            self._deadline = deadline + (time.perf_counter() - began)


class _Ready:
    """A batch run that is kept, with the ``limit`` of its latest call."""

    def __init__(self, shared: Shared, measures: tuple[str, ...], count: int) -> None:
        one = shared_experiment(shared)
        self.measures = _measures(measures, shared.top, shared.scheme, shared.form)
        self.size = batch_size(one, self.measures)
        self.limit = _Limit(0.0, 1, lambda: False)
        self.run = BatchRun(
            one,
            self.measures,
            count=min(count, self.size),
            threads=1,
            stop=lambda: self.limit.stop(),
            limited=lambda: self.limit.apart(),
        )


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

    def run(self, rows: list[tuple[int, tuple[float, ...]]], ended: Callable[[], bool]) -> None:
        """Run the rows in pieces that fit into memory and take some seconds, until ``ended``; store their results."""
        together = len(rows) >= LANE_ROWS or len(rows) * self.shared.N >= LANE_STEPS
        try:
            ready = _kept.ready(self.shared, self.measures, len(rows) if together else 1)
        except Exception as error:
            self._failed([place for place, _ in rows], error)
            return
        start, size = 0, min(ready.size, FIRST_PIECE if ready.run.side_by_side else 1)
        while start < len(rows) and not (start and ended()) and not self.stop():
            began = time.perf_counter()
            self._piece(ready, rows[start : start + size])
            start += size
            taken = max(time.perf_counter() - began, 1e-9)
            size = max(1, min(ready.size, 8 * size, int(size * PIECE_SECONDS / taken)))

    def _piece(self, ready: _Ready, rows: list[tuple[int, tuple[float, ...]]]) -> None:
        ready.limit = limit = _Limit(self.time_limit, len(rows), self.stop)
        faults: dict[int, list[str]] = {}
        try:
            with stopping_when(limit.stop), np.errstate(all="ignore"):  # extreme values are outcomes
                batch = ready.run.finished(np.array([state for _, state in rows]))
                found = evaluate(
                    ready.measures, batch, lambda i, name, reason: faults.setdefault(i, []).append(f"{name}: {reason}")
                )
        except StopAsked:
            if len(rows) > 1 and not self.stop():
                for row in rows:
                    self._piece(ready, [row])
            elif not self.stop():
                self._ended(rows[0][0], Outcome.INTERRUPTED, f"stopped; {self._limit_text}")
            return
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
                if not limit.over:
                    continue
                message += f"; {self._limit_text}"
            self._ended(place, ending.outcome, message)
            for name, values in columns.items():
                results.values[name][place] = values[i]

    @property
    def _limit_text(self) -> str:
        return f"the time limit is {self.time_limit:g} s"

    def _ended(self, place: int, outcome: Outcome, message: str) -> None:
        """Store the outcome of a row."""
        self.results.outcome[place], self.results.message[place] = outcome.value, message
        self.results.done[place] = True

    def _failed(self, places: list[int], error: Exception) -> None:
        """Store the failure of rows that did not become runs."""
        known = error if isinstance(error, TopcliError) else users_error(error)
        text = str(known) if known else f"internal error: {type(error).__name__}: {error}"
        for place in places:
            self.results.message[place] = " ".join(text.split())
            self.results.done[place] = True
