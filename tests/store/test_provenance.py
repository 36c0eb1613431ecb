"""Provenance in the manifest: the processor's name says which one it is, the commit whether files differ from it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from topcli.store import provenance
from topcli.store.provenance import Commit, cpu_name

X86 = "processor\t: 0\nmodel name\t: AMD EPYC 7763\nflags\t\t: fpu\n"
ARM = "processor\t: 0\nCPU implementer\t: 0x41\nCPU variant\t: 0x3\nCPU part\t: 0xd0c\nCPU revision\t: 1\n"


@pytest.mark.parametrize(("text", "name"), [(X86, "AMD EPYC 7763"), (ARM, "aarch64 Arm part 0xd0c variant 0x3 r1")])
def test_the_processor_is_named(monkeypatch: pytest.MonkeyPatch, text: str, name: str) -> None:
    monkeypatch.setattr(Path, "read_text", lambda self, **options: text)
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert cpu_name() == name


def test_the_commit_is_dirty_if_a_tracked_file_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a checkout of its own: none before the first commit, clean, changed, staged, and clean again."""
    git = shutil.which("git")
    if git is None:
        pytest.skip("no git here")

    def run(*arguments: str) -> str:
        settings = ("-c", "user.name=Nobody", "-c", "user.email=nobody@example.org", "-c", "commit.gpgsign=false")
        command = [git, "-C", str(tmp_path), *settings, *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    def found() -> dict[str, Any]:
        with Commit() as commit:
            return commit.read()

    source = tmp_path / "src" / "topcli" / "store" / "provenance.py"
    source.parent.mkdir(parents=True)
    source.write_text("one\n")
    monkeypatch.setattr(provenance, "__file__", str(source))
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    assert found() == {"commit": None, "dirty": None}
    run("init", "-q")
    assert found() == {"commit": None, "dirty": None}
    run("add", ".")
    run("commit", "-q", "-m", "first")
    clean = {"commit": run("rev-parse", "HEAD"), "dirty": False}
    assert found() == clean
    (tmp_path / "notes.txt").write_text("a new file changes no result\n")
    assert found() == clean
    source.write_text("two\n")
    assert found() == {**clean, "dirty": True}
    run("add", "src")
    assert found() == {**clean, "dirty": True}
    run("commit", "-q", "-m", "second")
    assert found() == {"commit": run("rev-parse", "HEAD"), "dirty": False}
    assert found()["commit"] != clean["commit"]
