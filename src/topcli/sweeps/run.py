"""Run the unfinished rows of a sweep, batch by batch, and store them in the folder ``<out>/<name>``.

The folder holds ``sweep.yaml`` (the resolved sweep file), the journal of finished rows, ``rows.parquet`` (the tidy
table of finished rows) and ``manifest.json`` (written last).
"""

from __future__ import annotations

import errno
import itertools
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.config.rows import Row, RowReader
from topcli.config.sweep import Sweep, load_sweep
from topcli.engine.drive import default_threads
from topcli.errors import TopcliError, UsageError
from topcli.store.files import io_failure, require_writable, sync, write_text, write_whole
from topcli.store.provenance import now
from topcli.store.result_folder import locked, release
from topcli.store.results import MANIFEST
from topcli.sweeps.journal import COMPLETED, JOURNAL, FinishedRows, Journal
from topcli.sweeps.plan import REASONS, Plan, Survey, changes, plan_sweep, survey
from topcli.sweeps.row_results import Results, Work, batches, unfinished
from topcli.sweeps.rows import ROWS_FILE
from topcli.sweeps.rows_file import sweep_manifest, write_rows

SWEEP_FILE = "sweep.yaml"
SHOWN_WARNINGS = 3
IN_FLIGHT = 2
"""Batches in flight for each worker."""
TABLE_SECONDS = 60.0
"""Shortest time between two tables written during a sweep."""

_TEMPORARY = re.compile(r"\.(sweep|rows|manifest)\.\d+\.(yaml|parquet|json)")
"""Names of files that are being written."""

Backend = Callable[[Iterable[list[Row]], Work, Callable[[], bool]], Iterator[tuple[list[Row], Results]]]
"""``backend(batches, work, stop)`` yields each batch and the results of ``work(batch)``, in any order, with a bounded
number in flight; the ``unfinished`` rows of a batch are another one. ``stop()`` turns true when no further batch is to
begin; rows that are not done are left out."""


@dataclass(frozen=True)
class SweepOptions:
    """Options and callbacks of a sweep, which do not change what it computes."""

    retry_failed: bool = False
    threads: int | None = None
    """Batches that are evaluated at the same time."""
    batch_scale: int = 1
    """Size of a batch in units of about a second of work."""
    stop: Callable[[], bool] = lambda: False
    on_progress: Callable[[int, int, str], None] = lambda done, total, note: None
    """Called with the rows done, their number, and a note on those that failed."""
    on_failure: Callable[[Row, str, str], None] = lambda row, outcome, message: None
    on_message: Callable[[str], None] = lambda line: None


@dataclass(frozen=True)
class SweepResult:
    """A sweep after a call: rows of the plan, those that ran and those that failed, and the seconds of the call."""

    folder: Path
    plan: Plan
    outcomes: dict[str, int]
    ran: int
    interrupted: bool
    seconds: float

    @property
    def finished(self) -> int:
        """Number of finished rows."""
        return sum(self.outcomes.values())

    @property
    def failed(self) -> int:
        """Number of finished rows that did not complete."""
        return self.finished - self.outcomes.get(COMPLETED, 0)


@dataclass
class _Tally:
    """Counts of a sweep that runs."""

    done: int = 0
    failed: int = 0
    ran: int = 0


def require_sweep_folder(folder: Path) -> None:
    """Raise UsageError if ``folder`` holds anything but a sweep."""
    try:
        if folder.exists() and not (folder.is_dir() and (is_sweep(folder) or not _others(folder))):
            raise UsageError(
                f"{folder}: exists and is not a sweep; nothing was written",
                "move it away, or choose another folder with --out, or another name with --set name=...",
            )
    except OSError as error:
        raise UsageError(f"{folder}: {(error.strerror or str(error)).lower()}; choose another with --out") from None


def _others(folder: Path) -> list[Path]:
    """Paths in ``folder`` that no sweep that was killed at its start can have left."""
    return [path for path in folder.iterdir() if not _TEMPORARY.fullmatch(path.name)]


def _remove_temporary(folder: Path) -> None:
    """Remove what a killed process has left half-written."""
    for path in folder.iterdir():
        if _TEMPORARY.fullmatch(path.name):
            path.unlink(missing_ok=True)


