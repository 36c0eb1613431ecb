"""Connection to a Dask cluster: its scheduler is found or started, its workers are compared with this process.

Every wait has a limit; the waits that may be long end when the sweep is to stop.
"""

from __future__ import annotations

import asyncio
import logging
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from topcli.config.sweep import Sweep
from topcli.errors import UsageError, quoted
from topcli.schemes.registry import loaded_scheme_files
from topcli.schemes.user_code import reason_of
from topcli.sweeps.cluster import POLL_SECONDS, RESTART_SECONDS, Cluster, answer, thread_count
from topcli.sweeps.run import SweepOptions, SweepResult, Watcher, run_sweep

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

    from topcli.sweeps.worker import Job

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
Stop = Callable[[], bool]


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
    options: SweepOptions | None = None,
    watcher: Watcher | None = None,
) -> SweepResult:
    """Run what is new in ``sweep`` on the Dask cluster at ``address``; otherwise as ``run_sweep``."""
    options, watcher = options or SweepOptions(), watcher or Watcher()
    with connected(address, watcher.message, watcher.stop) as cluster:
        divided = replace(options, threads=cluster.threads, batch_scale=BATCH_SCALE)
        return run_sweep(sweep, out, divided, watcher, cluster)


def _requireanswer(address: str) -> None:
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
                _requireanswer(address)
            client = stack.enter_context(Client(target, timeout=CONNECT_SECONDS, set_as_default=False))
        except Exception as error:
            reason = "what answers there is something else"
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
    job = Job(uuid.uuid4().hex[:16], versions(), loaded_scheme_files())
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

    found = cast(dict[str, Any], answer(client, address, lambda: client.run(describe, on_error="return")))
    cpus: dict[str, int] = {}
    for worker, said in sorted(found.items()):
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
