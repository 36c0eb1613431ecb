"""Plain data as YAML: sections by indentation, the values inside them on one line each."""

from __future__ import annotations

import re
from typing import Any

from topcli.config.scalars import resolve_scalar

_PLAIN = re.compile(r"[+-]?\.?[A-Za-z0-9][A-Za-z0-9._+-]*")


def to_yaml(data: dict[str, Any]) -> str:
    """``data`` as a YAML text; floats are written so that they read back bit for bit."""
    lines = []
    for key, value in data.items():
        if isinstance(value, dict) and value:
            lines.append(f"{_scalar(key)}:")
            lines += [f"  {_scalar(inner)}: {flow(item)}" for inner, item in value.items()]
        else:
            lines.append(f"{_scalar(key)}: {flow(value)}")
    return "\n".join(lines) + "\n"


def flow(value: Any) -> str:
    """``value`` on one line."""
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
            is_text = _PLAIN.fullmatch(value) and isinstance(resolve_scalar(value), str)
            return value if is_text else '"' + "".join(map(_escaped, value)) + '"'
        case _:
            return repr(value)


def _escaped(letter: str) -> str:
    if letter in '"\\':
        return "\\" + letter
    return letter if letter.isprintable() else f"\\U{ord(letter):08x}"
