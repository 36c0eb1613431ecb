"""Every command, config, example and notebook of the documentation is executed or says why not."""

from __future__ import annotations

import doctest
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import topcli
from conftest import ROOT
from documentation import Block, Page, difference, prepare, read_page, run, sessions, without_progress
from injected import python_process

pytestmark = pytest.mark.slow

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "examples").glob("*/README.md")),
    ROOT / "results" / "README.md",
]
LANGUAGES = {"console", "python", "yaml", "toml", "csv", "sh", "{toctree}", "{include}"}
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
READ = [read_page(path) for path in PAGES]
BLOCKS = [block for page in READ for block in page.blocks]
CONSOLE = [block for block in BLOCKS if block.language == "console"]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def named(blocks: list[Block]) -> list[object]:
    return [pytest.param(block, id=block.name) for block in blocks]


@pytest.mark.parametrize("block", named([block for block in CONSOLE if not block.mark("not executed")]))
def test_console_blocks_show_what_is_printed(block: Block, tmp_path: Path) -> None:
    prepare(block.page, tmp_path)
    commands = sessions(block)
    assert commands
    for command, shown in commands:
        code, now = run(command, tmp_path)
        assert code == int(block.mark("exits with") or 0), (command, now)
        assert not difference(shown, now), command


def test_blocks_that_are_not_executed_give_a_reason() -> None:
    skipped = [block for block in BLOCKS if block.mark("not executed")]
    assert all(len((block.mark("not executed") or "").split()) >= 3 for block in skipped)
    assert len(skipped) < len(CONSOLE) / 2


@pytest.mark.parametrize("page", [pytest.param(page, id=page.name) for page in READ])
def test_commands_are_in_console_blocks_only(page: Page) -> None:
    assert {block.language for block in page.blocks} <= LANGUAGES
    for block in page.blocks:
        if block.language == "sh":
            assert all(line.startswith("make ") for line in block.text.splitlines()), block.name
    assert not re.findall(r"^    +(?:\$ |topcli |make )", page.path.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize(
    "block",
    named(
        [
            block
            for block in BLOCKS
            if block.language == "python" and not block.mark("file") and not block.mark("not executed")
        ]
    ),
)
def test_python_examples_run(block: Block, tmp_path: Path) -> None:
    done = python_process(block.text, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "checks").glob("*.py")), ids=lambda path: path.stem)
def test_formulas_of_derivations_hold(path: Path, tmp_path: Path) -> None:
    done = python_process(path.read_text(encoding="utf-8"), cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("block", named([block for block in BLOCKS if block.language in ("yaml", "toml")]))
def test_configs_are_valid(block: Block, tmp_path: Path) -> None:
    prepare(block.page, tmp_path)
    path = tmp_path / f"config.{block.language}"
    path.write_text(block.text, encoding="utf-8")
    command = "sweep" if re.search("^base:", block.text, re.MULTILINE) else "run"
    own = f"--plugin {name}" if (name := block.mark("with")) else ""
    code, printed = run(f"topcli {command} {path} --dry-run {own}", tmp_path)
    assert code == 0, printed


def test_the_config_of_the_readme_is_the_packaged_one(tmp_path: Path) -> None:
    (config,) = (block.text for block in READ[0].blocks if block.language == "yaml")
    (tmp_path / "kowalevski_hk.yaml").write_text(config)
    assert run("topcli show kowalevski_hk.yaml", tmp_path) == run("topcli show kowalevski_hk", tmp_path)


def test_the_scheme_of_the_readme_can_be_compared(tmp_path: Path) -> None:
    prepare(READ[0], tmp_path)
    assert "`topcli compare hk euler-rule --plugin mine.py`" in README
    code, printed = run("topcli compare hk euler-rule --plugin mine.py --set N=2000 --set h=0.01", tmp_path)
    assert code == 0, printed
    assert any("euler-rule" in line for line in printed)


LINKS = [
    pytest.param(page.path.parent, target, id=f"{page.name}->{target}")
    for page in READ
    for target in dict.fromkeys(re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.path.read_text(encoding="utf-8")))
]


