"""Schemes and tops of users that raise: one line with their file and line, exit code 2."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import ROOT, Said

SCHEME = """
import topcli
from topcli.contracts import Stepper
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski

def step(s, h, p):
    return s

def fault(*arguments):
    raise KeyError("first\\nsecond")  # the line to name

class Bad(Kowalevski):
    kind = form = "bad"
    {method} = {raising}

TOPS["bad"] = Bad

@topcli.scheme("mine", top="bad", title="mine", order=1, explicit=True, self_adjoint=False, citation="none",
               equations="none"{trait})
def build(top, options):
    '''Rest.'''
    return {built}
"""
STEPPER = "Stepper(step, 6)"
CASES = {
    "build": ("title", "'bad'", "", "fault()"),
    "enter": ("title", "'bad'", "", "Stepper(step, 6, fault)"),
    "plain step": ("title", "'bad'", "", "Stepper(fault, 6, plain=True)"),
    "leave": ("title", "'bad'", "", "Stepper(step, 6, None, fault, plain=True)"),
    "modified": ("title", "'bad'", ", modified=fault", STEPPER),
    "constants": ("constants", "fault", "", STEPPER),
    "invariants": ("invariants", "fault", "", STEPPER),
}


def write(folder: Path, method: str, raising: str, trait: str, built: str) -> Path:
    path = folder / "raising.py"
    path.write_text(SCHEME.format(method=method, raising=raising, trait=trait, built=built))
    return path


def run(cli: Callable[..., Said], path: Path) -> Said:
    settings = ["--set", "top=bad", "--set", "scheme=mine", "--set", "N=20", "--quiet"]
    return cli("run", str(ROOT / "configs" / "kowalevski_hk.yaml"), "--scheme-file", str(path), *settings)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_code_that_raises_is_named_by_file_and_line(
    case: str, cli: Callable[..., Said], tmp_path: Path, own_registry: None
) -> None:
    path = write(tmp_path, *CASES[case])
    line = next(i for i, text in enumerate(path.read_text().splitlines(), 1) if "the line to name" in text)
    said = run(cli, path)
    assert said.code == 2
    place, why = f"{path}:{line}: in fault", "KeyError: 'first\\nsecond'"
    # the invariants of a top are asked for as soon as the schemes for every top are registered for it
    message = f"scheme file {path}: {why} ({place})" if case == "invariants" else f"{place}: {why}"
    assert said.err == f"error: {message}\n"


def test_a_build_that_returns_nothing_is_refused(cli: Callable[..., Said], tmp_path: Path, own_registry: None) -> None:
    said = run(cli, write(tmp_path, "title", "'bad'", "", "None"))
    assert said.code == 2
    assert "raising.py:19: scheme 'mine' is built as NoneType; return a Stepper" in said.err


@pytest.mark.parametrize("length", [2, 9])
def test_a_plain_step_of_the_wrong_length_is_refused(
    length: int, cli: Callable[..., Said], tmp_path: Path, own_registry: None
) -> None:
    path = write(tmp_path, "title", "'bad'", "", "Stepper(step, 6, plain=True)")
    path.write_text(path.read_text().replace("return s\n", f"return (0.5,) * {length}\n"))
    said = run(cli, path)
    assert said.code == 2
    assert said.err == f"error: {path}:7: the step returns {length} numbers; expected 6\n"


def test_errors_in_topcli_are_reported_as_bugs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], in_tmp: Path
) -> None:
    from topcli.__main__ import main

    scope: dict = {}
    ours = ROOT / "src" / "topcli" / "studies" / "doctor.py"
    exec(compile("def fault():\n    raise KeyError('ours')", str(ours), "exec"), scope)
    monkeypatch.setattr("topcli.studies.doctor.cache_state", scope["fault"])
    monkeypatch.setattr(sys, "argv", ["topcli", "doctor"])
    with pytest.raises(SystemExit) as leaving:
        main()
    assert leaving.value.code == 70
    assert "this is a bug in topcli" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "words", "code"),
    [
        ({"NUMBA_DISABLE_JIT": "1"}, "NUMBA_DISABLE_JIT is set", 1),
        ({"NUMBA_NUM_THREADS": "abc"}, "", 0),
        ({"NUMBA_NUM_THREADS": "0"}, "Number of threads specified must be > 0", 1),
        ({"PYTHONOPTIMIZE": "2"}, "", 0),
    ],
)
def test_settings_of_the_environment_are_not_blamed_on_the_scheme(
    tmp_path: Path, settings: dict[str, str], words: str, code: int
) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "topcli", "run", "kowalevski_hk", "--set", "N=20", "--quiet"],
        capture_output=True,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), **settings},
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert "hk.py" not in done.stderr
    assert len(done.stderr.splitlines()) <= 3


def test_package_that_cannot_be_loaded_is_not_reported_as_a_bug(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], in_tmp: Path
) -> None:
    from topcli.__main__ import main

    scope: dict = {"broken": ImportError("libarrow.so: failed to map segment", name="pyarrow.lib")}
    ours = ROOT / "src" / "topcli" / "cli" / "app.py"  # the file decides whose bug it is
    exec(compile("def call():\n    raise broken", str(ours), "exec"), scope)
    monkeypatch.setattr("topcli.cli.app.call", scope["call"])
    with pytest.raises(SystemExit) as leaving:
        main()
    assert leaving.value.code == 1
    assert "enough memory" in (err := capsys.readouterr().err)
    assert "Traceback" not in err


def test_a_compiler_that_cannot_be_loaded_is_not_a_folder_that_cannot_be_written(
    cli: Callable[..., Said], monkeypatch: pytest.MonkeyPatch
) -> None:
    from topcli.engine import native

    native._machine.cache_clear()
    native._process_engine.cache_clear()
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    try:
        said = cli("run", "kowalevski_hk", "--set", "N=20", "--quiet")
    finally:
        native._machine.cache_clear()
    assert said.code == 1
    assert "the compiler cannot be loaded: llvmlite" in said.err
    assert "written" not in said.err


def test_a_step_whose_square_is_no_double_is_run(cli: Callable[..., Said]) -> None:
    said = cli("run", "euler_hk", "--set", "h=1e155", "--name", "far", "--quiet")
    assert (said.code, said.out) == (1, "")
    assert said.err == "error: far: blew_up; the rows before are kept\n"
    report = json.loads(Path("results/far/report.json").read_text())
    assert (report["outcome"], report["step"]) == ("blew_up", 1)
