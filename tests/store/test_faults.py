"""The disk of faults, with which the tests of writes disturb a process, disturbs it where it should."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cases import table_of
from faults import Disk
from injected import in_fork

OPERATIONS = ["create new", "write new", "fsync new", "create other", "write other", "replace old"]


def written(root: Path) -> None:
    """Write two files, of which one is flushed, and put one in the place of the other."""
    with (root / "new").open("w") as file:
        file.write("12345678")
        file.flush()
        os.fsync(file.fileno())
    (root / "other").write_bytes(b"12345678")
    os.replace(root / "other", root / "old")


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

    def work() -> None:
        disk.install()
        (tmp_path / "outside").write_text("x")
        written(root)

    assert in_fork(work) == (0 if at == 0 else 99 if how.startswith("full") else -9)
    assert disk.operations() == OPERATIONS[: at or None]
    assert {path.name: path.stat().st_size for path in root.iterdir()} == left
