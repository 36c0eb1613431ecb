"""Tops that a config defines by formulas, in the section ``top`` with ``kind: custom``.

Each set of components, names of parameters, field and invariants is a class of its own, whose form names a digest of
them, so that results, machine code and schemes of different tops are kept apart. Its parameters are fields like those
of any top, and keys of the section too: ``top.k`` in a sweep replaces the value under ``parameters``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from keyword import iskeyword
from typing import Any, ClassVar

from pydantic import BaseModel

from topcli.contracts import Integral, Top
from topcli.field.expression import FUNCTIONS, NAME, Expression, function_of, parse, value_of
from topcli.tops import CUSTOM

VECTORS = ("angular_velocity", "vertical")
"""Keys of vectors of the body, each a list of three formulas."""
KEYS = ("components", "parameters", "field", "invariants", *VECTORS)
"""Keys of the section beside its kind."""
TAKEN = frozenset(("n", "t", "h", "trajectory", "normalize", "kind", *KEYS, *FUNCTIONS))
"""Names that mean something else in a config, a formula or a table."""
EXAMPLE: Mapping[str, Any] = {
    "kind": CUSTOM,
    "components": ["w1", "w2", "w3"],
    "parameters": {"A": 3.0, "B": 2.0, "C": 1.0, "k": 0.3},
    "field": {
        "w1": "((B - C)*w2*w3 - k*w2)/A",
        "w2": "((C - A)*w3*w1 + k*w1)/B",
        "w3": "(A - B)*w1*w2/C",
    },
    "invariants": {
        "energy": "(A*w1**2 + B*w2**2 + C*w3**2)/2",
        "momentum": "(A*w1)**2 + (B*w2)**2 + (C*w3 + k)**2",
    },
}
"""The gyrostat of Zhukovski and Volterra, the top of a starting config."""


class Custom(Top):
    """Top declared in a config."""

    kind = CUSTOM
    form = CUSTOM
    declaration: ClassVar[Mapping[str, Any]]
    """The section without its kind and parameters."""

    def section(self, parameters: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the section ``top`` of a config as plain data, with these ``parameters`` in place of the top's own."""
        values = {**self.model_dump(mode="json"), **(parameters or {})}
        given = {**self.declaration, "parameters": values}
        return {"kind": self.kind, **{key: given[key] for key in KEYS if given.get(key)}}

    @classmethod
    def parameters_in(cls, section: object) -> dict[str, Any]:
        """Return the parameters that a section ``top`` of a config gives."""
        assert isinstance(section, dict)
        beside = {key: value for key, value in section.items() if key in cls.model_fields}
        return {**(section.get("parameters") or {}), **beside}

    def __reduce__(self) -> tuple[Any, ...]:
        return _remade, (json.dumps(self.section()),)


def _remade(text: str) -> Top:
    section = json.loads(text)
    cls = custom_class(section)
    return cls.model_validate(cls.parameters_in(section))


def name_fault(name: str, what: str, earlier: Mapping[str, str]) -> str:
    """Reason why ``name`` cannot name a component, parameter or invariant; empty if it can.

    ``earlier`` says what the names are that are given already.
    """
    if not NAME.fullmatch(name):
        article = "an" if what[0] in "aeiou" else "a"
        return f"a name has letters, digits and _, and begins with a letter; {name[:40]!r} cannot name {article} {what}"
    if name in earlier:
        article = "an" if earlier[name][0] in "aeiou" else "a"
        return f"{name!r} names {article} {earlier[name]} already; choose another name"
    if what in ("component", "parameter") and iskeyword(name):
        return f"{name!r} is a word of Python, which no formula contains; choose another name for the {what}"
    of_models = what == "component" and name in dir(BaseModel)
    of_tops = what == "parameter" and (hasattr(Custom, name) or name in ("cls", "declaration") or name[:6] == "model_")
    if name in TAKEN or of_models or of_tops:
        return f"{name!r} is taken; choose another name for the {what}"
    return ""


def custom_class(section: Mapping[str, Any]) -> type[Custom]:
    """Class of the top that a valid section ``top`` declares; the same one for the same components, names and formulas.

    Raises ExpressionError.
    """
    declaration = {
        "components": list(section["components"]),
        "field": {name: section["field"][name] for name in section["components"]},
        "invariants": dict(section.get("invariants") or {}),
        **{key: list(section[key]) for key in VECTORS if section.get(key)},
    }
    return _made(json.dumps(declaration), tuple((section.get("parameters") or {}).items()))


_classes: dict[tuple[str, tuple[str, ...]], type[Custom]] = {}


def _made(declaration: str, parameters: tuple[tuple[str, float], ...]) -> type[Custom]:
    """Class of a declaration in JSON; the first one's parameters are the defaults."""
    key = declaration, tuple(name for name, _ in parameters)
    if key not in _classes:
        _classes[key] = _new(json.loads(declaration), dict(parameters), hashlib.sha256(repr(key).encode()).hexdigest())
    return _classes[key]


def _new(declaration: dict[str, Any], parameters: dict[str, float], digest: str) -> type[Custom]:
    components, names = tuple(declaration["components"]), tuple(parameters)

    def read(text: str) -> Expression:
        return parse(text, (*components, *names))

    integrals: dict[str, Integral] = {}
    holds_on: dict[str, dict[str, float]] = {}
    for name, given in declaration["invariants"].items():
        text, on = (given, {}) if isinstance(given, str) else (given["value"], given.get("on") or {})
        integrals[name] = value_of(read(text), components, names)
        holds_on[name] = on
    field = [read(text) for text in declaration["field"].values()]
    symbols = {"energy": ("E", "E")} if "E" not in (*components, *names, *integrals) else {}
    namespace: dict[str, Any] = {
        "__module__": __name__,
        "__annotations__": dict.fromkeys(names, float),
        **parameters,
        "form": f"{CUSTOM}-{digest[:8]}",
        "title": f"custom top of {', '.join(components)}",
        "citation": "declared in a config",
        "declaration": declaration,
        "components": components,
        "field": staticmethod(function_of("field", field, components, names)),
        "integrals": integrals,
        "symbols": symbols,
        "holds_on": holds_on,
    }
    for key in VECTORS:
        if key in declaration:
            namespace[key] = function_of(key, [read(text) for text in declaration[key]], components, names)
    metaclass: Any = type(Custom)
    return metaclass("Custom", (Custom,), namespace)
