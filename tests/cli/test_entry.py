"""The entry point: pipes that are closed early, file-system errors, systems that are not supported."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from topcli.__main__ import main
from topcli.engine.loop import Run


@pytest.mark.slow
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("fails", [False, True])
def test_a_closed_pipe_does_not_change_the_code(tmp_path: Path, unbuffered: str, fails: bool) -> None:
    """The reader is gone before anything is printed: the worst case of ``| head -1``. Both runs are finished."""
    failing = ("--set", "scheme=rk4", "--set", "h=40", "--set", "initial.omega=[1e6, 1e6, 1e6]")
    arguments = ("run", "kowalevski_hk", "kowalevski_hk", "--set", "N=50", *(failing if fails else ()))
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "topcli", *arguments],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        check=False,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )
    os.close(write)
    assert done.returncode == int(fails), done.stderr
    (folder,) = (tmp_path / "results").iterdir()
    assert done.stderr.count(f"{folder.name}: ") == (4 if fails else 2)
    assert "error: standard output" not in done.stderr
    assert "Traceback" not in done.stderr
    assert (folder / "manifest.json").is_file()


def test_errors_about_files_are_not_about_stdout(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(**options: object) -> None:
        raise OSError(13, "Permission denied", "some/folder")

    monkeypatch.setattr("topcli.cli.app.app", fails)
    with pytest.raises(SystemExit) as leaving:
        main()
    assert leaving.value.code == 1
    assert capsys.readouterr().err == "error: some/folder: permission denied\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ("--out", "x" * 300),
        ("--out", "/".join(["y" * 200] * 30)),
        ("--resume", "--out", "x" * 300),
        ("--out", "locked/r"),
    ],
    ids=["name", "path", "resume", "permission"],
)
def test_impossible_output_folder_is_refused_before_computing(
    cli, in_tmp: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    (in_tmp / "locked").mkdir()
    if arguments[-1] == "locked/r":
        stat = os.stat

        def denied(path: Any, *rest: Any, **options: Any) -> os.stat_result:
            if "locked/r" in str(path):
                raise PermissionError(13, "Permission denied", str(path))
            return stat(path, *rest, **options)

        monkeypatch.setattr(os, "stat", denied)  # the tests may run as root, whom nothing is denied
    monkeypatch.setattr(Run, "__iter__", None)
    said = cli("run", "kowalevski_hk", "--set", "N=5", *arguments)
    assert said.code == 2
    assert "nothing was written" in said.err
    assert "--out" in said.err
    assert len(said.err) < 1000


def test_windows_is_refused_at_once_naming_wsl(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("topcli.__main__.os.name", "nt")
    with pytest.raises(SystemExit) as leaving:
        main()
    monkeypatch.undo()
    assert leaving.value.code == 2
    err = capsys.readouterr().err
    assert "WSL" in err
    assert len(err.splitlines()) == 1
