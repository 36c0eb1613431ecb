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
from attack.damage import meet, plot, verify
from attack.faults import Disk
from attack.fuzz import misread, read_back, wrong_run
from attack.judge import Finding, content, judged, rows_apart, wrong_content
from attack.kills import Start
from attack.mutations import CORPUS, MUTATIONS, draw_for, mutant, mutated
from attack.pages import wrong_markup
from attack.sandbox import Case, Sandbox
from attack.scenes import Scene, wait
from attack.spoil import FOREIGN
from cases import table_of
from conftest import ROOT
from topcli.config.load import load, load_experiment
from topcli.config.models import Experiment
from topcli.errors import TopcliError
from topcli.runs.run import run_experiment
from topcli.store.series import write_parquet

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the attack calls topcli in forks")
TESTS = ROOT / "tests"
HK = ROOT / "configs" / "kowalevski_hk.yaml"


def python(*arguments: str | Path) -> str:
    """Output of a process that has the attack on its path."""
    path = os.pathsep.join([str(TESTS), str(TESTS / "support"), *filter(None, [os.environ.get("PYTHONPATH")])])
    command, environment = [sys.executable, *map(str, arguments)], {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


FINE = ("nothing", "write in out", "tab and letters", "message of 1000", "two messages", "codes")
SEEN = {
    "signal": ("segfault",),
    "traceback": ("exception", "code of a bug"),
    "exit code": ("unknown code",),
    "hang": ("hang",),
    "slow": ("slow",),
    "long message": ("message of 1001", "message of many lines"),
    "control character": ("escape", "carriage return", "C1", "bidi"),
    "touched": ("write outside", "remove outside", "rename to outside", "folder outside"),
}


@pytest.mark.slow
def test_every_planted_fault_is_seen_and_nothing_else(tmp_path: Path) -> None:
    seen = json.loads(python(TESTS / "attack" / "plants.py", tmp_path))
    assert seen == {plant: [] for plant in FINE} | {plant: [kind] for kind, plants in SEEN.items() for plant in plants}


def test_the_codes_are_those_of_the_table() -> None:
    unknown = {code for code in range(140) if "exit code" in dict(judged(Said(("run",), code, "", "")))}
    assert sorted({*range(140)} - unknown) == [0, 1, 2, 3, 4, 70, 130]


def test_a_finding_is_one_line_without_control_characters() -> None:
    line = str(Finding("kind", "fuzz 1", "a\n\x1b[31m\u202e" + "x" * 500))
    assert line.startswith("kind: fuzz 1: a\\n\\x1b[31m\\u202ex")
    assert len(line) < 330


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, ""),
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
    found = rows_apart(rows, {**{name: values.copy() for name, values in rows.items()}, **change})
    assert found.startswith(message)
    assert bool(found) == bool(message)


def run(out: Path, *overrides: str) -> tuple[Experiment, Path]:
    experiment = load_experiment(HK, ["N=12", *overrides])
    return experiment, run_experiment(experiment, out).stored.folder


def test_a_wrong_file_of_a_run_folder_is_found(tmp_path: Path) -> None:
    (_, whole), (_, other) = run(tmp_path / "whole"), run(tmp_path / "other", "h=0.002")
    expected = content(whole)
    assert wrong_content(expected, run(tmp_path / "again")[1]) == ""
    messages = {"series.parquet": "1[12] rows differ"}
    messages |= {f"{name}.{suffix}": f"another {name}" for name, suffix in (("report", "json"), ("config", "yaml"))}
    for name, message in {**messages, "manifest.json": "another manifest"}.items():
        mixed = tmp_path / f"mixed-{name}"
        shutil.copytree(whole, mixed)
        shutil.copyfile(other / name, mixed / name)
        assert re.match(message, wrong_content(expected, mixed)), name
        (mixed / name).write_bytes(b"{")
        assert "cannot be read" in wrong_content(expected, mixed) or name == "config.yaml"


