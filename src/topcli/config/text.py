"""YAML and TOML text as plain data with the line of every key, and plain data as YAML text.

Reading YAML follows the core schema of YAML 1.2: ``1e-3`` is a number, ``no`` is text.
"""

from __future__ import annotations

import json
import math
import re
from decimal import Decimal
from typing import Any

from topcli.errors import ConfigError, quoted

KeyPath = tuple[str | int, ...]
Lines = dict[KeyPath, int]

LONGEST_INTEGER = 300
"""Digits of the longest integer; longer ones become floats."""


class WrittenFloat(float):
    """A float together with its decimal text, which has more digits than a double holds."""

    text: str


def written_float(text: str) -> float:
    """Number of a decimal text; a ``WrittenFloat`` if a double does not hold all of its digits."""
    value = float(text)
    if math.isinf(value) or Decimal(text) == Decimal(repr(value)):
        return value
    number = WrittenFloat(value)
    number.text = text
    return number


_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}
_NOT_FINITE = {".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf, ".nan": math.nan}
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]{1,4})?")


def resolve_scalar(text: str) -> str | int | float | bool | None:
    """Return the value of an unquoted scalar; whole numbers of more than 300 digits become floats.

    >>> resolve_scalar("1e-3"), resolve_scalar("no"), resolve_scalar("007"), resolve_scalar("-auto")
    (0.001, 'no', 7, '-auto')
    """
    if (word := text.lower()) in _WORDS:
        return _WORDS[word]
    if not _NUMBER.fullmatch(text):
        return _NOT_FINITE.get(word, text)
    whole = text.lstrip("+-").isdigit() and len(text) <= LONGEST_INTEGER
    return int(text) if whole else written_float(text)


def parse_yaml(text: str, label: str) -> tuple[Any, Lines]:
    """Return the plain data of a YAML text and the line of every value; ``label`` names the text in messages.

    An empty text gives None; nothing in the data is shared. Raises ConfigError with ``label:line:column``.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError

    lines: Lines = {}
    try:
        root = YAML(typ="safe", pure=True).compose(text)
        return (None if root is None else _data(root, (), lines, label)), lines
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{label}:{mark.line + 1}:{mark.column + 1}" if mark else label
        problem = " ".join(str(error.problem or error.context).split())
        hint = "; indent with spaces, not tabs" if "'\\t'" in problem else ""
        raise ConfigError(f"{where}: YAML: {problem}{hint}") from None
    except ConfigError:
        raise
    except Exception as error:  # the parser meets arbitrary text, and some of it trips its own code
        raise ConfigError(f"{label}: YAML: cannot be read: {str(error).partition(chr(10))[0][:80]}") from None


_TAG = "tag:yaml.org,2002:"
_KINDS = ("null", "bool", "int", "float", "str", "timestamp", "value", "seq", "map")


def _data(node: Any, path: KeyPath, lines: Lines, label: str) -> Any:
    """Return the plain data of a node at ``path``; the value of an anchor is built again for every alias."""

    def refused(part: Any, text: str) -> ConfigError:
        return ConfigError(f"{label}:{part.start_mark.line + 1}:{part.start_mark.column + 1}: {text}")

    lines.setdefault(path, node.start_mark.line + 1)
    if (kind := str(node.tag).removeprefix(_TAG)) not in _KINDS:
        raise refused(node, f"YAML: tags such as {quoted(kind)} are not allowed; write the plain value")
    if node.id == "scalar":
        return node.value if node.style or kind == "str" else resolve_scalar(node.value)
    if node.id == "sequence":
        return [_data(item, (*path, i), lines, label) for i, item in enumerate(node.value)]

    # a section: the place of a value is that of its key
    section: dict[str, Any] = {}
    for name, item in node.value:
        key = _data(name, path, lines, label)
        if not isinstance(key, str):
            raise refused(name, "keys are names; a number or a word such as null needs quotes")
        inside = (*path, key)
        if key in section:
            full = ".".join(map(str, inside))
            raise refused(name, f"{full}: the key is given twice, first on line {lines[inside]}; keep one")
        lines[inside] = name.start_mark.line + 1
        section[key] = _data(item, inside, lines, label)
    return section


_UNQUOTED = re.compile(r"[+-]?[A-Za-z][A-Za-z0-9._+-]*")


def to_yaml(data: dict[str, Any]) -> str:
    """Return ``data`` as YAML: sections by indentation, the values inside them on one line each.

    Floats read back bit for bit. ruamel.yaml's own dump writes the same values, but takes 2 to 3 ms of each run instead
    of 0.1 ms.
    """
    lines = []
    for key, value in data.items():
        section = value if isinstance(value, dict) else {}
        lines.append(f"{_flow(key)}:" if section else f"{_flow(key)}: {_flow(value)}")
        lines += [f"  {_flow(inner)}: {_flow(item)}" for inner, item in section.items()]
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    """Return ``value`` on one line: as JSON, with the words that need no quotes without them."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str) and _UNQUOTED.fullmatch(value) and value.lower() not in _WORDS:
        return value
    text = json.dumps(value, ensure_ascii=False)  # in YAML, letters that cannot be printed need escapes as well
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08x}" for letter in text)


_POSITION = re.compile(r"line (\d+), column (\d+)")
_TABLE = re.compile(r"\s*\[+([^\[\]=]+)\]")
_ENTRY = re.compile(r"""\s*([\w.\s"'-]+?)\s*=""")


def parse_toml(text: str, label: str) -> tuple[dict[str, Any], Lines]:
    """Return the data of a TOML text and the line of every key outside inline tables.

    Raises ConfigError with ``label:line:column``.
    """
    import tomllib

    try:
        data = tomllib.loads(text, parse_float=lambda number: resolve_scalar(number.replace("_", "")))
    except (ValueError, RecursionError) as error:  # also of an integer of too many digits
        position = _POSITION.search(str(error))
        where = f"{label}:{position[1]}:{position[2]}" if position else label
        raise ConfigError(f"{where}: TOML: {str(error).partition(' (at ')[0]}") from None
    lines: Lines = {(): 1}
    table: KeyPath = ()
    for number, line in enumerate(text.split("\n"), 1):
        header = _TABLE.match(line)
        if match := header or _ENTRY.match(line):
            keys = tuple(part.strip(" \t\"'") for part in match[1].split("."))
            table = keys if header else table
            path = keys if header else (*table, *keys)
            for length in range(1, len(path) + 1):
                lines.setdefault(path[:length], number)
    return data, lines
