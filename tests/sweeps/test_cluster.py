"""Sweeps on a Dask cluster: real workers, some of which are killed; and clients of the tests."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from cases import table_of
from dask_processes import SECONDS, Processes, once, processes, wait_until
from scheme_files import unchanged_tables
from sweeping import BASE, DATA, MANY, sweep, table
from topcli.config.sweep import load_sweep
from topcli.errors import RunError, UsageError
from topcli.sweeps import cluster as connect
from topcli.sweeps.cluster import (
    ALONE,
    CLUSTER_IN_FLIGHT,
    RESTART_SECONDS,
    Cluster,
    connected,
    local_workers,
    require_dask,
    run_on_cluster,
)
from topcli.sweeps.row_results import Results, Work, forget

LONG = {
    **MANY,
    "base": {**BASE, "N": 200_000, "output": {"every": 100}},
    "measure": ["max_deviation.energy", "drift.energy"],
}
"""Some seconds of work."""


ENDLESS = {**DATA, "base": {**BASE, "N": 10**9, "output": {"every": 10**8}}, "grid": {"h": [1e-9, 2e-9]}}


@pytest.fixture
def dask() -> None:
    pytest.importorskip("distributed", reason="the extra dask is not installed")


@pytest.fixture
def cluster(dask: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    with processes(tmp_path_factory.mktemp("cluster")) as found:
        yield found


@pytest.fixture(autouse=True)
def no_scheme_files() -> Iterator[None]:
    """The files that a test loads are not sent to the workers of the next."""
    with unchanged_tables():
        yield
    forget()


@pytest.mark.parametrize(
    ("address", "count"),
    table_of("""
local:1          1
local:12         12
tcp://host:8786  0
host:8786        0
"""),
)
def test_an_address_is_a_number_of_local_workers_or_a_scheduler(address: str, count: int) -> None:
    assert local_workers(address) == count


@pytest.mark.parametrize("address", ["local:0", "local:-1", "local:", "local:two", "host", "tcp://host", "", ":"])
def test_anything_else_is_refused_with_examples(address: str) -> None:
    with pytest.raises(UsageError, match=r"neither a number of workers.*\n.*local:4.*tcp://host:8786"):
        local_workers(address)


def test_a_missing_package_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"--dask: the package distributed is missing\npip install 'topcli\[dask\]'"):
        require_dask()


def at_first(act: Callable[[], object]) -> tuple[list[int], Callable[..., None]]:
    """Numbers of rows done, and what is told of them, which first acts."""
    done: list[int] = []

    def progress(count: int, *more: int) -> None:
        if not done:
            act()
        done.append(count)

    return done, progress


@pytest.mark.slow
def test_rows_are_those_of_a_local_sweep_and_few_are_in_flight(cluster: Processes, tmp_path: Path) -> None:
    sweep(tmp_path / "here", MANY)
    flying: list[int] = []
    with connected(cluster.address) as found:
        assert found.threads == 2
        note = {"on_progress": lambda *counts: flying.append(len(found._flying))}
        result = sweep(tmp_path / "there", MANY, found, threads=12, **note)
    assert result.ran == 160
    assert repr(table(tmp_path / "there")) == repr(table(tmp_path / "here"))
    assert len(flying) > 4 * CLUSTER_IN_FLIGHT
    assert 0 < max(flying) < CLUSTER_IN_FLIGHT * 2
    assert run_on_cluster(cluster.address, load_sweep(MANY), tmp_path / "there").ran == 0


@pytest.mark.slow
def test_a_worker_that_is_killed_loses_no_row(cluster: Processes, tmp_path: Path) -> None:
    sweep(tmp_path / "here", LONG)
    _, victim, _ = cluster.running
    done, progress = at_first(victim.kill)
    with connected(cluster.address) as found:
        result = sweep(tmp_path / "there", LONG, found, threads=4, on_progress=progress)
    assert victim.wait(SECONDS) == -signal.SIGKILL
    assert done[0] < 160 == done[-1] == result.ran, "it was killed during the sweep, and each row came once"
    assert repr(table(tmp_path / "there")) == repr(table(tmp_path / "here"))


@pytest.mark.slow
def test_a_sweep_that_is_stopped_keeps_what_is_finished_and_frees_the_workers(
    cluster: Processes, tmp_path: Path
) -> None:
    with connected(cluster.address) as found:
        client = found.client
        stop = once(lambda: any(client.processing().values()), "no row is computed")
        result = sweep(tmp_path / "endless", ENDLESS, found, stop=stop)
        assert (result.interrupted, result.finished) == (True, 0)
        wait_until(lambda: not any(client.processing().values()), "the workers do not become free")
    done, progress = at_first(lambda: None)
    with connected(cluster.address) as found:
        result = sweep(tmp_path, MANY, found, threads=12, on_progress=progress, stop=lambda: bool(done))
    assert result.interrupted
    assert 0 < result.finished < 160
    rest = run_on_cluster(cluster.address, load_sweep(MANY), tmp_path)
    assert (rest.ran, rest.finished) == (160 - result.finished, 160)


@pytest.mark.slow
def test_a_lost_scheduler_is_reported_and_finished_rows_are_kept(cluster: Processes, tmp_path: Path) -> None:
    kill = at_first(cluster.running[0].kill)[1]
    with (
        pytest.raises(RunError, match="connection to the scheduler was lost; finished rows are kept"),
        connected(cluster.address) as found,
    ):
        sweep(tmp_path, LONG, found, threads=4, on_progress=kill)
    assert 0 < sweep(tmp_path, LONG).ran < 160


@pytest.mark.slow
@pytest.mark.parametrize("name", ["topcli", "python", "numba", "llvmlite", "numpy", "the source of topcli"])
def test_any_version_that_differs_or_is_missing_is_a_difference(dask: None, name: str) -> None:
    from topcli.sweeps.worker import difference, versions

    here = versions()
    assert difference(here, dict(here)) == ""
    assert difference(here, {**here, name: "0.0"}) == f"{name} is 0.0 there and {here[name]} here"
    there = {key: value for key, value in here.items() if key != name}
    assert difference(here, there) == f"{name} is missing there and {here[name]} here"


class Answering:
    """A client whose workers describe themselves by ``answers``."""

    def __init__(self, answers: dict[str, Any]) -> None:
        self.answers = answers

    def sync(self, ask: Any, callback_timeout: float) -> dict[str, Any]:
        return self.answers


@pytest.mark.parametrize(
    ("cpus", "warned"),
    table_of("""