def test_rows_must_reach_the_step_of_the_report(tmp_path: Path) -> None:
    experiment, folder = run(tmp_path)
    for overrides, code, message in (
        ([], 0, ""),
        ([], 1, "outcome completed, exit code 1"),
        (["h=0.0010000001"], 0, "in plain Python"),
        (["initial.omega=[2, 0, 1]"], 0, "initial state"),
    ):
        said = Said(("run",), code, "", "")
        found = wrong_run(load_experiment(HK, ["N=12", *overrides]), said, tmp_path)
        assert message in found
        assert bool(found) == bool(message)
    shutil.rmtree(folder)
    assert wrong_run(experiment, Said(("run",), 0, "", ""), tmp_path) == "it exited with 0 and there is no run folder"


@pytest.mark.parametrize("file", ["kowalevski_hk.yaml", "kowalevski_generic_hk.toml"])
def test_a_config_read_with_another_meaning_is_a_finding(tmp_path: Path, file: str) -> None:
    path = tmp_path / file
    path.write_text(CORPUS[file])
    assert misread(path, load_experiment(path)) == ""
    assert read_back(load_experiment(path), tmp_path) == ""
    for change in ("h=0.02", "N=11", "top.c0=1.5", "initial.omega=[0.7, -0.4, 1.25]"):
        assert misread(path, load_experiment(path, [change])).startswith(change.partition("=")[0])


class Box(Sandbox):
    """A sandbox with a copy of ``scene`` in which a file is damaged and every call of the command says the same."""

    def __init__(self, folder: Path, scene: Scene, said: Said, file: str = "series.parquet") -> None:
        super().__init__(folder, Case("finished", f"{scene.name}/{file}", "bit"))
        shutil.copytree(scene.before, self.out)
        self.said = said

    def call(self, *argv: str, prepare: Callable[[], object] = lambda: None) -> Said:
        prepare()
        return self.said


def cut(box: Box, scene: Scene) -> None:
    os.truncate(box.out / scene.name / "series.parquet", 100)


def other_rows(box: Box, scene: Scene) -> None:
    shutil.copytree(run(box.folder / "other", "h=0.002")[1], box.out / scene.name, dirs_exist_ok=True)


def other_bytes(box: Box, scene: Scene) -> None:
    scene.expected.files["series.parquet"] += b" "


def drawn(by: float) -> Callable[[Box, Scene], None]:
    """A figure of the run, of which a number is off."""

    def draw(box: Box, scene: Scene) -> None:
        (box.out / "figures").mkdir()
        rows = {name: scene.expected.rows[name].copy() for name in ("t", "gamma1")}
        rows["gamma1"][5] += by
        write_parquet(box.out / "figures" / "fig1.parquet", rows, {})

    return draw


def nothing(box: Box, scene: Scene) -> None:
    pass


def resumed(scene: Scene, box: Sandbox) -> None:
    meet(scene, box, ["--resume"], resumable=False)


def reported(scene: Scene, box: Sandbox) -> None:
    meet(scene, box, ["--json"], resumable=False)


def verified(scene: Scene, box: Sandbox) -> None:
    verify(scene, box, "series.parquet")


WRONG_STEP = json.dumps({"runs": [{"step": 11}]})
LOOKS = [
    (nothing, resumed, 0, "(up to date)", ""),
    (cut, resumed, 0, "(up to date)", "wrong rows"),
    (other_rows, resumed, 0, "", "wrong rows"),
    (other_bytes, resumed, 0, "(up to date)", "taken for good"),
    (nothing, reported, 0, WRONG_STEP, "wrong rows"),
    (nothing, verified, 1, "series.parquet: x", ""),
    (nothing, verified, 0, "", "taken for good"),
    (nothing, verified, 1, "damaged", "taken for good"),
    (drawn(0.0), plot, 0, "", ""),
    (drawn(1e-16), plot, 0, "", "wrong rows"),
]
"""What is done to a finished run, how the attack looks at it, what the command says, and the kind of the finding."""


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    _, folder = run(tmp_path / "before")
    return Scene("finished", folder.name, HK, tmp_path / "before", content(folder))


