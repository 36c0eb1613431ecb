"""A config as read: plain data, and for every key the place where it was written.

Plain data is what JSON knows: dicts with text keys, lists, text, numbers, booleans and None.
"""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from topcli.errors import ConfigError

KeyPath = tuple[str | int, ...]

MAX_BYTES = 1_000_000
MAX_NODES = 5_000
MAX_DEPTH = 16
MAX_INTEGER_BITS = 1024
SUFFIXES = (".yaml", ".yml", ".toml")


@dataclass
class Document:
    """Plain data with the place of its keys: ``file:line``, or the override that set them."""

    data: dict[str, Any]
    places: dict[KeyPath, str] = field(default_factory=dict)

    def place(self, path: KeyPath) -> str:
        """Where ``path``, or the section that holds it, was written; empty for data without a file."""
        for length in range(len(path), -1, -1):
            found = self.places.get(path[:length])
            if found is not None:
                return found
        return ""


def key_text(path: KeyPath) -> str:
    """A path as a user writes it: ``initial.gamma``, with odd keys quoted and positions in brackets.

    >>> key_text(("output", "columns", 2))
    'output.columns[2]'
    """
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            simple = part.isprintable() and len(part) <= 60
            text += ("." if text else "") + (part if simple else describe(part))
    return text


def describe(value: object) -> str:
    """A value in a message: short, on one line, and clear about its type.

    >>> describe("0.01"), describe(True), describe([1, 2])
    ("the text '0.01'", 'true', 'a list')
    """
    match value:
        case None:
            return "nothing"
        case bool():
            return "true" if value else "false"
        case str():
            return "the text " + (repr(value) if len(value) <= 60 else repr(value[:57]) + "...")
        case list():
            return "a list"
        case dict():
            return "a section"
        case _:
            text = repr(value)
            return text if len(text) <= 60 else text[:57] + "..."


def plain(value: object, document: Document, path: KeyPath = ()) -> Any:
    """A copy of ``value`` as plain data; tuples and numpy's scalars and arrays become lists and numbers.

    Raises ConfigError naming the key of anything else (dates, objects, keys that are not text, integers
    beyond 1024 bits) and of data nested deeper than 16 levels or of more than 5000 values.
    """
    count = 0

    def refuse(path: KeyPath, text: str) -> ConfigError:
        parts = (document.place(path), key_text(path), text)
        return ConfigError(": ".join(part for part in parts if part))

    def copy(value: Any, path: KeyPath) -> Any:
        nonlocal count
        count += 1
        if count > MAX_NODES:
            raise refuse((), f"more than {MAX_NODES} values; a config is small")
        if len(path) > MAX_DEPTH:
            raise refuse(path[:1], f"nested deeper than {MAX_DEPTH} levels")
        if not isinstance(value, (str, int, float, list, tuple, Mapping)) and hasattr(value, "tolist"):
            value = value.tolist()
        if isinstance(value, Mapping):
            for key in value:
                if not isinstance(key, str):
                    raise refuse(path, f"keys are names, not {describe(key)}")
            return {_text(key, path): copy(item, (*path, key)) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [copy(item, (*path, index)) for index, item in enumerate(value)]
        if isinstance(value, str):
            return _text(value, path)
        if value is None or isinstance(value, bool):
            return value
        if isinstance(value, float):
            return float(value)
        if isinstance(value, int):
            if value.bit_length() > MAX_INTEGER_BITS:
                raise refuse(path, f"an integer of more than {MAX_INTEGER_BITS} bits is too large")
            return int(value)
        raise refuse(path, f"must be a number, text, list or section, not a {type(value).__name__}")

    def _text(value: str, path: KeyPath) -> str:
        if not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
            raise refuse(path, "the text holds half of a surrogate pair, which is no character")
        return str.__str__(value)

    return copy(value, path)


def read_text(path: Path) -> str:
    """The text of a config file, with line ends as ``\\n`` and without a byte-order mark.

    Raises ConfigError for a missing file (with the nearest names beside it), a folder, a special, unreadable
    or too large file, and for bytes that are not UTF-8 text.
    """
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise ConfigError(f"{path}: is a folder; give a config file (.yaml, .yml or .toml)")
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"{path}: is not a regular file; give a config file (.yaml, .yml or .toml)")
        if status.st_size > MAX_BYTES:
            raise ConfigError(f"{path}: {status.st_size} bytes; a config is at most {MAX_BYTES}")
        content = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file{_files_nearby(path)}") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise ConfigError(f"{str(path)!r}: cannot be read: {reason}") from None
    if b"\0" in content:
        raise ConfigError(f"{path}: is a binary file; a config is UTF-8 text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{path}:{line}: is not UTF-8 text (byte 0x{content[error.start]:02x}); a config is UTF-8 text"
        ) from None
    return text.replace("\r\n", "\n")


def _files_nearby(path: Path) -> str:
    """Half a sentence on the configs that lie where ``path`` was sought; empty when there are none."""
    try:
        names = sorted(entry for entry in os.listdir(path.parent) if entry.endswith(SUFFIXES))
    except (OSError, ValueError):
        return f"; nor is there a folder {path.parent}"
    # by their stems, because the common ending makes any two names look alike
    stems = {Path(name).stem: name for name in names}
    close = [stems[stem] for stem in difflib.get_close_matches(path.stem, stems, n=2)]
    if close:
        return f"; did you mean {' or '.join(map(repr, close))}?"
    return f"; there are {', '.join(names[:5])}{', ...' if len(names) > 5 else ''}" if names else ""


def read_document(path: Path) -> Document:
    """Read a YAML or TOML config file.

    Raises ConfigError with ``file:line:column`` for wrong syntax, and as ``read_text`` does.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ConfigError(f"{path}: not a config; the name of a config ends in .yaml, .yml or .toml")
    text = read_text(path)
    if suffix == ".toml":
        from topcli.config.toml_text import parse_toml as parse
    else:
        from topcli.config.yaml_text import parse_yaml as parse
    data, lines = parse(text, str(path))
    if data is None or data == {}:
        raise ConfigError(f"{path}: is empty; `topcli init` writes a config to start from")
    places: dict[KeyPath, str] = {key: f"{path}:{line}" for key, line in lines.items()}
    if not isinstance(data, dict):
        raise ConfigError(f"{path}:1: a config is a list of `key: value` lines, not {describe(data)}")
    places.setdefault((), f"{path}:{min(lines.values(), default=1)}")
    document = Document(data, places)
    document.data = plain(data, document)
    return document
