"""JSON Schema of a config, and commented starter configs.

Both are built from the models and from the registries of tops and schemes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import to_jsonable_python

from topcli.analysis.columns import ATTITUDES, spellings
from topcli.config.draws import draw_examples, drawable
from topcli.config.ensemble import section_model
from topcli.config.formulas import Body, Conditional, CustomSection, Relation, example_class
from topcli.config.models import Config, Output
from topcli.config.sections import initial_model
from topcli.config.text import flow
from topcli.contracts import Scheme, Top
from topcli.errors import UsageError
from topcli.field.expression import NAME
from topcli.schemes.compose import COMPOSITIONS, obstacle
from topcli.schemes.own_tops import forms, top_class, top_names
from topcli.schemes.plugins import without_users_errors
from topcli.schemes.registry import find_scheme, names_for, schemes_of
from topcli.tops import CUSTOM, TOPS
from topcli.tops.declared import VECTORS

DRAFT = "https://json-schema.org/draft/2020-12/schema"
Schema = dict[str, Any]


def config_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of a config: every key, every registered top and scheme.

    The base describes each key; for each kind of top an ``if``/``then`` states the parameters, the initial
    vectors, the schemes that step it, and the columns.
    """
    schema = _schema(Config)
    known = top_names()
    properties = schema["properties"]
    properties["top"] |= {
        "anyOf": [
            {"enum": known},
            {"type": "object", "required": ["kind"], "properties": {"kind": {"enum": known}}},
        ]
    }
    properties["initial"] |= {"type": "object", "properties": {"from": _FROM_RUN["properties"]["from"]}}
    properties["ensemble"] |= {"anyOf": [{"$ref": f"#/$defs/{_ENSEMBLE}"}, *_ensemble_section(*TOPS.values())["anyOf"]]}
    schema["required"].remove("initial")
    schema["anyOf"] = [{"required": ["initial"]}, {"required": ["ensemble"]}]
    schema["oneOf"] = [{"required": ["N"]}, {"required": ["T"]}]
    properties["T"] = {"type": "number", "not": {"const": 0}, "description": properties["T"]["description"]}
    properties["scheme"] |= {"type": ["string", "object"]}
    properties["h"]["not"] = {"const": 0}
    return {
        "$schema": DRAFT,
        **schema,
        "title": "topcli config",
        "allOf": [*(_for_top(cls) for cls in TOPS.values()), _for_custom()],
        "$defs": {
            **{_ensemble_name(cls): _schema(section_model(cls)) for cls in TOPS.values()},
            _ENSEMBLE: _of_any_name(_schema(section_model(example_class()))),
        },
    }


_ENSEMBLE = f"ensemble_{CUSTOM}"
_FROM_RUN: Schema = {
    "type": "object",
    "required": ["from"],
    "properties": {
        "from": {"type": "string", "description": "the name or the folder of the stored run whose last state is taken"},
        "normalize": {"type": "boolean"},
    },
    "additionalProperties": False,
}
_FORMULA: Schema = {"type": ["string", "number"], "description": "a formula of components and parameters"}


def _of_any_name(part: Any) -> Any:
    """A part of the schema of an ensemble of the example, with any name in the place of its components."""
    if isinstance(part, list):
        return [_of_any_name(item) for item in part]
    if not isinstance(part, dict):
        return part
    made = {key: _of_any_name(item) for key, item in part.items()}
    named, known = made.get("properties", {}), example_class().components
    if known[0] in named:
        made["additionalProperties"] = named[known[0]]
        own = {key: item for key, item in named.items() if key not in known and not key.startswith("top.")}
        made["properties"] = own
        if made.pop("anyOf", None):  # one of the components is drawn
            made["anyOf"] = [{"minProperties": 3}, {"minProperties": 2, "not": {"required": ["seed"]}}]
    return made


