"""Commented configs to start a new experiment from, in YAML or TOML."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import to_jsonable_python

from topcli.config.draws import draw_examples
from topcli.config.models import Config, Output
from topcli.config.yaml_text import flow
from topcli.contracts import Scheme, Top
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import top_class

SCHEMA_FILE = "topcli.schema.json"
DEFAULT_SCHEMES = ("hybrid", "hk")
"""Default scheme of a starter config: the first of these that the top has."""
_VECTOR = [2, 0, 0]
_UNIT_VECTOR = ["auto", 0, 1e-3]

Line = tuple[str, Any, str]
"""A key, its value (None: commented out), and a note."""


def starter_config(
    top: str = "kowalevski", scheme: str | None = None, schema: str = SCHEMA_FILE, toml: bool = False
) -> str:
    """Return a commented config for ``top`` and ``scheme`` that loads; optional keys have their defaults.

    ``schema`` is the path of the JSON Schema that the editor's modeline names.
    Raises UnknownNameError with the nearest names, or UsageError for a scheme that does not fit the top.
    """
    cls = top_class(top)
    names = names_for(cls.form)
    found = find_scheme(scheme or _default_scheme(cls, names), cls.form)
    return "\n".join(_lines(cls, found, schema, toml)) + "\n"


def _default_scheme(cls: type[Top], names: Sequence[str]) -> str:
    """First of ``DEFAULT_SCHEMES``, else of ``names``, that can be built for the top; else the first one."""
    for name in [*(name for name in DEFAULT_SCHEMES if name in names), *names]:
        scheme = find_scheme(name, cls.form)
        with suppress(UsageError, ValidationError):
            scheme.build(cls.new(), scheme.options())
            return name
    return names[0]


def _lines(cls: type[Top], scheme: Scheme, schema: str, toml: bool) -> list[str]:
    modeline = f"#:schema {schema}" if toml else f"# yaml-language-server: $schema={schema}"
    lines = [modeline, *_about(cls, scheme), ""]
    sign, write = (" =", _toml_value) if toml else (":", flow)
    sections = _sections(cls, scheme)
    if toml:  # a bare key cannot follow a table
        sections = sorted(sections, key=lambda one: bool(one[0]))
    for title, comment, section in sections:
        lines += [f"# {comment}"] if comment else []
        lines += [f"[{title}]" if toml else f"{title}:"] if title else []
        indent = "  " if title and not toml else ""
        for key, value, note in section:
            text = f"# {key}{sign}" if value is None else f"{key}{sign} {write(value)}"
            lines.append(indent + text + (f"  # {note}" if note else ""))
        lines.append("")
        if title == "initial":
            lines += [*_ensemble(cls, toml), ""]
    return lines[:-1]


def _toml_value(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    return flow(value)


def _about(cls: type[Top], scheme: Scheme) -> list[str]:
    return [f"# {scheme.title}, for the {cls.title}.", f"# {scheme.citation}"]


def _sections(cls: type[Top], scheme: Scheme) -> Sequence[tuple[str, str, list[Line]]]:
    """Sections of the config: title (empty for keys of the top level), comment, lines."""
    described = {key: field.description or "" for key, field in Config.model_fields.items()}
    # the vectors choose the form of the state; where another form has the same ones only its own name does
    kind = cls.kind if top_class(cls.kind, list(cls.vectors)) is cls else cls.form
    name = f"{cls.form}_{scheme.name}".translate(str.maketrans("-/+", "___"))
    return (
        ("", "", [("name", name, described["name"])]),
        ("top", "", [("kind", kind, ""), *_fields(cls)]),
        ("initial", "", _initial(cls)),
        ("scheme", f"one of {', '.join(names_for(cls.form))}", [("name", scheme.name, ""), *_fields(scheme.options)]),
        ("", "", [("h", 0.001, described["h"]), ("N", 50000, described["N"])]),
        ("output", "", _fields(Output)),
    )


def _fields(model: type[BaseModel]) -> list[Line]:
    """Lines for the fields with defaults and descriptions; commented out where the default is none."""
    return [
        (
            key,
            None if field.is_required() else to_jsonable_python(field.get_default(call_default_factory=True)),
            field.description or "",
        )
        for key, field in model.model_fields.items()
    ]


def _initial(cls: type[Top]) -> list[Line]:
    """Lines for the vectors of the initial state."""
    lines: list[Line] = []
    for name, (start, stop) in cls.vectors.items():
        unit = name in cls.unit_vectors
        names = ", ".join(cls.components[start:stop])
        note = f"({names}); auto completes it to a unit vector, -auto with a minus sign" if unit else f"({names})"
        lines.append((name, list(_UNIT_VECTOR if unit else _VECTOR), note))
    if cls.unit_vectors:
        lines.append(("normalize", False, f"true scales {', '.join(cls.unit_vectors)} to unit length"))
    return lines


def _ensemble(cls: type[Top], toml: bool) -> list[str]:
    """Block to uncomment for many trajectories instead of one."""
    lines = ["[ensemble.random]"] if toml else ["ensemble:", "  random:"]
    indent, sign = ("", " = ") if toml else ("    ", ": ")
    lines += [f"{indent}{key}{sign}{value}" for key, value in (("count", 100), ("seed", 0))]
    for name in cls.vectors:
        first, *others = draw_examples(cls, name)
        text = '"sphere"' if toml and first == "sphere" else first
        lines.append(f"{indent}{name}{sign}{text.replace(': ', sign)}  # or {', '.join(others).replace(': ', sign)}")
    return [f"# {line}" for line in ["many trajectories instead of one, as in the scene kowalevski_ensemble", *lines]]
