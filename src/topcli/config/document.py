"""Config as read from a file, with overrides: plain data with the place of every key, which refusals name.

Plain data holds only what JSON has: dicts with text keys, lists, text, numbers, booleans and None. The faults of a
section are reported together; then the first one of those that depend on several sections.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Any, NoReturn, TypeVar, cast, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import to_json

from topcli.config.text import KeyPath, parse_yaml
from topcli.errors import ConfigError, UsageError, nearest, quoted, shortened, successor

Model = TypeVar("Model", bound=BaseModel)


@cache
def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """Docstrings of the fields of a model of this package, read from its source only for messages and schemas."""
    texts: dict[str, str] = {}
    for cls in (cls for cls in model.__mro__ if cls.__module__.startswith("topcli.config")):
        for key, text in pairwise(cast(Any, ast.parse(inspect.getsource(cls)).body[0]).body):
            if isinstance(key, ast.AnnAssign) and isinstance(text, ast.Expr):
                texts[ast.unparse(key.target)] = " ".join(ast.literal_eval(text.value).split())
    return texts


def description_of(model: type[BaseModel], key: str) -> str:
    """Description of a key of a section."""
    fields = {field.alias or name: name for name, field in model.model_fields.items()}
    return model.model_fields[fields[key]].description or _docstrings(model).get(fields[key], "")


def _describe(schema: dict[str, Any], model: type[BaseModel]) -> None:
    """Add descriptions to the JSON Schema of a model."""
    for key in fields_of(model):
        schema["properties"][key]["description"] = description_of(model, key)


STRICT = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, json_schema_extra=_describe)
"""Models of sections: no other keys, no conversions between types, finite numbers; docstrings describe their keys."""
SHOWN_FAULTS = 3
"""Faults that one message shows."""


@dataclass
class Document:
    """Plain data with the place of its keys: ``file:line``, or the override that set them."""

    data: dict[str, Any]
    places: dict[KeyPath, str] = field(default_factory=dict)

    @classmethod
    def of(cls, data: Any, places: dict[KeyPath, str] | None = None) -> Document:
        """Document of a copy of ``data`` as plain data. Raises ConfigError for what is none."""
        places = places or {}
        return cls(plain_data(data, cls({}, places)), places)

    def override(self, overrides: Sequence[str]) -> None:
        """Set the overridden keys; whole sections before keys inside them, in whichever order given.

        Raises ConfigError for a malformed override, and for a key inside a value that is not a section.
        """
        parsed = [(*parse_override(text), override_label(text)) for text in overrides]
        self.drop_partner({path[0]: value for path, value, _ in parsed if len(path) == 1})
        for path, value, label in sorted(parsed, key=lambda item: len(item[0])):
            self.set(path, value, label)

    def set(self, path: tuple[str, ...], value: Any, place: str = "") -> None:
        """Set the key ``path``, with ``place`` for messages; the bare name of a top or scheme becomes a section.

        Raises ConfigError for a key inside what is no section.
        """
        section = self.data
        for depth, key in enumerate(path[:-1]):
            inner: Any = section.get(key)
            if key in BARE and isinstance(inner, str):
                inner = {BARE[key]: inner}
            elif inner is not None and not isinstance(inner, dict):
                whole = key_text(path[: depth + 1])
                raise ConfigError(f"{place}: {whole} is {describe(inner)}, not a section; set {whole} as a whole")
            section[key] = section = dict(inner or {})
        if isinstance(section.get(path[-1]), dict | list):  # whose keys have places
            self.places = {key: where for key, where in self.places.items() if key[: len(path)] != path}
        section[path[-1]] = plain_data(value, Document({}, {path: place}), path)
        self.places[path] = place

    def drop_partner(self, changes: Mapping[str, Any]) -> None:
        """Remove N if ``changes`` set T, and T if they set N; nothing if they set both or neither."""
        for key, other in PARTNER.items():
            if key in changes and other not in changes:
                self.data.pop(other, None)

    def place(self, path: KeyPath) -> str:
        """Place of ``path``, or of the section that holds it; empty for data without a file."""
        sections = (path[:length] for length in range(len(path), -1, -1))
        return next((self.places[section] for section in sections if section in self.places), "")

    def message(self, path: KeyPath, text: str) -> str:
        """Return ``text`` after the place and the key of ``path``."""
        return ": ".join(part for part in (self.place(path), key_text(path), text) if part)

    def fault(self, path: KeyPath, text: str) -> NoReturn:
        """Refuse the config for a fault at ``path``. Raises ConfigError."""
        raise ConfigError(self.message(path, text))

    @contextmanager
    def at(self, *path: str | int) -> Iterator[None]:
        """Refuse what the body refuses, with the place and the key of ``path``."""
        try:
            yield
        except ConfigError:  # whose message has a place already
            raise
        except (ValueError, UsageError) as error:
            self.fault(path, str(error))

    def read(self, model: type[Model], data: object, *path: str | int, beside: Iterable[str] = ()) -> Model:
        """Return an instance of ``model`` from plain data, without conversions between types.

        Unknown keys are refused even by a model that allows them; ``beside`` lists further keys of the section. Raises
        ConfigError with the first faults of the section.
        """
        fields = fields_of(model)
        keys = [*beside, *fields]
        if not isinstance(data, dict):
            self.fault(path, f"must be a section with {', '.join(keys)}, not {describe(data)}")
        faults = [self.message((*path, key), unknown_key(key, keys)) for key in data if key not in keys]
        try:
            # JSON, because pydantic's strict mode then still accepts a list for a tuple and text for an enum
            text = to_json({key: value for key, value in data.items() if key in fields}, inf_nan_mode="constants")
            instance = model.model_validate_json(text, strict=True)
        except ValidationError as error:
            errors = error.errors(include_url=False)
            faults += [self.message((*path, *fault["loc"]), _words(fault, model)) for fault in errors]
        else:
            if not faults:
                return instance
        *lines, last = faults[:SHOWN_FAULTS]
        more = len(faults) - SHOWN_FAULTS
        raise ConfigError(*lines, f"{last} (and {more} more)" if more > 0 else last)


def key_text(path: KeyPath) -> str:
    """Return a path as a user writes it: ``initial.gamma``, with positions in brackets.

    >>> key_text(("output", "columns", 2))
    'output.columns[2]'
    """
    parts = (f"[{part}]" if isinstance(part, int) else f".{shortened(part)}" for part in path)
    return "".join(parts).removeprefix(".")


def describe(value: object) -> str:
    """Return a value as messages show it: short, on one line, and clear about its type.

    >>> describe("0.01"), describe(True), describe([1, 2])
    ("the text '0.01'", 'true', 'a list')
    """
    match value:
        case None:
            return "an empty value"
        case bool():
            return str(value).lower()
        case str():
            return f"the text {quoted(value)}"
        case list() | dict():
            kind = "list" if isinstance(value, list) else "section"
            return f"a {kind}" if value else f"an empty {kind}"
    return shortened(repr(value))


def number_of(value: object) -> float | None:
    """Return a number of plain data as a float; None if ``value`` is not a number."""
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def as_integer(value: Any) -> Any:
    """Return a whole number written as a float, such as 5e4, as an integer, and any other value as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def plain_data(value: Any, document: Document, path: KeyPath = ()) -> Any:
    """Return a copy of ``value`` as plain data; tuples and numpy's scalars and arrays become lists and numbers.

    Raises ConfigError naming the key of anything else, and of a number that no double holds.
    """
    value = value.tolist() if hasattr(value, "tolist") else value
    fault = f"must be a number, text, list or section, not a {type(value).__name__}"
    if isinstance(value, Mapping):
        return {str(key): plain_data(item, document, (*path, str(key))) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_data(item, document, (*path, i)) for i, item in enumerate(value)]
    if isinstance(value, (int, float)) and not abs(value) <= sys.float_info.max:
        fault = "must be a finite number that a double holds"
    elif value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise ConfigError(document.message(path, fault))


