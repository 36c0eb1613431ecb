"""Sweeps on a Dask cluster: real workers, some of which are killed, differ or join late; and clients of the tests."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, cast

import pytest

import topcli
from cases import table_of
from dask_processes import SECONDS, Processes, once, processes, wait_until
from injected import python_process
from sweeping import BASE, DATA, MANY, sweep, table
from topcli.config.rows import RowReader
from topcli.config.sweep import load_sweep
from topcli.errors import RunError, UsageError
from topcli.schemes.registry import load_plugin_file, unload_plugin_files
from topcli.sweeps import cluster as connect
from topcli.sweeps.cluster import (
    ALONE,
    CLUSTER_IN_FLIGHT,
    RESTART_SECONDS,
    Cluster,
    answer,
    batch_digest,
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


SCHEME = """\
import os
import topcli
from weights import WEIGHT
from topcli.contracts import Stepper
from topcli.tops.euler import field


def step(y, h, p):
    f = field(y, p)
    return (y[0] + WEIGHT * h * f[0], y[1] + h * f[1], y[2] + h * f[2])


@topcli.scheme("weighted-euler", top="euler", title="Euler's rule", order=1, explicit=True, self_adjoint=False,
               citation="none", equations="y' = y + h f(y)")
def build(top, options):
    '''Euler's rule with a weight.'''
    if top.A == 2.75:
        raise ValueError("no such top")
    if top.A == 2.875:
        os._exit(1)
    return Stepper(step, 3)
