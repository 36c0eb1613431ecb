"""Sweeps on a Dask cluster: connection to the scheduler, and batches as tasks.

The scheduler is found or started, and its workers are compared with this process. It never holds more than a few
batches for each thread of a worker. The key of a task is the digest of what it computes. A batch whose workers are lost
again and again is divided. The scheduler blames all tasks of a lost worker, so a single row is tried once more at the
end with nothing else in flight; if that ends its workers, too, it becomes a failed row. Every wait has a limit; the
waits that may be long end when the sweep is to stop.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
import pickle
import queue
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from topcli.config.rows import Row
from topcli.config.sweep import Sweep
from topcli.errors import RunError, UsageError, quoted
from topcli.schemes.plugins import FILES, reason_of
from topcli.sweeps.row_results import FAILED, Results, Work, unfinished
from topcli.sweeps.run import SweepOptions, SweepResult, run_sweep

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

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
CLUSTER_IN_FLIGHT = 3
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
                while len(self._flying) < CLUSTER_IN_FLIGHT * max(1, self.threads):
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
            flying = self._flying.pop(future.key, None)
            if flying is None:
                continue
            _, batch = flying
            if future.cancelled() or self.client.status == "closed":
                raise self._disconnected()
            try:
                results = future.result(timeout=COUNT_SECONDS)
            except TimeoutError:  # its worker was lost after the end: the scheduler has it computed again
                self._flying[future.key] = flying
                future.add_done_callback(self._ended.put)
                return  # it counts as ended, and would come again at once: workers may have to be replaced first
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
    """Digest of a task: its rows and measures, and the job."""
    content = [[row.digest for row in batch], list(work.measures), token]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def _lost(work: Work) -> Results:
    """Results of a row whose workers were lost each time."""
    message = "every worker that computed this row was lost; see the logs and memory limits of the workers"
    return Results([FAILED], [message], {name: [float("nan")] for name in work.measures}, [True])


LOCAL = "local:"
CONNECT_SECONDS = 5
"""Time in which a scheduler must answer."""
WORKER_SECONDS = 60.0
"""Time in which the first worker must have joined the scheduler."""
BATCH_SCALE = 3
"""Seconds of work in a batch: much longer than the scheduler's time for a task."""
_LOCAL_CLUSTER: dict[str, Any] = {
    "threads_per_worker": 1,
    "dashboard_address": "127.0.0.1:0",  # any port: the default one may be in use
    "worker_dashboard_address": None,
    "silence_logs": logging.CRITICAL,
    "death_timeout": WORKER_SECONDS,
    # Ctrl-C in a terminal is for the process that writes; it ends the workers
    "preload": "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)",
}


def require_dask() -> None:
    """Raise UsageError if the packages of the extra ``dask`` are missing."""
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"--dask: the package {error.name or 'distributed'} is missing", "pip install 'topcli[dask]' installs it"
        ) from None


