"""Tops that formulas declare: those of the catalogue, a file each, and those of configs, with ``kind: custom``.

Each set of components, names of parameters, field and invariants of a config is a class of its own, whose form names a
digest of them, so that results, machine code and schemes of different tops are kept apart. Its parameters are fields
like those of any top, and keys of the section too: ``top.k`` in a sweep replaces the value under ``parameters``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from fractions import Fraction
from functools import cache
from inspect import get_annotations
from keyword import iskeyword
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import BaseModel, Field, ValidationError, model_validator

from topcli.contracts import EulerPoisson, Floats, Integral, Invariant, Top
from topcli.field.expression import FUNCTIONS, NAME, function_of, in_arithmetic, parse, value_of
from topcli.field.polynomial import decimal
from topcli.tops import CUSTOM, BodyTop

CATALOGUE_FILES = Path(__file__).parent / "catalogue"
VECTORS = ("angular_velocity", "vertical")
"""Keys of vectors of the body, each a list of three formulas."""
_KEYS = ("components", "vectors", "parameters", "body", "field", "invariants", "hk", *VECTORS)
"""Keys of the section beside its kind."""
_TAKEN = frozenset(("n", "t", "h", "trajectory", "normalize", "kind", *_KEYS, *FUNCTIONS))
"""Names that mean something else in a config, a formula or a table."""


class Declared(Top):
    """Top declared by formulas."""

    declaration: ClassVar[Mapping[str, Any]]
    """The section, as it is written, without its kind and parameters."""
    conditions: ClassVar[Mapping[str, Callable[..., Any]]]
    """Functions of the parameters that are zero where an integral exists, by its name."""
    body_numbers: ClassVar[Callable[..., Any] | None]
    """Moments of inertia and mg(x0, y0, z0) of a body without a rotor, a function of the parameters."""

    @model_validator(mode="after")
    def _has_a_field(self) -> Declared:
        state = tuple(map(math.cos, range(1, len(self.components) + 1)))  # in general position
        try:
            self.field(state, self.constants())
        except ZeroDivisionError:
            zeros = ", ".join(f"{name} = 0" for name, value in self if value == 0.0)
            raise ValueError(f"the field divides by zero{f' with {zeros}' if zeros else ''}") from None
        except (ArithmeticError, ValueError):  # at this state, but not at every other
            pass
        return self

    def _exists(self, name: str) -> bool:
        """True if the condition of an integral holds for the decimal numbers that the parameters are given as."""
        condition = self.conditions.get(name)
        if condition is None:
            return True
        # numbers of other precisions are judged by their doubles, whose shortest texts are the decimals of the config
        constants = (value if isinstance(value, int | float | Fraction) else float(value) for value in self.constants())
        return not in_arithmetic(condition, decimal)((), tuple(map(decimal, constants)))[0]

    def invariants(self) -> tuple[Invariant, ...]:
        """Return the integrals whose conditions hold."""
        return tuple(invariant for invariant in super().invariants() if self._exists(invariant.name))

    def integrals_of(self, scheme: str, h: Any) -> Mapping[str, Integral]:
        """Return the integrals of the HK map whose conditions hold, without those that are the same at all states."""
        p, states = tuple(map(float, self.constants())), np.cos(np.arange(4.0 * len(self.components)))
        columns = tuple(states.reshape(len(self.components), 4))

        def with_step(integral: Integral) -> Integral:
            def modified(y: Floats, p: Floats) -> Any:
                return integral(y, (*p, h))

            modified.__doc__ = integral.__doc__
            return modified

        with np.errstate(all="ignore"):
            return {
                name: with_step(integral)
                for name, integral in self.hk.items()
                if scheme == "hk" and self._exists(name) and np.ptp(integral(columns, (*p, float(h))))
            }

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of a body without a rotor in the Euler-Poisson equations."""
        if self.body_numbers is None:
            raise NotImplementedError
        A, B, C, x, y, z = self.body_numbers((), self.constants())
        return EulerPoisson((A, B, C), (x, y, z))