"""


OF_FILE: dict[str, Any] = {
    "name": "study",
    "base": {
        "top": {"kind": "euler", "A": 2.5, "B": 2.0, "C": 1.5},
        "initial": {"omega": [0.7, -0.4, 1.3]},
        "scheme": "weighted-euler",
        "N": 500,
    },
    "grid": {"top.A": [2.25, 2.5, 2.75], "h": [0.01, 0.02]},
    "measure": ["max_deviation.m_sq"],
}


@pytest.fixture
def dask() -> None:
    pytest.importorskip("distributed", reason="the extra dask is not installed")


@pytest.fixture
def cluster(dask: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    with processes(tmp_path_factory.mktemp("cluster")) as found:
        yield found


@pytest.fixture
def scheme_file(tmp_path: Path, no_scheme_files: None) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(SCHEME)
    (tmp_path / "weights.py").write_text("WEIGHT = 0.5\n")
    return path


@pytest.fixture(autouse=True)
def no_scheme_files() -> Iterator[None]:
    """Files that other tests have loaded would be sent to the workers."""
    _unload()
    yield
    _unload()


def _unload() -> None:
    unload_plugin_files()
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
def test_a_worker_that_joins_later_gets_the_scheme_file(cluster: Processes, tmp_path: Path, scheme_file: Path) -> None:
    load_plugin_file(scheme_file)
    sweep(tmp_path / "here", OF_FILE)
    messages = [row["message"] for row in table(tmp_path / "here")]
    assert [str(scheme_file) in text for text in messages] == [False] * 4 + [True] * 2
    with connected(cluster.address) as found:
        for worker in cluster.running[1:]:
            worker.kill()
        new = cluster.worker()
        wait_until(lambda: list(found.client.nthreads().values()) == [1], "the new worker does not join")
        sweep(tmp_path / "there", OF_FILE, found)
        assert new.poll() is None
    assert repr(table(tmp_path / "there")) == repr(table(tmp_path / "here")), "messages name the same file"
    first = [row["max_deviation.m_sq"] for row in table(tmp_path / "here")]

    # the file is edited: the same worker, which has loaded it before, computes with the new content
    _unload()
    (tmp_path / "weights.py").write_text("WEIGHT = 1.0\n")
    load_plugin_file(scheme_file)
    sweep(tmp_path / "here2", OF_FILE)
    run_on_cluster(cluster.address, load_sweep(OF_FILE), tmp_path / "there2")
    assert repr(table(tmp_path / "there2")) == repr(table(tmp_path / "here2"))
    second = [row["max_deviation.m_sq"] for row in table(tmp_path / "here2")]
    assert all(a != b for a, b in zip(first[:4], second[:4], strict=True))


@pytest.mark.slow
def test_a_row_that_ends_its_workers_fails_alone(dask: None, tmp_path: Path, scheme_file: Path) -> None:
    load_plugin_file(scheme_file)
    data = {**OF_FILE, "grid": {"top.A": [2.25, 2.5]}, "base": {**OF_FILE["base"], "h": 0.01}}
    sweep(tmp_path / "here", data)
    deadly = {**data, "grid": {"top.A": [2.25, 2.875, 2.5]}}
    result = run_on_cluster("local:1", load_sweep(deadly), tmp_path / "there")
    rows = table(tmp_path / "there")
    assert result.outcomes == {"completed": 2, "failed": 1}
    assert rows[1]["message"].startswith("every worker that computed this row was lost")
    good = [row["max_deviation.m_sq"] for row in rows if row["outcome"] == "completed"]
    assert good == [row["max_deviation.m_sq"] for row in table(tmp_path / "here")]


@pytest.mark.slow
def test_workers_with_other_versions_are_refused_by_name(cluster: Processes, tmp_path: Path) -> None:
    numba = tmp_path / "site" / "numba-0.0.1.dist-info"
    numba.mkdir(parents=True)
    (numba / "METADATA").write_text("Metadata-Version: 2.1\nName: numba\nVersion: 0.0.1\n")
    with connected(cluster.address) as found:
        other = cluster.worker(tmp_path / "site")
        wait_until(lambda: len(found.client.nthreads()) == 3, "the other worker does not join")
        with pytest.raises(UsageError, match=r"worker tcp://127\.0\.0\.1:\d+: numba is 0\.0\.1 there and"):
            sweep(tmp_path, MANY, found, threads=12)
    with (
        pytest.raises(UsageError, match=r"worker tcp://127\.0\.0\.1:\d+: numba is 0\.0\.1 there and"),
        connected(cluster.address),
    ):
        pass
    other.kill()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "topcli.py").write_text("raise ImportError('broken')\n")
    with closing_client(cluster) as client:
        wait_until(lambda: len(client.nthreads()) == 2, "the other worker does not leave")
        cluster.worker(tmp_path / "broken")
        wait_until(lambda: len(client.nthreads()) == 3, "the broken worker does not join")
    with (
        pytest.raises(UsageError, match=r"worker tcp://127\.0\.0\.1:\d+: topcli cannot be imported there.*broken"),
        connected(cluster.address),
    ):
        pass


@pytest.mark.slow
def test_replaced_workers_of_this_machine_compute_the_rest(
    dask: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The library does not start a worker again that ends while it is started, as a deadly row may make it do."""
    from distributed.core import Status

    monkeypatch.setattr("topcli.sweeps.cluster.RESTART_SECONDS", 1.0)
    with connected("local:1") as found:
        local: Any = found.client.cluster

        def kill() -> None:
            (nanny,) = local.workers.values()
            nanny.status = Status.starting
            os.kill(nanny.pid, signal.SIGKILL)

        result = sweep(tmp_path, MANY, found, threads=12, on_progress=at_first(kill)[1])
        assert len(local.worker_spec) > 1
    assert (result.ran, result.outcomes) == (160, {"completed": 160})


def closing_client(cluster: Processes) -> Any:
    from distributed import Client

    return Client(cluster.address, set_as_default=False)


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
def test_a_scheduler_that_does_not_answer_is_reported(dask: None, tmp_path: Path) -> None:
    with closing(socket.socket()) as held:
        held.bind(("127.0.0.1", 0))
        held.listen()  # accepts, and never answers
        address = f"tcp://127.0.0.1:{held.getsockname()[1]}"
        with pytest.raises(UsageError, match=f"--dask {address}: no Dask scheduler can be reached"):
            run_on_cluster(address, load_sweep(DATA), tmp_path)
    assert os.listdir(tmp_path) == []