def is_sweep(folder: Path) -> bool:
    """True if ``folder`` is that of a sweep."""
    return any(os.path.exists(folder / name) for name in (JOURNAL, SWEEP_FILE))  # False for a name that is too long


def earlier_file(folder: Path) -> dict[str, Any] | None:
    """Sweep file of the previous call in ``folder``, as plain data; None if there is none that can be read."""
    try:
        return load_sweep(folder / SWEEP_FILE).resolved()
    except TopcliError:
        return None


def planned(sweep: Sweep, out: Path, options: SweepOptions) -> tuple[Plan, list[str]]:
    """Plan of a sweep, and the changes of its file since the previous call; nothing is written."""
    surveyed = survey(sweep)
    folder = out / sweep.name
    require_sweep_folder(folder)
    with Journal(folder) as journal:
        plan = plan_sweep(surveyed, journal.index(), options.retry_failed)
    return plan, changes(earlier_file(folder), sweep.resolved())


def rows_to_run(plan: Plan) -> Iterator[tuple[Row, int]]:
    """Yield the rows that have to run, each with the reason."""
    for row in RowReader(plan.survey.sweep).rows():
        if (reason := int(plan.status[row.number])) in REASONS:
            yield row, reason


def in_threads(threads: int) -> Backend:
    """Back end that evaluates batches in threads of this process."""

    def results(made: Iterable[list[Row]], work: Work, stop: Callable[[], bool]) -> Iterator[tuple[list[Row], Results]]:
        source = iter(made)
        flying: dict[Future[Results], list[Row]] = {}
        with ThreadPoolExecutor(threads) as pool:
            while True:
                free = 0 if stop() else IN_FLIGHT * threads - len(flying)
                for batch in itertools.islice(source, max(0, free)):
                    flying[pool.submit(work, batch, stop)] = batch
                if not flying:
                    return
                for future in wait(flying, return_when=FIRST_COMPLETED).done:
                    batch, results = flying.pop(future), future.result()
                    if (rest := unfinished(batch, results)) and not stop():
                        flying[pool.submit(work, rest, stop)] = rest
                    yield batch, results

    return results


def run_sweep(
    sweep: Sweep,
    out: Path,
    options: SweepOptions = SweepOptions(),
    backend: Backend | None = None,
) -> SweepResult:
    """Run the unfinished rows of ``sweep`` and store them in ``out/<name>``.

    Raises ConfigError for a wrong sweep file and UsageError for a folder that is in use or holds something else, both
    before anything runs, and RunError if writing fails; finished rows are kept.
    """
    began = time.perf_counter()
    surveyed = survey(sweep)
    for line in surveyed.warnings[:SHOWN_WARNINGS]:
        options.on_message(f"warning: {sweep.name}: {line}")
    folder = out / sweep.name
    require_sweep_folder(folder)
    require_writable(out)
    with ExitStack() as stack:
        try:
            folder.mkdir(exist_ok=True)
            sync(out)
            lock = locked(folder)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
                raise io_failure(error, folder, "finished rows are kept") from None
            raise UsageError(f"{folder}: cannot be written to ({error.strerror}); choose another with --out") from None
        if lock is None:
            raise UsageError(
                f"{folder}: another sweep is running in this folder; wait for its end, or choose another with --out"
            )
        stack.callback(release, folder, lock)
        _remove_temporary(folder)
        journal = stack.enter_context(Journal(folder, write=True))
        if journal.damaged:
            options.on_message(f"warning: {journal.path}: {journal.damaged} damaged lines; their rows run again")
        runner = _Runner(surveyed, folder, journal, options)
        return runner.run(backend, began)


