"""YAML and TOML text as plain data with the line of every key, and plain data as YAML text.

Reading YAML follows the core schema of YAML 1.2: ``1e-3`` is a number, ``no`` is text. The text goes through
ruamel.yaml's events once, so that nothing is built before it is checked: no tags, no duplicate keys, no merge keys,
bounded depth and size.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NoReturn

from topcli.config.document import (
    HALF_PAIR,
    MAX_DEPTH,
    MAX_NODES,
    KeyPath,
    describe,
    has_half_pair,
    key_text,
    written_float,
)
from topcli.errors import NAME_LENGTH, ConfigError, quoted, shortened

Lines = dict[KeyPath, int]

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
_INFINITE = re.compile(r"[-+]?\.(inf|Inf|INF)")
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
    if _INFINITE.fullmatch(text):
        return float(text.replace(".", ""))
    if text in (".nan", ".NaN", ".NAN"):
        return float("nan")
    return text


def parse_yaml(text: str, label: str) -> tuple[Any, Lines]:
    """Return the plain data of a YAML text and the line of every key; ``label`` names the text in messages.

    An empty text gives None; nothing in the data is shared. Raises ConfigError with ``label:line:column``.
    """
    builder = _Builder(label, _events(text, label))
    return builder.document(), builder.lines


@cache
def _scanner() -> type:
    """Scanner of ruamel.yaml that refuses tags at once, because decoding one takes quadratic time."""
    from ruamel.yaml.scanner import Scanner, ScannerError

    class Tagless(Scanner):
        def scan_tag(self) -> Any:
            tag = ""
            while len(tag) <= NAME_LENGTH and (letter := self.reader.peek(len(tag))) not in "\0 \t\r\n":
                tag += letter
            problem = f"tags such as {quoted(tag)} are not allowed; write the plain value"
            raise ScannerError(None, None, problem, self.reader.get_mark())

    return Tagless


def _events(text: str, label: str) -> Iterator[Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError
    from ruamel.yaml.reader import ReaderError

    parser = YAML(typ="safe", pure=True)
    parser.Scanner = _scanner()
    events = parser.parse(text)
    while True:
        try:
            event = next(events)
        except StopIteration:
            return
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            where = f"{label}:{mark.line + 1}:{mark.column + 1}" if mark else label
            problem = " ".join(str(error.problem or error.context or "wrong syntax").split())
            if "'\\t'" in problem:
                problem += "; indent with spaces, not tabs"
            raise ConfigError(f"{where}: YAML: {problem}") from None
        except ReaderError as error:
            line = text.count("\n", 0, error.position) + 1
            code = error.character if isinstance(error.character, int) else ord(error.character)
            raise ConfigError(f"{label}:{line}: YAML: the character U+{code:04X} is not allowed") from None
        except Exception as error:  # the parser meets arbitrary text, and some of it trips its own code
            reason = " ".join(f"{type(error).__name__} {error}".split())[:80]
            raise ConfigError(f"{label}: cannot be read as YAML ({reason}); check its syntax") from None
        yield event


@dataclass
class _Anchor:
    """An anchored value, with the size and height that each alias adds; ``ready`` once complete."""

    value: Any = None
    nodes: int = 0
    height: int = 0
    ready: bool = False


@dataclass
class _Builder:
    label: str
    events: Iterator[Any]
    lines: Lines = field(default_factory=dict)
    anchors: dict[str, _Anchor] = field(default_factory=dict)
    nodes: int = 0
    deepest: int = 0

    def refuse(self, event: Any, text: str) -> NoReturn:
        mark = event.start_mark
        raise ConfigError(f"{self.label}:{mark.line + 1}:{mark.column + 1}: {text}")

    def document(self) -> Any:
        """Return the value of the only document; None if there is none."""
        self._next("StreamStart")
        event = next(self.events)
        if _kind(event) == "StreamEnd":
            return None
        value = self.node(next(self.events), ())
        self._next("DocumentEnd")
        event = next(self.events)
        if _kind(event) != "StreamEnd":
            self.refuse(event, "a second document starts here; a config is one document")
        return value

    def _next(self, kind: str) -> None:
        event = next(self.events)
        if _kind(event) != kind:
            self.refuse(event, f"YAML: unexpected {_kind(event)}")

    def node(self, event: Any, path: KeyPath) -> Any:
        """Return the value that starts with ``event``."""
        self.count(event, 1, len(path))
        kind = _kind(event)
        if kind == "Alias":
            return self.alias(event, path)
        anchor = None
        if event.anchor is not None:
            anchor = self.anchors[event.anchor] = _Anchor()
        nodes, outer, self.deepest = self.nodes, self.deepest, len(path)
        match kind:
            case "Scalar":
                value = resolve_scalar(event.value) if event.implicit[0] else event.value
                if isinstance(value, str) and has_half_pair(value):
                    self.refuse(event, ": ".join(part for part in (key_text(path), HALF_PAIR) if part))
            case "SequenceStart":
                value = self.sequence(path)
            case _:
                value = self.mapping(path)
        if anchor:
            anchor.value, anchor.ready = value, True
            anchor.nodes, anchor.height = self.nodes - nodes + 1, self.deepest - len(path)
        self.deepest = max(outer, self.deepest)
        return value

    def count(self, event: Any, nodes: int, depth: int) -> None:
        """Bound the size and depth of the data built, with aliases expanded."""
        self.nodes += nodes
        self.deepest = max(self.deepest, depth)
        if self.nodes > MAX_NODES:
            self.refuse(event, f"more than {MAX_NODES} values (aliases expanded), which is too many for a config")
        if depth > MAX_DEPTH:
            self.refuse(event, f"nested deeper than {MAX_DEPTH} levels")

    def alias(self, event: Any, path: KeyPath) -> Any:
        anchor, name = self.anchors.get(event.anchor), shortened(event.anchor)
        if anchor is None:
            self.refuse(event, f"alias *{name}: no anchor &{name} comes before it")
        if not anchor.ready:
            self.refuse(event, f"alias *{name} is inside its own anchor; write the value out")
        self.count(event, anchor.nodes, len(path) + anchor.height)
        return deepcopy(anchor.value)  # an override may change one of the places

    def sequence(self, path: KeyPath) -> list[Any]:
        items: list[Any] = []
        while _kind(event := next(self.events)) != "SequenceEnd":
            items.append(self.node(event, (*path, len(items))))
        return items

    def mapping(self, path: KeyPath) -> dict[str, Any]:
        section: dict[str, Any] = {}
        while _kind(event := next(self.events)) != "MappingEnd":
            key = self.key(event, path)
            inside = (*path, key)
            if key in section:
                first = f"line {self.lines[inside]}"
                self.refuse(event, f"{key_text(inside)}: the key is given twice, first on {first}; keep one")
            self.lines[inside] = event.start_mark.line + 1
            section[key] = self.node(next(self.events), inside)
        return section

    def key(self, event: Any, path: KeyPath) -> str:
        kind = _kind(event)
        if kind not in ("Scalar", "Alias"):
            self.refuse(event, "keys are names, not lists or sections")
        if kind == "Scalar" and event.implicit[0] and event.value == "<<":
            self.refuse(event, "merge keys (<<) are not allowed; write the keys out")
        key = self.node(event, path)
        if not isinstance(key, str):
            self.refuse(event, f"keys are names, not {describe(key)}")
        return key


def _kind(event: Any) -> str:
    return type(event).__name__.removesuffix("Event")


_UNQUOTED = re.compile(r"[+-]?\.?[A-Za-z0-9][A-Za-z0-9._+-]*")


def to_yaml(data: dict[str, Any]) -> str:
    """Return ``data`` as YAML: sections by indentation, the values inside them on one line each.

    Floats read back bit for bit. ruamel.yaml's own dump writes the same values, but takes 2 to 3 ms of each run instead
    of 0.1 ms, and ``flow``, which the commented starter config needs for single values, would remain.
    """
    lines = []
    for key, value in data.items():
        if isinstance(value, dict) and value:
            lines.append(f"{_scalar(key)}:")
            lines += [f"  {_scalar(inner)}: {flow(item)}" for inner, item in value.items()]
        else:
            lines.append(f"{_scalar(key)}: {flow(value)}")
    return "\n".join(lines) + "\n"


def flow(value: Any) -> str:
    """Return ``value`` on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_scalar(key)}: {flow(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(flow(item) for item in value) + "]"
    return _scalar(value)


def _scalar(value: str | float | bool | None) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case str():
            is_text = _UNQUOTED.fullmatch(value) and isinstance(resolve_scalar(value), str)
            return value if is_text else '"' + "".join(map(_escaped, value)) + '"'
        case _:
            return float.__repr__(value) if isinstance(value, float) else repr(value)


def _escaped(letter: str) -> str:
    if letter in '"\\':
        return "\\" + letter
    return letter if letter.isprintable() else f"\\U{ord(letter):08x}"


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
    import tomllib

    if deep := _DEEP_KEY.search(text):  # tomllib's time and memory grow with the square of a key's parts
        number = text.count("\n", 0, deep.start()) + 1
        raise ConfigError(f"{label}:{number}: TOML: a key of more than {MAX_DEPTH} parts")
    try:
        data = tomllib.loads(text, parse_float=lambda number: written_float(number.replace("_", "")))
    except tomllib.TOMLDecodeError as error:
        message = " ".join(str(error).split())
        match = _WHERE.fullmatch(message)
        where = label
        if match:
            message = match[1]
            where += f":{match[2]}:{match[3]}" if match[2] else f":{text.rstrip().count(chr(10)) + 1}"
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
    while match := _KEY_PART.match(text, position):
        parts.append(next(part for part in match.groups()[:3] if part is not None))
        position = match.end()
        if not match[4] or len(parts) > 32:
            break
    return tuple(parts), position
