"""Rigid bodies in an ideal fluid: the cases of Clebsch and of Kirchhoff."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Top
from topcli.tops import gamma_of, omega_of


def clebsch(y: Floats, p: Floats) -> Floats:
    """Return p x Omega p and p x m; the constants are (omega1, omega2, omega3)."""
    m1, m2, m3, p1, p2, p3 = y
    o1, o2, o3 = p
    return (
        (o3 - o2) * p2 * p3,
        (o1 - o3) * p3 * p1,
        (o2 - o1) * p1 * p2,
        p2 * m3 - p3 * m2,
        p3 * m1 - p1 * m3,
        p1 * m2 - p2 * m1,
    )


def kirchhoff(y: Floats, p: Floats) -> Floats:
    """Return m x a m + p x b p and p x a m with a = (a1, a1, a3), b = (b1, b1, b3); constants (a1, a3, b1, b3)."""
    m1, m2, m3, p1, p2, p3 = y
    a1, a3, b1, b3 = p
    return (
        (a3 - a1) * m2 * m3 + (b3 - b1) * p2 * p3,
        (a1 - a3) * m3 * m1 + (b1 - b3) * p3 * p1,
        0.0,
        a3 * (p2 * m3) - a1 * (p3 * m2),
        a1 * (p3 * m1) - a3 * (p1 * m3),
        a1 * (p1 * m2 - p2 * m1),
    )


def kirchhoff_omega(y: Floats, p: Floats) -> Floats:
    """Return the angular velocity a m."""
    return (p[0] * y[0], p[0] * y[1], p[1] * y[2])


def p_sq(y: Floats, p: Floats) -> Any:
    """Linear momentum p of body and fluid, squared."""
    return y[3] ** 2 + y[4] ** 2 + y[5] ** 2


def m_p(y: Floats, p: Floats) -> Any:
    """Scalar product of the angular momentum m and the linear momentum p."""
    return y[0] * y[3] + y[1] * y[4] + y[2] * y[5]


def clebsch_energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    return (y[0] ** 2 + y[1] ** 2 + y[2] ** 2 + p[0] * y[3] ** 2 + p[1] * y[4] ** 2 + p[2] * y[5] ** 2) / 2


def second(y: Floats, p: Floats) -> Any:
    """Second quadratic integral of Clebsch, ½ Σ(ωᵢ mᵢ² - ωⱼ ωₖ pᵢ²)."""
    momenta = p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2
    return (momenta - p[1] * p[2] * y[3] ** 2 - p[2] * p[0] * y[4] ** 2 - p[0] * p[1] * y[5] ** 2) / 2


def kirchhoff_energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    across = p[0] * (y[0] ** 2 + y[1] ** 2) + p[2] * (y[3] ** 2 + y[4] ** 2)
    return (across + p[1] * y[2] ** 2 + p[3] * y[5] ** 2) / 2


def m_axis(y: Floats, p: Floats) -> Any:
    """Angular momentum about the axis of symmetry."""
    return y[2]


class InFluid(Top):
    """Rigid body in an ideal fluid; m and p are the angular and linear momentum with the fluid, in the body's frame."""

    components = ("m1", "m2", "m3", "p1", "p2", "p3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"m": (0, 3), "p": (3, 6)}
    vertical = staticmethod(gamma_of)
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "p_sq": ("p²", r"\boldsymbol{p}^2"),
        "m_p": ("m·p", r"\boldsymbol{m}\cdot\boldsymbol{p}"),
    }


class Clebsch(InFluid):
    """Clebsch top (rigid body in an ideal fluid).

    The state consists of the angular momentum m and the linear momentum p of body and fluid. The motion has four
    quadratic integrals. If m·p = 0, p moves like the point in Neumann's problem (a point on a sphere in a quadratic
    potential). The Hirota-Kimura (HK) map is integrable, and the degrees of its iterates grow like n². The HK map
    conserves four functions. One of them is a simple quotient; the others are quotients of the coefficients of an HK
    basis (a set of linear relations that hold between monomials along an orbit).
    """

    kind = "clebsch"
    title = "Clebsch top (rigid body in an ideal fluid)"
    citation = "Clebsch 1870; Petrera, Pfadler, Suris 2009 (HK map)"
    formula = r"""
\dot m = p\times\Omega p, \qquad \dot p = p\times m, \qquad \Omega = \mathrm{diag}(\omega_1, \omega_2, \omega_3)
"""
    swing = "p1"
    field = staticmethod(clebsch)
    angular_velocity = staticmethod(omega_of)
    integrals: ClassVar[Mapping[str, Integral]] = {"p_sq": p_sq, "m_p": m_p, "energy": clebsch_energy, "second": second}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        **InFluid.symbols,
        "energy": ("H₁", "H_1"),
        "second": ("H₂", "H_2"),
        "modified_p_sq": ("p² mod", r"\widetilde{\boldsymbol{p}^2}"),
    }

    omega1: float = Field(default=1.0, description="coefficient of p1² in twice the energy")
    omega2: float = Field(default=2.0, description="coefficient of p2² in twice the energy")
    omega3: float = Field(default=4.0, description="coefficient of p3² in twice the energy")

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return p² over 1 - h²/4 (omega1 p1² + omega2 p2² + omega3 p3²), which the HK map conserves."""

        def modified_p_sq(y: Floats, p: Floats) -> Any:
            """Linear momentum, squared, modified so that the HK map conserves it."""
            terms = p[0] * y[3] ** 2 + p[1] * y[4] ** 2 + p[2] * y[5] ** 2
            return p_sq(y, p) / (1 - (h / 2) ** 2 * terms)

        return {"modified_p_sq": modified_p_sq} if scheme == "hk" else {}


class Kirchhoff(InFluid):
    """Kirchhoff top (rigid body of revolution in an ideal fluid).

    The motion has three quadratic integrals and the integral m3, the angular momentum about the axis of revolution. The
    motion is given by elliptic functions. The Hirota-Kimura (HK) map conserves m3 exactly. The HK map is integrable,
    and the degrees of its iterates grow like n². Its three other integrals are quotients of the coefficients of an HK
    basis (a set of linear relations that hold between monomials along an orbit). For a body that is neither a body of
    revolution nor a Clebsch top, the degrees grow like 6^n.
    """

    kind = "kirchhoff"
    title = "Kirchhoff top (rigid body of revolution in an ideal fluid)"
    citation = "Kirchhoff 1870; Petrera, Pfadler, Suris 2011 (HK map)"
    formula = r"""
\dot m = m\times a m + p\times b p, \qquad \dot p = p\times a m, \qquad
a = \mathrm{diag}(a_1, a_1, a_3), \quad b = \mathrm{diag}(b_1, b_1, b_3)
"""
    swing = "p3"
    field = staticmethod(kirchhoff)
    angular_velocity = staticmethod(kirchhoff_omega)
    integrals: ClassVar[Mapping[str, Integral]] = {
        "p_sq": p_sq,
        "m_p": m_p,
        "energy": kirchhoff_energy,
        "m_axis": m_axis,
    }
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        **InFluid.symbols,
        "energy": ("H", "H"),
        "m_axis": ("m·e₃", r"m\cdot e_3"),
    }

    a1: float = Field(default=1.0, description="coefficient of m1² and m2² in twice the energy")
    a3: float = Field(default=1.6, description="coefficient of m3² in twice the energy")
    b1: float = Field(default=0.8, description="coefficient of p1² and p2² in twice the energy")
    b3: float = Field(default=2.0, description="coefficient of p3² in twice the energy")
