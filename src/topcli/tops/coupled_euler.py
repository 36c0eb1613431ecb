"""Two Euler tops coupled by a common component."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Invariant, Top
from topcli.field.polynomial import decimal


def field(y: Floats, p: Floats) -> Floats:
    """Return the rates; ``p`` is (alpha1, ..., alpha6)."""
    x1, x2, x3, x4, x5 = y
    a1, a2, a3, a4, a5, a6 = p
    return (a1 * x2 * x3, a2 * x3 * x1, a3 * x1 * x2 + a4 * x4 * x5, a5 * x5 * x3, a6 * x3 * x4)


def h12(y: Floats, p: Floats) -> Any:
    """Integral of the first top, α₂x₁² - α₁x₂²."""
    return p[1] * y[0] ** 2 - p[0] * y[1] ** 2


def h45(y: Floats, p: Floats) -> Any:
    """Integral of the second top, α₆x₄² - α₅x₅²."""
    return p[5] * y[3] ** 2 - p[4] * y[4] ** 2


def coupling(y: Floats, p: Floats) -> Any:
    """Integral that contains the common component x₃, α₃α₆x₁² + α₁α₄x₅² - α₁α₆x₃²."""
    return p[2] * p[5] * y[0] ** 2 + p[0] * p[3] * y[4] ** 2 - p[0] * p[5] * y[2] ** 2


def mixed(y: Floats, p: Floats) -> Any:
    """Integral of both tops if α₁α₂ = α₅α₆, α₁x₂x₅ - α₆x₁x₄."""
    return p[0] * (y[1] * y[4]) - p[5] * (y[0] * y[3])


class CoupledEuler(Top):
    """Two coupled Euler tops with five components, one of which belongs to both tops.

    The motion has three quadratic integrals, and a fourth one if α₁α₂ = α₅α₆. In that case, all four integrals, divided
    by 1 - h²/4 α₁α₂x₃², are integrals of the Hirota-Kimura (HK) map with the step size h. The map is then integrable,
    and the degrees of its iterates grow like n². Without the condition α₁α₂ = α₅α₆, the HK map conserves only two
    quotients of this kind, and the degrees grow like (2 + √5)^n. This is true even if 4α₁α₂ = α₅α₆, although the motion
    then has a fourth integral, of degree four.
    """

    kind = "coupled-euler"
    title = "coupled Euler tops (two tops with a common component)"
    citation = "Petrera, Pfadler, Suris 2011"
    formula = r"""
\dot x_1 = \alpha_1 x_2x_3, \quad \dot x_2 = \alpha_2 x_3x_1, \quad \dot x_3 = \alpha_3 x_1x_2 + \alpha_4 x_4x_5, \quad
\dot x_4 = \alpha_5 x_5x_3, \quad \dot x_5 = \alpha_6 x_3x_4
"""
    components = ("x1", "x2", "x3", "x4", "x5")
    energy = "coupling"
    swing = "x3"
    field = staticmethod(field)
    integrals: ClassVar[Mapping[str, Integral]] = {
        "h12": h12,
        "h45": h45,
        "coupling": coupling,
        "mixed": mixed,
    }
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "h12": ("H₁₂", "H_{12}"),
        "h45": ("H₄₅", "H_{45}"),
        "coupling": ("H₃", "H_3"),
        "mixed": ("H₁₄", "H_{14}"),
        "modified_h12": ("H₁₂ mod", r"\widetilde{H_{12}}"),
        "modified_h45": ("H₄₅ mod", r"\widetilde{H_{45}}"),
        "modified_coupling": ("H₃ mod", r"\widetilde{H_3}"),
        "modified_mixed": ("H₁₄ mod", r"\widetilde{H_{14}}"),
    }

    alpha1: float = Field(default=2.0, description="coefficient of x2 x3 in the rate of x1")
    alpha2: float = Field(default=-6.0, description="coefficient of x3 x1 in the rate of x2")
    alpha3: float = Field(default=-1.5, description="coefficient of x1 x2 in the rate of x3")
    alpha4: float = Field(default=2.0, description="coefficient of x4 x5 in the rate of x3")
    alpha5: float = Field(default=3.0, description="coefficient of x5 x3 in the rate of x4")
    alpha6: float = Field(default=-4.0, description="coefficient of x3 x4 in the rate of x5")

    @property
    def has_mixed(self) -> bool:
        """True if α₁α₂ = α₅α₆, for the decimal numbers that the parameters are given as."""
        return decimal(self.alpha1) * decimal(self.alpha2) == decimal(self.alpha5) * decimal(self.alpha6)

    def invariants(self) -> tuple[Invariant, ...]:
        """Return the integrals, without ``mixed`` if its condition does not hold."""
        return tuple(one for one in super().invariants() if one.name != "mixed" or self.has_mixed)

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return the quotients that the HK map conserves."""

        def made(plain: Integral, i: int, j: int) -> Integral:
            def modified(y: Floats, p: Floats) -> Any:
                return plain(y, p) / (1 - (h / 2) ** 2 * (p[i] * p[j]) * y[2] ** 2)

            modified.__doc__ = f"{plain.__doc__}, modified so that the HK map conserves it".replace(".,", ",")
            return modified

        if scheme != "hk":
            return {}
        if self.has_mixed:
            return {f"modified_{name}": made(one, 0, 1) for name, one in self.integrals.items()}
        return {"modified_h12": made(h12, 0, 1), "modified_h45": made(h45, 4, 5)}
