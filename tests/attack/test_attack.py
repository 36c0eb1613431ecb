"""The attack itself: it sees each kind of fault that it looks for, and what holds today still holds under a small one.

``make attack`` is the large one.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from attack.__main__ import PARTS, arguments
from attack.command import Said, fork
from attack.damage import Case, Sandbox, foreign_kept, meet, plot, verify
from attack.faults import Disk
from attack.fuzz import misread, read_back, wrong_run
from attack.judge import Finding, content, judged, rows_apart, wrong_content
from attack.kills import Start
from attack.mutations import CORPUS, MUTATIONS, Mutant, draw_for, mutant
from attack.pages import Reader
from attack.scenes import Scene, wait
from attack.spoil import FOREIGN
from conftest import ROOT
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.runs.run import run_experiment
from topcli.store.series import write_parquet

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the attack calls topcli in forks")
TESTS = ROOT / "tests"
HK = ROOT / "configs" / "kowalevski_hk.yaml"


def python(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )


def attack(folder: Path, *arguments: str) -> str:
    """Output of a small attack, in which nothing may be found."""
    done = python("-m", "attack", *arguments, "--folder", folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


FINE = ("nothing", "write in out", "tab and letters", "message of 1000", "two messages", "codes")
SEEN = {
    "segfault": ["signal"],
    "exception": ["traceback"],
    "unknown code": ["exit code"],
    "code of a bug": ["traceback"],
    "hang": ["hang"],
    "slow": ["slow"],
    "message of 1001": ["long message"],
    "message of many lines": ["long message"],
    "escape": ["control character"],
    "carriage return": ["control character"],
    "C1": ["control character"],
    "bidi": ["control character"],
    "write outside": ["touched"],
    "remove outside": ["touched"],
    "rename to outside": ["touched"],
    "folder outside": ["touched"],
}


@pytest.mark.slow
def test_every_planted_fault_is_seen_and_nothing_else(tmp_path: Path) -> None:
    done = python(TESTS / "attack" / "plants.py", tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {name: SEEN.get(name, []) for name in (*FINE, *SEEN)}


def test_the_codes_are_those_of_the_table() -> None:
    unknown = {code for code in range(140) if "exit code" in dict(judged(Said(("run",), code, "", "")))}
    assert sorted({*range(140)} - unknown) == [0, 1, 2, 3, 4, 70, 130]


def test_a_finding_is_one_line_without_control_characters() -> None:
    line = str(Finding("kind", "fuzz 1", "a\n\x1b[31m\u202e" + "x" * 500))
    assert line.startswith("kind: fuzz 1: a\\n\\x1b[31m\\u202ex")
    assert len(line) < 330


# --- wrong rows -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.array([1.0, np.nextafter(0.1, 1), np.nan, 0.0])}, "1 rows differ, first x[1]"),
        ({"x": np.array([1.0, 0.1, np.nan, -0.0])}, "1 rows differ, first x[3]"),
        ({"x": np.array([1.0, 0.1, 0.0, 0.0])}, "1 rows differ, first x[2]"),
        ({"n": np.array([0, 1, 2, 4])}, "1 rows differ, first n[3]"),
        ({"x": np.array([1.0, 0.1, np.nan])}, "3 rows, not 4"),
        ({"y": np.zeros(4)}, "columns ['n', 'x', 'y']"),
    ],
)
def test_rows_that_differ_in_one_bit_are_found(change: dict[str, np.ndarray], message: str) -> None:
    rows = {"n": np.arange(4), "x": np.array([1.0, 0.1, np.nan, 0.0])}
    assert rows_apart(rows, {name: values.copy() for name, values in rows.items()}) == ""
    assert rows_apart(rows, {**rows, **change}).startswith(message)


def run(out: Path, *overrides: str) -> tuple[Experiment, Path]:
    experiment = load_experiment(HK, ["N=12", *overrides])
    return experiment, run_experiment(experiment, out).stored.folder


def test_a_wrong_file_of_a_run_folder_is_found(tmp_path: Path) -> None:
    _, whole = run(tmp_path / "whole")
    _, other = run(tmp_path / "other", "h=0.002")
    expected = content(whole)
    assert wrong_content(expected, run(tmp_path / "again")[1]) == ""
    for name, message in {
        "series.parquet": "11 rows differ|12 rows differ",
        "report.json": "another report",
        "manifest.json": "another manifest",
        "config.yaml": "another config",
    }.items():
        mixed = tmp_path / f"mixed-{name}"
        shutil.copytree(whole, mixed)
        shutil.copyfile(other / name, mixed / name)
        assert re.match(message, wrong_content(expected, mixed)), name
        (mixed / name).write_bytes(b"{")
        assert "cannot be read" in wrong_content(expected, mixed) or name == "config.yaml"


def test_rows_must_reach_the_step_of_the_report(tmp_path: Path) -> None:
    experiment, folder = run(tmp_path)
    said = Said(("run",), 0, "", "")
    assert wrong_run(experiment, said, tmp_path) == ""
    assert wrong_run(experiment, Said(("run",), 1, "", ""), tmp_path) == "outcome completed, exit code 1"
    assert "plain Python" in wrong_run(load_experiment(HK, ["N=12", "h=0.0010000001"]), said, tmp_path)
    assert "initial state" in wrong_run(load_experiment(HK, ["N=12", "initial.omega=[2, 0, 1]"]), said, tmp_path)
    shutil.rmtree(folder)
    assert wrong_run(experiment, said, tmp_path) == "it exited with 0 and there is no run folder"


@pytest.mark.parametrize("file", ["kowalevski_hk.yaml", "kowalevski_generic_hk.toml"])
def test_a_config_read_with_another_meaning_is_a_finding(tmp_path: Path, file: str) -> None:
    case = Mutant(file, CORPUS[file].encode(), "")
    path = tmp_path / file
    path.write_bytes(case.content)
    assert misread(case, load_experiment(path)) == ""
    assert read_back(load_experiment(path), tmp_path) == ""
    for change in ("h=0.02", "N=11", "top.c0=1.5", "initial.omega=[0.7, -0.4, 1.25]"):
        assert misread(case, load_experiment(path, [change])).startswith(change.partition("=")[0])


# --- what the damages and the kills look for -------------------------------------------------------------------------


class Box(Sandbox):
    """A sandbox in which every call of the command says the same."""

    def __init__(self, folder: Path, said: Said, case: Case) -> None:
        super().__init__(folder, case)
        self.out.mkdir()
        self.said = said

    def call(self, *argv: str, prepare: Callable[[], object] = lambda: None) -> Said:
        return self.said


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    _, folder = run(tmp_path / "before")
    return Scene("finished", folder.name, HK, tmp_path / "before", content(folder))


def box(scene: Scene, tmp_path: Path, code: int, out: str, path: str = "series.parquet") -> Box:
    """A sandbox with a copy of ``scene``, where the file ``path`` counts as damaged."""
    made = Box(tmp_path / "box", Said(("run",), code, out, ""), Case("finished", f"{scene.name}/{path}", "bit"))
    shutil.copytree(scene.before, made.out, dirs_exist_ok=True)
    return made


def test_a_damaged_series_must_not_be_up_to_date(scene: Scene, tmp_path: Path) -> None:
    whole = box(scene, tmp_path, 0, "(up to date)")
    meet(scene, whole, [], resumable=False)
    assert whole.case.faults == []
    os.truncate(whole.out / scene.name / "series.parquet", 100)
    meet(scene, whole, [], resumable=False)
    assert whole.case.faults[0][0] == "wrong rows"
    shutil.copytree(run(tmp_path / "other", "h=0.002")[1], whole.out / scene.name, dirs_exist_ok=True)
    meet(scene, whole, ["--resume"], resumable=False)
    assert "rows differ" in whole.case.faults[1][1]
    assert len(whole.case.faults) == 2


def test_a_damaged_file_whose_rows_are_right_is_still_damaged(scene: Scene, tmp_path: Path) -> None:
    marked = box(scene, tmp_path, 0, "(up to date)")
    scene.expected.files["series.parquet"] += b" "
    meet(scene, marked, [], resumable=False)
    assert [kind for kind, _ in marked.case.faults] == ["taken for good"]


def test_a_wrong_report_is_a_finding(scene: Scene, tmp_path: Path) -> None:
    message = {**scene.expected.report, "step": 11}
    wrong = box(scene, tmp_path, 0, json.dumps({"runs": [message]}))
    meet(scene, wrong, ["--json"], resumable=False)
    assert "reports another step" in wrong.case.faults[0][1]


def test_a_refusal_must_keep_the_checkpoint(scene: Scene, tmp_path: Path, monkeypatch) -> None:
    lost = box(scene, tmp_path, 1, "")
    checkpoint = lost.out / scene.name / "checkpoint.npz"
    checkpoint.write_text("x")
    meet(scene, lost, ["--resume"], resumable=True)
    assert lost.case.faults == []
    monkeypatch.setattr(lost, "call", lambda *argv: checkpoint.unlink() or lost.said)
    meet(scene, lost, ["--resume"], resumable=True)
    assert [kind for kind, _ in lost.case.faults] == ["lost"]


@pytest.mark.parametrize(("code", "out", "faults"), [(1, "series.parquet: x", 0), (0, "", 1), (1, "damaged", 1)])
def test_verify_must_name_the_file(scene: Scene, tmp_path: Path, code: int, out: str, faults: int) -> None:
    asked = box(scene, tmp_path, code, out)
    verify(scene, asked, "series.parquet")
    assert [kind for kind, _ in asked.case.faults] == ["taken for good"] * faults


def test_a_figure_must_show_the_rows_of_its_run(scene: Scene, tmp_path: Path) -> None:
    drawn = box(scene, tmp_path, 0, "")
    (drawn.out / "figures").mkdir()
    rows = {name: scene.expected.rows[name].copy() for name in ("t", "gamma1")}
    write_parquet(drawn.out / "figures" / "fig1.parquet", rows, {})
    plot(scene, drawn)
    assert drawn.case.faults == []
    rows["gamma1"][5] = np.nextafter(rows["gamma1"][5], 2.0)
    write_parquet(drawn.out / "figures" / "fig1.parquet", rows, {})
    plot(scene, drawn)
    assert "1 rows differ, first gamma1[5]" in drawn.case.faults[0][1]


def test_foreign_files_must_survive(scene: Scene, tmp_path: Path) -> None:
    kept = box(scene, tmp_path, 0, "")
    (kept.out / "theirs").write_text(FOREIGN)
    foreign_kept(kept, 1)
    assert kept.case.faults == []
    foreign_kept(kept, 2)
    assert [kind for kind, _ in kept.case.faults] == ["lost"]


def test_leftovers_of_a_kill_are_judged(scene: Scene, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert Start(scene, empty).check(empty, 0) == 0
    with pytest.raises(AssertionError, match="went back from step 5 to 0"):
        Start(scene, empty).check(empty, 5)
    with pytest.raises(AssertionError, match="an earlier finished run was lost"):
        Start(scene, empty, [scene.expected]).check(empty, 0)
    assert Start(scene, empty, [scene.expected]).check(scene.before, 0) == 12
    (scene.before / scene.name / "report.json").write_text("{")
    with pytest.raises(ValueError, match="cannot be read"):
        Start(scene, empty).check(scene.before, 0)


def written(root: Path) -> int:
    """Write two files, of which one is flushed, and put one in the place of the other."""
    with (root / "new").open("w") as file:
        file.write("12345678")
        file.flush()
        os.fsync(file.fileno())
    (root / "other").write_bytes(b"12345678")
    os.replace(root / "other", root / "old")
    return 0


OPERATIONS = ["create new", "write new", "fsync new", "create other", "write other", "replace old"]


@pytest.mark.parametrize(
    ("at", "how", "left"),
    [
        (0, "before", {"new": 8, "old": 8}),
        (2, "before", {"new": 0, "old": 3}),
        (2, "torn", {"new": 4, "old": 3}),
        (2, "after", {"new": 8, "old": 3}),
        (2, "power", {"new": 0, "old": 3}),
        (3, "power", {"new": 8, "old": 3}),
        (6, "before", {"new": 8, "other": 8, "old": 3}),
        (6, "power", {"new": 8, "old": 0}),
        (5, "full once", {"new": 8, "other": 4, "old": 3}),
    ],
)
def test_a_fault_falls_on_its_operation(tmp_path: Path, at: int, how: str, left: dict[str, int]) -> None:
    root = tmp_path / "root"
    root.mkdir()
    (root / "old").write_text("123")
    disk = Disk(root, at, how)

    def work() -> int:
        disk.install()
        (tmp_path / "outside").write_text("x")
        return written(root)

    status = wait(fork(work))
    assert status == (0 if at == 0 else 99 if how.startswith("full") else -9)
    assert disk.operations() == OPERATIONS[: at or None]
    assert {path.name: path.stat().st_size for path in root.iterdir()} == left


# --- the attack as a whole ------------------------------------------------------------------------------------------


def test_mutants_follow_from_the_seed_and_every_mutation_changes_something() -> None:
    assert [mutant(5, i) for i in range(40)] == [mutant(5, i) for i in range(40)]
    assert mutant(5, 1) != mutant(6, 1)
    for number, mutation in enumerate(dict.fromkeys(MUTATIONS)):
        texts = [CORPUS["kowalevski_hk.yaml"], CORPUS["kowalevski_generic_hk.toml"]]
        changed = [mutation(draw_for(number, "", i), text) != text for i in range(6) for text in texts]
        assert sum(changed) >= 6, mutation.__name__


@pytest.mark.slow
def test_mutated_configs_end_in_a_result_or_an_error(tmp_path: Path) -> None:
    """With this seed long names, which the messages repeat whole, come later."""
    printed = attack(tmp_path, "fuzz", "--seed", "1", "--configs", "60", "--workers", "2")
    counted = re.search(r"fuzz: 60 configs, (\d+) accepted in", printed)
    assert counted
    assert 12 < int(counted[1]) < 48


@pytest.mark.slow
def test_damaged_files_are_survived(tmp_path: Path) -> None:
    """Damages that hold: of checkpoints, series and folders, the last one of the machine-code cache."""
    cases = ["2", "6", "10", "11"]
    printed = attack(tmp_path, "damage", "--seed", "1", "--only", *cases)
    assert f"damage: {len(cases)} cases, " in printed


@pytest.mark.slow
def test_a_small_attack_finds_nothing(tmp_path: Path) -> None:
    """All other parts, in one process, which prepares their scenes once."""
    cases = {"kills": 5, "sweeps": 2, "axes": 3, "flips": 5, "series": 2, "pages": 3, "odd": 2}
    numbers = [word for part, count in cases.items() for word in (f"--{PARTS[part][1]}", str(count))]
    printed = attack(tmp_path, *cases, "--seed", "1", "--workers", "1", *numbers)
    for part, count in cases.items():
        assert f"{part}: {count} cases, " in printed


def test_markup_in_a_page_is_seen() -> None:
    reader = Reader()
    reader.feed('<p title="<b>"><a href="#part1">x</a><svg><path style="fill: url(#a)"/></svg>&lt;script&gt;')
    assert reader.wrong == []
    reader.feed('<script>1</script><img src="x"><a href="javascript:1">x</a><p onclick="1"><link href="http://x">')
    assert [text.split()[0] for text in reader.wrong] == ["an", "an", "img", "a", "a", "p", "link"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["pieces"], "no such part: pieces"),
        (["--only", "1"], "--only wants"),
        (["kills", "odd", "--only", "1"], "--only wants"),
    ],
)
def test_wrong_usage_is_refused(
    words: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["attack", *words])
    with pytest.raises(SystemExit):
        arguments()
    assert message in capsys.readouterr().err


def test_number_of_attacks_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, number in {"SEED": "7", "CONFIGS": "8", "DAMAGES": "9", "KILLS": "10", "ODDS": "11"}.items():
        monkeypatch.setenv(f"ATTACK_{name}", number)
    monkeypatch.setattr(sys, "argv", ["attack", "--kills", "3"])
    asked = arguments()
    assert (asked.seed, asked.configs, asked.damages, asked.kills, asked.odds) == (7, 8, 9, 3, 11)
    assert asked.parts == ["fuzz", "damage", "kills", "sweeps", "axes", "flips", "series", "pages", "odd"]
