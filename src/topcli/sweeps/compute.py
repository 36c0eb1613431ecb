"""Computation of rows: experiments from many initial states, in threads of this process or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import copy_context
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, StopAsked, stop_asked
from topcli.engine.machine import Machine
from topcli.errors import RunError, TopcliError, UsageError
from topcli.plugins import (
    FILES,
    REGISTERED,
    load_plugin_file,
    plugin_failures,
    reason_of,
    sources_of,
    users_error,
)
from topcli.store.identity import digest_of_texts, package_digest
from topcli.sweeps.batch import Measuring, evaluate
from topcli.sweeps.measures import resolve_measures
from topcli.sweeps.store import FAILED, StoredRow

INTERRUPTED = Outcome.INTERRUPTED.value
POLL_SECONDS = 0.5
"""Seconds between two questions whether to stop."""
IN_FLIGHT = 2
"""Batches in flight for each worker."""
Machines = dict[Any, Machine]


class Piece(NamedTuple):
    """An ``experiment``, its initial ``states`` (m, d), and the numbers of their ``rows``."""

    experiment: Experiment
    states: Array
    rows: Sequence[int]


def compute(
    experiment: Experiment | dict[str, Any],
    states: Array,
    names: Sequence[str],
    machines: Machines,
) -> list[StoredRow]:
    """Run an experiment, or a resolved config, from several initial states.

    Parameters
    ----------
    experiment : Experiment or dict
        Experiment, whose own initial state is ignored.
    states : ndarray, shape (m, d)
        Initial states.
    names : sequence of str
        Names of the measures.
    machines : dict
        Machine code of earlier experiments, to be used again for the same top, scheme and options.

    Returns
    -------
    list of tuple
        Outcome, message and measures of each row. They do not depend on the other rows, but for the measure of the
        time. No error of a row is raised: its outcome is ``failed``. Once the work is asked to stop, the outcome of the
        rows that are not finished is ``interrupted``.
    """
    try:
        if isinstance(experiment, dict):
            experiment = load_experiment(experiment)
        top, scheme, options = experiment.top, experiment.scheme, experiment.options
        measures = resolve_measures(names, top, scheme, options, tuple(experiment.output.quantities or ()))
        key = top, scheme.build, options.model_dump_json()
        run = Measuring(experiment, measures, machines.get(key))
        machines[key] = run.machine
    except Exception as error:
        return _failed(error, len(states), names)
    pieces = [states[start : start + run.size] for start in range(0, len(states), run.size)]
    return [row for piece in pieces for row in _results(run, piece, names)]


def _results(run: Measuring, states: Array, names: Sequence[str]) -> list[StoredRow]:
    """Results of rows that fit into memory together."""
    count = len(states)
    try:
        with np.errstate(all="ignore"):  # extreme values are outcomes
            batch = run.finished(states)
            values, faults = evaluate(run.measures, batch)
    except StopAsked:
        return [(INTERRUPTED, "", b"")] * count
    except Exception as error:
        if count > 1:  # so that only the rows that fail are lost
            return [row for i in range(count) for row in _results(run, states[i : i + 1], names)]
        return _failed(error, 1, names)
    numbers = np.column_stack([np.empty((count, 0)), *(values[name] for name in names)])
    messages = [ending.message for ending in batch.endings]
    for i, name, reason in faults:
        messages[i] += f"; {name}: {reason}"
    outcomes = [ending.outcome.value for ending in batch.endings]
    return list(zip(outcomes, messages, map(bytes, numbers), strict=True))


def _failed(error: Exception, count: int, names: Sequence[str]) -> list[StoredRow]:
    """Results of rows that did not become runs."""
    reported = error if isinstance(error, TopcliError) else users_error(error)
    text = str(reported) if reported else f"internal error: {type(error).__name__}: {error}"
    return [(FAILED, " ".join(text.split()), np.full(len(names), np.nan).tobytes())] * count


def code_of_process() -> str:
    """Digest of topcli and of all tops, schemes and measures that come from elsewhere, as they are in this process."""
    plugin_failures()
    texts = {name + text for value in REGISTERED for name, text in sources_of([value]).items()}
    return digest_of_texts([package_digest(), *sorted(texts)])


def compute_batch(
    pieces: Sequence[tuple[Experiment | dict[str, Any], Array]],
    names: Sequence[str],
    plugins: Sequence[str] = (),
    code: str = "",
) -> list[StoredRow]:
    """Results of a batch of experiments with their initial states, on any worker.

    A worker of a cluster has the files ``plugins`` at the same paths. Raises UsageError if its ``code`` is not that of
    the process that collects the rows.
    """
    for path in plugins:
        load_plugin_file(Path(path))
    if code and code_of_process() != code:
        raise UsageError("a worker has another version of topcli or of a plugin; install the same on all")
    machines: Machines = {}
    return [row for experiment, states in pieces for row in compute(experiment, states, names, machines)]


@contextmanager
def executor(threads: int, dask: str | None) -> Iterator[tuple[Executor, int]]:
    """Threads of this process or a Dask cluster, ``local:N`` or an address, and the number of its threads.

    Raises UsageError if there is no cluster.
    """
    if dask is None:
        with ThreadPoolExecutor(threads) as pool:
            yield pool, threads
        return
    try:
        from distributed import Client, LocalCluster

        kind, _, count = dask.partition(":")
        local = {"threads_per_worker": 1, "dashboard_address": ":0"}
        cluster: Any = LocalCluster(n_workers=int(count), **local) if kind == "local" else dask
        client: Any = Client(cluster, timeout=10)
        client.get_versions(check=True)
    except ImportError:
        raise UsageError("--dask: needs packages; install them with: pip install 'topcli[dask]'") from None
    except (OSError, ValueError) as error:
        raise UsageError(f"--dask {dask}: no scheduler can be reached ({reason_of(error)})") from None
    with client, client.get_executor(pure=False) as pool:
        yield pool, max(1, sum(client.nthreads().values()))


def results(
    batches: Iterable[list[Piece]], names: Sequence[str], pool: Executor, workers: int, dask: str | None
) -> Iterator[tuple[list[Piece], list[StoredRow]]]:
    """Yield batches and their results as they end, until all have ended or the work is asked to stop.

    Dask runs a batch whose worker was lost again on other workers. Raises RunError if they are lost too.
    """
    plugins, code = ([str(path) for path in FILES], code_of_process()) if dask else ([], "")
    source, flying = iter(batches), dict[Future[list[StoredRow]], list[Piece]]()
    while True:
        for batch in islice(source, 0 if stop_asked() else max(0, IN_FLIGHT * workers - len(flying))):
            pieces = [(experiment.resolved() if dask else experiment, states) for experiment, states, _ in batch]
            # a thread hears of a request to stop by its context; a worker of a cluster cannot
            begin = compute_batch if dask else partial(copy_context().run, compute_batch)
            flying[pool.submit(begin, pieces, names, plugins, code)] = batch
        if not flying:
            return
        # batches that have not begun are cancelled by a stop, which is asked for while none ends
        while not (ended := wait(flying, POLL_SECONDS, FIRST_COMPLETED).done):
            for future in flying if stop_asked() else ():
                future.cancel()
        for future in ended:
            batch = flying.pop(future)
            try:
                yield batch, future.result()
            except CancelledError:
                continue
            except Exception as error:
                if dask is None or isinstance(error, TopcliError):
                    raise
                text = f"--dask {dask}: {reason_of(error)}; finished rows are kept"
                raise RunError(text, "run the sweep again to continue") from None
