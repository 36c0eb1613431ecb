"""Zhukovski-Volterra gyrostat: a free body with rotors that spin at constant rates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Top
from topcli.tops import omega_of

PAIRS = ("hk_23", "hk_31", "hk_12")
"""Names of the integrals of the HK map, by the component that they leave out."""


def field(y: Floats, p: Floats) -> Floats:
    """Return m x (a m + b); ``p`` is (a1, a2, a3, b1, b2, b3)."""
    m1, m2, m3 = y
    a1, a2, a3, b1, b2, b3 = p
    return (
        (a3 - a2) * m2 * m3 + b3 * m2 - b2 * m3,
        (a1 - a3) * m3 * m1 + b1 * m3 - b3 * m1,
        (a2 - a1) * m1 * m2 + b2 * m1 - b1 * m2,
    )


def omega(y: Floats, p: Floats) -> Floats:
    """Return the angular velocity a m + b."""
    return (p[0] * y[0] + p[3], p[1] * y[1] + p[4], p[2] * y[2] + p[5])


def m_sq(y: Floats, p: Floats) -> Any:
    """Angular momentum, squared."""
    return y[0] ** 2 + y[1] ** 2 + y[2] ** 2


def energy(y: Floats, p: Floats) -> Any:
    """Energy up to a constant."""
    return (p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2) / 2 + p[3] * y[0] + p[4] * y[1] + p[5] * y[2]


def pair_integral(k: int, h: float) -> Integral:
    """Integral of the HK map if there is no rotor on the axis k.

    The equations of the two other components are x' = alpha_j m_k y and y' = alpha_i m_k x with x = alpha_j m_i + b_i,
    y = alpha_i m_j - b_j: linear, with the factor m_k. The map multiplies alpha_i x² - alpha_j y² by the same factor as
    the divisor.
    """
    i, j = (k + 1) % 3, (k + 2) % 3

    def integral(m: Floats, p: Floats) -> Any:
        alpha = (p[2] - p[1], p[0] - p[2], p[1] - p[0])
        x, y = alpha[j] * m[i] + p[3 + i], alpha[i] * m[j] - p[3 + j]
        return (alpha[i] * x**2 - alpha[j] * y**2) / (1 - (h / 2) ** 2 * (alpha[i] * alpha[j]) * m[k] ** 2)

    integral.__doc__ = f"Quotient of polynomials that the HK map conserves, quadratic in m{i + 1} and m{j + 1}"
    return integral


class Volterra(Top):
    """Zhukovski-Volterra gyrostat (free body with rotors).

    The state m is the angular momentum of the body with its rotors. The motion has two quadratic integrals and is given
    by elliptic functions. The Hirota-Kimura (HK) map has an integral for each axis without a rotor. With a rotor on
    only one axis, the map is integrable, and the degrees of its iterates grow like n². With rotors on two axes the map
    has one integral, and the degrees grow like (1 + √2)^n. With rotors on all three axes the map has no integral, and
    the degrees grow like 3^n.
    """

    kind = "volterra"
    title = "Zhukovski-Volterra gyrostat (free body with rotors)"
    citation = "Zhukovski 1885; Volterra 1899; Petrera, Pfadler, Suris 2011 (HK map)"
    formula = r"""
\dot m = m\times\omega, \qquad \omega_i = a_i m_i + b_i
"""
    components = ("m1", "m2", "m3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"m": (0, 3)}
    swing = "m2"
    field = staticmethod(field)
    angular_velocity = staticmethod(omega)
    vertical = staticmethod(omega_of)
    integrals: ClassVar[Mapping[str, Integral]] = {"m_sq": m_sq, "energy": energy}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "m_sq": ("m²", r"\boldsymbol{m}^2"),
        "energy": ("E", "E"),
        "hk_23": ("F₂₃", "F_{23}"),
        "hk_31": ("F₃₁", "F_{31}"),
        "hk_12": ("F₁₂", "F_{12}"),
    }

    a1: float = Field(default=1.0, description="reciprocal of the first moment of inertia")
    a2: float = Field(default=1.5, description="reciprocal of the second moment of inertia")
    a3: float = Field(default=2.5, description="reciprocal of the third moment of inertia")
    b1: float = Field(default=0.4, description="-a1 times the angular momentum of the rotor on the first axis")
    b2: float = Field(default=0.0, description="-a2 times the angular momentum of the rotor on the second axis")
    b3: float = Field(default=0.0, description="-a3 times the angular momentum of the rotor on the third axis")

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return the integrals of the HK map, one for each axis without a rotor; constants are left out."""
        alpha = (self.a3 - self.a2, self.a1 - self.a3, self.a2 - self.a1)
        b = (self.b1, self.b2, self.b3)
        axes = [k for k in range(3) if not b[k] and alpha[(k + 1) % 3] and alpha[(k + 2) % 3]]
        return {PAIRS[k]: pair_integral(k, h) for k in axes if scheme == "hk"}
