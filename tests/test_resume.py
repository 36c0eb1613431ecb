"""Runs that are stopped, killed or out of disk, and resumed: equal, bit for bit, to the run that was left alone."""

from __future__ import annotations

import errno
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from conftest import GEN, ROOT
from test_contract import TRIALS, by_name
from topcli.analysis.drift import InvariantTally
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Outcome, Scheme, Stepper
from topcli.engine.loop import Run
from topcli.errors import RunError, UsageError
from topcli.schemes.registry import all_schemes
from topcli.store import parts, series
from topcli.store.checkpoint import CHECKPOINT, read_checkpoint
from topcli.store.parts import lock_left, lock_new, new_part, parts_of
from topcli.store.run_folder import stored_run, stored_runs
from topcli.store.series import SeriesWriter, read_metadata, read_series
from topcli.studies.run import run_experiment

HK = ROOT / "configs" / "kowalevski_hk.yaml"
NAME = "kowalevski_hk"
FILES = ["config.yaml", "manifest.json", "report.json", "report.md"]
KINDS = {
    "increments": "kowalevski_hk",
    "carried phase": "kowalevski_hybrid_xi",
    "iterative with counters": "kowalevski_hybrid_sym",
    "interpreted": "kowalevski_dop853",
    "closed form": "euler_exact",
    "chart": "kowalevski_bohlin_a",
}


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("CHUNK_STEPS", 23), ("PLAIN_STEPS", 23), ("CHUNK_ROWS", 16)):
        monkeypatch.setattr(f"topcli.engine.loop.{name}", value)
    monkeypatch.setattr(series, "ROW_GROUP", 40)
    monkeypatch.setattr("topcli.studies.resume.BATCH", 20)


def small(*overrides: str) -> Experiment:
    return load_experiment(HK, ["N=300", *overrides])


def after(chunks: int) -> Callable[[], bool]:
    """A ``stop`` that says so after a number of chunks."""
    asked = iter(range(10**6))
    return lambda: next(asked) >= chunks


def content(folder: Path) -> dict[str, object]:
    """Everything a run folder says apart from times."""
    report = json.loads((folder / "report.json").read_text())
    del report["seconds"]
    (path,) = folder.glob("series.*")
    manifest = json.loads((folder / "manifest.json").read_text())
    told = {key: manifest[key] for key in ("digest", "code", "outcome", "message", "files", "config", "environment")}
    told["files"] = sorted(told["files"])
    return {"report": report, "series": path.read_bytes(), "config": (folder / "config.yaml").read_text(), **told}


def killed(out: Path, experiment: Experiment, chunks: int) -> Path:
    """What a process leaves that is killed after so many chunks with a checkpoint after each of them."""

    class Killed(BaseException):
        pass

    def progress(done: int, total: int) -> None:
        if chunks <= done // 23:
            raise Killed

    with pytest.raises(Killed):
        run_experiment(experiment, out, force=True, checkpoint_every=0.0, progress=progress)
    (folder,) = out.glob(f".{experiment.name}.part-*")
    return folder


@by_name
def test_every_scheme_goes_on_bit_for_bit(scheme: Scheme) -> None:
    """Working states of every scheme, carried quantities and counters included, and the sums of the report."""
    top = TRIALS[scheme.top][-1]
    method, N, every = scheme.build(top, scheme.options()), 120, 7
    invariants = top.invariants()

    def pieces(run: Run, tally: InvariantTally) -> list[bytes]:
        made = []
        for chunk in run:
            tally.add(chunk.n, chunk.states)
            made.append(chunk.n.tobytes() + chunk.states.tobytes())
        return made

    y0 = GEN[: len(top.components)]
    whole, whole_tally = Run(top, method, y0, 0.01, N, every), InvariantTally(invariants, 0.01)
    expected = pieces(whole, whole_tally)
    first, tally = Run(top, method, y0, 0.01, N, every, after(3)), InvariantTally(invariants, 0.01)
    before = pieces(first, tally)
    start = first.position()
    assert start is not None
    assert 0 < start.done < N
    resumed = InvariantTally(invariants, 0.01)
    resumed.restore(tally.state())
    second = Run(top, method, y0, 0.01, N, every, start=start)
    assert b"".join(before + pieces(second, resumed)) == b"".join(expected)
    assert second.ending == whole.ending
    assert second.position().work.tobytes() == whole.position().work.tobytes()
    assert resumed.rows() == whole_tally.rows()


