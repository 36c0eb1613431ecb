"""Versions, counts, divided batches and waits of a sweep on a cluster, with clients and clocks of the tests."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import topcli
from dask_processes import SECONDS
from sweeping import DATA
from topcli.config.rows import RowReader
from topcli.config.sweep import load_sweep
from topcli.errors import RunError, UsageError
from topcli.sweeps import cluster as connect
from topcli.sweeps.cluster import ALONE, IN_FLIGHT, Cluster, batch_digest
from topcli.sweeps.evaluate import Results, Work


@pytest.fixture
def dask() -> None:
    pytest.importorskip("distributed", reason="the extra dask is not installed")


def test_a_task_is_named_after_what_it_computes() -> None:
    rows = list(RowReader(load_sweep(DATA)).rows())
    one = Work(("deviation.energy",))
    names = [
        batch_digest(rows, one, "a"),
        batch_digest(rows[1:], one, "a"),
        batch_digest(rows, Work(("drift.energy",)), "a"),
        batch_digest(rows, Work(("deviation.energy",), 1.0), "a"),
        batch_digest(rows, one, "b"),
    ]
    assert len(set(names)) == 5
    assert batch_digest(list(rows), Work(("deviation.energy",)), "a") == names[0]


SOURCE = Path(topcli.__file__).parent


DESCRIBE = "import json; from topcli.sweeps.worker import versions; print(json.dumps(versions()))"


@pytest.mark.slow
@pytest.mark.parametrize("change", ["a comment", "a new file", "a missing file", "nothing"])
def test_another_source_of_the_same_version_is_another_version(dask: None, tmp_path: Path, change: str) -> None:
    """A worker with a copy of topcli, one file of which differs by as little as a comment."""
    from topcli.sweeps.worker import difference, versions

    copy = Path(shutil.copytree(SOURCE, tmp_path / "topcli", ignore=shutil.ignore_patterns("__pycache__")))
    if change == "a comment":
        with (copy / "analysis" / "leaving.py").open("a") as file:
            file.write("# the same\n")
    elif change == "a new file":
        (copy / "schemes" / "heavy" / "added.py").write_text("")
    elif change == "a missing file":
        (copy / "schemes" / "heavy" / "hk.py").unlink()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", DESCRIBE], env=environment, capture_output=True, text=True, check=True, timeout=SECONDS
    )
    found = json.loads(done.stdout)
    assert list(found) == ["topcli", "python", "numba", "llvmlite", "numpy", "the source of topcli"]
    fault = difference(versions(), found)
    here, there = versions()["the source of topcli"], found["the source of topcli"]
    assert fault == ("" if change == "nothing" else f"the source of topcli is {there} there and {here} here")
    assert (here == there) == (change == "nothing")


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
    [
        (["one"], ""),
        (["one", "one"], ""),
        (["one", "two", "one"], "2 with one, 1 with two"),
        (["a", "b", "c"], "1 with a, 1 with b, 1 with c"),
    ],
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


def test_the_back_end_is_bounded_by_its_threads() -> None:
    """Without workers a batch is still submitted, so that the sweep waits for them instead of ending."""

    class Alone(Cluster):
        def __init__(self) -> None:
            super().__init__(None, "", None, 0, print)  # type: ignore[arg-type]
            self.sent: list[int] = []

        def _submit(self, batch: Any, work: Any, *, alone: bool = False) -> None:
            self.sent.append(len(self._flying))
            self._flying[len(self.sent)] = (None, batch)  # type: ignore[assignment]

        def _arrived(self, work: Any, seconds: float = 0.0) -> Any:
            key = next(iter(self._flying))
            yield self._flying.pop(key)[1], None

        def _count(self) -> None: ...

        def _last(self) -> Any:
            return iter(())

        def _give_up(self) -> None: ...

    alone = Alone()
    batches = [[k] for k in range(10)]
    assert [batch for batch, _ in alone(batches, Work(()), lambda: False)] == batches  # type: ignore[arg-type]
    assert max(alone.sent) == IN_FLIGHT - 1


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