def _for_custom() -> Schema:
    """Schema of the sections for a top that the config declares."""
    kind: Schema = {"const": CUSTOM, "description": "a top that this section declares"}
    top = _schema(CustomSection)
    properties = {"kind": kind, **top["properties"], "body": _schema(Body)}
    properties["components"]["items"] |= {"pattern": f"^{NAME.pattern}$"}
    properties["field"] |= {"type": "object", "additionalProperties": _FORMULA}
    for key, model in (("invariants", Relation), ("hk", Conditional)):
        relation = _schema(model)
        relation["properties"]["value"] |= _FORMULA
        relation["properties"]["if"] |= _FORMULA
        properties[key] |= {"type": "object", "additionalProperties": {"anyOf": [_FORMULA, relation]}}
    for part in (*(properties[key]["anyOf"][0] for key in VECTORS), *properties["body"]["properties"].values()):
        part |= {"type": "array", "items": _FORMULA, "minItems": 3, "maxItems": 3}
    section = {
        "type": "object",
        "required": ["kind"],
        "oneOf": [{"required": ["components", "field"]}, {"required": ["body"]}],
        "properties": properties,
        "additionalProperties": {"type": "number", "description": "the value of a parameter, instead of the one above"},
    }
    schemes = schemes_of(example_class().form)
    return {
        "if": _is_top({"const": CUSTOM}),
        "then": {
            "properties": {
                "top": section,
                "initial": {
                    "anyOf": [{"type": "object", "additionalProperties": {"type": ["number", "array"]}}, _FROM_RUN]
                },
                "ensemble": {"anyOf": [{"$ref": f"#/$defs/{_ENSEMBLE}"}, {"type": "null"}]},
                "scheme": {"anyOf": [_scheme(scheme) for scheme in schemes]},
            }
        },
    }


def _for_top(cls: type[Top]) -> Schema:
    """Schema of the sections for a top of class ``cls``."""
    kind: Schema = {"const": cls.kind}
    schemes = schemes_of(cls.form)
    top = cls.new()
    integrals = [*top.invariants()]
    for scheme in schemes:
        with without_users_errors():
            integrals += scheme.modified(top, 0.01, scheme.options()) if scheme.modified else ()
    attitude = [name for names in ATTITUDES.values() for name in names]
    columns = [
        "n",
        "t",
        *cls.components,
        *attitude,
        *(text for integral in integrals for text in spellings(integral.name, integral.symbol)),
    ]
    items: Schema = {"anyOf": [{"enum": list(dict.fromkeys(columns))}, {"pattern": "^modified_"}]}
    initial = _schema(initial_model(cls))
    vectors = initial.pop("required")
    given = [{"required": vectors}, {"required": ["from"]}]
    complete: Schema = {"anyOf": [{"required": ["ensemble"]}, {"properties": {"initial": {"anyOf": given}}}]}
    condition = _is_top(kind)
    others = {name for form in forms(cls.kind) for name in form.vectors} - set(vectors)
    if len(forms(cls.kind)) > 1:
        condition["required"].append("initial")
        condition["properties"]["initial"] = {"required": vectors}
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
                "initial": {"anyOf": [initial, _FROM_RUN]},
                "ensemble": _ensemble_section(cls),
                "scheme": {"anyOf": [_scheme(scheme) for scheme in schemes]},
                "output": {
                    "anyOf": [
                        {"properties": {"columns": {"anyOf": [{"type": "array", "items": items}, {"type": "null"}]}}},
                        {"required": ["quantities"]},  # which are columns too
                    ]
                },
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


def _section(model: type[BaseModel], key: str, value: Schema) -> Schema:
    """Schema of a section with the fields of ``model`` and with ``key``, which names the top or scheme."""
    schema = _schema(model)
    required = [key, *schema.get("required", [])]
    return _closed({key: value, **schema.get("properties", {})}) | {"required": required}


def _ensemble_name(cls: type[Top]) -> str:
    """Name under ``$defs`` of the section ``ensemble`` for tops of class ``cls``."""
    return f"ensemble_{cls.form}".replace("/", "_")


def _ensemble_section(*tops: type[Top]) -> Schema:
    """Schema of the section ``ensemble`` for a top of one of these classes."""
    return {"anyOf": [*({"$ref": f"#/$defs/{_ensemble_name(cls)}"} for cls in tops), {"type": "null"}]}


def _schema(model: type[BaseModel]) -> Schema:
    """Schema of a model, whole, and without the titles, which only repeat the keys."""
    schema = model.model_json_schema()
    return _inlined(schema, schema.pop("$defs", {}))


