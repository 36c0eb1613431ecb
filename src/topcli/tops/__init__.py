"""Tops: parameters, equations of motion and integrals; one module per top.

``TOPS`` maps every form of every top to its class. A kind of top has several forms if its state can be written in
several ways. The first form is the default, and the vectors of the initial state choose among them. This module also
contains the state that several tops share, and integrals together with the sizes of their terms.
"""

from __future__ import annotations

import re
from collections import UserDict
from collections.abc import Callable, Collection, Mapping
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from topcli.contracts import Array, Floats, Invariant, Top
from topcli.errors import UnknownNameError, UsageError, nearest, quoted

CATALOGUE = {
    "volterra": "volterra.Volterra",
    "lagrange-gyrostat": "gyrostats.LagrangeGyrostat",
    "kowalevski-gyrostat": "gyrostats.KowalevskiGyrostat",
    "goryachev-chaplygin": "partial.GoryachevChaplygin",
    "hess-appelrot": "partial.HessAppelrot",
    "clebsch": "fluid.Clebsch",
    "kirchhoff": "fluid.Kirchhoff",
    "suslov": "suslov.Suslov",
    "coupled-euler": "coupled_euler.CoupledEuler",
    "gaudin": "gaudin.Gaudin",
    "weierstrass": "weierstrass.Weierstrass",
    "so4": "so4.So4",
}
"""Tops that are declared by their field and integrals alone; the schemes that a field is enough for step them."""

BUILT_IN = {
    "kowalevski": "kowalevski.Kowalevski",
    "euler": "euler.Euler",
    "euler+gamma": "euler.EulerGamma",
    "lagrange": "lagrange.Lagrange",
    "lagrange/inertial": "lagrange.LagrangeInertial",
    "heavy": "heavy.Heavy",
    **CATALOGUE,
}
"""Module and class of each built-in form. A form is its kind, or begins with its kind and + or /."""


CUSTOM = "custom"
"""Kind of the tops that a config declares (``tops.custom``)."""


def gentle_scene(form: str) -> str:
    """Name of the packaged scene of a top of the catalogue that is easy for every scheme."""
    return f"{form.replace('-', '_')}_gentle"


class Tops(UserDict[str, Any]):
    """Classes of the tops by form; a built-in class is imported when it is first needed, which shortens start-up.

    Tops that configs have ``declared`` are found as well, but are not listed.
    """

    def __init__(self, classes: Mapping[str, str]) -> None:
        self.declared: dict[str, type[Top]] = {}
        self.names: dict[str, str] = {}
        """Names of the configs that have declared tops, by form."""
        super().__init__(classes)

    def __contains__(self, form: object) -> bool:
        return form in self.data or form in self.declared

    def __getitem__(self, form: str) -> type[Top]:
        if form in self.declared:
            return self.declared[form]
        top = self.data[form]
        if isinstance(top, str):
            module, name = top.split(".")
            top = self.data[form] = getattr(import_module(f"topcli.tops.{module}"), name)
        return top

    def called(self, form: str) -> str:
        """Name of a form for messages: of a declared top, the name of its config."""
        return self.names.get(form, CUSTOM if form.startswith(f"{CUSTOM}-") else form)

    def kind(self, form: str) -> str:
        """Kind of a form, without importing its class."""
        top = self.declared.get(form) or self.data[form]
        return re.split(r"[+/]", form)[0] if isinstance(top, str) else top.kind


TOPS = Tops(BUILT_IN)


def _find_more(name: str) -> list[str]:
    """Import the plugins that may have a top of this name, all without one; messages on those that failed."""
    plugins = import_module("topcli.schemes.plugins")  # by name: tops depend on no scheme, nor do their digests
    return plugins.find_more_tops(name)


def top_names() -> list[str]:
    """Names of the tops for users: each kind, and each form that differs from its kind; ``custom`` comes last."""
    _find_more("")
    return [*dict.fromkeys(name for form in TOPS for name in (TOPS.kind(form), form)), CUSTOM]


def forms(name: str) -> list[type[Top]]:
    """Forms of the top called ``name``, matched without case: all of a kind with the default first, or a single one.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    wanted = name.lower()
    known = wanted == CUSTOM or wanted in TOPS or any(TOPS.kind(form) == wanted for form in TOPS)
    failures = () if known else _find_more(wanted)
    found = [TOPS[form] for form in TOPS if TOPS.kind(form) == wanted]
    if not found and wanted in TOPS:
        return [TOPS[wanted]]
    if wanted == CUSTOM:
        raise UsageError("a custom top is declared in a config; `topcli init --top custom` writes one to start from")
    if not found:
        raise UnknownNameError(f"unknown top {quoted(name)}; {nearest(name, top_names())}", *failures)
    return found


def other_forms(top: Top | type[Top]) -> list[type[Top]]:
    """Forms of the kind of ``top`` other than its own."""
    return [form for form in TOPS.values() if form.kind == top.kind and form.form != top.form]


def top_class(name: str, vectors: Collection[str] = ()) -> type[Top]:
    """Return the class of the top called ``name`` that has the ``vectors`` in its initial state.

    If a top has several forms (choices of state variables), the names of the ``vectors``, such as omega and gamma,
    decide which form is meant. If no form has these vectors, the default form is returned. Raises UnknownNameError,
    with the nearest names, if there is no such top.
    """
    found = forms(name)
    return next((top for top in found if set(top.vectors) == set(vectors)), found[0])


Value = Callable[[Array], Array]


def omega_of(y: Floats, p: Floats) -> Floats:
    """First three components of the state."""
    return (y[0], y[1], y[2])


def gamma_of(y: Floats, p: Floats) -> Floats:
    """Components of the state from the fourth to the sixth."""
    return (y[3], y[4], y[5])


class BodyTop(Top):
    """Top with the state (omega, gamma): angular velocity and vertical, both in the body's frame."""

    angular_velocity = staticmethod(omega_of)
    vertical = staticmethod(gamma_of)

    components: ClassVar[tuple[str, ...]] = ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"omega": (0, 3), "gamma": (3, 6)}
    unit_vectors: ClassVar[tuple[str, ...]] = ("gamma",)


def sum_of_products(name: str, symbol: str, tex: str, meaning: str, value: Value) -> Invariant:
    """Integral that is a sum of products of components with positive coefficients: its scale is that of ``|y|``."""
    return Invariant(name, symbol, tex, meaning, value, lambda y: value(np.abs(y)))


def length_sq(name: str, symbol: str, tex: str, meaning: str = "length of the vertical, squared") -> Invariant:
    """Square of the last three components."""

    def value(y: Array) -> Array:
        return y[:, 3] ** 2 + y[:, 4] ** 2 + y[:, 5] ** 2

    return Invariant(name, symbol, tex, meaning, value, value)


def energy(kinetic: Value, weight: float, component: int, meaning: str = "energy") -> Invariant:
    """Sum of the ``kinetic`` energy, which is positive, and ``weight`` times a component."""
    return Invariant(
        "energy",
        "E",
        r"E",
        meaning,
        lambda y: kinetic(y) + weight * y[:, component],
        lambda y: kinetic(y) + np.abs(weight * y[:, component]),
    )


VERTICAL = "angular momentum about the vertical"
