"""TOML text to plain data with the line of every key."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from topcli.config.document import MAX_DEPTH, KeyPath, written_float
from topcli.errors import ConfigError

_WHERE = re.compile(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", re.DOTALL)
_KEY_PART = re.compile(r"""[ \t]*(?:"((?:[^"\\\n]|\\.)*)"|'([^'\n]*)'|([A-Za-z0-9_-]+))[ \t]*(\.?)""")
_PART = r"""(?:[A-Za-z0-9_-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![A-Za-z0-9_-])(?:{_PART}[ \t]*+\.[ \t]*+){{{MAX_DEPTH}}}")
_TOKEN = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}'
    r"|'''.*?'{3,5}"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'"
    r"|#[^\n]*|[\[\]{}\n]",
    re.DOTALL,
)


def parse_toml(text: str, label: str) -> tuple[dict[str, Any], dict[KeyPath, int]]:
    """Return the data of a TOML text and the line of every key outside inline tables.

    Raises ConfigError with ``label:line:column``.
    """
    if found := _DEEP_KEY.search(text):  # tomllib's time and memory grow with the square of a key's parts
        number = text.count("\n", 0, found.start()) + 1
        raise ConfigError(f"{label}:{number}: TOML: a key of more than {MAX_DEPTH} parts")
    try:
        data = tomllib.loads(text, parse_float=lambda number: written_float(number.replace("_", "")))
    except tomllib.TOMLDecodeError as error:
        message = " ".join(str(error).split())
        found = _WHERE.fullmatch(message)
        where = label
        if found:
            message = found[1]
            where += f":{found[2]}:{found[3]}" if found[2] else f":{text.rstrip().count(chr(10)) + 1}"
        if "overwrite" in message:
            message += "; is a key given twice?"
        raise ConfigError(f"{where}: TOML: {message}") from None
    except RecursionError:
        raise ConfigError(f"{label}: TOML: nested too deeply") from None
    except ValueError:  # from int(), which takes no more than 4300 digits
        raise ConfigError(f"{label}: TOML: a number has too many digits") from None
    return data, key_lines(text)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Return the line on which each key or table header of a valid TOML text first appears."""
    lines: dict[KeyPath, int] = {}
    table: KeyPath = ()
    position, number = 0, 1
    while position < len(text):
        while position < len(text) and text[position] in " \t":
            position += 1
        header = text[position : position + 1] == "["
        opening = 2 if text.startswith("[[", position) else int(header)
        keys, position = _dotted_key(text, position + opening)
        if header:
            table = keys
        if keys:
            path = keys if header else (*table, *keys)
            for length in range(1, len(path) + 1):
                lines.setdefault(path[:length], number)
        depth = opening
        for token in _TOKEN.finditer(text, position):
            position = token.end()
            depth += token[0] in ("[", "{")
            depth -= token[0] in ("]", "}")
            number += token[0].count("\n")
            if token[0] == "\n" and depth <= 0:
                break
        else:
            break
    return lines


def _dotted_key(text: str, position: int) -> tuple[KeyPath, int]:
    """Return the parts of the key at ``position`` and its end; no parts for a blank line or a comment."""
    parts: list[str] = []
    while found := _KEY_PART.match(text, position):
        parts.append(next(part for part in found.groups()[:3] if part is not None))
        position = found.end()
        if not found[4] or len(parts) > 32:
            break
    return tuple(parts), position