def unknown_key(key: str, keys: Iterable[str]) -> str:
    """Message about a key that does not exist."""
    names = list(keys)
    same = next((name for name in names if name.lower() == key.lower()), None)
    near = f"did you mean {same!r}?" if same else nearest(key, names) if names else "none is allowed here"
    return f"unknown key; {successor(f'key {key}') or near}"


@cache
def fields_of(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of ``model`` by their keys in a config."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


_WORDS = {
    "Input should": "must",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    ", got a number with a fractional part": "",
    "a valid string": "text",
    "a valid array": "a list",
    "an object": "a section",
}
"""Words of pydantic, each with that of a config."""


def _words(fault: Any, model: type[BaseModel]) -> str:
    """Message for one of pydantic's errors about data for ``model``."""
    kind, path, wrong = fault["type"], fault["loc"] or ("",), describe(fault["input"])
    section = _section_at(model, path if kind == "model_type" else path[:-1])
    keys = fields_of(section) if section else {}
    match kind:
        case "value_error":
            return str(fault["ctx"]["error"])
        case "missing":
            text = description_of(section, str(path[-1])) if section else ""
            return f"missing; give {text}" if text else "missing"
        case "extra_forbidden":
            return unknown_key(str(path[-1]), keys)
        case "model_type":
            return f"must be a section with {', '.join(keys)}, not {wrong}"
        case "too_short" | "too_long":
            return fault["msg"]
    text = fault["msg"]
    for word, ours in _WORDS.items():
        text = text.replace(word, ours)
    return f"{text}, not {wrong}"


def _section_at(model: type[BaseModel] | None, path: Iterable[str | int]) -> type[BaseModel] | None:
    """Model of the section ``path`` inside ``model``; None if the section has none."""
    for part in path:
        field = fields_of(model).get(str(part)) if model else None
        kinds = (field.annotation, *get_args(field.annotation)) if field else ()
        model = next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)
    return model


BARE = {"top": "kind", "scheme": "name"}
"""Sections that may be given as a bare name, each with the key whose value the name is."""
PARTNER = {"T": "N", "N": "T"}
"""Keys of which a config has one, each with the one whose place it takes."""
_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def override_label(text: str) -> str:
    """Name of an override in messages, and the place of the key that it sets."""
    return f"--set {shortened(text)}"


def parse_override(text: str) -> tuple[tuple[str, ...], Any]:
    """Return the path and the value of ``key=value``: a dotted path, and a value in YAML.

    >>> parse_override("initial.gamma=[auto, 0, 1e-3]")
    (('initial', 'gamma'), ['auto', 0, 0.001])

    Raises ConfigError naming the text.
    """
    key, _, value = text.partition("=")
    path = tuple(part.strip() for part in key.split("."))
    label = override_label(text)
    if not value.strip() or not all(_KEY.fullmatch(part) for part in path):
        raise ConfigError(f"{label}: expected key=value, such as h=0.01 or top.c0=2")
    return path, parse_yaml(value, label)[0]
