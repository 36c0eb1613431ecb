"""Tops: parameters, equations of motion and integrals.

The tops of the paper, for which there are schemes of their own, are classes in a module each. All others are formulas:
those of the catalogue in a YAML file each, those of configs in their section ``top`` (``tops.declared``). The decorator
``topcli.top`` registers a class of a user (``tops.own``).

``TOPS`` maps every form of every top to its class. A kind of top has several forms if its state can be written in
several ways. The first form is the default, and the vectors of the initial state choose among them. This module also
contains the state that several tops share.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Collection, Mapping
from importlib import import_module
from typing import Any, ClassVar

from topcli.contracts import Floats, Top
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.plugins import is_built_in, plugin_failures, require_plugin

CATALOGUE = (
    "volterra",
    "lagrange-gyrostat",
    "kowalevski-gyrostat",
    "goryachev-chaplygin",
    "hess-appelrot",
    "clebsch",
    "kirchhoff",
    "suslov",
    "coupled-euler",
    "gaudin",
    "weierstrass",
    "so4",
)
"""Tops that are declared by formulas alone, in files of this name (``tops.declared``)."""

BUILT_IN = {
    "kowalevski": "kowalevski.Kowalevski",
    "euler": "euler.Euler",
    "euler+gamma": "euler.EulerGamma",
    "lagrange": "lagrange.Lagrange",
    "lagrange/inertial": "lagrange.LagrangeInertial",
    "heavy": "declared",
    **dict.fromkeys(CATALOGUE, "declared"),
}
"""Module and class of each built-in form. A form is its kind, or begins with its kind and + or /."""


CUSTOM = "custom"
"""Kind of the tops that a config declares (``tops.declared``)."""


def gentle_scene(form: str) -> str:
    """Name of the packaged scene of a top of the catalogue that is easy for every scheme."""
    return f"{form.replace('-', '_')}_gentle"


class Tops(UserDict[str, Any]):
    """Classes of the tops by form; a built-in class is imported when it is first needed, which shortens start-up.

    Tops that configs have ``declared`` are found as well, but are not listed.
    """

    def __init__(self, classes: Mapping[str, str]) -> None:
        self.declared: dict[str, type[Top]] = {}
        self.origins: dict[str, str] = {}
        """Package or file of each form that a plugin registered."""
        super().__init__(classes)

    def __contains__(self, form: object) -> bool:
        return form in self.data or form in self.declared

    def __getitem__(self, form: str) -> type[Top]:
        top = self.declared.get(form) or self.data[form]
        if isinstance(top, str):
            module, _, name = top.partition(".")
            imported = import_module(f"topcli.tops.{module}")
            top = self.data[form] = getattr(imported, name) if name else imported.catalogue_class(form)
        return top

    def called(self, form: str) -> str:
        """Name of a form for messages, without the digest of a declared top."""
        return CUSTOM if form.startswith(f"{CUSTOM}-") else form


TOPS = Tops(BUILT_IN)


def kind_of(form: str) -> str:
    """Kind of a form."""
    return form.replace("/", "+").partition("+")[0]


def top_names() -> list[str]:
    """Names of the tops for users: each kind, and each form that differs from its kind; ``custom`` comes last."""
    plugin_failures()
    return [*dict.fromkeys(name for form in TOPS for name in (kind_of(form), form)), CUSTOM]


def forms(name: str) -> list[type[Top]]:
    """Forms of the top called ``name``, matched without case: all of a kind with the default first, or a single one.

    Raises UnknownNameError, with the nearest names, for an unknown kind.
    """
    key = name.lower()
    if key == CUSTOM:
        raise UsageError("a custom top is declared in a config, by its section top")
    failures = [] if any(key in (kind_of(form), form) for form in TOPS) else require_plugin(key, "top")
    classes = [TOPS[form] for form in TOPS if key in (kind_of(form), form)]
    if not classes:
        raise UnknownNameError(f"unknown top {quoted(name)}; {nearest(name, top_names())}", *failures)
    return classes


def top_class(name: str, vectors: Collection[str] = ()) -> type[Top]:
    """Return the class of the top called ``name`` that has the ``vectors`` in its initial state.

    If a top has several forms (choices of state variables), the names of the ``vectors``, such as omega and gamma,
    decide which form is meant. If no form has these vectors, the default form is returned. Raises UnknownNameError,
    with the nearest names, if there is no such top.
    """
    classes = forms(name)
    return next((top for top in classes if set(top.vectors) == set(vectors)), classes[0])


def top_origin(top: type[Top]) -> str:
    """``topcli``, or the package or file of a top."""
    return "topcli" if is_built_in(top) else TOPS.origins.get(top.form, top.__module__)


def omega_of(y: Floats, p: Floats) -> Floats:
    """First three components of the state."""
    return (y[0], y[1], y[2])


def gamma_of(y: Floats, p: Floats) -> Floats:
    """Components of the state from the fourth to the sixth."""
    return (y[3], y[4], y[5])


def gamma_sq(y: Floats, p: Floats) -> Any:
    """Length of the vertical, squared."""
    return y[3] ** 2 + y[4] ** 2 + y[5] ** 2


class BodyTop(Top):
    """Top with the state (omega, gamma): angular velocity and vertical, both in the body's frame."""

    angular_velocity = staticmethod(omega_of)
    vertical = staticmethod(gamma_of)

    components: ClassVar[tuple[str, ...]] = ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"omega": (0, 3), "gamma": (3, 6)}
    unit_vectors: ClassVar[tuple[str, ...]] = ("gamma",)