def test_physical_states_alone_would_not_do() -> None:
    """Positive control: started again from the recorded state, a scheme with carried quantities ends elsewhere."""
    (scheme,) = (s for s in all_schemes() if (s.name, s.top) == ("hybrid-xi", "kowalevski"))
    top = TRIALS["kowalevski"][1]
    method = scheme.build(top, scheme.options())
    assert isinstance(method, Stepper)
    assert method.width > 6
    whole = np.concatenate([chunk.states.copy() for chunk in Run(top, method, GEN, 0.01, 400)])
    half = np.concatenate([chunk.states.copy() for chunk in Run(top, method, whole[200], 0.01, 200)])
    assert not (half == whole[200:]).all()
    assert np.abs(half - whole[200:]).max() < 1e-12


@pytest.mark.parametrize("scene", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_an_interrupted_run_is_resumed_to_the_same_folder(tmp_path: Path, scene: str, suffix: str) -> None:
    N = 70 if "dop853" in scene else 300
    experiment = load_experiment(ROOT / "configs" / f"{scene}.yaml", [f"N={N}", f"output.format={suffix}"])
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    out, told = tmp_path / "out", []
    chunks = 2
    result = run_experiment(experiment, out, stop=after(chunks))
    for _ in range(3):  # three times on, and stopped again
        assert result.outcome is Outcome.INTERRUPTED
        assert (result.stored.folder / CHECKPOINT).exists()
        rows = len(next(iter(read_series(result.stored.series).values())))
        assert rows == result.report["step"] + 1
        result = run_experiment(experiment, out, resume=True, stop=after(1), tell=told.append)
        assert result.status == "resumed"
        if result.outcome is Outcome.COMPLETED:
            break
    result = run_experiment(experiment, out, resume=True, tell=told.append)
    assert content(result.stored.folder) == expected
    assert f"continues from step {chunks * 16 if N > 70 else 32} of {N}" in told[0]
    assert [path.name for path in out.iterdir()] == [experiment.name]
    assert result.report["seconds"]["run"] > 0.0
    assert result.stored.manifest["resumed"][0]["step"] > 0
    assert run_experiment(experiment, out, resume=True).status == "up to date"


def test_a_killed_run_is_resumed_and_nothing_of_it_is_left(tmp_path: Path) -> None:
    experiment = small("output.every=2")
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    out = tmp_path / "out"
    left = killed(out, experiment, 9)
    assert stored_runs(out) == []
    checkpoint = read_checkpoint(left)
    assert checkpoint is not None
    assert checkpoint.done >= 9 * 23
    (left / ".checkpoint.npz").write_bytes(b"half a checkpoint")
    with (left / "series.parquet").open("ab") as file:
        file.write(b"half a row group")
    result = run_experiment(experiment, out, resume=True)
    assert content(result.stored.folder) == expected
    assert [path.name for path in out.iterdir()] == [NAME]


def test_killed_between_manifest_and_place_it_is_only_put_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        pass

    def rename(*args: object) -> None:
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr("topcli.store.run_folder.RunWriter._rename", rename)
        with pytest.raises(Killed):
            run_experiment(small(), tmp_path)
        assert stored_runs(tmp_path) == []
    (left,) = tmp_path.iterdir()
    assert sorted(path.name for path in left.iterdir()) == sorted([*FILES, "series.parquet"])
    left.rename(tmp_path / f".{NAME}.part-999999999-00000000")  # a process that lives no more
    monkeypatch.setattr("topcli.studies.run.Run", None)  # nothing is integrated
    assert run_experiment(small(), tmp_path, resume=True).outcome is Outcome.COMPLETED
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


def test_without_resume_it_runs_again_and_says_what_could_be(tmp_path: Path) -> None:
    told: list[str] = []
    killed(tmp_path, small(), 5)
    result = run_experiment(small(), tmp_path, tell=told.append)
    assert (result.status, result.outcome) == ("ran", Outcome.COMPLETED)
    assert "--resume would continue" in told[0]
    assert [path.name for path in tmp_path.iterdir()] == [NAME], "superseded, and swept away"


def test_nothing_to_resume_starts_afresh_saying_so(tmp_path: Path) -> None:
    told: list[str] = []
    assert run_experiment(small(), tmp_path, resume=True, tell=told.append).status == "ran"
    assert told == [f"{NAME}: nothing to resume; starts afresh"]


@pytest.mark.parametrize("how", ["killed", "interrupted"])
def test_another_experiment_or_code_is_refused_and_nothing_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    if how == "killed":
        left = killed(tmp_path, small(), 5)
    else:
        left = run_experiment(small(), tmp_path, stop=after(5)).stored.folder
    before = {path.name: path.read_bytes() for path in left.iterdir() if path.name != "lock"}
    with pytest.raises(UsageError, match=r"different experiment \(h: 0.001 there, 0.002 here\).*\n.*without --resume"):
        run_experiment(small("h=0.002"), tmp_path, resume=True)
    monkeypatch.setattr("topcli.studies.run.method_fingerprint", lambda method: "0" * 64)
    with pytest.raises(UsageError, match="other code of the scheme hk"):
        run_experiment(small(), tmp_path, resume=True)
    assert {path.name: path.read_bytes() for path in left.iterdir() if path.name != "lock"} == before
    monkeypatch.undo()


def test_an_interrupted_run_never_takes_the_place_of_more(tmp_path: Path) -> None:
    complete = content(run_experiment(small(), tmp_path).stored.folder)
    result = run_experiment(small(), tmp_path, force=True, stop=after(3))
    assert result.set_aside is not None
    assert content(result.set_aside) == complete
    further = run_experiment(small(), tmp_path / "b", stop=after(8))
    less = run_experiment(small(), tmp_path / "b", stop=after(2))
    assert less.set_aside is not None
    assert stored_run(less.set_aside).manifest["step"] == further.report["step"]
    told: list[str] = []
    run_experiment(small(), tmp_path / "b", resume=True, tell=told.append)
    assert f"step {further.report['step']} of" in told[0], "the one that got further goes on"


def test_a_forced_run_beside_a_different_one_is_resumed(tmp_path: Path) -> None:
    first = content(run_experiment(small("h=0.002"), tmp_path).stored.folder)
    killed(tmp_path, small(), 5)
    result = run_experiment(small(), tmp_path, resume=True)
    assert (result.status, result.outcome) == ("resumed", Outcome.COMPLETED)
    assert result.set_aside is not None
    assert content(result.set_aside) == first


def test_a_run_that_fails_has_no_checkpoint(tmp_path: Path) -> None:
    overrides = ["scheme=rk4", "h=40", "initial.omega=[1e6, 1e6, 1e6]"]
    result = run_experiment(small(*overrides), tmp_path, checkpoint_every=0.0)
    assert result.outcome is Outcome.BLEW_UP
    assert not (result.stored.folder / CHECKPOINT).exists()
    assert run_experiment(small(*overrides), tmp_path, resume=True).status == "up to date"


def full_after(monkeypatch: pytest.MonkeyPatch, room: int, forever: bool = True) -> None:
    """A disk that takes so many bytes of series more, and then nothing, or what has been cut off before."""
    append, used = SeriesWriter._append, [0]

    def limited(self: SeriesWriter, data: bytes) -> None:
        if used[0] + len(data) > room:
            used[0] = room if forever else 0
            raise OSError(errno.ENOSPC, "No space left on device", str(self._path))
        used[0] += len(data)
        append(self, data)

    monkeypatch.setattr(SeriesWriter, "_append", limited)


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_full_disk_leaves_what_was_written_readable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    """No checkpoint yet: what reached the disk is kept as an interrupted run, and can be resumed."""
    experiment = small(f"output.format={suffix}")
    expected = content(run_experiment(experiment, tmp_path / "whole").stored.folder)
    data = read_series(tmp_path / "whole" / NAME / f"series.{suffix}")
    with monkeypatch.context() as patched:
        full_after(patched, 16_000, forever=False)
        with pytest.raises(RunError, match=rf"series.{suffix}: no space left .* kept, marked interrupted") as caught:
            run_experiment(experiment, tmp_path / "out")
    assert caught.value.exit_code == 1
    stored = stored_run(tmp_path / "out" / NAME)
    assert stored is not None
    assert stored.interrupted
    kept = read_series(stored.series)
    assert 0 < len(kept["t"]) == stored.manifest["step"] + 1 < 301
    assert all((kept[name] == data[name][: len(kept[name])]).all() for name in data)
    assert content(run_experiment(experiment, tmp_path / "out", resume=True).stored.folder) == expected


def test_a_disk_without_room_for_anything_leaves_the_last_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = content(run_experiment(small(), tmp_path / "whole").stored.folder)
    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        full_after(patched, 16_000)
        with pytest.raises(RunError, match=r"no space left .* last checkpoint holds is kept.*\(up to step \d+\)"):
            run_experiment(small(), out, checkpoint_every=0.0)
    assert stored_runs(out) == []
    assert content(run_experiment(small(), out, resume=True).stored.folder) == expected
    assert [path.name for path in out.iterdir()] == [NAME]


def test_a_checkpoint_that_cannot_be_written_is_told_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sync, calls = os.fsync, iter(range(10**6))

    def full(handle: int) -> None:
        if next(calls) >= 9:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(handle)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(RunError, match="no space left"):
            run_experiment(small("output.every=50"), tmp_path, checkpoint_every=0.0)
    told: list[str] = []
    run_experiment(small("output.every=50"), tmp_path, resume=True, tell=told.append)
    assert "continues from step" in told[0]


def test_a_living_process_keeps_others_off(tmp_path: Path) -> None:
    """The lock is the system's: held by a living process, free the moment it is killed."""
    code = (
        "import sys, time; from pathlib import Path; from topcli.config.load import load_experiment\n"
        "from topcli.studies.run import run_experiment\n"
        f"experiment = load_experiment({str(HK)!r}, ['N=300'])\n"
        "def wait(done, total):\n"
        "    if done > 200000 or done == total:\n"
        "        print('running', flush=True); time.sleep(60)\n"
        "run_experiment(experiment, Path(sys.argv[1]), checkpoint_every=0.0, progress=wait)\n"
    )
    other = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout is not None
        assert other.stdout.readline() == "running\n"
        (part,) = parts_of(tmp_path, NAME)
        assert (part.alive, part.owner["pid"]) == (True, other.pid)
        with pytest.raises(UsageError, match=f"process {other.pid} is running this experiment"):
            run_experiment(small(), tmp_path, resume=True)
        told: list[str] = []
        assert run_experiment(small(), tmp_path, tell=told.append).status == "ran"
        assert told == [f"{NAME}: process {other.pid} is running this experiment too"]
        assert part.folder.is_dir(), "the other one's folder is left alone"
    finally:
        other.kill()
        other.communicate()
    (part,) = parts_of(tmp_path, NAME)
    assert not part.alive, "a stale lock does not block"
    assert run_experiment(small(), tmp_path, force=True, resume=True).status in ("resumed", "ran")
    assert parts_of(tmp_path, NAME) == []


@pytest.mark.parametrize("locks", [True, False])
def test_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, locks: bool) -> None:
    """Where the system has no locks, the number of the process tells whether it lives."""
    if not locks:
        monkeypatch.setattr(parts, "fcntl", None)
    folder = new_part(tmp_path, "x")
    folder.mkdir()
    assert lock_left(folder) is None, "just made by a living process"
    mine = lock_new(folder, {"digest": "d"})
    assert parts.owner(folder) == {"pid": os.getpid(), "digest": "d"}
    assert lock_left(folder) is None
    mine.release()
    mine.release()
    if not locks:
        (folder / "lock").write_text('{"pid": 999999999}')
    again = lock_left(folder, {"digest": "e"})
    assert again is not None
    assert parts.owner(folder)["digest"] == "e"
    again.release()


