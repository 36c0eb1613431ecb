"""Cases of a test written as text: what is given, and indented below it what is expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from _pytest.mark.structures import ParameterSet


def cases_of(text: str) -> list[ParameterSet]:
    """Parameters of a test, named by the line that is given: the line, and the lines below it."""
    cases: list[tuple[str, list[str]]] = []
    for line in text.strip("\n").split("\n"):
        if line.startswith("    "):
            cases[-1][1].append(line.strip())
        else:
            cases.append((line, []))
    return [pytest.param(*case, id=case[0]) for case in cases]


def parts_of(path: Path) -> dict[str, str]:
    """Parts of a file of cases by their names, which follow ``==``; the text above the first explains the file."""
    parts = [part.partition("\n") for part in path.read_text(encoding="utf-8").split("\n== ")]
    return {name: text for name, _, text in parts[1:]}