class _Runner:
    """A sweep that runs in its locked folder."""

    def __init__(self, surveyed: Survey, folder: Path, journal: Journal, options: SweepOptions) -> None:
        self.survey, self.sweep, self.folder = surveyed, surveyed.sweep, folder
        self.journal, self.options = journal, options
        self.plan = plan_sweep(surveyed, journal.index(), options.retry_failed)
        self.tally = _Tally(done=self.plan.done, failed=self.plan.failed)
        self.started = now()
        self._written, self._table_seconds = time.monotonic(), 0.0

    def run(self, backend: Backend | None, began: float) -> SweepResult:
        """Run the rows of the plan, and write the table and the manifest."""
        threads = self.options.threads or default_threads()
        (self.folder / MANIFEST).unlink(missing_ok=True)  # it vouches for the files that now change
        self._write(SWEEP_FILE, self.sweep.to_yaml())
        if self.plan.to_run:
            rows = (row for row, _ in rows_to_run(self.plan))
            made = batches(rows, threads, self.options.batch_scale)
            work = Work(self.sweep.measures)
            for batch, results in (backend or in_threads(threads))(made, work, self.options.stop):
                self._keep(batch, results)
        outcomes = self._table()
        complete = sum(outcomes.values()) == self.survey.count
        interrupted = self.options.stop() and not complete
        seconds = time.perf_counter() - began
        if complete:
            text = sweep_manifest(self.folder, self.sweep, outcomes, self.started, seconds)
            self._write(MANIFEST, text)
        return SweepResult(self.folder, self.plan, outcomes, self.tally.ran, interrupted, seconds)

    def _keep(self, batch: Sequence[Row], results: Results) -> None:
        """Store the results of a batch in the journal, report failures and progress."""
        which = [i for i, done in enumerate(results.done) if done]
        if not which:
            return
        names = self.survey.code_names
        self.journal.append(
            FinishedRows(
                digest=[batch[i].digest for i in which],
                outcome=[results.outcome[i] for i in which],
                message=[results.message[i] for i in which],
                code=[names[self.survey.codes[batch[i].number]] for i in which],
                keys={key: [batch[i].keys[at] for i in which] for at, key in enumerate(self.sweep.keys)},
                values={name: [values[i] for i in which] for name, values in results.values.items()},
                cpu=results.cpu,
            )
        )
        for i in which:
            if results.outcome[i] != COMPLETED:
                self.tally.failed += 1
                self.options.on_failure(batch[i], results.outcome[i], results.message[i])
        self.tally.done += len(which)
        self.tally.ran += len(which)
        note = f"{self.tally.failed} failed" if self.tally.failed else ""
        self.options.on_progress(self.tally.done, self.survey.count - self.plan.repeated, note)
        if time.monotonic() - self._written > max(TABLE_SECONDS, 20.0 * self._table_seconds):
            self._table()

    def _table(self) -> dict[str, int]:
        """Write ``rows.parquet``; the numbers of its current rows by outcome."""
        began = time.monotonic()
        current = plan_sweep(self.survey, self.journal.index())
        path = self.folder / ROWS_FILE
        outcomes: dict[str, int] = {}

        def write(temporary: Path) -> None:
            outcomes.clear()
            outcomes.update(write_rows(temporary, current, self.journal))

        try:
            write_whole(path, write)
        except OSError as error:
            raise io_failure(error, path, "the finished rows are kept in the journal") from None
        self._written = time.monotonic()
        self._table_seconds = self._written - began
        return outcomes

    def _write(self, name: str, text: str) -> None:
        path = self.folder / name
        try:
            write_text(path, text)
        except OSError as error:
            raise io_failure(error, path, "finished rows are kept") from None


def stored_sweep_file(folder: Path, overrides: Sequence[str] = ()) -> Sweep:
    """Return the sweep in ``folder``. Raises UsageError for a folder without one."""
    if not is_sweep(folder):
        raise UsageError(
            f"{folder}: is not the folder of a sweep; give the folder that topcli sweep wrote, such as results/NAME"
        )
    return load_sweep(folder / SWEEP_FILE, overrides)


def find_row(folder: Path, number: int) -> tuple[Sweep, Row]:
    """Return the sweep in ``folder`` and row ``number`` of its plan.

    Raises UsageError for a folder without a sweep and for a number that no row has.
    """
    sweep = stored_sweep_file(folder)
    row = RowReader(sweep).row(number) if number >= 0 else None
    if row is None:
        count = sum(1 for _ in sweep.assignments())
        raise UsageError(f"{folder}: has no row {number}; its rows are 0 to {count - 1}")
    return sweep, row
