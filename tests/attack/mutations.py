"""Wrong configs and sweep files: valid ones, changed at random by a few of the mutations below."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
TEXTS: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("texts.yaml").read_text(encoding="utf-8"))
SMALL = "small.yaml"
"""A sweep file that is quickly run."""


def read(folder: Path) -> dict[str, str]:
    """The configs of a folder by file name."""
    files = sorted(path for path in folder.iterdir() if path.suffix in (".yaml", ".toml"))
    return {path.name: path.read_text(encoding="utf-8") for path in files}


SWEEPS = {f"sweep-{name}": text for name, text in read(CONFIGS / "sweeps").items()} | {SMALL: TEXTS["configs"][SMALL]}
CORPUS = {**read(CONFIGS), **TEXTS["configs"], **SWEEPS}
TOKEN = re.compile(r"[\w.+-]+|[^\w\s]")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d[\d.]*(?:[eE][-+]?\d+)?(?!\w)")
VALUE = re.compile(r"(?m)(?<=[:=] )[^\n#]+")
KEY = re.compile(r"(?m)^ *\w+")
STRETCH = re.compile(r"(?s).{1,3}")
TOKENS = sorted({token for text in CORPUS.values() for token in TOKEN.findall(text)})
LINES = sorted(
    {line for text in CORPUS.values() for line in text.splitlines() if line and not line.startswith("#")}
    | {f"name: '{name}'" for name in TEXTS["names"]}
)
CONTROLS = "".join(map(chr, [*range(1, 32), *range(127, 160), 0x202E, 0x2066, 0x200F, 0xFEFF, 0x2028, 0x200B, 0xAD]))
LETTERS = "äßЖ漢あع🌀é\u0301ﬁI\u0130ſ\u00a0\u3000２"
BOMB = "".join(f"x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 9) if i else '1'}]\n" for i in range(12))
"""Aliases that stand for 9¹² numbers."""


def _size(draw: random.Random, largest: int) -> int:
    """A size from 2 on, each power of ten as likely as the next."""
    return int(2 * (largest / 2) ** draw.random())


def _nested(draw: random.Random, old: str) -> str:
    nest, depth = draw.choice(list(TEXTS["nests"])), _size(draw, 20_000)
    return nest * depth + old + TEXTS["nests"][nest] * depth * draw.randrange(2)


def _control(draw: random.Random, old: str) -> str:
    """A control character or a letter of the whole world, plain or escaped."""
    odd = draw.choice(CONTROLS if draw.random() < 0.7 else LETTERS)
    return f'"{old.strip()}\\u{ord(odd):04x}"' if ord(odd) < 0x10000 and draw.random() < 0.4 else old + odd


Source = Callable[[random.Random, str], str]
REPLACED: dict[str, tuple[tuple[re.Pattern[str], ...], Source]] = {
    "foreign token": ((TOKEN,), lambda draw, old: draw.choice(TOKENS)),
    "odd number": ((NUMBER,), lambda draw, old: draw.choice(TEXTS["numbers"])),
    "many digits": ((NUMBER,), lambda draw, old: str(draw.randrange(1, 10)) * _size(draw, 20_000)),
    "wrong type": ((VALUE,), lambda draw, old: draw.choice(TEXTS["values"])),
    "deep": ((VALUE,), _nested),
    "alias": ((VALUE,), lambda draw, old: draw.choice((*TEXTS["aliases"], "*" + "a" * _size(draw, 100_000)))),
    "tag": ((VALUE,), lambda draw, old: draw.choice((*TEXTS["tags"], "!" * _size(draw, 30_000), "!!\n" * 3000)) + old),
    "control": ((TOKEN, VALUE, KEY), _control),
    "long": ((TOKEN, VALUE), lambda draw, old: (draw.choice(TEXTS["long"]) * _size(draw, 200_000))[:200_000]),
    "splice": ((STRETCH,), lambda draw, old: "".join(draw.choices(TEXTS["pieces"], k=draw.randrange(1, 4)))),
}
"""Mutations that put something in the place of what one of these patterns finds."""


def foreign_keys(draw: random.Random, lines: list[str]) -> None:
    """Keys of another top, scheme, ensemble or sweep, in the place of the same key or between two lines."""
    new = draw.choice(LINES)
    same = [i for i, line in enumerate(lines) if re.split("[:=]", line)[0] == re.split("[:=]", new)[0]]
    at = draw.choice(same) if same and draw.random() < 0.7 else draw.randrange(len(lines) + 1)
    lines[at : at + (at in same)] = [new]


def section(draw: random.Random, lines: list[str]) -> None:
    """A stretch of lines from another config, or none, in the place of some lines or between two."""
    other = draw.choice(list(CORPUS.values())).splitlines()
    begin, at = draw.randrange(len(other)), draw.randrange(len(lines) + 1)
    lines[at : at + draw.randrange(3)] = other[begin : begin + draw.randrange(8)]


def repeat(draw: random.Random, lines: list[str]) -> None:
    """A line once more, perhaps with another indentation."""
    line = draw.choice(lines or [""])
    indented = draw.choice((" ", "   ", "\t", "- ", "? ", ": ", "# ")) + line.strip()
    lines.insert(draw.randrange(len(lines) + 1), draw.choice((line, indented)))


def bomb(draw: random.Random, lines: list[str]) -> None:
    """Aliases that explode, before everything."""
    lines.insert(0, BOMB)


def ends(draw: random.Random, lines: list[str]) -> None:
    """Other ends of lines, or the end cut off."""
    end = draw.choice(("\r\n", "\r", ""))
    lines[:] = (
        [end.join(lines)] if end else [line[: len(line) // 2] for line in lines[: draw.randrange(len(lines) + 1)]]
    )


LINEWISE = {one.__name__: one for one in (foreign_keys, section, repeat, bomb, ends)}
MUTATIONS = (*REPLACED, *LINEWISE)
GENTLE = ("odd number", "foreign token", "foreign_keys", "section", "wrong type", "repeat")
"""Those after which a config is most often still one."""


def mutated(draw: random.Random, name: str, text: str) -> str:
    """A text after one of ``MUTATIONS``."""
    if name in LINEWISE:
        lines = text.splitlines()
        LINEWISE[name](draw, lines)
        return "\n".join(lines) + "\n"
    patterns, source = REPLACED[name]
    found = list(draw.choice(patterns).finditer(text))
    if not found:
        return text + source(draw, "")
    place = draw.choice(found)
    return text[: place.start()] + source(draw, place[0]) + text[place.end() :]


def flip(draw: random.Random, content: bytes) -> bytes:
    """Some bits changed."""
    changed = bytearray(content)
    for _ in range(draw.randrange(1, 5) if changed else 0):
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def draw_for(seed: int, part: str, index: int) -> random.Random:
    """The random numbers of one case: those of no other, and the same wherever and whenever it is tried."""
    return random.Random(f"{seed}/{part}/{index}")


def mutant(draw: random.Random) -> tuple[str, bytes, str]:
    """A wrong config or sweep file: the name of its file, its content, and the mutations that made it."""
    file = draw.choice(sorted(CORPUS))
    text, names = CORPUS[file], GENTLE if draw.random() < 0.5 else MUTATIONS
    made_by = draw.choices(names, k=draw.choice((0, 1, 1, 1, 2, 3)))
    for name in made_by:
        text = mutated(draw, name, text)[:1_100_000]
    content = text.encode("utf-8", "surrogatepass")
    return file, flip(draw, content) if draw.random() < 0.1 else content, " ".join(made_by)
