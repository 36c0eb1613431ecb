"""The JSON Schema of a config, and commented configs to start a new experiment from.

Both are built from the models and from the registries of tops and schemes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import to_jsonable_python

from topcli.analysis.columns import ATTITUDES, spellings
from topcli.config.draws import Random, draw_examples, energy_fault
from topcli.config.ensemble import SOURCES, Section
from topcli.config.models import Config, Output
from topcli.config.ranges import Range
from topcli.config.sections import AUTO
from topcli.config.text import flow
from topcli.contracts import Scheme, Top
from topcli.errors import UsageError
from topcli.schemes.compose import COMPOSITIONS, obstacle
from topcli.schemes.registry import all_schemes, find_scheme, names_for
from topcli.tops import TOPS, forms, top_class, top_names

DRAFT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]


def config_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of a config: every key, every registered top and scheme.

    The base describes each key; for each kind of top an ``if``/``then`` states the parameters, the initial
    vectors, the schemes that step it, and the columns.
    """
    schema = Config.model_json_schema()
    known = top_names()
    properties = schema["properties"]
    properties["top"] |= {
        "anyOf": [
            {"enum": known},
            {"type": "object", "required": ["kind"], "properties": {"kind": {"enum": known}}},
        ]
    }
    properties["initial"] |= {"type": "object"}
    properties["ensemble"] = any_ensemble_schema() | {"description": properties["ensemble"]["description"]}
    schema["required"].remove("initial")
    schema["anyOf"] = [{"required": ["initial"]}, {"required": ["ensemble"]}]
    schema["oneOf"] = [{"required": ["N"]}, {"required": ["T"]}]
    properties["T"] = {"type": "number", "not": {"const": 0}, "description": properties["T"]["description"]}
    properties["scheme"] |= {"type": ["string", "object"]}
    properties["h"]["not"] = {"const": 0}
    properties["output"].pop("$ref", None)
    properties["output"] |= schema.pop("$defs")["Output"]
    _drop_titles(properties)
    return {
        "$schema": DRAFT,
        **schema,
        "title": "topcli config",
        "allOf": [_for_top(cls) for cls in TOPS.values()],
    }


def _for_top(cls: type[Top]) -> Schema:
    """Schema of the sections for a top of class ``cls``."""
    kind: Schema = {"const": cls.kind}
    schemes = [scheme for scheme in all_schemes() if scheme.top == cls.form]
    top = cls.new()
    integrals = [
        *top.invariants(),
        *(invariant for s in schemes if s.modified for invariant in s.modified(top, 0.01, s.options())),
    ]
    attitude = [name for names in ATTITUDES.values() for name in names]
    columns = [
        "n",
        "t",
        *cls.components,
        *attitude,
        *(text for integral in integrals for text in spellings(integral.name, integral.symbol)),
    ]
    items: Schema = {"anyOf": [{"enum": list(dict.fromkeys(columns))}, {"pattern": "^modified_"}]}
    initial = {name: _vector(cls, name) for name in cls.vectors}
    complete: Schema = {"anyOf": [{"required": ["ensemble"]}, {"properties": {"initial": {"required": list(initial)}}}]}
    normalize = {
        "type": "boolean",
        "default": False,
        "description": f"scale {', '.join(cls.unit_vectors) or 'the unit vectors'} to unit length",
    }
    condition = _is_top(kind)
    others = {name for form in forms(cls.kind) for name in form.vectors} - set(initial)
    if len(forms(cls.kind)) > 1:
        condition["required"].append("initial")
        condition["properties"]["initial"] = {"required": list(initial)}
        if others:
            condition["properties"]["initial"]["not"] = {"anyOf": [{"required": [name]} for name in sorted(others)]}
    if cls.form != cls.kind:  # the form's own name leaves nothing for the vectors to choose
        condition = {"anyOf": [condition, _is_top({"const": cls.form})]}
        kind = {"enum": [cls.kind, cls.form]}
    return {
        "if": condition,
        "then": {
            "properties": {
                "top": {"anyOf": [kind, _section(cls, "kind", kind | {"description": cls.title})]},
                "initial": _closed({**initial, "normalize": normalize}),
                "ensemble": ensemble_schema(cls, {**initial, "normalize": normalize}),
                "scheme": {"anyOf": [_scheme(scheme) for scheme in schemes]},
                "output": {"properties": {"columns": {"anyOf": [{"type": "array", "items": items}, {"type": "null"}]}}},
            },
            **complete,
        },
    }


def _closed(properties: Schema) -> Schema:
    """Schema of a section that has no other keys than ``properties``."""
    return {"type": "object", "additionalProperties": False, "properties": properties}


def _is_top(name: Schema) -> Schema:
    """Schema of a config whose top has this ``name``, bare or in a section."""
    named: Schema = {"type": "object", "required": ["kind"], "properties": {"kind": name}}
    return {"required": ["top"], "properties": {"top": {"anyOf": [name, named]}}}


def _scheme(scheme: Scheme) -> Schema:
    """Schema of a scheme by its bare name or as a section with its options, and composed if it can be."""
    name = {"const": scheme.name, "description": scheme.title}
    forms = [name, _section(scheme.options, "name", name)]
    if not obstacle(scheme):
        compose = {"enum": list(COMPOSITIONS), "description": "the symmetric composition of its steps"}
        forms[1]["properties"]["compose"] = compose
        composed = {"enum": [f"{scheme.name}+{other}" for other in COMPOSITIONS], "description": scheme.title}
        forms += [composed, _section(scheme.options, "name", composed)]
    return {"anyOf": forms, "description": scheme.title}


