"""Tops: parameters, equations of motion and integrals; one module per top.

``TOPS`` maps every form of every top to its class. A kind of top has several forms if its state can be written in
several ways. The first form is the default, and the vectors of the initial state choose among them. This module also
contains the state that several tops share.
"""

from __future__ import annotations

from collections import UserDict
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar

from topcli.contracts import Floats, Top

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
    "heavy": "heavy.Heavy",
    **dict.fromkeys(CATALOGUE, ""),
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
        super().__init__(classes)

    def __contains__(self, form: object) -> bool:
        return form in self.data or form in self.declared

    def __getitem__(self, form: str) -> type[Top]:
        if form in self.declared:
            return self.declared[form]
        top = self.data[form]
        if isinstance(top, str):
            if form in CATALOGUE:
                top = import_module("topcli.tops.declared").catalogue_class(form)
            else:
                module, name = top.split(".")
                top = getattr(import_module(f"topcli.tops.{module}"), name)
            self.data[form] = top
        return top

    def called(self, form: str) -> str:
        """Name of a form for messages, without the digest of a declared top."""
        return CUSTOM if form.startswith(f"{CUSTOM}-") else form

    def kind(self, form: str) -> str:
        """Kind of a form, without importing its class."""
        top = self.declared.get(form) or self.data[form]
        return form.replace("/", "+").partition("+")[0] if isinstance(top, str) else top.kind


TOPS = Tops(BUILT_IN)


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
