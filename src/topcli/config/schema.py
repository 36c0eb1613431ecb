"""JSON Schema of a config, for editors."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from topcli.config.formulas import CustomSection
from topcli.config.models import Config
from topcli.schemes.registry import all_schemes
from topcli.tops import CUSTOM, TOPS, top_names

Schema = dict[str, Any]


def config_schema() -> Schema:
    """Return the JSON Schema (draft 2020-12) of a config: every key, every registered top and scheme.

    Which schemes, vectors and columns fit which top is left to the loader.
    """
    schema, schemes = Config.model_json_schema(), all_schemes()
    tops = [(top, kind) for top in TOPS.values() for kind in {top.kind: 0, top.form: 0}]
    sections = [_section(top, "kind", kind) | {"description": top.title} for top, kind in tops]
    custom = _section(CustomSection, "kind", CUSTOM) | {"additionalProperties": {"type": "number"}}
    schema["properties"]["top"] |= {"anyOf": [{"enum": top_names()}, *sections, custom]}
    options = {(scheme.name, scheme.options): scheme.title for scheme in schemes}
    named = [_section(model, "name", name) | {"description": title} for (name, model), title in options.items()]
    composed: Schema = {"type": "string", "pattern": r"\+"}
    with_steps = {"type": "object", "required": ["name"], "properties": {"name": composed}}
    names = {"enum": sorted({scheme.name for scheme in schemes})}
    schema["properties"]["scheme"] |= {"anyOf": [names, composed, with_steps, *named]}
    steps = {"oneOf": [{"required": ["N"]}, {"required": ["T"]}]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, **steps, "title": "topcli config"}


def _section(model: type[BaseModel], key: str, name: str) -> Schema:
    """Schema of a section with the fields of ``model`` and with ``key``, which is ``name``."""
    fields = model.model_json_schema()
    properties = {key: {"const": name}, **fields.get("properties", {})}
    if key == "name":
        properties["compose"] = {"type": "string", "description": "the symmetric composition of its steps"}
    required = [key, *fields.get("required", [])]
    return {**fields, "properties": properties, "required": required, "additionalProperties": False}
