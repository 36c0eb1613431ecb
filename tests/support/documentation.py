"""Pages of the documentation as their tests read them: blocks, their marks, and what their commands should print.

A ```console block shows commands after ``$`` and what they print; a line ``...`` matches any number of lines. Marks
in front of a block:

- ``<!-- not executed: reason -->``
- ``<!-- exits with 4 -->``
- ``<!-- file: name -->``: the block is a file that the commands of its page find in their folder.
- ``<!-- with: name -->``: the config needs this file of its page as ``--plugin``.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from conftest import ROOT
from forked import topcli

Shown = tuple[int, list[str]]

TIMINGS = ("ns per step", "compile or load")
SLOPES = ("drift per unit time", "standard error", "over the run")
ROUND_OFF = 1e-11
"""Smaller numbers are round-off, which differs between machines."""


@dataclass
class Page:
    path: Path
    blocks: list[Block] = field(default_factory=list)

    @property
    def name(self) -> str:
        return str(self.path.relative_to(ROOT))

    def files(self) -> dict[str, str]:
        return {name: block.text for block in self.blocks if (name := block.mark("file"))}


@dataclass
class Block:
    page: Page
    line: int
    comments: str
    language: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.page.name}:{self.line}"

    def mark(self, word: str) -> str | None:
        found = re.search(rf"<!-- {word}:? (.+?) -->", self.comments)
        return found and found[1]


def read_page(path: Path, text: str | None = None) -> Page:
    page = Page(path)
    text = path.read_text(encoding="utf-8") if text is None else text
    for found in re.finditer(r"((?:^<!-- [^\n]*? -->\n)*)^```(\S*)[^\n]*\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        line = text[: found.start(2)].count("\n") + 1
        page.blocks.append(Block(page, line, found[1], found[2], found[3]))
    return page


def number(text: str) -> float | None:
    try:
        return float(text.rstrip(",:"))
    except ValueError:
        return None


def last_digit(text: str) -> float:
    """One unit in the last digit of a number as it is written."""
    mantissa, _, exponent = text.rstrip(",:").lower().partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def agrees(shown: str, now: str) -> bool:
    """True if two printed lines have equal words, and equal numbers but for the last digit, round-off and timings."""
    ours, theirs = shown.split(), now.split()
    if ours == theirs:
        return shown == now.rstrip()
    if len(ours) != len(theirs):
        return False
    for one, other in zip(ours, theirs, strict=True):
        a, b = number(one), number(other)
        if one == other or (a is not None and b is not None and shown.startswith(TIMINGS)):
            continue
        if a is None or b is None:
            return False
        if max(abs(a), abs(b)) < ROUND_OFF:
            if not any(slope in shown for slope in SLOPES) and not (a and b and 0.25 <= a / b <= 4.0):
                return False
        elif not abs(a - b) <= 1.01 * last_digit(one):
            return False
    return True


def difference(shown: list[str], now: list[str]) -> str:
    """Empty if the lines shown are those printed, else the first line shown that is not."""
    at, gap = 0, False
    for line in shown:
        if line == "...":
            gap = True
            continue
        matches = [i for i in range(at, len(now) if gap else min(at + 1, len(now))) if agrees(line, now[i])]
        if not matches:
            return f"shown: {line!r}; printed: {now[at : at + 3]}"
        at, gap = matches[0] + 1, False
    return "" if gap or at == len(now) else f"printed as well: {now[at]!r}"


def sessions(block: Block) -> list[tuple[str, list[str]]]:
    """The commands of a console block, each with the lines shown as its output."""
    found: list[tuple[str, list[str]]] = []
    for line in block.text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        else:
            found[-1][1].append(line)
    return found


def run(command: str, cwd: Path, scripts: Path | None = None, environment: Mapping[str, str] = os.environ) -> Shown:
    """Exit code of topcli or a script, and the lines that a person at a terminal of 160 columns sees.

    The programs are those of the folder ``scripts``, if it is given.
    """
    program, *arguments = shlex.split(command)
    assert program in ("topcli", "python"), f"mark it as not executed: {command}"
    environment = {**environment, "COLUMNS": "160"}
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "output"
        if program == "topcli" and scripts is None:
            code = topcli(arguments, cwd, environment, output)
        else:
            started = [str(scripts / program)] if scripts else [sys.executable, "-u"]
            with output.open("wb") as file:
                code = subprocess.run(
                    [*started, *arguments], stdout=file, stderr=subprocess.STDOUT, cwd=cwd, env=environment, check=False
                ).returncode
        return code, without_progress(output.read_text(encoding="utf-8").splitlines())


def without_progress(lines: list[str]) -> list[str]:
    """Lines but those that a slow machine adds, such as ``stress: 75.0%, 3 of 4 steps, 0.13 steps/s, 8 s left``."""
    return [line for line in lines if not re.match(r"\S+: [0-9.]+%, [0-9]+ of [0-9]+ [a-z]+", line)]


def prepare(page: Page, folder: Path) -> None:
    for name, text in page.files().items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "configs").symlink_to(ROOT / "configs")