def test_a_damaged_checkpoint_is_not_gone_on_from(tmp_path: Path) -> None:
    left = killed(tmp_path, small(), 5)
    path = left / CHECKPOINT
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))
    assert read_checkpoint(left) is None
    told: list[str] = []
    run_experiment(small(), tmp_path, resume=True, tell=told.append)
    assert "nothing to resume" in told[0]


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
@pytest.mark.parametrize("rows", [0, 1, 39, 40, 41, 400])
def test_a_series_cut_anywhere_goes_on_to_the_same_file(tmp_path: Path, suffix: str, rows: int) -> None:
    data = {"n": np.arange(500), "x": np.random.default_rng(1).normal(size=500)}
    whole, cut = tmp_path / f"whole.{suffix}", tmp_path / f"cut.{suffix}"
    cuts = [*range(0, rows, 17), rows]

    def write(writer: SeriesWriter, begin: int, end: int) -> None:
        writer.write({name: values[begin:end] for name, values in data.items()})

    with SeriesWriter(whole, ["n", "x"], {"who": "test"}) as writer:
        for begin, end in zip(cuts, [*cuts[1:], 500], strict=True):
            write(writer, begin, end)
        writer.finish({"end": "yes"})
    with SeriesWriter(cut, ["n", "x"], {"who": "test"}) as writer:
        for begin, end in itertools.pairwise(cuts):
            write(writer, begin, end)
        mark = writer.mark()
        write(writer, rows, min(rows + 90, 500))
    with SeriesWriter(cut, ["n", "x"], {"who": "test"}, mark) as writer:
        write(writer, rows, 500)
        writer.finish({"end": "yes"})
    assert cut.read_bytes() == whole.read_bytes()
    assert all((read_series(cut)[name] == values).all() for name, values in data.items())
    if suffix == "parquet":
        assert pq.read_metadata(cut).metadata[b"end"] == b"yes"
        assert read_metadata(cut)["who"] == "test"