['one']                ''
['one', 'one']         ''
['one', 'two', 'one']  2 with one, 1 with two
['a', 'b', 'c']        1 with a, 1 with b, 1 with c
"""),
)
def test_workers_with_several_kinds_of_processors_are_warned_of(dask: None, cpus: list[str], warned: str) -> None:
    from topcli.sweeps.worker import Job, versions

    answers = {f"tcp://{i}": {"versions": versions(), "cpu": cpu} for i, cpu in enumerate(cpus)}
    client: Any = Answering(answers)
    said = connect._check_workers(client, "there", Job("", versions(), ()))
    expected = f"warning: the workers have different processors ({warned}); results may differ in the last digits"
    assert said == ([expected] if warned else [])
    answers["tcp://0"] = {"versions": {**versions(), "the source of topcli": "other"}, "cpu": cpus[0]}
    with pytest.raises(UsageError, match=r"worker tcp://0: the source of topcli is other there and \w+ here"):
        connect._check_workers(client, "there", Job("", versions(), ()))


class NoWorkers:
    """A client whose workers are those of ``threads``, one number for each count."""

    status = "running"

    def __init__(self, *threads: int) -> None:
        self._threads = iter(threads)

    def sync(self, ask: Any, callback_timeout: float) -> dict[str, int]:
        return {"tcp://there": next(self._threads)}

    def nthreads(self) -> None:
        raise AssertionError("without a limit")


def counted(cluster: Cluster, now: dict[str, float], moments: int) -> list[float]:
    """Times at which workers are replaced, counted every five seconds."""
    found: list[float] = []
    cluster.replace_workers = lambda: found.append(now["s"])
    for _ in range(moments):
        now["s"] += 5.0
        cluster._count()
    return found


def test_workers_of_this_machine_that_do_not_come_back_are_replaced_at_most_five_times() -> None:
    """A worker that ends while it is started is never started again, and the sweep would wait for ever."""
    now, said = {"s": 100.0}, list[str]()
    nothing: Any = None

    def cluster(*threads: int) -> Cluster:
        client: Any = NoWorkers(*threads)
        return Cluster(client, "local:2", nothing, 2, said.append, clock=lambda: now["s"])

    # one is there at first; without any it takes ten seconds, and again ten seconds for what was started
    assert counted(cluster(2, *[0] * 6), now, 7) == [115.0, 125.0, 135.0]
    assert said == ["warning: local:2 has no workers left; waiting for new ones"]
    now["s"] = 0.0
    assert counted(cluster(*[0, 0, 0, 1] * 6), now, 24) == [10.0, 30.0, 50.0, 70.0, 90.0, 110.0]
    now["s"] = 0.0
    with pytest.raises(RunError, match=r"local:2: its workers end before they begin; .* kept\nrun the sweep again"):
        counted(cluster(*[0] * 20), now, 20)
    assert now["s"] == 60.0


def test_a_scheduler_without_workers_is_waited_for_until_the_sweep_is_stopped() -> None:
    """Workers of a queue may come after hours."""
    now, asked = {"s": 0.0}, list[int]()
    nothing: Any = None
    client: Any = NoWorkers(*[0] * 10**4)

    class Waiting(Cluster):
        def _submit(self, batch: Any, work: Any, *, alone: bool = False) -> None:
            self._flying[str(batch)] = (None, batch)  # type: ignore[assignment]

        def _arrived(self, work: Any, seconds: float = 0.0) -> Any:
            now["s"] += 30.0
            return iter(())

        def _last(self) -> Any:
            return iter(())

        def _give_up(self) -> None: ...

    def stop() -> bool:
        asked.append(1)
        return len(asked) > 1000

    waiting: Any = Waiting(client, "tcp://there:1", nothing, 2, lambda line: None, clock=lambda: now["s"])
    assert list(waiting([[0], [1]], Work(()), stop)) == []
    assert now["s"] == 30_000.0


def test_a_result_that_was_lost_with_its_worker_waits_for_another_one(dask: None) -> None:
    """Its future has ended and gives no result until there are workers again, which only counting them brings."""
    from distributed import TimeoutError

    class Lost:
        key = "lost"

        def cancelled(self) -> bool:
            return False

        def add_done_callback(self, act: Any) -> None:
            act(self)

        def result(self, timeout: float) -> Results:
            now["s"] += timeout
            assert now["s"] < 1000.0, "neither are the workers counted nor is the sweep asked to stop"
            if not replaced:
                raise TimeoutError
            return Results(message=[""], done=[True])

    class Losing(Cluster):
        def _submit(self, batch: Any, work: Any, *, alone: bool = False) -> None:
            future: Any = Lost()
            self._flying[future.key] = (future, batch)
            self._ended.put(future)

    now, replaced, client = {"s": 0.0}, list[float](), cast(Any, NoWorkers(*[0] * 100))
    cluster = Losing(client, "local:1", cast(Any, None), 1, lambda line: None, clock=lambda: now["s"])
    cluster.replace_workers = lambda: replaced.append(now["s"])
    assert [batch for batch, _ in cluster([cast(Any, [0])], Work(()), lambda: now["s"] > 100.0)] == [[0]]
    assert replaced == [RESTART_SECONDS]


def test_a_batch_whose_workers_are_lost_is_divided_until_one_row_is_left(dask: None) -> None:
    """A task that is not lost finishes the first of its rows; the rest is another batch."""
    from distributed.scheduler import KilledWorker

    class Task:
        """A task that is lost if it, or one that is in flight with it, holds the fatal row."""

        def __init__(self, key: str, batch: list[int]) -> None:
            self.key, self.batch = key, batch

        def cancelled(self) -> bool:
            return False

        def result(self, timeout: float) -> Results:
            if any(7 in batch for batch in [self.batch, *(batch for _, batch in cluster._flying.values())]):
                raise KilledWorker(self.key, None, 3)
            return Results(message=[str(row) for row in self.batch], done=[i < 1 for i in range(len(self.batch))])

    class Fatal(Cluster):
        def _submit(self, batch: Any, work: Any, *, alone: bool = False) -> None:
            future: Any = Task(f"{batch}{ALONE if alone else ''}", batch)
            self._flying[future.key] = (future, batch)
            self._ended.put(future)

    client: Any = type("Client", (), {"status": "running"})()
    nothing: Any = None
    cluster = Fatal(client, "here", nothing, 1, lambda line: None)
    batches: Any = [[0, 1, 2], [3, 4, 5, 6, 7]]
    found: list[Any] = list(cluster(batches, Work(("swings",)), lambda: False))
    assert sorted(row for batch, one in found for row, done in zip(batch, one.done, strict=True) if done) == [*range(8)]
    (failed,) = [results for batch, results in found if batch == [7]]
    assert (failed.outcome, failed.done) == (["failed"], [True])
    assert all(results.message == [str(row) for row in batch] for batch, results in found if batch != [7])