def _section(model: Any, key: str, value: Schema) -> Schema:
    """Schema of a section with the fields of ``model`` and with ``key``, which names the top or scheme."""
    schema = model.model_json_schema()
    properties = schema.get("properties", {})
    _drop_titles(properties)
    section = _closed({key: value, **properties}) | {"required": [key, *schema.get("required", [])]}
    if "$defs" in schema:
        # "#/$defs/..." of an embedded schema resolves inside it only when it has an identity of its own
        named = value.get("const") or value["enum"][0]
        section |= {"$id": f"topcli:{key}:{named}", "$defs": schema["$defs"]}
    return section


def _vector(cls: type[Top], name: str) -> Schema:
    """Schema of a vector of the initial state."""
    start, stop = cls.vectors[name]
    unit = name in cls.unit_vectors
    item: Schema = {"anyOf": [{"type": "number"}, {"enum": list(AUTO)}]} if unit else {"type": "number"}
    text = f"({', '.join(cls.components[start:stop])})"
    if unit:
        text += "; a unit vector; one component may be auto, +auto or -auto, which completes it"
    return {
        "type": "array",
        "items": item,
        "minItems": stop - start,
        "maxItems": stop - start,
        "description": text,
    }


def _drop_titles(properties: Schema) -> None:
    """Remove the titles, which only repeat the keys."""
    for value in properties.values():
        value.pop("title", None)
        if isinstance(value.get("properties"), dict):
            _drop_titles(value["properties"])


def any_ensemble_schema() -> Schema:
    """Schema of the section ``ensemble`` for an unknown top, with the vectors and parameters of all tops."""
    classes = list(TOPS.values())
    vectors = list(dict.fromkeys(name for cls in classes for name in cls.vectors))
    draws: Schema = {}
    for name in vectors:
        ways = [way for cls in classes if name in cls.vectors for way in _draw(cls, name)["anyOf"]]
        draws[name] = {"anyOf": [way for i, way in enumerate(ways) if way not in ways[:i]]}
    known = [key for cls in classes for key in _axes(cls)]
    initial: Schema = {name: {"type": "array"} for name in vectors} | {"normalize": {"type": "boolean"}}
    return _ensemble_section(initial, draws, list(dict.fromkeys(known)))


def ensemble_schema(cls: type[Top], initial: Schema) -> Schema:
    """Schema of the section ``ensemble`` for tops of class ``cls``; ``initial`` are the keys of an initial state."""
    return _ensemble_section(initial, {name: _draw(cls, name) for name in cls.vectors}, _axes(cls))


def _axes(cls: type[Top]) -> list[str]:
    """Keys of a grid."""
    return [*cls.components, *(f"top.{name}" for name in cls.model_fields)]


def _ensemble_section(initial: Schema, draws: Schema, known: list[str]) -> Schema:
    section, random = _bare_schema(Section), _bare_schema(Random)
    axis: Schema = {"anyOf": [{"type": "array", "items": {"type": "number"}, "minItems": 1}, _bare_schema(Range)]}
    section["properties"]["states"] |= {
        "type": "array",
        "minItems": 1,
        "items": _closed(initial),
    }
    section["properties"]["grid"] |= _closed(dict.fromkeys(known, axis))
    section["properties"]["random"] |= random | {
        "properties": random["properties"] | draws,
        "anyOf": [{"required": [name]} for name in draws],
    }
    for source in SOURCES:
        section["properties"][source].pop("default")
    return {"anyOf": [section | {"anyOf": [{"required": [source]} for source in SOURCES]}, {"type": "null"}]}


def _bare_schema(model: type[BaseModel]) -> Schema:
    """Schema of ``model`` without the titles and its docstring."""
    schema = model.model_json_schema()
    _drop_titles(schema["properties"])
    return {key: value for key, value in schema.items() if key not in ("title", "description")}


def _draw(cls: type[Top], name: str) -> Schema:
    """Schema of the ways to draw a vector."""
    unit = name in cls.unit_vectors
    positive: Schema = {"type": "number", "exclusiveMinimum": 0}
    kinds: Schema = {
        "sphere": {"const": 1.0} if unit else positive | {"description": "uniform on the sphere of this radius"},
        "near": positive
        | {"description": f"uniform within this {'angle' if unit else 'distance'} of the vector in initial"},
    }
    if not unit and not energy_fault(cls.new(), name):
        kinds["energy"] = {
            "type": "number",
            "description": "a direction uniform on the sphere, scaled to this energy of the whole state",
        }
    sections = [_closed({kind: value}) | {"required": [kind]} for kind, value in kinds.items()]
    if unit:
        sections.append({"const": "sphere", "description": "uniform on the unit sphere"})
    return {"anyOf": sections}


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
    chosen = find_scheme(scheme or _default_scheme(cls, names), cls.form)
    return "\n".join(_lines(cls, chosen, schema, toml)) + "\n"


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
        sections = sorted(sections, key=lambda section: bool(section[0]))
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
