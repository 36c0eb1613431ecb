"""Every command, config and example of the documentation is executed or says why not."""

from __future__ import annotations

import doctest
import inspect
import re
from pathlib import Path

import pytest

import topcli
from conftest import ROOT
from documentation import Block, Page, difference, prepare, read_page, run, sessions
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
    text = page.path.read_text(encoding="utf-8")
    assert not re.findall(r"^    +(?:\$ |topcli |make )", text, re.MULTILINE)
    assert len(re.findall("^```", text, re.MULTILINE)) == 2 * len(page.blocks)


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
    assert seen > 25


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


# the Python interface


@pytest.mark.parametrize("name", ["bench", "compare", "order", "run", "simulate", "stress", "sweep"])
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


def words(text: str | None) -> list[str] | None:
    """Words of an output without numbers, whose last digits differ between machines."""
    return None if text is None else [one for one in text.split() if not re.search(r"\d[.e]|^NaN$", one)]
