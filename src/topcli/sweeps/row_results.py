"""Results of rows of a sweep, as columns, computed from the rows as plain data.

It has no state besides caches, and its arguments and results can be sent to another process: the local sweep calls it
in threads, another back end on its workers. The result of a row does not depend on the other rows of its batch, except
for the measure of its time.
"""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, NamedTuple

import numpy as np

from topcli.config.document import Document
from topcli.config.models import Experiment, Output
from topcli.config.rows import Row
from topcli.config.sections import read_scheme
from topcli.contracts import Outcome, Scheme, StopAsked, Top, stopping_when
from topcli.errors import TopcliError
from topcli.schemes.plugins import users_error
from topcli.store.provenance import cpu_name
from topcli.sweeps.batch import Measuring, evaluate
from topcli.sweeps.measures import Measure, resolve_measures
from topcli.tops import CUSTOM, TOPS

FAILED = "failed"
"""Outcome of a row that an error ended before it became a run."""
PIECE_SECONDS = 2.0
"""The results of a call are handed over after the first piece that ends later than this."""


class Pace(NamedTuple):
    """Way to step rows that differ only in the initial state; it changes no value."""

    lane_steps: int = 1 << 17
    """Steps, all together, from which on it pays to step the rows side by side, with machine code of its own."""
    lane_rows: int = 32
    """Rows from which on that pays."""
    first_piece: int = 64
    """Rows of the first piece of a group that is stepped side by side; one by one, a first piece has one row."""
    seconds: float = PIECE_SECONDS
    """Time of later pieces."""


class Shared(NamedTuple):
    """Properties that rows must have in common to be stepped side by side: all but the initial state."""

    form: str
    top: str
    scheme: str
    h: float
    N: int
    every: int
    quantities: str = ""

    @classmethod
    def of(cls, row: Row) -> Shared:
        """Shared properties of ``row``."""
        return cls(row.form, row.top, row.scheme, row.h, row.N, row.every, row.quantities)


@dataclass
class Results:
    """Results of rows, by columns; ``values`` are the measures. Rows that were not finished are not ``done``."""

    outcome: list[str] = field(default_factory=list)
    message: list[str] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=dict)
    done: list[bool] = field(default_factory=list)
    cpu: str = ""