def test_many_row_groups_keep_their_places(tmp_path: Path) -> None:
    """Offsets beyond one byte of a varint, and one row group read without the others."""
    path = tmp_path / "series.parquet"
    names = ["n", *(f"x{i}" for i in range(20))]
    data = {name: np.random.default_rng(i).normal(size=40) for i, name in enumerate(names)}
    data["n"] = np.arange(40)
    with SeriesWriter(path, names, {}) as writer:
        for _ in range(300):
            writer.write(data)
        writer.finish({})
    file = pq.ParquetFile(path)
    assert file.num_row_groups == 300
    for index in (0, 1, 150, 299):
        group = file.read_row_group(index)
        assert all((group.column(name).to_numpy() == data[name]).all() for name in names)
    assert pq.read_table(path).num_rows == 12_000


def test_few_rows_in_many_pieces_take_the_memory_of_their_numbers(tmp_path: Path) -> None:
    import tracemalloc

    with SeriesWriter(tmp_path / "series.parquet", ["n", "x"], {}) as writer:
        tracemalloc.start()
        for i in range(39):
            writer.write({"n": np.array([i]), "x": np.array([0.5])})
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 10_000


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the kills are of forks")
def test_killed_at_random_moments(tmp_path: Path) -> None:
    """SIGKILL anywhere leaves the old state or one to be resumed; ``TOPCLI_KILLS=50`` for more of them."""
    kills = os.environ.get("TOPCLI_KILLS", "8")
    command = [sys.executable, str(Path(__file__).with_name("kills.py")), str(tmp_path), kills, "20"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["kills"] >= int(kills)
    assert told["finished"] > 0
