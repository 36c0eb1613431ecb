"""A config as read: plain data, and for every key the place where it was written.

Plain data holds only what JSON has: dicts with text keys, lists, text, numbers, booleans and None.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

from topcli.errors import NAME_LENGTH, ConfigError, quoted, shortened

KeyPath = tuple[str | int, ...]

MAX_NODES = 5_000
MAX_DEPTH = 16
MAX_INTEGER_BITS = 1024
DOUBLE_DIGITS = 15
"""Every decimal text of at most this length is the shortest text of its double."""
HALF_PAIR = "the text holds half of a surrogate pair, which is no character"


class WrittenFloat(float):
    """A float together with its decimal text, which has more digits than a double holds."""

    text: str

    def __deepcopy__(self, memo: object) -> WrittenFloat:
        return self


def written_float(text: str) -> float:
    """Number of a decimal text; a ``WrittenFloat`` if a double does not hold all of its digits."""
    value = float(text)
    if len(text) <= DOUBLE_DIGITS or not math.isfinite(value) or Decimal(text) == Decimal(repr(value)):
        return value
    made = WrittenFloat(value)
    made.text = text
    return made


@dataclass
class Document:
    """Plain data with the place of its keys: ``file:line``, or the override that set them."""

    data: dict[str, Any]
    places: dict[KeyPath, str] = field(default_factory=dict)

    def place(self, path: KeyPath) -> str:
        """Place of ``path``, or of the section that holds it; empty for data without a file."""
        for length in range(len(path), -1, -1):
            found = self.places.get(path[:length])
            if found is not None:
                return found
        return ""


def key_text(path: KeyPath) -> str:
    """Return a path as a user writes it: ``initial.gamma``, with odd keys quoted and positions in brackets.

    >>> key_text(("output", "columns", 2))
    'output.columns[2]'
    """
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            simple = part.isprintable() and len(part) <= NAME_LENGTH
            text += ("." if text else "") + (part if simple else describe(part))
    return text


def describe(value: object) -> str:
    """Return a value as messages show it: short, on one line, and clear about its type.

    >>> describe("0.01"), describe(True), describe([1, 2])
    ("the text '0.01'", 'true', 'a list')
    """
    match value:
        case None:
            return "nothing"
        case bool():
            return "true" if value else "false"
        case str():
            return f"the text {quoted(value)}"
        case list():
            return "a list"
        case dict():
            return "a section"
        case _:
            return shortened(repr(value))


def has_half_pair(text: str) -> bool:
    """True if ``text`` holds half of a surrogate pair, which no encoding can write."""
    return not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text)


def plain(value: object, document: Document, path: KeyPath = ()) -> Any:
    """Return a copy of ``value`` as plain data; tuples and numpy's scalars and arrays become lists and numbers.

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
            return value if isinstance(value, WrittenFloat) else float(value)
        if isinstance(value, int):
            if value.bit_length() > MAX_INTEGER_BITS:
                raise refuse(path, f"an integer of more than {MAX_INTEGER_BITS} bits is too large")
            return int(value)
        raise refuse(path, f"must be a number, text, list or section, not a {type(value).__name__}")

    def _text(value: str, path: KeyPath) -> str:
        if has_half_pair(value):
            raise refuse(path, HALF_PAIR)
        return str.__str__(value)

    return copy(value, path)