@pytest.mark.parametrize(("folder", "target"), LINKS)
def test_links_have_targets(folder: Path, target: str) -> None:
    """In a checkout too, where the generated pages do not exist."""
    assert (folder / target).is_file()


def contents(page: Page) -> list[str]:
    """Names of pages in the lists of contents of a page."""
    blocks = [block for block in page.blocks if block.language == "{toctree}"]
    return [line for block in blocks for line in block.text.splitlines() if line and not line.startswith(":")]


def test_every_page_is_in_the_contents() -> None:
    listed = [name for page in READ if page.path.parent == ROOT / "docs" for name in contents(page)]
    assert len(listed) == len(set(listed))
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert set(listed) == pages | {f"notebooks/{path.stem}" for path in NOTEBOOKS}


def test_included_parts_are_generated() -> None:
    """Each part of the reference is included by one page."""
    functions = (ROOT / "docs" / "reference_pages.py").read_text(encoding="utf-8")
    parts = re.findall(r'^    "(\w+)": \1_part,$', functions, re.MULTILINE)
    texts = [page.path.read_text(encoding="utf-8") for page in READ]
    included = [name for text in texts for name in re.findall(r"^```\{include\} (\S+)", text, re.MULTILINE)]
    assert sorted(included) == sorted(f"reference/{name}.md" for name in parts)


