"""Mistakes in a command: exit code 2, up to three lines that say what is wrong and what to do, and nothing written."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cases import cases_of
from conftest import ROOT, Said
from documentation import read_page
from stored_results import store_run, store_sweep

pytestmark = pytest.mark.slow

Cli = Callable[..., Said]
SWEEP = """\
name: study
base: {top: kowalevski, initial: {omega: [0.7, -0.4, 1.3], gamma: [0.6, 0.48, 0.64]}, scheme: rk4, h: 0.01, N: 50}
grid:
  h: [0.01, 0.02]
measure: [max_deviation.energy]
"""
SCHEME = """\
import topcli
@topcli.scheme({name}, top={top}, order=1, explicit=True, self_adjoint=True)
def build(top, options):
    {docstring}
"""
FILES = {
    **read_page(ROOT / "docs" / "own.md").files(),
    "study.yaml": SWEEP,
    "file.txt": "x",
    "old.html": "x",
    "none.json": "x",
    "other.json": '{"command": "nothing"}',
    "empty.py": "x = 1\n",
    "taken.py": SCHEME.format(name="'hk'", top="'kowalevski'", docstring="'''One.'''"),
    "misspelt.py": SCHEME.format(name="'my'", top="'kowalewski'", docstring="'''One.'''"),
    "undocumented.py": SCHEME.format(name="'my'", top="'kowalevski'", docstring="pass"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a user, a stored run and a stored sweep."""
    path = tmp_path_factory.mktemp("work")
    for name, text in FILES.items():
        (path / name).write_text(text)
    store_run(path / "results", "mine", N=60)
    store_sweep(path / "results", "swept")
    (path / "bare").mkdir()
    (path / "bare.html").mkdir()
    np.savetxt(path / "mine.csv", np.eye(4), delimiter=",", header="time,w_x,w_y,w_z", comments="")
    return path


@pytest.fixture
def refused(cli: Cli, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Message of a command in the folder, which must refuse."""

    def call(command: str) -> str:
        monkeypatch.chdir(folder)
        before = sorted(folder.rglob("*"))
        said = cli(*shlex.split(command))
        assert (said.code, said.out) == (2, "")
        assert said.err.startswith("error: ")
        assert len(said.err.strip().splitlines()) <= 3
        assert sorted(folder.rglob("*")) == before
        return said.err

    return call


MISTAKES = (Path(__file__).parent / "refusals.txt").read_text(encoding="utf-8")
"""Commands, and below each of them parts of its message."""


@pytest.mark.parametrize(("command", "messages"), cases_of(MISTAKES))
def test_a_mistake_is_answered_in_words(refused: Callable[[str], str], command: str, messages: list[str]) -> None:
    said = refused(command)
    assert [message for message in messages if message not in said] == []
