"""Config as read from a file: plain data with the line of every key, and the mistakes in it.

Plain data holds only what JSON has: dicts with text keys, lists, text, numbers, booleans and None. Mistakes are
gathered, so that several are reported at once, each with its place and key.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cache
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import to_json

from topcli.errors import NAME_LENGTH, ConfigError, UnknownNameError, UsageError, nearest, quoted, shortened

KeyPath = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)

STRICT = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, protected_namespaces=())
"""Models of sections: no other keys, no conversions between types, finite numbers."""
SHOWN_PROBLEMS = 3
"""Mistakes that one message shows."""

MAX_NODES = 5_000
MAX_DEPTH = 16
MAX_INTEGER_BITS = 1024
DOUBLE_DIGITS = 15
"""Every decimal text of at most this length is the shortest text of its double."""
HALF_PAIR = "the text holds half of a surrogate pair, which is not a character"


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
        sections = (path[:length] for length in range(len(path), -1, -1))
        return next((self.places[section] for section in sections if section in self.places), "")

    def message(self, path: KeyPath, text: str) -> str:
        """Return ``text`` after the place and the key of ``path``."""
        return ": ".join(part for part in (self.place(path), key_text(path), text) if part)


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
            return "an empty value"
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


def number_of(value: object) -> float | None:
    """Return ``value`` as a float, infinite if too large for one; None if it is not a number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf


def as_integer(value: Any) -> Any:
    """Return a whole number written as a float, such as 5e4, as an integer, and any other value as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def has_half_pair(text: str) -> bool:
    """True if ``text`` holds half of a surrogate pair, which no encoding can write."""
    return not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text)


def plain(value: object, document: Document, path: KeyPath = ()) -> Any:
    """Return a copy of ``value`` as plain data; tuples and numpy's scalars and arrays become lists and numbers.

    Raises ConfigError naming the key of anything else (dates, objects, keys that are not text, integers
    beyond 1024 bits) and of data nested deeper than 16 levels or of more than 5000 values.
    """
    count = 0

    def copy(value: Any, path: KeyPath) -> Any:
        nonlocal count
        made: Any = None
        count += 1
        if count > MAX_NODES:
            raise ConfigError(document.message((), f"more than {MAX_NODES} values, which is too many for a config"))
        if len(path) > MAX_DEPTH:
            raise ConfigError(document.message(path[:1], f"nested deeper than {MAX_DEPTH} levels"))
        if hasattr(value, "tolist"):
            value = value.tolist()
        match value:
            case None | bool() | WrittenFloat():
                return value
            case Mapping():
                return {key_of(key, path): copy(item, (*path, key)) for key, item in value.items()}
            case list() | tuple():
                return [copy(item, (*path, index)) for index, item in enumerate(value)]
            case str():
                fault = HALF_PAIR if has_half_pair(value) else ""
                made = str.__str__(value)
            case float():
                return float(value)
            case int():
                too_large = value.bit_length() > MAX_INTEGER_BITS
                fault = f"an integer of more than {MAX_INTEGER_BITS} bits is too large" if too_large else ""
                made = int(value)
            case _:
                fault = f"must be a number, text, list or section, not a {type(value).__name__}"
        if fault:
            raise ConfigError(document.message(path, fault))
        return made

    def key_of(key: object, path: KeyPath) -> str:
        if not isinstance(key, str) or has_half_pair(key):
            fault = HALF_PAIR if isinstance(key, str) else f"keys are names, not {describe(key)}"
            raise ConfigError(document.message(path, fault))
        return str.__str__(key)

    return copy(value, path)


@dataclass
class Problems:
    """The mistakes found in one document."""

    document: Document
    messages: list[str] = field(default_factory=list)
    unknown_names: int = 0

    def add(self, path: KeyPath, text: str, *, unknown_name: bool = False) -> None:
        """Add a mistake at ``path``; ``unknown_name`` marks the name of a top or scheme that does not exist."""
        message = self.document.message(path, text)
        if message not in self.messages:
            self.messages.append(message)
            self.unknown_names += unknown_name

    @contextmanager
    def at(self, *path: str | int, model: type[BaseModel] | None = None) -> Iterator[None]:
        """Add what the body refuses, also by pydantic's errors for ``model``, as mistakes at ``path``."""
        try:
            yield
        except ValidationError as error:
            self.explain(error, path, model)
        except (ValueError, UsageError) as error:
            self.add(path, str(error), unknown_name=isinstance(error, UnknownNameError))

    def explain(self, error: ValidationError, path: KeyPath, model: type[BaseModel] | None) -> None:
        """Add pydantic's errors about data for ``model`` at ``path``."""
        for fault in error.errors(include_url=False):
            self.add((*path, *fault["loc"]), _explain(fault, model))

    def raise_any(self) -> None:
        """Raise the first three: UnknownNameError if all are unknown names, otherwise ConfigError."""
        if not self.messages:
            return
        lines = self.messages[:SHOWN_PROBLEMS]
        if len(self.messages) > SHOWN_PROBLEMS:
            lines[-1] += f" (and {len(self.messages) - SHOWN_PROBLEMS} more)"
        raise UnknownNameError(*lines) if self.unknown_names == len(self.messages) else ConfigError(*lines)


