"""The commented config that a new experiment starts from."""

from __future__ import annotations

from pydantic import BaseModel
from pydantic_core import to_jsonable_python

from topcli.config.emit import flow
from topcli.config.models import Config, Output
from topcli.contracts import Top
from topcli.schemes.registry import find_scheme, names_for
from topcli.tops import top_class

SCHEMA_FILE = "topcli.schema.json"
_VECTOR = "[2, 0, 0]"
_UNIT_VECTOR = "[auto, 0, 1e-3]"


def starter_config(top: str = "kowalevski", scheme: str = "hybrid", schema: str = SCHEMA_FILE) -> str:
    """A commented config for ``top`` and ``scheme``, which loads; optional keys stand with their defaults.

    ``schema`` is the path of the JSON Schema that the editor's modeline names.
    Raises UnknownNameError with the nearest names, or UsageError for a scheme that does not fit the top.
    """
    cls = top_class(top)
    found = find_scheme(scheme, cls.form)
    described = {key: field.description for key, field in Config.model_fields.items()}
    lines = [
        f"# yaml-language-server: $schema={schema}",
        f"# {found.title}, for the {cls.title}.",
        f"# {found.citation}",
        "",
        f"name: {cls.kind}_{found.name}".replace("-", "_") + f"  # {described['name']}",
        "",
        "top:",
        f"  kind: {cls.kind}",
        *_fields(cls),
        "",
        "initial:",
        *_initial(cls),
        "",
        f"# one of {', '.join(names_for(cls.form))}",
        "scheme:",
        f"  name: {found.name}",
        *_fields(found.options),
        "",
        f"h: 0.001  # {described['h']}",
        f"N: 50000  # {described['N']}",
        "",
        "output:",
        *_fields(Output),
    ]
    return "\n".join(lines) + "\n"


def _fields(model: type[BaseModel]) -> list[str]:
    """A line for each field with its default and description; commented out where the default is none."""
    lines = []
    for key, field in model.model_fields.items():
        value = None if field.is_required() else field.get_default(call_default_factory=True)
        note = f"  # {field.description}" if field.description else ""
        lines.append(f"  # {key}:{note}" if value is None else f"  {key}: {flow(to_jsonable_python(value))}{note}")
    return lines


def _initial(cls: type[Top]) -> list[str]:
    """The vectors of the initial state."""
    lines = []
    for name, (start, stop) in cls.vectors.items():
        unit = name in cls.unit_vectors
        names = ", ".join(cls.components[start:stop])
        note = f"({names}); auto completes it to a unit vector, -auto with a minus sign" if unit else f"({names})"
        lines.append(f"  {name}: {_UNIT_VECTOR if unit else _VECTOR}  # {note}")
    if cls.unit_vectors:
        lines.append(f"  normalize: false  # true scales {', '.join(cls.unit_vectors)} to unit length")
    return lines