def _inlined(schema: Any, definitions: Schema) -> Any:
    """The schema with its definitions in the place of the references to them."""
    if isinstance(schema, list):
        return [_inlined(item, definitions) for item in schema]
    if not isinstance(schema, dict):
        return schema
    named = definitions[schema["$ref"].rpartition("/")[2]] if "$ref" in schema else {}
    whole = {key: value for key, value in (named | schema).items() if key not in ("$ref", "title")}
    return {key: _inlined(value, definitions) for key, value in whole.items()}


SCHEMA_FILE = "topcli.schema.json"
DEFAULT_SCHEMES = ("hybrid", "hk")
"""Default scheme of a starter config: the first of these that the top has."""
_VECTOR = [2, 0, 0]
_COMPONENTS = (0.9, -0.4, 1.2, 0.6, -0.5, 0.8)
"""Values of components that belong to no vector of three."""
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
    cls = example_class() if top.lower() == CUSTOM else top_class(top)
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
            if isinstance(value, dict):  # a section in the section, which in TOML comes last
                lines.append((f"[{title}.{key}]" if toml else f"{indent}{key}:") + (f"  # {note}" if note else ""))
                lines += [f"{indent * 2}{inner}{sign} {write(item)}" for inner, item in value.items()]
                continue
            text = f"# {key}{sign}" if value is None else f"{key}{sign} {write(value)}"
            lines.append(indent + text + (f"  # {note}" if note else ""))
        lines.append("")
        if title == "initial":
            lines += [*block, ""] if (block := _ensemble(cls, toml)) else []
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
    is_custom = cls.kind == CUSTOM
    kind = cls.kind if is_custom or top_class(cls.kind, list(cls.vectors)) is cls else cls.form
    name = f"{CUSTOM if is_custom else cls.form}_{scheme.name}".translate(str.maketrans("-/+", "___"))
    return (
        ("", "", [("name", name, described["name"])]),
        ("top", "", _declaration(cls) if is_custom else [("kind", kind, ""), *_fields(cls)]),
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


def _declaration(cls: type[Top]) -> list[Line]:
    """Lines of the section of a top that the config declares."""
    described = {key: field.description or "" for key, field in CustomSection.model_fields.items()}
    return [(key, value, described.get(key, "")) for key, value in cls.new().section().items()]


def _initial(cls: type[Top]) -> list[Line]:
    """Lines for the vectors of the initial state."""
    lines: list[Line] = []
    for name, (start, stop) in cls.vectors.items():
        unit = name in cls.unit_vectors
        names = ", ".join(cls.components[start:stop])
        if stop - start != 3:
            start_values = [_COMPONENTS[i % len(_COMPONENTS)] for i in range(start, stop)]
            lines.append((name, start_values if stop - start > 1 else start_values[0], ""))
            continue
        note = f"({names})" + ("; auto completes it to a unit vector, -auto with a negative number" if unit else "")
        lines.append((name, list(_UNIT_VECTOR if unit else _VECTOR), note))
    if cls.unit_vectors:
        lines.append(("normalize", False, f"if true, {', '.join(cls.unit_vectors)} is scaled to unit length"))
    return lines


def _ensemble(cls: type[Top], toml: bool) -> list[str]:
    """Block to uncomment for many trajectories instead of one, of a top with vectors that can be drawn."""
    drawn = drawable(cls)
    if not drawn:
        return []
    lines = ["[ensemble.random]"] if toml else ["ensemble:", "  random:"]
    indent, sign = ("", " = ") if toml else ("    ", ": ")
    lines += [f"{indent}{key}{sign}{value}" for key, value in (("count", 100), ("seed", 0))]
    for name in drawn:
        first, *others = draw_examples(cls, name)
        text = '"sphere"' if toml and first == "sphere" else first
        note = f"  # or {', '.join(others)}" if others else ""
        lines.append(f"{indent}{name}{sign}{text.replace(': ', sign)}{note.replace(': ', sign)}")
    return [f"# {line}" for line in ["many trajectories instead of one, as in the scene kowalevski_ensemble", *lines]]
