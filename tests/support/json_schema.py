"""Whether data satisfy a JSON Schema, for the keywords that the config's schema uses."""

from __future__ import annotations

import re
from typing import Any

TYPES: dict[str, Any] = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}
ANNOTATIONS = ("$schema", "$defs", "title", "description", "default", "examples", "then")


def of_type(name: str, value: Any) -> bool:
    if name in TYPES:
        return isinstance(value, TYPES[name])
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and (name == "number" or float(value).is_integer())


def fits(schema: Any, value: Any) -> bool:
    """True if ``value`` satisfies ``schema``."""
    return _fits(schema, value, schema.get("$defs", {}))


def _fits(schema: Any, value: Any, definitions: Any) -> bool:
    """True if ``value`` satisfies a part of a schema with these ``definitions``."""
    return all(name in ANNOTATIONS or _holds(schema, name, limit, value, definitions) for name, limit in schema.items())


def _holds(schema: Any, name: str, limit: Any, value: Any, definitions: Any) -> bool:
    """True if one keyword of the schema holds, which may say nothing of values of this type."""

    def fits(part: Any, item: Any) -> bool:
        return _fits(part, item, definitions)

    match name, value:
        case "$ref", _:
            return fits(definitions[limit.removeprefix("#/$defs/")], value)
        case "type", _:
            return any(of_type(kind, value) for kind in ([limit] if isinstance(limit, str) else limit))
        case "const", _:
            return value == limit and isinstance(value, bool) == isinstance(limit, bool)
        case "enum", _:
            return value in limit
        case "not", _:
            return not fits(limit, value)
        case "anyOf" | "oneOf" | "allOf", _:
            count = sum(fits(inner, value) for inner in limit)
            return {"anyOf": count > 0, "oneOf": count == 1, "allOf": count == len(limit)}[name]
        case "if", _:
            return not fits(limit, value) or fits(schema["then"], value)
        case "properties", dict():
            return all(fits(limit[key], item) for key, item in value.items() if key in limit)
        case "required", dict():
            return value.keys() >= set(limit)
        case "additionalProperties", dict():
            others = value.keys() - schema.get("properties", {}).keys()
            return not others if limit is False else limit is True or all(fits(limit, value[key]) for key in others)
        case "items", list():
            return all(fits(limit, item) for item in value)
        case ("minItems", list()) | ("minProperties", dict()):
            return len(value) >= limit
        case ("maxItems", list()) | ("maxProperties", dict()):
            return len(value) <= limit
        case "uniqueItems", list():
            return len(set(map(repr, value))) == len(value)
        case "minimum", int() | float():
            return value >= limit
        case "maximum", int() | float():
            return value <= limit
        case "exclusiveMinimum", int() | float():
            return value > limit
        case "maxLength", str():
            return len(value) <= limit
        case "pattern", str():
            return re.search(limit, value) is not None
    assert name in ("properties", "required", "additionalProperties", "items", "pattern", "exclusiveMinimum") or (
        name.startswith(("min", "max", "unique"))
    ), name
    return True
