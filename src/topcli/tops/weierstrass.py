"""Differential equation of the Weierstrass function."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Top


def field(y: Floats, p: Floats) -> Floats:
    """Return (v, 6 x² - g2/2)."""
    x, v = y
    return (v, 6 * x**2 - p[0] / 2)


def energy(y: Floats, p: Floats) -> Any:
    """Half of v² - 4x³ + g₂x; its value is -g₃/2."""
    return (y[1] ** 2 - 4 * y[0] ** 3 + p[0] * y[0]) / 2


class Weierstrass(Top):
    """Equation of the Weierstrass function (x = ℘(t - t0) with the invariants g2 and g3).

    A coordinate of many tops, such as gamma3 of the Lagrange top, obeys this equation up to a shift and a scale factor.
    Motions in the potential well, between the two lower roots of 4x³ - g₂x - g₃, are periodic; motions outside the well
    have poles. The Hirota-Kimura (HK) map is integrable and conserves a modified energy, a rational function of the
    state. The degrees of its iterates grow like n².
    """

    kind = "weierstrass"
    title = "equation of the Weierstrass function"
    citation = "Petrera, Pfadler, Suris 2011 (HK map); Celledoni, McLachlan, Owren, Quispel 2013 (its modified energy)"
    formula = r"""
\dot x = v, \qquad \dot v = 6x^2 - \tfrac12 g_2
"""
    components = ("x", "v")
    field = staticmethod(field)
    integrals: ClassVar[Mapping[str, Integral]] = {"energy": energy}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "energy": ("E", "E"),
        "modified_energy": ("E mod", r"\widetilde{E}"),
    }

    g2: float = Field(default=3.0, description="invariant g2; the potential well has its minimum at x = -sqrt(g2/12)")

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return E + h/3 E' · (1 - h/2 f')^-1 f, which the HK map of a cubic Hamiltonian conserves."""

        def modified_energy(y: Floats, p: Floats) -> Any:
            """Energy, modified so that the HK map conserves it."""
            x, v = y
            force = 6 * x**2 - p[0] / 2
            return energy(y, p) + h**2 / 6 * (12 * (x * v**2) - force**2) / (1 - 3 * h**2 * x)

        return {"modified_energy": modified_energy} if scheme == "hk" else {}
