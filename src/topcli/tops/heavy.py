"""General heavy top: any moments of inertia, any centre of gravity (Sogo, section 1.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import EulerPoisson, Floats, Integral
from topcli.tops import BodyTop, gamma_sq


def field(s: Floats, p: Floats) -> Floats:
    """Right-hand side of Sogo's (Euler), (Poisson); ``p`` is (A, B, C, mg x0, mg y0, mg z0)."""
    w1, w2, w3, g1, g2, g3 = s
    A, B, C, x, y, z = p
    return (
        ((B - C) * w2 * w3 + (g2 * z - g3 * y)) / A,
        ((C - A) * w3 * w1 + (g3 * x - g1 * z)) / B,
        ((A - B) * w1 * w2 + (g1 * y - g2 * x)) / C,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def m_gamma(y: Floats, p: Floats) -> Any:
    """Angular momentum about the vertical."""
    return p[0] * y[0] * y[3] + p[1] * y[1] * y[4] + p[2] * y[2] * y[5]


def energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    kinetic = (p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2) / 2
    return kinetic + (p[3] * y[3] + p[4] * y[4] + p[5] * y[5])


class Heavy(BodyTop):
    r"""Heavy top with any moments of inertia (A, B, C) and any mg(x0, y0, z0); dimensionless.

    (x0, y0, z0) is the position of the centre of gravity, and mg the weight. In general, the heavy top has only three
    integrals and is not integrable. It is integrable if the parameters are those of Euler's, Lagrange's or Kowalevski's
    top. With the default parameters, chaotic motions exist.

    Source
    ------
    Euler 1765; Sogo, Discrete Spinning Tops, section 1.1, EulerPoisson

    Formula
    -------
    J\dot\omega = J\omega\times\omega + \gamma\times r, \qquad \dot\gamma = \gamma\times\omega, \qquad
    J = \mathrm{diag}(A, B, C), \quad r = mg\,(x_0, y_0, z_0)
    """

    kind = "heavy"
    form = "heavy"
    title = "heavy top (any moments of inertia and centre of gravity)"
    swing = "gamma1"
    field = staticmethod(field)
    integrals: ClassVar[Mapping[str, Integral]] = {"gamma_sq": gamma_sq, "m_gamma": m_gamma, "energy": energy}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "gamma_sq": ("γ²", r"\gamma^2"),
        "m_gamma": ("m·γ", r"m\cdot\gamma"),
        "energy": ("E", "E"),
    }

    A: float = Field(default=2.0, gt=0.0, description="first moment of inertia")
    B: float = Field(default=1.5, gt=0.0, description="second moment of inertia")
    C: float = Field(default=1.0, gt=0.0, description="third moment of inertia")
    x0: float = Field(default=1.0, description="mg x0, the weight times the first coordinate of the centre of gravity")
    y0: float = Field(default=0.5, description="mg y0, the weight times the second coordinate of the centre of gravity")
    z0: float = Field(default=0.8, description="mg z0, the weight times the third coordinate of the centre of gravity")

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations: its own parameters."""
        return EulerPoisson((self.A, self.B, self.C), (self.x0, self.y0, self.z0))
