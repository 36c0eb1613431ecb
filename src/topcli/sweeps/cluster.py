"""A sweep on a Dask cluster: batches as tasks, a bounded number in flight, results back to the one writer.

The scheduler never holds more than a few batches for each thread of a worker. The key of a task is the digest of what
it computes. A batch whose workers are lost again and again is divided. The scheduler blames all tasks of a lost worker,
so a single row is tried once more at the end with nothing else in flight; if that ends its workers, too, it becomes a
failed row.
"""

from __future__ import annotations

import hashlib
import json
import pickle
import queue
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

from topcli.config.rows import Row
from topcli.errors import RunError, UsageError
from topcli.schemes.user_code import reason_of
from topcli.sweeps.evaluate import FAILED, Results, Work, unfinished

if TYPE_CHECKING:
    from distributed import Client, Future

    from topcli.sweeps.worker import Job

ANSWER_SECONDS = 60.0
"""Time in which the scheduler and all workers must answer a question."""
RESTART_SECONDS = 10.0
"""Time in which a lost worker of this machine is started again, and in which a cluster on this machine must end."""
RESTARTS = 5
"""Times in a row that this machine's workers are replaced if none of them is started again."""
POLL_SECONDS = 0.2
COUNT_SECONDS = 2.0
"""Time between two counts of the workers."""
IN_FLIGHT = 3
"""Batches in flight for each thread of a worker."""
ALONE = "-alone"
"""End of the key of a row that is in flight alone."""
Batch = list[Row]
Stop = Callable[[], bool]


def answer(client: Client, address: str, ask: Callable[[], Any], seconds: float = ANSWER_SECONDS) -> Any:
    """Result of a call of the client, which waits for ever itself. Raises RunError if there is none in time."""

    async def asking() -> Any:
        return await ask()

    try:
        return client.sync(asking, callback_timeout=seconds)
    except TimeoutError:
        raise RunError(
            f"--dask {address}: the scheduler or a worker has not answered within {seconds:g} s",
            "finished rows are kept; see the logs of the workers, and run the sweep again to continue",
        ) from None


def thread_count(client: Client, address: str) -> int:
    """Number of threads of all workers."""
    return sum(cast(dict[str, int], answer(client, address, client.nthreads)).values())


