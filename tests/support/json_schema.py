"""Whether data satisfy a JSON Schema, for the keywords that the config's schema uses."""

from __future__ import annotations

import re
from typing import Any


def fits(schema: Any, value: Any, root: Any = None) -> bool:
    """True if ``value`` satisfies ``schema``, for the keywords that the config's schema uses."""
    root = root or schema
    checks = {"object": dict, "array": list, "string": str, "boolean": bool, "null": type(None)}

    def of_type(name: str) -> bool:
        if name in ("number", "integer"):
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            return number and (name == "number" or float(value).is_integer())
        return isinstance(value, checks[name])

    def keyword(name: str, limit: Any) -> bool:
        match name:
            case "type":
                return any(of_type(kind) for kind in ([limit] if isinstance(limit, str) else limit))
            case "const":
                return value == limit and isinstance(value, bool) == isinstance(limit, bool)
            case "enum":
                return value in limit
            case "not":
                return not fits(limit, value, root)
            case "anyOf":
                return any(fits(inner, value, root) for inner in limit)
            case "oneOf":
                return sum(fits(inner, value, root) for inner in limit) == 1
            case "allOf":
                return all(fits(inner, value, root) for inner in limit)
            case "if":
                return not fits(limit, value, root) or fits(schema["then"], value, root)
            case "properties" if isinstance(value, dict):
                return all(fits(limit[key], item, root) for key, item in value.items() if key in limit)
            case "required" if isinstance(value, dict):
                return all(key in value for key in limit)
            case "additionalProperties" if isinstance(value, dict):
                return limit is not False or value.keys() <= schema["properties"].keys()
            case "items" if isinstance(value, list):
                return all(fits(limit, item, root) for item in value)
            case "minItems" | "maxItems" if isinstance(value, list):
                return len(value) >= limit if name == "minItems" else len(value) <= limit
            case "uniqueItems" if isinstance(value, list):
                return len(set(map(repr, value))) == len(value)
            case "minimum" if isinstance(value, (int, float)):
                return value >= limit
            case "maximum" if isinstance(value, (int, float)):
                return value <= limit
            case "exclusiveMinimum" if isinstance(value, (int, float)):
                return value > limit
            case "maxLength" if isinstance(value, str):
                return len(value) <= limit
            case "pattern" if isinstance(value, str):
                return re.search(limit, value) is not None
            case _:
                known = {"$schema", "title", "description", "default", "then", "properties", "required"}
                known |= {"additionalProperties", "items", "minItems", "maxItems", "uniqueItems", "minimum"}
                known |= {"maximum", "exclusiveMinimum", "maxLength", "pattern"}
                assert name in known, name
                return True

    return all(keyword(name, limit) for name, limit in schema.items())
