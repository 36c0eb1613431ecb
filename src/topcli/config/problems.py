"""Mistakes in a config, gathered so that several are reported at once, each with its place and key."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from topcli.config.document import Document, KeyPath, describe, key_text
from topcli.errors import ConfigError, UnknownNameError, nearest

Model = TypeVar("Model", bound=BaseModel)
SHOWN = 3


@dataclass
class Problems:
    """The mistakes found in one document."""

    document: Document
    messages: list[str] = field(default_factory=list)
    unknown_names: int = 0

    def add(self, path: KeyPath, text: str, *, unknown_name: bool = False) -> None:
        """Add a mistake at ``path``; ``unknown_name`` marks the name of a top or scheme that does not exist."""
        parts = (self.document.place(path), key_text(path), text)
        message = ": ".join(part for part in parts if part)
        if message not in self.messages:
            self.messages.append(message)
            self.unknown_names += unknown_name

    def raise_any(self) -> None:
        """Raise the first three: UnknownNameError if all are unknown names, otherwise ConfigError."""
        if not self.messages:
            return
        lines = self.messages[:SHOWN]
        if len(self.messages) > SHOWN:
            lines[-1] += f" (and {len(self.messages) - SHOWN} more)"
        raise UnknownNameError(*lines) if self.unknown_names == len(self.messages) else ConfigError(*lines)


def unknown_key(key: str, known: Iterable[str]) -> str:
    """Message about a key that does not exist."""
    names = list(known)
    same = [name for name in names if name.lower() == key.lower()]
    if same:
        return f"unknown key; did you mean {same[0]!r}?"
    if len(names) <= 1:
        return f"unknown key; only {names[0]!r} is allowed here" if names else "unknown key; none is allowed here"
    return f"unknown key; {nearest(key, names)}"


def validate(
    model: type[Model], data: dict[str, Any], path: KeyPath, problems: Problems, beside: Iterable[str] = ()
) -> Model | None:
    """Return an instance of ``model`` from plain data, without conversions between types; None if it does not fit.

    Unknown keys are refused even by a model that allows them; ``beside`` lists further keys of the section.
    """
    fields = model.model_fields
    known = {key: value for key, value in data.items() if key in fields}
    for key in data:
        if key not in fields and key not in beside:
            problems.add((*path, key), unknown_key(key, [*fields, *beside]))
    try:
        # JSON, because pydantic's strict mode then still accepts a list for a tuple and text for an enum
        instance = model.model_validate_json(json.dumps(known), strict=True)
    except ValidationError as error:
        for found in error.errors(include_url=False):
            problems.add((*path, *found["loc"]), _explain(found, model))
        return None
    return instance if known.keys() == data.keys() - set(beside) else None


def _explain(found: Any, model: type[BaseModel]) -> str:
    """Message for one of pydantic's errors."""
    value, limits = describe(found.get("input")), found.get("ctx", {})
    match found["type"]:
        case "missing":
            inside = _model_at(model, found["loc"][:-1])
            description = inside.model_fields[str(found["loc"][-1])].description if inside else None
            return "missing" + (f"; give {description}" if description else "")
        case "extra_forbidden":
            inside = _model_at(model, found["loc"][:-1])
            return unknown_key(str(found["loc"][-1]), inside.model_fields if inside else ())
        case "value_error":
            return str(limits["error"])
        case "literal_error" | "enum":
            return f"must be {limits['expected']}, not {value}"
        case "finite_number":
            return f"must be a finite number, not {value}"
        case "greater_than":
            return f"must be greater than {limits['gt']}, not {value}"
        case "greater_than_equal":
            return f"must be at least {limits['ge']}, not {value}"
        case "less_than":
            return f"must be less than {limits['lt']}, not {value}"
        case "less_than_equal":
            return f"must be at most {limits['le']}, not {value}"
        case kind:
            return _explain_type(kind, value) or f"{found['msg']}, not {value}"


def _explain_type(kind: str, value: str) -> str:
    expected = {
        "float": "a number",
        "int": "a whole number",
        "bool": "true or false",
        "string": "text (in quotes, if it looks like something else)",
        "tuple": "a list",
        "list": "a list",
        "model": "a section with keys",
        "dict": "a section with keys",
    }.get(kind.partition("_")[0])
    return f"must be {expected}, not {value}" if expected and kind.endswith("_type") else ""


def _model_at(model: type[BaseModel], path: Iterable[str | int]) -> type[BaseModel] | None:
    """Return the model of the section ``path`` inside ``model``; None if the section has no model."""
    for part in path:
        inner = model.model_fields[str(part)].annotation if str(part) in model.model_fields else None
        if not (isinstance(inner, type) and issubclass(inner, BaseModel)):
            return None
        model = inner
    return model
