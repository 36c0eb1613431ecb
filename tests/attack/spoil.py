"""Ways to damage a file."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

from attack.mutations import flip

FOREIGN = "a file of somebody else\n"
HOSTILE: tuple[Any, ...] = (
    *(
        None,
        [],
        {},
        1,
        -1,
        True,
        1e300,
        float("nan"),
        float("inf"),
        10**400,
        "",
        "x" * 50_000,
        "../../x",
        "/etc/passwd",
    ),
    *("\x1b[31mred\x1b[0m", "\u202eevil", "[link=http://x]y[/link]", "\x9b2J", {"a": None}, [[[[1]]]], "\0", "a\nb"),
    *(["object", "Pendulum", [1]], ["array", "<f8", [-1, 7], "AAAA"], ["complex", 10**400, 0], ["fraction", 1, 0]),
    *(
        ["object", "Path", {}],
        ["array", "|O", [1], "AAAAAAAAAAA="],
        ["x"],
        "/etc/passwd",
        "printf",
        ["system"],
        "advance",
    ),
)
"""Values that a key of a JSON file should never have."""


def _bits(draw: random.Random, path: Path) -> None:
    path.write_bytes(flip(draw, path.read_bytes()))


def _bit(draw: random.Random, path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
    path.write_bytes(bytes(data))


def _truncate(draw: random.Random, path: Path) -> None:
    size = path.stat().st_size
    os.truncate(path, draw.choice((0, 1, 4, size // 2, size - 1, draw.randrange(size))))


def _zero(draw: random.Random, path: Path) -> None:
    data = path.read_bytes()
    start = draw.randrange(len(data))
    length = min(len(data) - start, draw.choice((1, 8, 512, 4096, len(data))))
    path.write_bytes(data[:start] + bytes(length) + data[start + length :])


def _append(draw: random.Random, path: Path) -> None:
    with path.open("ab") as file:
        file.write(draw.randbytes(draw.choice((1, 100, 5000))))


def _foreign_text(draw: random.Random, path: Path) -> None:
    path.write_bytes(draw.choice((b"a text\n", draw.randbytes(300), b"\xff\xfe\0", b"{}", b"[]", b"null", b"PK\3\4")))


def _folder(draw: random.Random, path: Path) -> None:
    path.unlink()
    path.mkdir()
    if draw.random() < 0.5:
        (path / "precious.txt").write_text(FOREIGN)


def _link(draw: random.Random, path: Path) -> None:
    elsewhere = next(folder for folder in path.parents if (folder / "elsewhere").is_dir()) / "elsewhere"
    target = draw.choice((elsewhere / "precious.txt", elsewhere, Path("nowhere"), Path(path.name), Path("/dev/null")))
    path.unlink()
    path.symlink_to(target)


def _removed(draw: random.Random, path: Path) -> None:
    path.unlink()


def hostile_value(draw: random.Random, value: Any) -> Any:
    """A value of a JSON file with something else in one place, or without one of its keys."""
    if isinstance(value, dict) and value and draw.random() < 0.8:
        key = draw.choice(sorted(value))
        if draw.random() < 0.1:
            return {name: one for name, one in value.items() if name != key}
        return {**value, key: hostile_value(draw, value[key])}
    if isinstance(value, list) and len(value) > 1 and draw.random() < 0.8:
        at = draw.randrange(len(value))
        return [*value[:at], hostile_value(draw, value[at]), *value[at + 1 :]]
    return draw.choice(HOSTILE)


def hostile_json(draw: random.Random, path: Path) -> None:
    """A JSON file with values of another kind, or with nesting without end."""
    try:
        text = json.dumps(hostile_value(draw, json.loads(path.read_bytes())))
    except ValueError:
        text = "a text\n"
    path.write_text(draw.choice(("[", '{"a":', '{"pid": [')) * 100_000 if draw.random() < 0.1 else text)


Damage = Callable[[random.Random, Path], None]
DAMAGES: tuple[Damage, ...] = (
    *(_bit, _bit, _bits, _truncate, _truncate, _zero, _zero, _append, _foreign_text, _folder, _link, _removed),
)