def test_formulas_are_well_formed() -> None:
    """MathJax shows its errors in the page, and Sphinx does not know of them."""
    seen = 0
    for page in READ:
        text = re.sub(r"^```.*?^```$", "", page.path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        assert text.count("$$") % 2 == 0, page.name
        for formula in re.findall(r"\$\$(.*?)\$\$", text, re.DOTALL):
            assert formula.count("{") == formula.count("}"), (page.name, formula)
            begun, ended = (sorted(re.findall(rf"\\{word}\{{(\w+)\}}", formula)) for word in ("begin", "end"))
            assert begun == ended, (page.name, formula)
            assert len(re.findall(r"\\left\b", formula)) == len(re.findall(r"\\right\b", formula)), (page.name, formula)
            assert r"\tag" not in formula, f"{page.name}: write $$ (label) after the formula"
            seen += 1
    assert seen > 40


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= 150
    assert len((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").splitlines()) <= 150


def inline(program: str) -> list[str]:
    """Commands of ``program`` within the text of all pages, and in the marks and blocks that are not executed."""
    texts = [page.path.read_text(encoding="utf-8") for page in READ]
    return sorted({" ".join(one.split()) for text in texts for one in re.findall(rf"`({program} [^`]+)`", text)})


@pytest.mark.parametrize("command", inline("topcli"))
def test_commands_in_the_text_exist(command: str, cli) -> None:
    """Their names and options; what else they are given is the reader's."""
    skipped = {"python", "-c"}
    words = [word for word in command.partition(" |")[0].split()[1:] if word not in skipped]
    if words in (["--help"], ["--version"]):
        return
    subject = words[:2] if words[0] == "list" and len(words) > 1 else words[:1]
    page = cli(*subject, "--help")
    assert page.code == 0, page.err
    for word in words:
        if word.startswith("--"):
            assert re.search(rf"{re.escape(word)}\b", page.out), word


def test_make_targets_in_the_text_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    used = {command.split()[1] for command in inline("make")}
    assert len(used) >= 6
    assert used <= targets
    described = set(re.findall(r"^# make ([a-z-]+)", makefile, re.MULTILINE))
    assert used <= described


def test_files_in_the_text_exist() -> None:
    """Paths of Python files, from the root of the checkout or shorter."""
    own = {"mine.py"}
    present = [
        path.as_posix()
        for top in ("src", "tests", "benchmarks", "docs", "examples")
        for path in (ROOT / top).rglob("*.py")
    ]
    seen = 0
    for page in READ:
        for name in set(re.findall(r"`([\w/.-]+\.py)`", page.path.read_text(encoding="utf-8"))) - own:
            assert any(path.endswith(f"/{name}") for path in present), f"{page.name}: {name}"
            seen += 1
    assert seen > 8


def test_difference_finds_each_kind() -> None:
    now = ["name: done", "E max  1.0e-05  2.0e-13", "E drift per unit time  -1.0e-17", "ns per step  16.5", "end"]
    assert not difference(now, now)
    assert not difference(["name: done", "...", "end"], now)
    assert not difference([now[0], "E max  1.1e-05  4.0e-13", "...", "ns per step  99.9", "..."], now)
    assert not difference(["...", "E drift per unit time  3.0e-16", "..."], now)
    assert "printed as well" in difference(now[:-1], now)
    for wrong in (
        "E max  1.3e-05  2.0e-13",
        "E max  1.0e-05  2.0e-12",
        "E  max  1.0e-05  2.0e-13",
        "E min  1.0e-05  2.0e-13",
    ):
        assert "shown" in difference(["...", wrong, "..."], now), wrong
    assert difference(["...", "end", "...", "name: done", "..."], now)
    assert difference(["...", "ns per step", "..."], now)


def test_progress_of_a_slow_machine_is_left_out() -> None:
    slow = ["stress: 75.0%, 3 of 4 steps, 0.13 steps/s, 8 s left", "coarse: completed 5000 steps (t = 50)"]
    assert without_progress(slow) == slow[1:]


# the Python interface, and notebooks


@pytest.mark.parametrize("name", ["compare", "order", "run", "simulate", "simulate_ensemble", "stress", "sweep"])
def test_public_functions_document_every_parameter_and_their_example_runs(name: str) -> None:
    function = getattr(topcli, name)
    text = inspect.getdoc(function) or ""
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert f"\n{section}\n{'-' * len(section)}\n" in text
    for parameter in inspect.signature(function).parameters.values():
        stars = {parameter.VAR_KEYWORD: "**", parameter.VAR_POSITIONAL: "*"}.get(parameter.kind, "")
        assert f"\n{stars}{parameter.name}" in text
    globs = {"__name__": "__main__"}
    (example,) = doctest.DocTestFinder(recurse=False).find(function, name, globs=globs)
    result = doctest.DocTestRunner(optionflags=doctest.FAIL_FAST).run(example)
    assert result.attempted > 3
    assert not result.failed


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


def code_cells(path: Path) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]


def words(text: str | None) -> list[str] | None:
    """Words of an output without numbers, whose last digits differ between machines."""
    return None if text is None else [one for one in text.split() if not re.search(r"\d[.e]|^NaN$", one)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_cells_of_a_notebook_run_and_show_what_is_stored(path: Path, tmp_path: Path) -> None:
    """They were executed from top to bottom, without errors or messages."""
    cells = code_cells(path)
    assert f"notebooks/{path.stem}\n" in (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert {one["output_type"] for cell in cells for one in cell["outputs"]} == {"execute_result", "display_data"}
    assert all(len(line) < 88 for cell in cells for line in "".join(cell["source"]).splitlines())
    sources = json.dumps(["".join(cell["source"]) for cell in cells])
    command = [sys.executable, "-W", "error", "-c", RUNNER]
    done = subprocess.run(command, input=sources, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for cell, now in zip(cells, json.loads(done.stdout), strict=True):
        results = [one["data"]["text/plain"] for one in cell["outputs"] if one["output_type"] == "execute_result"]
        assert words(now["text"]) == (words("".join(results[0])) if results else None)
        assert now["figures"] == sum("image/png" in one.get("data", {}) for one in cell["outputs"])
