"""The modules import each other in one direction, for types and within functions too."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from graphlib import CycleError, TopologicalSorter

import pytest

from conftest import ROOT

SOURCE = ROOT / "src"
MODULES = {
    ".".join(path.relative_to(SOURCE).with_suffix("").parts): path
    for path in (SOURCE / "topcli").rglob("*.py")
    if path.stem != "__init__"
}


def imported(text: str) -> set[str]:
    """Names of the modules of ``MODULES`` that a source text imports anywhere."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & MODULES.keys()


def first_circle(graph: Mapping[str, set[str]]) -> list[str]:
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


@pytest.mark.slow
def test_no_import_circle_hidden_or_not() -> None:
    graph = {name: imported(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}
    assert sum(map(len, graph.values())) > 2 * len(graph), "the imports are found"
    assert first_circle(graph) == []


@pytest.mark.parametrize(
    "text",
    [
        "if TYPE_CHECKING:\n    from topcli.engine.ensemble import EnsembleRun",
        "def late():\n    from topcli.engine import ensemble",
        "import topcli.engine.ensemble",
    ],
)
def test_a_hidden_circle_would_be_found(text: str) -> None:
    """Control: for types only, within a function, as a whole module."""
    graph = {"topcli.engine.tile": imported(text), "topcli.engine.ensemble": {"topcli.engine.tile"}}
    assert set(first_circle(graph)) == set(graph)
