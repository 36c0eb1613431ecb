"""Texts in the sources: one module prints, and exit codes are documented alike."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from conftest import ROOT

SOURCES = sorted((ROOT / "src" / "topcli").rglob("*.py"))


def calls(path: Path) -> list[ast.Call]:
    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]


@pytest.mark.slow
def test_only_one_module_prints() -> None:
    """Whoever prints past ``talk`` prints raw characters. Pipes to other processes are no terminal."""
    for path in SOURCES:
        if path.name == "output.py":
            continue
        for call in calls(path):
            where = f"{path}:{call.lineno}"
            stream = next((ast.unparse(word.value) for word in call.keywords if word.arg == "file"), "sys.stdout")
            if isinstance(call.func, ast.Name) and call.func.id == "print" and stream.startswith("sys."):
                assert path.name == "__main__.py", where
                assert all(isinstance(one, ast.Constant) or "strerror" in ast.unparse(one) for one in call.args), where
            assert not (isinstance(call.func, ast.Attribute) and call.func.attr in ("echo", "secho")), where


def test_exit_codes_are_documented_alike() -> None:
    from topcli.errors import ExitCode

    page = (ROOT / "docs" / "running.md").read_text(encoding="utf-8").split("## Exit codes")[1]
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)] == list(ExitCode)