def local_workers(address: str) -> int:
    """Number of workers of ``local:N``; 0 for the address of a scheduler.

    Raises UsageError if ``address`` is neither.
    """
    if address.startswith(LOCAL):
        count = address.removeprefix(LOCAL)
        if count.isascii() and count.isdigit() and int(count) > 0:
            return int(count)
    else:
        protocol, _, rest = address.rpartition("://")
        _, colon, port = rest.rpartition(":")
        if (protocol or "tcp").isalnum() and colon and port.rstrip("/").isdigit():
            return 0
    raise UsageError(
        f"--dask {quoted(address)}: neither a number of workers nor the address of a scheduler",
        "give local:4 for four workers on this machine, or an address such as tcp://host:8786",
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the log of the library from stderr: what matters is reported by us."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


def run_on_cluster(
    address: str,
    sweep: Sweep,
    out: Path,
    options: SweepOptions = SweepOptions(),
) -> SweepResult:
    """Run the unfinished rows of ``sweep`` on the Dask cluster at ``address``; otherwise as ``run_sweep``."""
    with connected(address, options.on_message, options.stop) as cluster:
        divided = replace(options, threads=cluster.threads, batch_scale=BATCH_SCALE)
        return run_sweep(sweep, out, divided, cluster)


def _require_answer(address: str) -> None:
    """Raise the library's error, or TimeoutError, if no scheduler answers; the client itself waits forever for one
    that accepts a connection and is silent."""
    from distributed.comm.core import connect
    from distributed.security import Security

    async def ask() -> None:
        options = Security().get_connection_args("client")
        comm = await asyncio.wait_for(connect(address, timeout=CONNECT_SECONDS, **options), CONNECT_SECONDS)
        comm.abort()

    with ThreadPoolExecutor(1) as pool:  # this thread may have a running event loop
        pool.submit(asyncio.run, ask()).result()


@contextmanager
def connected(
    address: str, on_message: Callable[[str], None] = lambda line: None, stop: Stop = lambda: False
) -> Iterator[Cluster]:
    """Connect to the scheduler at ``address``, or start one for ``local:N``, and prepare its workers.

    Parameters
    ----------
    address : str
        ``local:N`` for N worker processes on this machine, or the address of a scheduler, ``tcp://host:port``.
    on_message : callable, optional
        Called with each warning.
    stop : callable, optional
        Once it returns true, workers are waited for no longer.

    Yields
    ------
    Cluster
        Back end for ``run_sweep``.

    Raises
    ------
    UsageError
        If dask is missing, no scheduler answers, it has no workers, or a worker has other versions.
    """
    count = local_workers(address)
    require_dask()
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        stack.enter_context(_quiet())
        target: Any = address
        local: LocalCluster | None = None
        if count:
            target = local = LocalCluster(n_workers=count, **_LOCAL_CLUSTER)
            stack.callback(_close, local)
        try:
            if not count:
                _require_answer(address)
            client = stack.enter_context(Client(target, timeout=CONNECT_SECONDS, set_as_default=False))
        except Exception as error:
            reason = "another program answers there"
            if isinstance(error, OSError | TimeoutError):
                reason = str(error)[:200] or f"no answer within {CONNECT_SECONDS} s"
            raise UsageError(
                f"--dask {address}: no Dask scheduler can be reached ({reason})",
                "dask scheduler starts one; --dask local:4 uses this machine",
            ) from None
        if count:
            stack.callback(_wait_for_restarts, client, address, count)
        cluster = _prepared(client, address, on_message, stop, stack)
        if local:
            cluster.replace_workers = lambda: local.scale(len(local.worker_spec) + count)
        yield cluster


def _wait_for_restarts(client: Client, address: str, count: int) -> None:
    """Wait until ``count`` workers of one thread are there: closing the cluster while one is restarted is an error."""
    deadline = time.monotonic() + RESTART_SECONDS
    with suppress(Exception):
        while thread_count(client, address) < count and time.monotonic() < deadline:
            time.sleep(POLL_SECONDS)


def _close(cluster: LocalCluster) -> None:
    """Close ``cluster``; the rows are finished, and what fails here concerns processes that end with this one."""
    with suppress(Exception):
        cluster.close(timeout=RESTART_SECONDS)


def _prepared(client: Client, address: str, on_message: Callable[[str], None], stop: Stop, stack: ExitStack) -> Cluster:
    """Cluster whose workers have the same versions and are ready for the sweep."""
    from topcli.sweeps.worker import Job, Preparation, versions

    threads = _wait_for_workers(client, address, on_message, stop)
    job = Job(uuid.uuid4().hex[:16], versions(), tuple(FILES.values()))
    for line in _check_workers(client, address, job):
        on_message(line)
    plugin = Preparation(job)
    answer(client, address, lambda: client.register_plugin(plugin, name=plugin.name))

    def unregister() -> None:
        with suppress(Exception):  # the scheduler may be gone
            answer(client, address, lambda: client.unregister_worker_plugin(plugin.name), RESTART_SECONDS)

    stack.callback(unregister)
    return Cluster(client, address, job, threads, on_message)


def _wait_for_workers(client: Client, address: str, on_message: Callable[[str], None], stop: Stop) -> int:
    """Number of threads of all workers, of which there is at least one."""
    deadline, said = time.monotonic() + WORKER_SECONDS, False
    while not (threads := thread_count(client, address)):
        if stop() or time.monotonic() > deadline:
            raise UsageError(
                f"--dask {address}: the scheduler has no workers", f"dask worker {address} starts one on this machine"
            )
        if not said:
            on_message(f"{address} has no workers; waiting for one")
            said = True
        time.sleep(POLL_SECONDS)
    return threads


def _check_workers(client: Client, address: str, job: Job) -> list[str]:
    """Compare the workers with this process; return warnings. Raises UsageError that names a worker that differs."""
    from topcli.sweeps.worker import describe, difference

    answers = cast(dict[str, Any], answer(client, address, lambda: client.run(describe, on_error="return")))
    cpus: dict[str, int] = {}
    for worker, said in sorted(answers.items()):
        if isinstance(said, BaseException):
            raise UsageError(
                f"worker {worker}: topcli cannot be imported there ({reason_of(said)[:200]})",
                f"install topcli {job.versions['topcli']} there",
            )
        if fault := difference(job.versions, said["versions"]):
            raise UsageError(f"worker {worker}: {fault}", "install the same versions there")
        cpus[said["cpu"]] = cpus.get(said["cpu"], 0) + 1
    if len(cpus) < 2:
        return []
    kinds = ", ".join(f"{count} with {cpu}" for cpu, count in cpus.items())
    return [f"warning: the workers have different processors ({kinds}); results may differ in the last digits"]
