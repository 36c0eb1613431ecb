"""The everyday subset of YAML, line by line: sections by indentation, scalars, flat ``[...]`` and ``{...}``.

It accepts only what it reads exactly as a full YAML parser does (tested against one), and leaves the rest.
"""

from __future__ import annotations

import re
from typing import Any

from topcli.config.scalars import resolve_scalar

MAX_TEXT = 20_000
MAX_INDENT_LEVELS = 12

_KEY = r"[A-Za-z_][A-Za-z0-9_-]{0,60}"
SCALAR = r"[+-]?\.?[A-Za-z0-9][A-Za-z0-9._+-]*"
_LIST = rf"\[ *(?:{SCALAR}(?: *, *{SCALAR})*)? *\]"
_PAIR = rf"{_KEY}: +{SCALAR}"
_SECTION = rf"\{{ *(?:{_PAIR}(?: *, *{_PAIR})*)? *\}}"
_LINE = re.compile(rf"( *)({_KEY}):(?: +({SCALAR}|{_LIST}|{_SECTION}))? *(?: #.*)?")
_BLANK = re.compile(r" *(?:#.*)?")
_VALUE = re.compile(rf" *({SCALAR}|{_LIST}|{_SECTION}) *")

Path = tuple[str | int, ...]


class _BeyondError(Exception):
    """The text is beyond the subset."""


def parse_lines(text: str) -> tuple[dict[str, Any], dict[Path, int]] | None:
    """The data of ``text`` and the line of every key, or None when it needs a full YAML parser."""
    if len(text) > MAX_TEXT:
        return None
    try:
        return _sections(text)
    except _BeyondError:
        return None


def parse_flat(text: str) -> Any:
    """The value of a scalar or a flat list or section; raises ValueError when it needs a full YAML parser."""
    found = _VALUE.fullmatch(text)
    if not found or len(text) > MAX_TEXT:
        raise ValueError("needs a full YAML parser")
    try:
        return _value(found[1], (), 0, {})
    except _BeyondError:
        raise ValueError("needs a full YAML parser") from None


def _sections(text: str) -> tuple[dict[str, Any], dict[Path, int]]:
    data: dict[str, Any] = {}
    lines: dict[Path, int] = {}
    stack: list[tuple[int, dict[str, Any], Path]] = [(0, data, ())]
    empty: tuple[dict[str, Any], str] | None = None  # the last key when nothing follows it on its line
    for number, line in enumerate(text.split("\n"), 1):
        if not line.isprintable():
            raise _BeyondError
        if _BLANK.fullmatch(line):
            continue
        found = _LINE.fullmatch(line)
        if not found:
            raise _BeyondError
        indent = len(found[1])
        if indent > stack[-1][0] and empty and len(stack) < MAX_INDENT_LEVELS:
            section, key = empty
            section[key] = {}
            stack.append((indent, section[key], (*stack[-1][2], key)))
        while indent < stack[-1][0]:
            stack.pop()
        if indent != stack[-1][0]:
            raise _BeyondError
        _, section, path = stack[-1]
        key = _key(found[2], path, number, lines)
        section[key] = None if found[3] is None else _value(found[3], (*path, key), number, lines)
        empty = (section, key) if found[3] is None else None
    if not data:
        raise _BeyondError
    return data, lines


def _key(text: str, path: Path, number: int, lines: dict[Path, int]) -> str:
    if not isinstance(resolve_scalar(text), str) or (*path, text) in lines:
        raise _BeyondError
    lines[(*path, text)] = number
    return text


def _value(text: str, path: Path, number: int, lines: dict[Path, int]) -> Any:
    if text[0] not in "[{":
        return resolve_scalar(text)
    items = [item.strip() for item in text[1:-1].split(",")]
    if items == [""]:
        return [] if text[0] == "[" else {}
    if text[0] == "[":
        return [resolve_scalar(item) for item in items]
    pairs = [item.split(":") for item in items]
    return {_key(key, path, number, lines): resolve_scalar(value.strip()) for key, value in pairs}