GONE = {
    "digits": "the report has the deviations in the precision of the run",
    "include": "list further rows in zip, or run a second sweep",
    "store": "`topcli show SWEEP --row NUMBER` prints a row as a config for topcli run",
}
"""Replacements of keys of earlier versions, for messages."""


def unknown_key(key: str, known: Iterable[str]) -> str:
    """Message about a key that does not exist."""
    if key in GONE:
        return f"unknown key; {GONE[key]}"
    names = list(known)
    same = [name for name in names if name.lower() == key.lower()]
    if same:
        return f"unknown key; did you mean {same[0]!r}?"
    if len(names) <= 1:
        return f"unknown key; only {names[0]!r} is allowed here" if names else "unknown key; none is allowed here"
    return f"unknown key; {nearest(key, names)}"


@cache
def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of ``model`` by their keys in a config."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def validate(
    model: type[Model], data: object, path: KeyPath, problems: Problems, beside: Iterable[str] = ()
) -> Model | None:
    """Return an instance of ``model`` from plain data, without conversions between types; None if it does not fit.

    Unknown keys are refused even by a model that allows them; ``beside`` lists further keys of the section.
    """
    fields = fields_of(model)
    if not isinstance(data, dict):
        problems.add(path, f"must be a section with {', '.join([*beside, *fields])}, not {describe(data)}")
        return None
    known = {key: value for key, value in data.items() if key in fields}
    unknown = [key for key in data if key not in fields and key not in beside] if len(known) < len(data) else []
    for key in unknown:
        problems.add((*path, key), unknown_key(key, [*beside, *fields]))
    try:
        instance = read_model(model, known)
        return None if unknown else instance
    except ValidationError as error:
        problems.explain(error, path, model)
    return None


def read_model(model: type[Model], data: object) -> Model:
    """Return an instance of ``model`` from plain data. Raises pydantic's ValidationError."""
    # JSON, because pydantic's strict mode then still accepts a list for a tuple and text for an enum
    return model.model_validate_json(to_json(data, inf_nan_mode="constants"), strict=True)


_EXPECTED = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "text (in quotes, if it looks like something else)",
    "tuple": "a list",
    "list": "a list",
    "dict": "a section with keys",
}
"""Kinds of values that keys may need, by the beginning of the name of pydantic's error."""
_BOUNDS = {
    "literal_error": "must be {expected}",
    "enum": "must be {expected}",
    "too_short": "must be a list",
    "finite_number": "must be a finite number",
    "greater_than": "must be greater than {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be less than {lt}",
    "less_than_equal": "must be at most {le}",
}


def _explain(fault: Any, model: type[BaseModel] | None) -> str:
    """Message for one of pydantic's errors about data for ``model``."""
    kind, limits = fault["type"], fault.get("ctx", {})
    if kind == "value_error":
        return str(limits["error"])
    *section, key = fault["loc"] or ("",)
    fields = _fields_at(model, section)
    if kind == "missing":
        hint = fields[key].description if key in fields else None
        return f"missing; give {hint}" if hint else "missing"
    if kind == "extra_forbidden":
        return unknown_key(str(key), fields)
    expected = _EXPECTED.get(kind.partition("_")[0]) if kind.endswith("_type") else None
    if kind == "model_type":
        expected = f"a section with {', '.join(_fields_at(model, fault['loc']))}"
    text = f"must be {expected}" if expected else _BOUNDS[kind].format(**limits) if kind in _BOUNDS else fault["msg"]
    example = (fields[key].examples or [None])[0] if key in fields else None
    given = "an empty one" if fault.get("input") in ([], {}) else describe(fault.get("input"))
    return f"{text}, not {given}" + (f"; for example {example}" if example else "")


def _fields_at(model: type[BaseModel] | None, path: Iterable[str | int]) -> dict[str, FieldInfo]:
    """Fields of the section ``path`` inside ``model``; none if the section has no model."""
    for part in path:
        field = fields_of(model).get(str(part)) if model else None
        read = [getattr(data, "json_schema_input_type", None) for data in field.metadata] if field else []
        kinds = [kind for given in (field.annotation if field else None, *read) for kind in (given, *get_args(given))]
        models = (kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel))
        model = next(models, None)
    return fields_of(model) if model else {}
