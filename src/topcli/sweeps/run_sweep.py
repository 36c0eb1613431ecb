"""Run the rows of a sweep that are not finished, and store them in the folder ``<out>/<name>``.

The digest of a row covers what it computes and the code that computes it, so that a plan is the difference of two sets:
the digests of the sweep and those in the store.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topcli.config.states import unit_warnings
from topcli.config.sweep import Group, Sweep
from topcli.contracts import Top, stop_asked
from topcli.engine.drive import default_threads
from topcli.errors import RunError, TopcliError, UsageError
from topcli.store.files import io_failure, require_writable, write_text
from topcli.store.identity import canonical, code_digest, digest_of_texts
from topcli.store.provenance import now
from topcli.store.result_folder import locked, release, set_aside
from topcli.store.results import MANIFEST, StoredResult, read_result
from topcli.sweeps.compute import INTERRUPTED, Piece, code_of_process, executor, results
from topcli.sweeps.measures import definition_texts, resolve_measures
from topcli.sweeps.store import (
    COMPLETED,
    DATABASE,
    FAILED,
    ROWS_FILE,
    SWEEP_FILE,
    RowStore,
    StoredRow,
    is_sweep,
    write_manifest,
    write_table,
)
from topcli.tops.bodies import moment_warnings

BATCH_ROWS, BATCH_STEPS, PER_WORKER = 1 << 10, 1 << 24, 4
"""Most rows and steps of a batch, and batches into which a small sweep is divided for each worker."""
SHOWN_WARNINGS, WARNED_GROUPS, WARNED_STATES = 3, 64, 1000


@dataclass(frozen=True)
class SweepOptions:
    """Options and callbacks of a sweep, which do not change what it computes."""

    force: bool = False
    """Begin anew; the earlier folder is renamed."""
    threads: int | None = None
    """Batches that are computed at the same time."""
    dask: str | None = None
    """Address of a Dask scheduler, or ``local:N`` for N workers on this machine."""
    on_progress: Callable[[int, int, str], None] = lambda done, total, note: None
    """Called with the rows done, their number, and a note on those that failed."""
    on_failure: Callable[[int, str], None] = lambda row, message: None
    """Called with the number and the message of a row that did not complete."""
    on_message: Callable[[str], None] = lambda line: None


@dataclass(frozen=True)
class SweepResult:
    """A sweep after a call: its rows, those that ran, outcomes of the finished ones, and the seconds of the call."""

    folder: Path
    rows: int
    ran: int
    outcomes: dict[str, int]
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


@dataclass(frozen=True)
class SweepPlan:
    """All rows of a sweep in ``groups``, the digest of each row, and warnings about the first ones."""

    groups: list[Group]
    digests: list[bytes]
    warnings: list[str] = field(default_factory=list)

    def waiting(self, finished: dict[bytes, StoredRow]) -> NDArray[np.bool_]:
        """True for each row that has to run: rows that are equal run once, and rows that an error ended run again."""
        seen = {digest for digest, row in finished.items() if row[0] != FAILED}
        waiting = np.zeros(len(self.digests), dtype=bool)
        for number, digest in enumerate(self.digests):
            if digest not in seen:
                seen.add(digest)
                waiting[number] = True
        return waiting


def sweep_plan(sweep: Sweep) -> SweepPlan:
    """Validate every row of a sweep.

    Raises ConfigError or UnknownNameError with the file, the line and the key of the fault, also for a measure that
    does not exist or does not fit a row, and SchemeCodeError for code without a file.
    """
    groups = list(sweep.groups())
    digests = [b""] * sum(len(group.numbers) for group in groups)
    codes: dict[tuple[type[Top], str, str], str] = {}
    warnings = list[str]()
    for index, (experiment, states, numbers, _) in enumerate(groups):
        # code of the steps and the measures, once for all groups that share it
        top, scheme, output = experiment.top, experiment.scheme, experiment.output
        config, quantities = {**experiment.resolved(), "name": "", "initial": "", "output": ""}, output.quantities or {}
        kind = type(top), scheme.name, canonical([config["scheme"], quantities])
        if kind not in codes:
            try:
                resolve_measures(sweep.measures, top, scheme, experiment.options, tuple(quantities))
            except TopcliError as error:
                sweep.document.fault(("measure",), str(error))
            texts = [code_digest(type(top), scheme), experiment.own_code, *definition_texts(sweep.measures)]
            codes[kind] = digest_of_texts([*texts, *sweep.measures])

        # digests of the rows: what they share, and their states
        shared = hashlib.sha256(canonical([config, top.form, output.every, quantities, codes[kind]]).encode())
        for number, state in zip(numbers.tolist(), np.ascontiguousarray(states), strict=True):
            digest = shared.copy()
            digest.update(state.tobytes())
            digests[number] = digest.digest()
        if index < WARNED_GROUPS:
            warnings += [*moment_warnings(top), *unit_warnings(type(top), states[:WARNED_STATES])]
    return SweepPlan(groups, digests, list(dict.fromkeys(warnings)))


def planned(sweep: Sweep, out: Path) -> tuple[SweepPlan, NDArray[np.bool_]]:
    """Plan of a sweep, and True for each of its rows that has to run; no row is run."""
    plan, folder = sweep_plan(sweep), out / sweep.name
    require_sweep_folder(folder)
    if not (folder / DATABASE).exists():
        return plan, plan.waiting({})
    with RowStore(folder) as store:
        return plan, plan.waiting(store.read())


def require_sweep_folder(folder: Path) -> None:
    """Raise UsageError if ``folder`` holds anything but a sweep and temporary files of a killed process."""
    others = not is_sweep(folder) and os.path.isdir(folder) and any(folder.glob("[!.]*"))
    if others or os.path.isfile(folder):
        advice = "move it away, or choose another folder with --out, or another name with --set name=..."
        raise UsageError(f"{folder}: exists and is not a sweep; nothing was written", advice)


def run_sweep(sweep: Sweep, out: Path, options: SweepOptions = SweepOptions()) -> SweepResult:
    """Run the rows of ``sweep`` that are not finished, and store all in ``out/<name>``.

    Raises ConfigError for a wrong sweep file and UsageError for a folder that is in use or holds something else, both
    before anything runs, and RunError if writing fails; finished rows are kept.
    """
    began, started, folder = time.perf_counter(), now(), out / sweep.name
    require_sweep_folder(folder)
    code = code_of_process()
    if not options.force and (stored := _up_to_date(folder, sweep, code)):
        rows, outcomes = stored.manifest["rows"], stored.manifest["outcomes"]
        return SweepResult(folder, rows, 0, outcomes, False, time.perf_counter() - began)
    plan = sweep_plan(sweep)
    for line in plan.warnings[:SHOWN_WARNINGS]:
        options.on_message(f"warning: {sweep.name}: {line}")
    require_writable(out)
    try:
        with executor(options.threads or default_threads(), options.dask) as pool, _claimed(folder, sweep, options):
            write_text(folder / SWEEP_FILE, sweep.to_yaml())
            write_manifest(folder, sweep, started=started)
            with RowStore(folder) as store:
                ran = _run_rows(sweep, plan, store, pool, options)
                outcomes = write_table(folder, sweep, plan.groups, plan.digests, store.read())
            rows, finished, seconds = len(plan.digests), sum(outcomes.values()), time.perf_counter() - began
            outcome = COMPLETED if finished == rows else INTERRUPTED
            entries = {"rows": rows, "step": finished, "outcomes": outcomes, "code": code, "seconds": seconds}
            write_manifest(folder, sweep, True, **entries, outcome=outcome, started=started)
    except OSError as error:
        raise io_failure(error, folder, "finished rows are kept") from None
    return SweepResult(folder, rows, ran, outcomes, stop_asked() and finished < rows, seconds)


def _up_to_date(folder: Path, sweep: Sweep, code: str) -> StoredResult | None:
    """Stored sweep, if all its rows are finished and neither the sweep nor any code has changed; otherwise None."""
    with suppress(RunError):  # a damaged manifest is written again
        stored = read_result(folder)
        if stored and stored.complete and FAILED not in stored.manifest["outcomes"]:
            same = (stored.manifest["digest"], stored.manifest["code"]) == (sweep.digest, code)
            return stored if same and not stored.damage() else None
    return None


@contextmanager
def _claimed(folder: Path, sweep: Sweep, options: SweepOptions) -> Iterator[None]:
    """Hold the lock of the folder of a sweep, which exists then. Raises UsageError if another process has it."""
    lock = locked(folder)
    if lock is None:
        advice = "wait for its end, or choose another with --out"
        raise UsageError(f"{folder}: another sweep is running in this folder; {advice}")
    try:
        if options.force and is_sweep(folder):
            earlier = set_aside(StoredResult(folder, {"key": sweep.digest[:8]}))
            options.on_message(f"renamed the earlier sweep to {earlier}")
        folder.mkdir(exist_ok=True)
        for name in (MANIFEST, SWEEP_FILE, ROWS_FILE):
            for torn in folder.glob(f".{Path(name).stem}.*"):  # of a process that was killed while it wrote a file
                torn.unlink()
        yield
    finally:
        release(folder, lock)


def _run_rows(sweep: Sweep, plan: SweepPlan, store: RowStore, pool: tuple[Executor, int], options: SweepOptions) -> int:
    """Run the rows of a plan that have to run, and store them; return their number."""
    finished = store.read()
    waiting = plan.waiting(finished)
    total, to_run, ran = len(plan.digests), int(waiting.sum()), 0
    failed = sum(digest in finished and finished[digest][0] not in (COMPLETED, FAILED) for digest in plan.digests)
    batches = batches_of(plan.groups, waiting, pool[1])
    for batch, computed in results(batches, sweep.measures, *pool, options.dask):
        numbers = [number for piece in batch for number in piece.rows]
        rows = {number: row for number, row in zip(numbers, computed, strict=True) if row[0] != INTERRUPTED}
        store.add([plan.digests[number] for number in rows], list(rows.values()))
        for number, (outcome, message, _) in rows.items():
            if outcome != COMPLETED:
                failed += 1
                options.on_failure(number, message)
        ran += len(rows)
        options.on_progress(total - to_run + ran, total, f"{failed} failed" if failed else "")
    return ran


def batches_of(groups: Sequence[Group], waiting: NDArray[np.bool_], workers: int) -> Iterator[list[Piece]]:
    """Yield the rows that are ``waiting`` in batches for the ``workers``; each has a row at least."""
    total = sum(int(waiting[group.numbers].sum()) * group.experiment.N for group in groups)
    most = min(BATCH_STEPS, total // (PER_WORKER * workers) + 1)
    batch, steps, count = list[Piece](), 0, 0
    for experiment, states, numbers, _ in groups:
        places = np.flatnonzero(waiting[numbers])
        while len(places):
            room = min(BATCH_ROWS - count, (most - steps) // experiment.N)
            if room < 1 and batch:
                yield batch
                batch, steps, count = [], 0, 0
                continue
            chosen, places = np.split(places, [max(1, room)])
            batch.append(Piece(experiment, states[chosen], numbers[chosen].tolist()))
            steps, count = steps + len(chosen) * experiment.N, count + len(chosen)
    if batch:
        yield batch
