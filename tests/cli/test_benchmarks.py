"""Benchmarks: what they import from topcli is there; they are run by hand, and a move would not be seen otherwise."""

from __future__ import annotations

import ast
from importlib import import_module
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_what_a_benchmark_imports_is_there(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "topcli":
            assert node.module
            missing = [each.name for each in node.names if not hasattr(import_module(node.module), each.name)]
            submodules = {child.stem for child in Path(str(import_module(node.module).__file__)).parent.glob("*.py")}
            assert not set(missing) - submodules, f"{node.module}: {missing}"
