"""YAML and TOML text as plain data with the line of every key, and plain data as YAML text.

Reading YAML follows the core schema of YAML 1.2: ``1e-3`` is a number, ``no`` is text.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any, NoReturn

from topcli.errors import ConfigError, quoted

KeyPath = tuple[str | int, ...]
Lines = dict[KeyPath, int]

MAX_NODES = 5_000
MAX_DEPTH = 16
DOUBLE_DIGITS = 15
"""Every decimal text of at most this length is the shortest text of its double."""
HALF_PAIR = "the text holds half of a surrogate pair, which is not a character"


class WrittenFloat(float):
    """A float together with its decimal text, which has more digits than a double holds."""

    text: str


def written_float(text: str) -> float:
    """Number of a decimal text; a ``WrittenFloat`` if a double does not hold all of its digits."""
    value = float(text)
    if len(text) <= DOUBLE_DIGITS or not math.isfinite(value) or Decimal(text) == Decimal(repr(value)):
        return value
    number = WrittenFloat(value)
    number.text = text
    return number


def has_half_pair(text: str) -> bool:
    """True if ``text`` holds half of a surrogate pair, which no encoding can write."""
    return not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text)


_WORDS: dict[str, bool | None] = {
    "": None,
    "~": None,
    **dict.fromkeys(("null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_OTHER_BASE = re.compile(r"0o[0-7]{1,300}|0x[0-9a-fA-F]{1,250}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_LONGEST_INTEGER = 300


def resolve_scalar(text: str) -> str | int | float | bool | None:
    """Return the value of an unquoted scalar; whole numbers of more than 300 digits become floats.

    >>> resolve_scalar("1e-3"), resolve_scalar("no"), resolve_scalar("0x1f"), resolve_scalar("-auto")
    (0.001, 'no', 31, '-auto')
    """
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) <= _LONGEST_INTEGER else float(text)
    if _FLOAT.fullmatch(text):
        return written_float(text)
    if _OTHER_BASE.fullmatch(text):
        return int(text, 0)
    return float(text.replace(".", "")) if _NOT_FINITE.fullmatch(text) else text


def parse_yaml(text: str, label: str) -> tuple[Any, Lines]:
    """Return the plain data of a YAML text and the line of every key; ``label`` names the text in messages.

    An empty text gives None; nothing in the data is shared. Raises ConfigError with ``label:line:column``.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError
    from ruamel.yaml.reader import ReaderError

    try:
        root = YAML(typ="safe", pure=True).compose(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{label}:{mark.line + 1}:{mark.column + 1}" if mark else label
        problem = " ".join(str(error.problem or error.context).split())
        problem = f"{error.context} {problem}" if problem.startswith("but ") else problem
        hint = "; indent with spaces, not tabs" if "'\\t'" in problem else ""
        raise ConfigError(f"{where}: YAML: {problem}{hint}") from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        code = error.character if isinstance(error.character, int) else ord(error.character)
        raise ConfigError(f"{label}:{line}: YAML: the character U+{code:04X} is not allowed") from None
    except Exception as error:  # the parser meets arbitrary text, and some of it trips its own code
        reason = " ".join(f"{type(error).__name__} {error}".split())[:80]
        raise ConfigError(f"{label}: cannot be read as YAML ({reason}); check its syntax") from None
    reader = _Reader(label)
    return (None if root is None else reader.value(root, ())), reader.lines


_TAG = "tag:yaml.org,2002:"
_KINDS = ("null", "bool", "int", "float", "str", "timestamp", "value", "seq", "map")


@dataclass
class _Reader:
    """Plain data of nodes; the value of an anchor is built again for every alias."""

    label: str
    lines: Lines = field(default_factory=dict)
    count: int = 0

    def refuse(self, node: Any, text: str) -> NoReturn:
        mark = node.start_mark
        raise ConfigError(f"{self.label}:{mark.line + 1}:{mark.column + 1}: {text}")

    def value(self, node: Any, path: KeyPath) -> Any:
        """Return the value of ``node`` at ``path``."""
        self.count += 1
        if self.count > MAX_NODES or len(path) > MAX_DEPTH:  # also of an alias inside its own anchor
            self.refuse(node, f"more than {MAX_NODES} values, or nested deeper than {MAX_DEPTH} levels")
        kind = str(node.tag).removeprefix(_TAG)
        if kind not in _KINDS:
            self.refuse(node, f"YAML: tags such as {quoted(kind)} are not allowed; write the plain value")
        if isinstance(node.value, str):
            value = node.value if node.style or kind == "str" else resolve_scalar(node.value)
            if isinstance(value, str) and has_half_pair(value):
                self.refuse(node, ": ".join(filter(None, (_dotted(path), HALF_PAIR))))
            return value
        if kind == "seq":
            return [self.value(item, (*path, i)) for i, item in enumerate(node.value)]
        section: dict[str, Any] = {}
        for name, item in node.value:
            key = self.value(name, path) if isinstance(name.value, str) else None
            if not isinstance(key, str):
                self.refuse(name, "keys are names; a number or a word such as null needs quotes")
            inside = (*path, key)
            if key in section:
                first = f"first on line {self.lines[inside]}"
                self.refuse(name, f"{_dotted(inside)}: the key is given twice, {first}; keep one")
            self.lines[inside] = name.start_mark.line + 1
            section[key] = self.value(item, inside)
        return section


def _dotted(path: KeyPath) -> str:
    return ".".join(map(str, path))


_UNQUOTED = re.compile(r"[+-]?\.?[A-Za-z0-9][A-Za-z0-9._+-]*")


def to_yaml(data: dict[str, Any]) -> str:
    """Return ``data`` as YAML: sections by indentation, the values inside them on one line each.

    Floats read back bit for bit. ruamel.yaml's own dump writes the same values, but takes 2 to 3 ms of each run instead
    of 0.1 ms.
    """
    lines = []
    for key, value in data.items():
        if isinstance(value, dict) and value:
            lines.append(f"{_flow(key)}:")
            lines += [f"  {_flow(inner)}: {_flow(item)}" for inner, item in value.items()]
        else:
            lines.append(f"{_flow(key)}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    """Return ``value`` on one line: as JSON, with the words that need no quotes without them."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_flow(key)}: {_flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, str) and _UNQUOTED.fullmatch(value) and isinstance(resolve_scalar(value), str):
        return value
    text = json.dumps(value, ensure_ascii=False)  # in YAML, letters that cannot be printed need escapes as well
    return "".join(letter if letter.isprintable() else f"\\U{ord(letter):08x}" for letter in text)


_WHERE = re.compile(r"(.*) \(at (?:line (\d+), column (\d+)|end of document)\)", re.DOTALL)
_HEADER = re.compile(r"""\s*\[+([\w.\s"'-]+)\]+""")
_KEY = re.compile(r"""\s*([\w.\s"'-]+?)\s*=""")
_PART = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")


def parse_toml(text: str, label: str) -> tuple[dict[str, Any], Lines]:
    """Return the data of a TOML text and the line of every key outside inline tables.

    Raises ConfigError with ``label:line:column``.
    """
    import tomllib

    try:
        data = tomllib.loads(text, parse_float=lambda number: written_float(number.replace("_", "")))
    except (ValueError, RecursionError) as error:  # also of an integer of too many digits
        message, where = " ".join(str(error).split()), label
        if match := _WHERE.fullmatch(message):
            message = match[1]
            where += f":{match[2]}:{match[3]}" if match[2] else f":{text.rstrip().count(chr(10)) + 1}"
        hint = "; is a key given twice?" if "overwrite" in message else ""
        raise ConfigError(f"{where}: TOML: {message}{hint}") from None
    lines: Lines = {}
    table: KeyPath = ()
    for number, line in enumerate(text.split("\n"), 1):
        header = _HEADER.match(line)
        if match := header or _KEY.match(line):
            keys = tuple(part.strip("\"'") for part in _PART.findall(match[1])[:MAX_DEPTH])
            path = keys if header else (*table, *keys)
            if not _holds(data, path):  # a row of a list, or text of several lines
                continue
            table = keys if header else table
            for length in range(1, len(path) + 1):
                lines.setdefault(path[:length], number)
    return data, lines


def _holds(data: Any, path: KeyPath) -> bool:
    """True if ``path`` leads to a value; of a list of tables, to one in the last table."""
    for key in path:
        data = data[-1] if isinstance(data, list) and data else data
        if not isinstance(data, dict) or key not in data:
            return False
        data = data[key]
    return True
