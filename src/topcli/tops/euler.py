"""Euler top: free rigid body with any moments of inertia (Sogo, section 1.2), without and with the vertical."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import EulerPoisson, Floats, Integral, Top
from topcli.tops import BodyTop, gamma_sq, omega_of


def euler_field(y: Floats, p: Floats) -> Floats:
    """Right-hand side of Sogo's (Euler) without gravity: omega_i' = alpha_i omega_j omega_k."""
    w1, w2, w3 = y
    return (p[3] * w2 * w3, p[4] * w3 * w1, p[5] * w1 * w2)


def field_with_gamma(y: Floats, p: Floats) -> Floats:
    """Right-hand side of Sogo's (Euler) without gravity, and of (Poisson)."""
    w1, w2, w3, g1, g2, g3 = y
    return (
        p[3] * w2 * w3,
        p[4] * w3 * w1,
        p[5] * w1 * w2,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def momentum(y: Floats, p: Floats) -> Floats:
    """Angular momentum (A omega1, B omega2, C omega3)."""
    return (p[0] * y[0], p[1] * y[1], p[2] * y[2])


def m_sq(y: Floats, p: Floats) -> Any:
    """Angular momentum, squared."""
    return (p[0] * y[0]) ** 2 + (p[1] * y[1]) ** 2 + (p[2] * y[2]) ** 2


def m_omega(y: Floats, p: Floats) -> Any:
    """Twice the energy."""
    return p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2


def euler_m_gamma(y: Floats, p: Floats) -> Any:
    """Angular momentum about the vertical."""
    return p[0] * (y[0] * y[3]) + p[1] * (y[1] * y[4]) + p[2] * (y[2] * y[5])


class Euler(Top):
    r"""Euler top (free rigid body).

    The moments of inertia are (A, B, C), and there is no torque. The state is the angular velocity omega in the body
    frame. All quantities are dimensionless.

    Moments that violate the triangle inequality, such as A > B + C, cause a warning, not an error: no rigid body has
    such moments, but the equations are still defined.

    Source
    ------
    Euler 1765; Sogo, Discrete Spinning Tops, section 1.2

    Formula
    -------
    A\dot\omega_1 = (B - C)\,\omega_2\omega_3, \qquad B\dot\omega_2 = (C - A)\,\omega_3\omega_1, \qquad
    C\dot\omega_3 = (A - B)\,\omega_1\omega_2
    """

    kind = "euler"
    form = "euler"
    components = ("omega1", "omega2", "omega3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"omega": (0, 3)}
    energy = "m_omega"
    energy_factor = 0.5
    swing = "omega2"
    step_constants = (
        "A",
        "B",
        "C",
        "alpha1 = (B - C)/A",
        "alpha2 = (C - A)/B",
        "alpha3 = (A - B)/C",
    )
    field = staticmethod(euler_field)
    angular_velocity = staticmethod(omega_of)
    vertical = staticmethod(momentum)
    integrals: ClassVar[Mapping[str, Integral]] = {"m_sq": m_sq, "m_omega": m_omega}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "m_sq": ("m²", r"\boldsymbol{m}^2"),
        "m_omega": ("m·ω", r"\boldsymbol{m}\cdot\boldsymbol{\omega}"),
        "gamma_sq": ("γ²", r"\boldsymbol{\gamma}^2"),
        "m_gamma": ("m·γ", r"\boldsymbol{m}\cdot\boldsymbol{\gamma}"),
    }

    A: float = Field(default=3.0, gt=0.0, description="first moment of inertia; positive")
    B: float = Field(default=2.0, gt=0.0, description="second moment of inertia; positive")
    C: float = Field(default=1.0, gt=0.0, description="third moment of inertia; positive")

    def constants(self) -> Floats:
        """Return ``(A, B, C, alpha1, alpha2, alpha3)`` with alpha1 = (B - C)/A, and the others cyclically."""
        A, B, C = self.A, self.B, self.C
        return (A, B, C, (B - C) / A, (C - A) / B, (A - B) / C)

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations."""
        return EulerPoisson((self.A, self.B, self.C), (0.0, 0.0, 0.0))


class EulerGamma(Euler):
    r"""Euler top (free rigid body) with the vertical.

    The vertical gamma is a direction fixed in space, expressed in the body frame.

    Formula
    -------
    A\dot\omega_1 = (B - C)\,\omega_2\omega_3, \qquad B\dot\omega_2 = (C - A)\,\omega_3\omega_1, \qquad
    C\dot\omega_3 = (A - B)\,\omega_1\omega_2

    \dot\gamma = \gamma\times\omega
    """

    form = "euler+gamma"
    components = BodyTop.components
    vectors = BodyTop.vectors
    vertical = BodyTop.vertical
    unit_vectors = BodyTop.unit_vectors
    field = staticmethod(field_with_gamma)
    integrals: ClassVar[Mapping[str, Integral]] = {**Euler.integrals, "gamma_sq": gamma_sq, "m_gamma": euler_m_gamma}
