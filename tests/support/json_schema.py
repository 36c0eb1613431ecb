"""Whether data satisfy a JSON Schema, for the keywords that the config's schema uses."""

from __future__ import annotations

import re
from typing import Any

TYPES = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}


def of_type(name: str, value: Any) -> bool:
    if name in TYPES:
        return isinstance(value, TYPES[name])
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and (name == "number" or float(value).is_integer())


def fits(schema: Any, value: Any, root: Any = None) -> bool:
    """True if ``value`` satisfies ``schema``, a part of ``root``."""
    root = root or schema
    if "$ref" in schema:
        return fits(root["$defs"][schema["$ref"].rpartition("/")[2]], value, root)
    holds = ["const" not in schema or value == schema["const"], value in schema.get("enum", [value])]
    holds.append("type" not in schema or of_type(schema["type"], value))
    for key, join in (("anyOf", any), ("allOf", all), ("oneOf", lambda parts: sum(parts) == 1)):
        holds.append(key not in schema or join([fits(part, value, root) for part in schema[key]]))
    if isinstance(value, dict):
        properties, others = schema.get("properties", {}), schema.get("additionalProperties", True)
        holds += [key in value for key in schema.get("required", ())]
        for key, item in value.items():
            part = properties.get(key, others)
            holds.append(part if isinstance(part, bool) else fits(part, item, root))
    if isinstance(value, list):
        holds += [fits(schema.get("items", {}), item, root) for item in value]
    if isinstance(value, list | dict):
        holds.append(max(schema.get(key, 0) for key in ("minItems", "minProperties")) <= len(value))
    if of_type("number", value):
        holds += [value >= schema.get("minimum", value), value <= schema.get("maximum", value)]
        holds.append("exclusiveMinimum" not in schema or value > schema["exclusiveMinimum"])
    if isinstance(value, str):
        holds.append(re.search(schema.get("pattern", ""), value) is not None)
    return all(holds)
