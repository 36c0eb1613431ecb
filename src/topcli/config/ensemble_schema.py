"""The JSON Schema of the section ``ensemble`` of a config."""

from __future__ import annotations

from typing import Any

from topcli.config.draws import energy_of
from topcli.config.ensemble import MAX_TRAJECTORIES, Random, Section, Spaced
from topcli.config.members import SOURCES
from topcli.contracts import Top
from topcli.tops import TOPS

Schema = dict[str, Any]


def any_ensemble_schema() -> Schema:
    """The section for a top that is not known: its keys and their types, for the vectors and parameters of all."""
    classes = list(TOPS.values())
    vectors = list(dict.fromkeys(name for cls in classes for name in cls.vectors))
    draws: Schema = {}
    for name in vectors:
        ways = [way for cls in classes if name in cls.vectors for way in _draw(cls, name)["anyOf"]]
        draws[name] = {"anyOf": [way for i, way in enumerate(ways) if way not in ways[:i]]}
    known = [key for cls in classes for key in _axes(cls)]
    initial: Schema = {name: {"type": "array"} for name in vectors} | {"normalize": {"type": "boolean"}}
    return _section(initial, draws, list(dict.fromkeys(known)))


def ensemble_schema(cls: type[Top], initial: Schema) -> Schema:
    """The section for the tops of class ``cls``, of which ``initial`` are the keys of an initial state."""
    return _section(initial, {name: _draw(cls, name) for name in cls.vectors}, _axes(cls))


def _axes(cls: type[Top]) -> list[str]:
    """Keys of a grid."""
    return [*cls.components, *(f"top.{name}" for name in cls.model_fields)]


def _section(initial: Schema, draws: Schema, known: list[str]) -> Schema:
    described = {key: field.description for key, field in Section.model_fields.items()}
    count: Schema = {"type": "integer", "minimum": 1, "maximum": MAX_TRAJECTORIES}
    spaced: Schema = {
        "type": "object",
        "required": list(Spaced.model_fields),
        "additionalProperties": False,
        "properties": {
            key: (count if key == "count" else {"type": "number"}) | {"description": field.description}
            for key, field in Spaced.model_fields.items()
        },
    }
    axis: Schema = {"anyOf": [{"type": "array", "items": {"type": "number"}, "minItems": 1}, spaced]}
    seed = {"type": "integer", "minimum": 0, "default": 0, "description": Random.model_fields["seed"].description}
    properties: Schema = {
        "states": {
            "type": "array",
            "minItems": 1,
            "items": {"type": "object", "additionalProperties": False, "properties": initial},
            "description": described["states"],
        },
        "grid": {
            "type": "object",
            "additionalProperties": False,
            "properties": dict.fromkeys(known, axis),
            "description": described["grid"],
        },
        "random": {
            "type": "object",
            "required": ["count"],
            "anyOf": [{"required": [name]} for name in draws],
            "additionalProperties": False,
            "properties": {
                "count": count | {"description": Random.model_fields["count"].description},
                "seed": seed,
                **draws,
            },
            "description": described["random"],
        },
        "store": {
            "enum": ["trajectories", "final", "statistics"],
            "default": "trajectories",
            "description": described["store"],
        },
    }
    section: Schema = {
        "type": "object",
        "additionalProperties": False,
        "anyOf": [{"required": [source]} for source in SOURCES],
        "properties": properties,
    }
    return {"anyOf": [section, {"type": "null"}]}


def _draw(cls: type[Top], name: str) -> Schema:
    """How a vector may be drawn."""
    unit = name in cls.unit_vectors
    positive: Schema = {"type": "number", "exclusiveMinimum": 0}
    kinds: Schema = {
        "sphere": {"const": 1.0} if unit else positive | {"description": "uniform on the sphere of this radius"},
        "near": positive
        | {"description": f"uniform within this {'angle' if unit else 'distance'} of the vector in initial"},
    }
    if not unit and energy_of(cls.new()):
        kinds["energy"] = {
            "type": "number",
            "description": "a direction uniform on the sphere, scaled to this energy of the whole state",
        }
    sections: list[Schema] = [
        {"type": "object", "required": [kind], "additionalProperties": False, "properties": {kind: value}}
        for kind, value in kinds.items()
    ]
    if unit:
        sections.append({"const": "sphere", "description": "uniform on the unit sphere"})
    return {"anyOf": sections}
