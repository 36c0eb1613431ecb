"""The notebooks of the documentation: their cells run in order, and the stored outputs are those of this code."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
RUNNER = """
import ast, json, sys
import matplotlib
matplotlib.use("agg")
from matplotlib import pyplot
names, shown = {"__name__": "__main__"}, []
for source in json.load(sys.stdin):
    tree = ast.parse(source)
    last = None
    if isinstance(tree.body[-1], ast.Expr) and not source.rstrip().endswith(";"):
        last = ast.Expression(tree.body.pop().value)
    exec(compile(tree, "<cell>", "exec"), names)
    value = None if last is None else eval(compile(last, "<cell>", "eval"), names)
    shown.append({"text": None if value is None else repr(value), "figures": len(pyplot.get_fignums())})
    pyplot.close("all")
print(json.dumps(shown))
"""
"""Cells as a kernel executes them: the value of a last expression is shown, figures are shown and closed."""


def cells(path: Path) -> list[dict[str, Any]]:
    found = json.loads(path.read_text(encoding="utf-8"))
    return [cell for cell in found["cells"] if cell["cell_type"] == "code"]


def stored(cell: dict[str, Any]) -> dict[str, Any]:
    """Text and number of pictures of the stored outputs of a cell."""
    texts = [one["data"]["text/plain"] for one in cell["outputs"] if one["output_type"] == "execute_result"]
    pictures = [one for one in cell["outputs"] if "image/png" in one.get("data", {})]
    return {"text": "".join(texts[0]) if texts else None, "figures": len(pictures)}


def words(text: str | None) -> list[str] | None:
    """Words of an output without numbers, whose last digits differ between machines."""
    return None if text is None else [one for one in text.split() if not re.search(r"\d[.e]|^NaN$", one)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_notebook_was_executed_from_top_to_bottom_without_errors(path: Path) -> None:
    found = cells(path)
    assert [cell["execution_count"] for cell in found] == list(range(1, len(found) + 1))
    kinds = {one["output_type"] for cell in found for one in cell["outputs"]}
    assert kinds == {"execute_result", "display_data"}, "neither errors nor messages"
    assert all(len(line) < 88 for cell in found for line in "".join(cell["source"]).splitlines())


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_cells_run_and_show_what_is_stored(path: Path, tmp_path: Path) -> None:
    sources = json.dumps(["".join(cell["source"]) for cell in cells(path)])
    command = [sys.executable, "-W", "error", "-c", RUNNER]
    done = subprocess.run(command, input=sources, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for cell, now in zip(cells(path), json.loads(done.stdout), strict=True):
        then = stored(cell)
        assert words(now["text"]) == words(then["text"])
        assert now["figures"] == then["figures"]


def test_there_is_a_notebook_in_the_documentation() -> None:
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert NOTEBOOKS
    for path in NOTEBOOKS:
        assert f"notebooks/{path.stem}\n" in index