class Custom(Declared):
    """Top declared in a config."""

    kind = CUSTOM
    form = CUSTOM

    @classmethod
    def generic(cls) -> Self:
        """Return the top with parameters in no special relation: a zero may make a quadratic integral linear."""
        return cls(**{name: math.sqrt(1.7 + i) for i, name in enumerate(cls.model_fields)})

    def section(self, parameters: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the section ``top`` of a config as plain data, with these ``parameters`` in place of the top's own."""
        values = {**self.model_dump(mode="json"), **(parameters or {})}
        whole = {**self.declaration, "parameters": values}
        return {"kind": self.kind, **{key: whole[key] for key in _KEYS if whole.get(key)}}

    @classmethod
    def parameters_in(cls, section: object) -> dict[str, Any]:
        """Return the parameters that a section ``top`` of a config gives."""
        assert isinstance(section, dict)
        beside = {key: value for key, value in section.items() if key in cls.model_fields}
        return {**(section.get("parameters") or {}), **beside}


def name_fault(name: str, what: str, earlier: Mapping[str, str]) -> str:
    """Reason why ``name`` cannot name a component, parameter or invariant; empty if it can.

    ``earlier`` says what the names are that are given already.
    """
    if not NAME.fullmatch(name):
        return f"a name has letters, digits and _, and begins with a letter; {name[:40]!r} cannot name the {what}"
    if name in earlier:
        return f"{name!r} already names the {earlier[name]}; choose another name"
    of_models = what == "component" and name in dir(BaseModel)
    declared = hasattr(Custom, name) or any(name in get_annotations(base) for base in Custom.__mro__)
    of_tops = what == "parameter" and (declared or name == "cls" or name[:6] == "model_")
    of_python = what in ("component", "parameter") and iskeyword(name)
    taken = name in _TAKEN or of_models or of_tops or of_python
    return f"{name!r} is taken; choose another name for the {what}" if taken else ""


_classes: dict[tuple[str, tuple[str, ...]], type[Custom]] = {}


def custom_class(section: Mapping[str, Any]) -> type[Custom]:
    """Class of the top that a valid section ``top`` declares; the same one for the same components, names and formulas.

    The parameters of the first such section with which the field has values are the defaults. Raises ExpressionError.
    """
    declaration = {key: section[key] for key in _KEYS if key != "parameters" and section.get(key)}
    if "field" in declaration:
        declaration["field"] = {name: section["field"][name] for name in section["components"]}
    text, parameters = json.dumps(declaration), dict(section.get("parameters") or {})
    key = text, tuple(parameters)
    if key in _classes:
        return _classes[key]
    cls = _new(
        Custom,
        json.loads(text),
        parameters,
        form=f"{CUSTOM}-{hashlib.sha256(repr(key).encode()).hexdigest()[:8]}",
        title=f"custom top of {', '.join(with_body(declaration)['components'])}",
        citation="declared in a config",
    )
    with suppress(ValidationError):
        cls.new()
        _classes[key] = cls
    return cls


@cache
def catalogue_class(kind: str) -> type[Declared]:
    """Class of a top of the catalogue."""
    from ruamel.yaml import YAML

    read = YAML(typ="safe", pure=True).load(CATALOGUE_FILES / f"{kind}.yaml")
    words = {key: read.get(key, {}) for key in ("descriptions", "positive")}
    parameters = {
        name: Field(
            default=value, gt=0.0 if name in words["positive"] else None, description=words["descriptions"][name]
        )
        for name, value in read["parameters"].items()
    }
    declaration = {"components": list(read.get("field", ())), **{key: read[key] for key in _KEYS if key in read}}
    texts = {key: read[key] for key in ("title", "citation", "formula", "swing", "energy", "symbols") if key in read}
    texts["__doc__"] = f"{read['title']}.\n\n{read['about']}"
    return _new(Declared, declaration, parameters, kind=kind, form=kind, **texts)


CYCLES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def _is_zero(formula: Any) -> bool:
    return str(formula) in ("0", "0.0")


def with_body(declaration: Mapping[str, Any]) -> dict[str, Any]:
    """A declaration with the components, formulas and vectors of its ``body``, if it has one.

    The state is omega and gamma, and the equations are Jω' = (Jω + k) x ω + γ x r, γ' = γ x ω with the moments J, the
    angular momentum k of the rotor and r = mg(x0, y0, z0).
    """
    if not (body := declaration.get("body")):
        return dict(declaration)
    J, r, k = ([str(x) for x in body.get(key) or (0, 0, 0)] for key in ("moments", "gravity", "rotor"))
    omega, gamma = ("omega1", "omega2", "omega3"), ("gamma1", "gamma2", "gamma3")

    def term(sign: str, factor: str, component: str) -> str:
        return "" if _is_zero(factor) else f"{sign} ({factor})*{component}"

    def added(*terms: str) -> str:
        return " ".join(filter(None, terms)).removeprefix("+ ")

    # terms that are zero are left out, so that a free body has no gravity and no rotor in its code
    rates: dict[str, str] = {}
    for i, j, m in CYCLES:
        inertia = term("+", "0" if J[j] == J[m] else f"({J[j]}) - ({J[m]})", f"{omega[j]}*{omega[m]}")
        rotor = (term("-", k[m], omega[j]), term("+", k[j], omega[m]))
        weight = added(term("+", r[m], gamma[j]), term("-", r[j], gamma[m]))
        rates[omega[i]] = f"({added(inertia, *rotor, weight and f'+ ({weight})') or '0'})/({J[i]})"
    rates |= {gamma[i]: f"{gamma[j]}*{omega[m]} - {gamma[m]}*{omega[j]}" for i, j, m in CYCLES}
    squares = added(*(term("+", J[i], f"{omega[i]}**2") for i in range(3)))
    momenta = (
        f"+ ({J[i]})*({omega[i]}*{gamma[i]})" if _is_zero(k[i]) else f"+ (({J[i]})*{omega[i]} + ({k[i]}))*{gamma[i]}"
        for i in range(3)
    )
    integrals = {
        "gamma_sq": "gamma1**2 + gamma2**2 + gamma3**2",
        "m_gamma": added(*momenta),
        "energy": added(f"({squares})/2", *(term("+", r[i], gamma[i]) for i in range(3))),
    }
    return {
        **declaration,
        "components": [*omega, *gamma],
        "vectors": {"omega": omega, "gamma": gamma},
        "field": rates,
        "invariants": {**integrals, **(declaration.get("invariants") or {})},
        "angular_velocity": omega,
        "vertical": gamma,
    }


BODY_SYMBOLS = {
    "gamma_sq": ("γ²", r"\gamma^2", "length of the vertical, squared"),
    "m_gamma": ("m·γ", r"m\cdot\gamma", "angular momentum about the vertical"),
    "energy": ("E", "E", "energy"),
}


def _new(base: type[Any], declaration: Mapping[str, Any], parameters: Mapping[str, Any], **attributes: Any) -> Any:
    """Class of a declaration; ``parameters`` are their defaults or fields of pydantic."""
    full = with_body(declaration)
    components, names = tuple(full["components"]), tuple(parameters)
    symbols = {**(BODY_SYMBOLS if "body" in full else {}), **attributes.pop("symbols", {})}

    def function(name: str, texts: Iterable[Any], variables: tuple[str, ...] = components) -> Callable[..., Any]:
        """Function of the variables and the parameters, like one of a top written in Python."""
        return function_of(name, [parse(str(text), (*variables, *names)) for text in texts], variables, names)

    def integral(name: str, text: Any, more: tuple[str, ...]) -> Integral:
        value = value_of(parse(str(text), (*components, *names, *more)), components, (*names, *more))
        value.__doc__ = symbols[name][2] if name in symbols else name
        return value

    def relations(key: str) -> dict[str, Mapping[str, Any]]:
        """Integrals by name, each with its ``value`` and the conditions ``on`` and ``if``."""
        parts = full.get(key) or {}
        return {name: part if isinstance(part, Mapping) else {"value": part} for name, part in parts.items()}

    invariants, modified = relations("invariants"), relations("hk")
    every = [*invariants.items(), *modified.items()]
    if base is Custom and "energy" not in symbols and "E" not in (*components, *names, *invariants):
        symbols["energy"] = ("E", "E", "energy")

    # a class, since a top is a type with parameters for all that follows, from defaults to several instances
    namespace: dict[str, Any] = {
        "__module__": __name__,
        "__annotations__": dict.fromkeys(names, float),
        **parameters,
        **attributes,
        "declaration": declaration,
        "components": components,
        "field": staticmethod(function("field", [full["field"][name] for name in components])),
        "integrals": {name: integral(name, part["value"], ()) for name, part in invariants.items()},
        "hk": {name: integral(name, part["value"], ("h",)) for name, part in modified.items()},
        "holds_on": {name: part["on"] for name, part in every if part.get("on")},
        "conditions": {name: function("condition", [part["if"]], ()) for name, part in every if part.get("if")},
        "symbols": {name: tuple(texts[:2]) for name, texts in symbols.items()},
        "body_numbers": None,
        **{key: function(key, full[key]) for key in VECTORS if full.get(key)},
    }
    if spans := full.get("vectors"):
        places = {name: index for index, name in enumerate(components)}
        namespace["vectors"] = {name: (places[part[0]], places[part[-1]] + 1) for name, part in spans.items()}
    if body := full.get("body"):
        namespace["unit_vectors"] = BodyTop.unit_vectors
        if all(map(_is_zero, body.get("rotor") or ())):
            namespace["body_numbers"] = staticmethod(function("body", [*body["moments"], *body["gravity"]], ()))
    metaclass: Any = type(base)
    return metaclass(base.__name__, (base,), namespace)