@dataclass
class Cluster:
    """Back end of a sweep on the prepared workers of a scheduler; ``threads`` is the number of their threads.

    ``replace_workers`` starts other workers, if they are on this machine: a worker that ends while it is started is not
    started again.
    """

    client: Client
    address: str
    job: Job
    threads: int
    on_message: Callable[[str], None]
    replace_workers: Callable[[], object] | None = None
    clock: Callable[[], float] = time.monotonic
    _flying: dict[Any, tuple[Future[Any], Batch]] = field(default_factory=dict)
    _ended: queue.SimpleQueue[Future[Any]] = field(default_factory=queue.SimpleQueue)
    _pieces: deque[Batch] = field(default_factory=deque)
    """Parts of batches that were divided."""
    _suspects: deque[Batch] = field(default_factory=deque)
    """Single rows whose workers were lost while other rows were there, too."""
    _replaced: int = 0

    def __post_init__(self) -> None:
        self._counted = self._alive = self.clock()
        """Times at which the workers were counted, and at which one was there or they were replaced."""

    def __call__(self, made: Iterable[Batch], work: Work, stop: Stop) -> Iterator[tuple[Batch, Results]]:
        """Yield each batch and its results; the rows in flight are given up once ``stop()`` returns true."""
        source = iter(made)
        try:
            while not stop():
                while len(self._flying) < IN_FLIGHT * max(1, self.threads):
                    batch = self._pieces.popleft() if self._pieces else next(source, None)
                    if batch is None:
                        break
                    self._submit(batch, work)
                if not self._flying:
                    if not self._suspects:
                        return
                    self._submit(self._suspects.popleft(), work, alone=True)
                yield from self._arrived(work)
                self._count()
            yield from self._last()
        finally:
            self._give_up()

    def _submit(self, batch: Batch, work: Work, *, alone: bool = False) -> None:
        from topcli.sweeps.worker import evaluate

        key = f"topcli-{batch_digest(batch, work, self.job.token)}{ALONE if alone else ''}"
        # pickled here: the library would look at every number for what it has to wait for
        future = self.client.submit(evaluate, self.job.token, work, pickle.dumps(batch), key=key)
        self._flying[key] = (future, batch)
        future.add_done_callback(self._ended.put)

    def _arrived(self, work: Work, seconds: float = POLL_SECONDS) -> Iterator[tuple[Batch, Results]]:
        """Yield what has ended, after waiting for at most ``seconds``."""
        from distributed import TimeoutError
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker

        while True:
            try:
                future = self._ended.get(timeout=seconds)
            except queue.Empty:
                return
            seconds = 0.0
            found = self._flying.pop(future.key, None)
            if found is None:
                continue
            _, batch = found
            if future.cancelled() or self.client.status == "closed":
                raise self._disconnected()
            try:
                results = future.result(timeout=COUNT_SECONDS)
            except TimeoutError:  # its worker was lost after the end: the scheduler has it computed again
                self._flying[future.key] = found
                future.add_done_callback(self._ended.put)
                continue
            except KilledWorker:
                if len(batch) > 1:
                    self._pieces.extend((batch[: len(batch) // 2], batch[len(batch) // 2 :]))
                    continue
                if not str(future.key).endswith(ALONE):
                    self._suspects.append(batch)
                    continue
                results = _lost(work)
            except CommClosedError:
                raise self._disconnected() from None
            except UsageError:
                raise
            except Exception as error:
                raise RunError(
                    f"--dask {self.address}: a worker failed: {reason_of(error)}", "finished rows are kept"
                ) from None
            self._pieces.extend(filter(None, [unfinished(batch, results)]))
            yield batch, results

    def _disconnected(self) -> RunError:
        return RunError(
            f"--dask {self.address}: the connection to the scheduler was lost; finished rows are kept",
            "run the sweep again to continue",
        )

    def _last(self) -> Iterator[tuple[Batch, Results]]:
        """Yield the batches that have ended when the sweep is stopped."""
        for future, batch in list(self._flying.values()):
            if future.status == "finished":
                with suppress(Exception):
                    yield batch, future.result(timeout=COUNT_SECONDS)

    def _count(self) -> None:
        """Count the threads of the workers, so that new ones get work, too. Raises RunError if there will be none."""
        now = self.clock()
        if now - self._counted < COUNT_SECONDS:
            return
        self._counted = now
        with suppress(OSError, RunError):
            threads = thread_count(self.client, self.address)
            if not threads and self.threads:
                self.on_message(f"warning: {self.address} has no workers left; waiting for new ones")
            self.threads = threads
        if self.threads:
            self._alive, self._replaced = now, 0
        elif self.replace_workers and now - self._alive >= RESTART_SECONDS:
            if self._replaced == RESTARTS:
                raise RunError(
                    f"--dask {self.address}: its workers end before they begin; finished rows are kept",
                    "run the sweep again to continue",
                )
            self._alive, self._replaced = now, self._replaced + 1
            self.replace_workers()

    def _give_up(self) -> None:
        """Cancel what is in flight, and end the rows that are being evaluated."""
        from topcli.sweeps.worker import stop

        if not self._flying:
            return
        with suppress(Exception):
            flying = [future for future, _ in self._flying.values()]
            answer(self.client, self.address, lambda: self.client.cancel(flying), RESTART_SECONDS)
            ask = self.client.run
            answer(self.client, self.address, lambda: ask(stop, self.job.token, on_error="ignore"), RESTART_SECONDS)
        self._flying.clear()


def batch_digest(batch: Sequence[Row], work: Work, token: str) -> str:
    """Digest of a task: its rows, measures and time limit, and the job."""
    content = [[row.digest for row in batch], list(work.measures), work.time_limit, token]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _lost(work: Work) -> Results:
    """Results of a row whose workers were lost each time."""
    message = "each worker that computed this row was lost; see its log, or its limit of memory"
    return Results([FAILED], [message], {name: [float("nan")] for name in work.measures}, [True])
