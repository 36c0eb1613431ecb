"""Cases of a test written as text: a table, or what is given and indented below it what is expected."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path
from typing import Any

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


def table_of(text: str) -> list[ParameterSet]:
    """Parameters of a test, which a line names: cells with two or more spaces between them, Python literals or text."""
    lines = [re.split(" {2,}", line) for line in text.strip("\n").split("\n")]
    return [pytest.param(*map(_value, cells), id=" ".join(cells)) for cells in lines]


def numbers_of(text: str) -> dict[str, tuple[float, ...]]:
    """Numbers by name, a line each: the name, a colon, the numbers; a remark may follow ``#``."""
    lines = (line.partition("#")[0].partition(":") for line in text.strip("\n").split("\n"))
    return {name: tuple(map(float, numbers.split())) for name, _, numbers in lines if numbers}


def _value(cell: str) -> Any:
    try:
        return ast.literal_eval(cell)
    except (SyntaxError, ValueError):
        return math.nan if cell == "nan" else cell


def changes_of(name: str) -> list[tuple[str, str, str]]:
    """Changes of a declaration from a file beside the tests of tops: the old text, the new one, and a message."""
    blocks = (Path(__file__).parents[1] / "tops" / name).read_text(encoding="utf-8").rstrip().split("\n\n")[1:]
    changes = []
    for change, message in (block.replace("\\n", "\a").splitlines() for block in blocks):
        old, _, new = change.replace("\a", "\n").partition(" ->")
        changes.append((old, new.removeprefix(" "), message))
    return changes


MOTIONS = parts_of(Path(__file__).parents[1] / "tops" / "motions.txt")
"""States of special motions, as text."""