def results_of_rows(
    rows: Sequence[Row],
    measures: Sequence[str],
    stop: Callable[[], bool] = lambda: False,
    seconds: float = float("inf"),
    *,
    pace: Pace = Pace(),  # noqa: B008 (never changed)
) -> Results:
    """Evaluate rows; the results are in their order.

    Parameters
    ----------
    rows : sequence of Row
        Rows, best with those of equal top, scheme, h, N and output next to each other.
    measures : sequence of str
        Names of the measures.
    stop : callable, optional
        Asked between chunks; once it returns true, unfinished rows are given up and are not ``done``.
    seconds : float, optional
        Time after which no other rows are begun; these are not ``done``. At least one is.
    pace : Pace, optional
        Sizes of the pieces in which the rows are run.

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
        group = _Group(shared, tuple(measures), stop, results, pace)
        group.run([(at, rows[at].initial) for at in places], ended)
        if ended():
            break
    return results


@dataclass(frozen=True)
class Work:
    """``results_of_rows`` with its options, as plain data that can be sent to another process; ``work(rows)`` calls it.

    So that finished rows need not wait for others, it hands over what it has after some seconds; ``unfinished`` rows
    have to be sent again. Schemes and measures of plugin files must have been loaded there before.
    """

    measures: tuple[str, ...]

    def __call__(self, rows: Sequence[Row], stop: Callable[[], bool] = lambda: False) -> Results:
        """Evaluate rows."""
        return results_of_rows(rows, self.measures, stop, PIECE_SECONDS)


def unfinished(rows: Sequence[Row], results: Results) -> list[Row]:
    """Rows of a call that are not done; none if the call was stopped before the first one."""
    return [row for row, done in zip(rows, results.done, strict=True) if not done] if any(results.done) else []


@cache
def _cpu() -> str:
    return cpu_name()


@lru_cache(maxsize=256)
def _scheme(text: str, form: str) -> tuple[Scheme, Any]:
    """Scheme and options of a resolved section."""
    document = Document({})
    scheme = read_scheme(json.loads(text), TOPS[form], document)
    document.check()
    assert scheme is not None
    return scheme


def _declared(section: dict[str, Any]) -> type[Top]:
    from topcli.config.formulas import declared_class

    cls = declared_class(section)
    assert cls is not None
    return cls


@lru_cache(maxsize=256)
def _top(text: str, form: str) -> Top:
    """Top of a resolved section."""
    section = json.loads(text)
    cls = TOPS[form] if section["kind"] != CUSTOM else _declared(section)
    return cls.model_validate(cls.parameters_in(section))


@lru_cache(maxsize=256)
def _measures(names: tuple[str, ...], shared: Shared) -> tuple[Measure, ...]:
    """Measures of rows that share these values."""
    like = shared_experiment(shared)
    quantities = tuple(like.output.quantities or ())
    return resolve_measures(names, like.top, like.scheme, like.options, any_counter=True, quantities=quantities)


@lru_cache(maxsize=256)
def shared_experiment(shared: Shared) -> Experiment:
    """Experiment of rows that share these values; its initial state has no meaning."""
    quantities = json.loads(shared.quantities) if shared.quantities else None
    top = _top(shared.top, shared.form)  # first, since a config may declare it
    scheme, options = _scheme(shared.scheme, shared.form)
    return Experiment.model_construct(
        name="row",
        top=top,
        y0=(0.0,) * len(top.components),
        scheme=scheme,
        options=options,
        h=shared.h,
        N=shared.N,
        output=Output.model_construct(format="parquet", every=shared.every, columns=None, quantities=quantities),
    )


@lru_cache(maxsize=16)
def _measuring(shared: Shared, measures: tuple[str, ...]) -> Measuring:
    """Runs of rows that share these values, ready to start."""
    return Measuring(shared_experiment(shared), _measures(measures, shared), threads=1)


def forget() -> None:
    """Forget what is kept for later batches, after the registered schemes or measures have changed."""
    for cached in (_scheme, _top, _measures, shared_experiment, _measuring):
        cached.cache_clear()


@dataclass
class _Group:
    """Rows that differ only in their initial states; a row is its place in the results and its state."""

    shared: Shared
    measures: tuple[str, ...]
    stop: Callable[[], bool]
    results: Results
    pace: Pace

    def run(self, rows: list[tuple[int, tuple[float, ...]]], ended: Callable[[], bool]) -> None:
        """Run the rows in pieces that fit into memory and take some seconds, until ``ended``; store their results."""
        together = len(rows) >= self.pace.lane_rows or len(rows) * self.shared.N >= self.pace.lane_steps
        try:
            run = _measuring(self.shared, self.measures)
        except Exception as error:
            self._failed([place for place, _ in rows], error)
            return
        most = run.size if together else 1
        start, size = 0, min(most, self.pace.first_piece)
        while start < len(rows) and not (start and ended()) and not self.stop():
            began = time.perf_counter()
            self._piece(run, rows[start : start + size])
            start += size
            taken = max(time.perf_counter() - began, 1e-9)
            size = max(1, min(most, 8 * size, int(size * self.pace.seconds / taken)))

    def _piece(self, run: Measuring, rows: list[tuple[int, tuple[float, ...]]]) -> None:
        faults: dict[int, list[str]] = {}
        try:
            with stopping_when(self.stop), np.errstate(all="ignore"):  # extreme values are outcomes
                batch = run.finished(np.array([state for _, state in rows]), self.stop)
                figures = evaluate(
                    run.measures, batch, lambda i, name, reason: faults.setdefault(i, []).append(f"{name}: {reason}")
                )
        except StopAsked:
            return
        except Exception as error:
            if len(rows) > 1:  # so that only the rows that fail are lost
                for row in rows:
                    self._piece(run, [row])
            else:
                self._failed([rows[0][0]], error)
            return
        columns = {name: values.tolist() for name, values in figures.items()}
        results = self.results
        for i, (place, _) in enumerate(rows):
            ending = batch.endings[i]
            if ending.outcome is Outcome.INTERRUPTED:
                continue
            results.outcome[place] = ending.outcome.value
            results.message[place] = "; ".join([ending.message, *faults.get(i, ())])
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


WINDOW = 1 << 14
"""Rows that are looked at together, to find those that can be stepped side by side."""
BATCH_STEPS = 1 << 25
"""Most steps of a batch, unless a single row has more."""
BATCH_ROWS = 1 << 10
PER_WORKER = 4
"""Batches into which a small sweep is divided for each worker."""


def batches(rows: Iterable[Row], workers: int, scale: int = 1) -> Iterator[list[Row]]:
    """Yield all rows in batches of ``scale`` times the usual size, for ``workers`` that evaluate them side by side."""
    source = iter(rows)
    while window := list(itertools.islice(source, WINDOW)):
        steps = sum(row.N for row in window)
        limit = min(scale * BATCH_STEPS, steps // (PER_WORKER * workers) + 1)
        groups: dict[Shared, list[Row]] = {}
        for row in window:
            groups.setdefault(Shared.of(row), []).append(row)
        yield from _packed(groups.values(), limit, scale * BATCH_ROWS)


def _packed(groups: Iterable[list[Row]], limit: int, most: int) -> Iterator[list[Row]]:
    """Yield batches of at most ``limit`` steps and ``most`` rows, or of one row; only larger groups are divided."""
    batch: list[Row] = []
    steps = 0
    for group in groups:
        size = max(1, min(most, limit // group[0].N))
        for start in range(0, len(group), size):
            piece = group[start : start + size]
            more = sum(row.N for row in piece)
            if batch and (steps + more > limit or len(batch) + len(piece) > most):
                yield batch
                batch, steps = [], 0
            batch += piece
            steps += more
    if batch:
        yield batch