@pytest.mark.parametrize(("spoil", "look", "code", "out", "kind"), LOOKS)
def test_what_is_wrong_with_a_run_is_seen(
    scene: Scene,
    tmp_path: Path,
    spoil: Callable[[Box, Scene], None],
    look: Callable[[Scene, Sandbox], None],
    code: int,
    out: str,
    kind: str,
) -> None:
    box = Box(tmp_path / "box", scene, Said(("run",), code, out, ""))
    spoil(box, scene)
    look(scene, box)
    assert [found for found, _ in box.case.faults] == [kind] * bool(kind)


def test_a_refusal_must_keep_the_checkpoint_and_foreign_files(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    box = Box(tmp_path / "box", scene, Said(("run",), 1, "", ""))
    (box.out / "theirs").write_text(FOREIGN)
    checkpoint = box.out / scene.name / "checkpoint.npz"
    checkpoint.write_text("x")
    meet(scene, box, ["--resume"], resumable=True)
    box.foreign_kept(1)
    assert box.case.faults == []
    monkeypatch.setattr(box, "call", lambda *argv: checkpoint.unlink() or box.said)
    meet(scene, box, ["--resume"], resumable=True)
    box.foreign_kept(2)
    assert [kind for kind, _ in box.case.faults] == ["lost", "lost"]


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
    table_of("""
0  before     {"new": 8, "old": 8}
2  before     {"new": 0, "old": 3}
2  torn       {"new": 4, "old": 3}
2  after      {"new": 8, "old": 3}
2  power      {"new": 0, "old": 3}
3  power      {"new": 8, "old": 3}
6  before     {"new": 8, "other": 8, "old": 3}
6  power      {"new": 8, "old": 0}
5  full once  {"new": 8, "other": 4, "old": 3}
"""),
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


def test_mutants_follow_from_the_seed_and_every_mutation_changes_something() -> None:
    def mutants(seed: int) -> list[tuple[str, bytes, str]]:
        return [mutant(draw_for(seed, "", i)) for i in range(40)]

    assert mutants(5) == mutants(5) != mutants(6)
    for name in MUTATIONS:
        texts = [CORPUS["kowalevski_hk.yaml"], CORPUS["kowalevski_generic_hk.toml"]]
        changed = [mutated(draw_for(i, name, 0), name, text) != text for i in range(6) for text in texts]
        assert sum(changed) >= 6, name


def test_some_mutants_are_accepted_and_some_are_not(tmp_path: Path) -> None:
    accepted = []
    for i in range(60):
        file, text, _ = mutant(draw_for(1, "fuzz", i))
        (tmp_path / file).write_bytes(text)
        try:
            accepted.append(load(tmp_path / file))
        except TopcliError:
            continue
    assert 12 < len(accepted) < 48


@pytest.mark.slow
def test_a_small_attack_finds_nothing(tmp_path: Path) -> None:
    """All parts, in one process, which prepares what is attacked once."""
    printed = python("-m", "attack", "--folder", tmp_path, "--seed", "1", "--workers", "1", "--cases", "2")
    for part in PARTS:
        assert f"{part}: 2 cases, " in printed


def test_markup_in_a_page_is_seen() -> None:
    fine = '<p title="<b>"><a href="#part1">x</a><svg><path style="fill: url(#a)"/></svg>&lt;script&gt;</p>'
    assert list(wrong_markup(fine)) == []
    wrong = '<script>1</script><img src="x"><a href="javascript:1">x</a><p onclick="1"></p><link href="http://x">'
    assert [text.split()[0] for text in wrong_markup(wrong)] == ["an", "an", "img", "a", "p", "link"]
    assert list(wrong_markup("<p><a>x</p>")) == ["</p> closes <a>"]


@pytest.mark.parametrize(
    ("words", "message"),
    table_of("""
pieces                no such part: pieces
--only 1              --only wants
kills pages --only 1  --only wants
"""),
)
def test_wrong_usage_is_refused(
    words: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["attack", *words.split()])
    with pytest.raises(SystemExit):
        arguments()
    assert message in capsys.readouterr().err


def test_the_seed_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATTACK_SEED", "7")
    monkeypatch.setattr(sys, "argv", ["attack", "kills", "--cases", "3"])
    asked = arguments()
    assert (asked.seed, asked.cases, asked.parts) == (7, 3, ["kills"])
