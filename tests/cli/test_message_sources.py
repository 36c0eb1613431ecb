"""Texts in the sources: one module prints, errors have no line ends of their own, none names a file of a checkout."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from conftest import ROOT
from topcli.config.schema import starter_config
from topcli.tops import TOPS

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


@pytest.mark.slow
def test_lines_of_an_error_are_arguments() -> None:
    """A line end inside a line would be printed as an escape."""
    for path in SOURCES:
        for call in calls(path):
            name = getattr(call.func, "id", getattr(call.func, "attr", ""))
            if name in ("UsageError", "ConfigError", "RunError", "UnknownNameError", "SchemeCodeError", "TopcliError"):
                texts = [node.value for node in ast.walk(call) if isinstance(node, ast.Constant)]
                assert not any("\n" in text for text in texts if isinstance(text, str)), f"{path}:{call.lineno}"


TARGETS = "|".join(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))

CHECKOUT = re.compile(rf"docs/|README|CONTRIBUTING|\bmake (?:{TARGETS})\b|tests/|examples/")


def user_texts(path: Path) -> list[str]:
    """String constants of a module other than docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    bare = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    return [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in bare
    ]


GENERATES_PAGE = "paper/page.py"
"""Writes a page of the documentation, which may name others."""


@pytest.mark.slow
def test_messages_name_no_file_of_the_checkout() -> None:
    """The wheel has none of them."""
    package = ROOT / "src" / "topcli"
    named = {
        f"{path.relative_to(package)}: {text}"
        for path in package.rglob("*.py")
        if path.relative_to(package).as_posix() != GENERATES_PAGE
        for text in user_texts(path)
        if CHECKOUT.search(text)
    }
    assert not named
    assert CHECKOUT.search("see docs/claims.md")


def test_packaged_configs_name_no_file_of_the_checkout() -> None:
    texts = {path.name: path.read_text(encoding="utf-8") for path in (ROOT / "configs").rglob("*.*")}
    assert not [name for name, text in texts.items() if CHECKOUT.search(text)]


@pytest.mark.parametrize("form", TOPS)
def test_starters_name_no_file_of_the_checkout(form: str) -> None:
    text = starter_config(form, None, "topcli.schema.json")
    assert not CHECKOUT.search(text)
    assert "as in the scene kowalevski_ensemble" in text


def test_exit_codes_are_documented_alike() -> None:
    from topcli.errors import ExitCode

    page = (ROOT / "docs" / "running.md").read_text(encoding="utf-8").split("## Exit codes")[1]
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page, re.MULTILINE)] == list(ExitCode)