@pytest.mark.slow
def test_ctrl_c_ends_a_sweep_on_local_workers_as_interrupted(dask: None, tmp_path: Path) -> None:
    data = {**LONG, "base": {**LONG["base"], "N": 2_000_000, "output": {"every": 1000}}}
    (tmp_path / "study.yaml").write_text(load_sweep(data).to_yaml())
    command = [sys.executable, "-m", "topcli", "sweep", "study.yaml", "--out", "out", "--dask", "local:2"]
    environment = {**os.environ, "PYTHONPATH": str(Path(topcli.__file__).parents[1])}
    running = subprocess.Popen(
        command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )
    journal = tmp_path / "out" / "study" / "journal.jsonl"
    wait_until(
        lambda: (journal.exists() and journal.stat().st_size) or running.poll() is not None, "no row is finished"
    )
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=SECONDS)
    assert running.returncode == 130, said.decode()
    assert b"interrupted; run it again to continue" in said
    assert b"Traceback" not in said
    assert 0 < len(table(tmp_path / "out")) < 160


@pytest.mark.slow
def test_a_worker_that_does_not_answer_is_not_waited_for(
    cluster: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing_client(cluster) as client:
        os.kill(cluster.running[1].pid, signal.SIGSTOP)
        with pytest.raises(RunError, match=r"--dask here: the scheduler or a worker has not answered within 1 s"):
            answer(client, "here", lambda: client.run(os.getpid), 1.0)

        def impatient(client: Any, address: str, ask: Any, seconds: float = 0.0) -> Any:
            return answer(client, address, ask, 2.0)

        monkeypatch.setattr(connect, "answer", impatient)
        with pytest.raises(RunError, match=f"--dask {cluster.address}: .* a worker has not answered within 2 s"):
            run_on_cluster(cluster.address, load_sweep(DATA), tmp_path)
        os.kill(cluster.running[1].pid, signal.SIGCONT)
        wait_until(lambda: len(client.run(os.getpid)) == 2, "the worker does not go on")
    assert os.listdir(tmp_path) == []


def test_a_task_is_named_after_what_it_computes() -> None:
    rows = list(RowReader(load_sweep(DATA)).rows())
    one = Work(("max_deviation.energy",))
    names = [
        batch_digest(rows, one, "a"),
        batch_digest(rows[1:], one, "a"),
        batch_digest(rows, Work(("drift.energy",)), "a"),
        batch_digest(rows, one, "b"),
    ]
    assert len(set(names)) == 4
    assert batch_digest(list(rows), Work(("max_deviation.energy",)), "a") == names[0]


SOURCE = Path(topcli.__file__).parent


DESCRIBE = "import json; from topcli.sweeps.worker import versions; print(json.dumps(versions()))"


@pytest.mark.slow
@pytest.mark.parametrize("change", ["a comment", "a new file", "a missing file", "nothing"])
def test_another_source_of_the_same_version_is_another_version(dask: None, tmp_path: Path, change: str) -> None:
    """A worker with a copy of topcli, one file of which differs by as little as a comment."""
    from topcli.sweeps.worker import difference, versions

    copy = Path(shutil.copytree(SOURCE, tmp_path / "topcli", ignore=shutil.ignore_patterns("__pycache__")))
    if change == "a comment":
        with (copy / "errors.py").open("a") as file:
            file.write("# the same\n")
    elif change == "a new file":
        (copy / "schemes" / "added.py").write_text("")
    elif change == "a missing file":
        max((copy / "figures").glob("*.py")).unlink()
    found = json.loads(python_process(DESCRIBE, cwd=tmp_path, PYTHONPATH=str(tmp_path)).stdout)
    assert list(found) == ["topcli", "python", "numba", "llvmlite", "numpy", "the source of topcli"]
    fault = difference(versions(), found)
    here, there = versions()["the source of topcli"], found["the source of topcli"]
    assert fault == ("" if change == "nothing" else f"the source of topcli is {there} there and {here} here")
    assert (here == there) == (change == "nothing")


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
