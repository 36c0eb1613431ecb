"""Heavy tops that are integrable only on a level of an integral: Goryachev-Chaplygin and Hess-Appelrot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field, model_validator

from topcli.contracts import EulerPoisson, Floats, Integral
from topcli.tops.gyrostats import HeavyGyrostat


def chaplygin(y: Floats, p: Floats) -> Any:
    """Cubic integral of Chaplygin, ω₃(ω₁² + ω₂²) - c₀ω₁γ₃."""
    return y[2] * (y[0] ** 2 + y[1] ** 2) - p[3] * (y[0] * y[5])


def hess(y: Floats, p: Floats) -> Any:
    """Function A x₀ ω₁ + C z₀ ω₃, zero on the invariant hyperplane of Hess."""
    return p[0] * p[3] * y[0] + p[2] * p[4] * y[2]


class GoryachevChaplygin(HeavyGyrostat):
    """Goryachev-Chaplygin top: A = B = 4C, centre of gravity on the first axis.

    The moments of inertia are A = B = 4 and C = 1 without loss of generality. Motions without angular momentum
    about the vertical, m·γ = 0, have a fourth integral, which is cubic; other motions are chaotic in general. The
    Hirota-Kimura (HK) map conserves none of the four integrals. The degrees of its iterates grow like (3 + √6)^n, so
    the map is not integrable.
    """

    kind = "goryachev-chaplygin"
    title = "Goryachev-Chaplygin top (A = B = 4C, integrable where m·γ = 0)"
    citation = "Goryachev 1900; Chaplygin 1901"
    formula = r"""
J\dot\omega = J\omega\times\omega + \gamma\times r, \qquad \dot\gamma = \gamma\times\omega

J = \mathrm{diag}(4, 4, 1), \qquad r = (c_0, 0, 0)
"""
    step_constants = ("4", "4", "1", "c0", "0", "0")
    integrals: ClassVar[Mapping[str, Integral]] = {**HeavyGyrostat.integrals, "chaplygin": chaplygin}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {**HeavyGyrostat.symbols, "chaplygin": ("G", "G")}
    holds_on: ClassVar[Mapping[str, Mapping[str, float]]] = {"chaplygin": {"m_gamma": 0.0}}

    c0: float = Field(default=1.0, description="mg x0, the weight times the first coordinate of the centre of gravity")

    def constants(self) -> Floats:
        """Return ``(4, 4, 1, c0, 0, 0)``."""
        return (4.0, 4.0, 1.0, self.c0, 0.0, 0.0)

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations."""
        return EulerPoisson((4.0, 4.0, 1.0), (self.c0, 0.0, 0.0))


class HessAppelrot(HeavyGyrostat):
    """Hess-Appelrot top: A (B - C) x₀² = C (A - B) z₀².

    This condition determines B. Geometrically, the centre of gravity lies on a line through the fixed point that is
    normal to a circular section of the gyration ellipsoid (Σ mᵢ²/Jᵢ = const). A motion that starts on the hyperplane
    F = A x₀ ω₁ + C z₀ ω₃ = 0 remains there, since dF/dt = λ ω₂ F with a constant λ; other motions are chaotic in
    general. The Hirota-Kimura (HK) map also maps this hyperplane to itself, but conserves no integral of the motion.
    The degrees of its iterates grow like (3 + √6)^n. While λ ω₂ is positive, rounding errors of F grow exponentially.
    """

    kind = "hess-appelrot"
    title = "Hess-Appelrot top (an invariant relation instead of a fourth integral)"
    citation = "Hess 1890"
    formula = r"""
J\dot\omega = J\omega\times\omega + \gamma\times r, \qquad \dot\gamma = \gamma\times\omega

J = \mathrm{diag}(A, B, C), \qquad r = (x_0, 0, z_0), \qquad A\,(B - C)\,x_0^2 = C\,(A - B)\,z_0^2
"""
    step_constants = ("A", "B = A*C*(x0**2 + z0**2)/(A*x0**2 + C*z0**2)", "C", "x0", "z0", "0")
    integrals: ClassVar[Mapping[str, Integral]] = {**HeavyGyrostat.integrals, "hess": hess}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {**HeavyGyrostat.symbols, "hess": ("F", "F")}
    holds_on: ClassVar[Mapping[str, Mapping[str, float]]] = {"hess": {"hess": 0.0}}

    A: float = Field(default=3.0, gt=0.0, description="first moment of inertia; positive")
    C: float = Field(default=2.0, gt=0.0, description="third moment of inertia; positive")
    x0: float = Field(default=1.0, description="mg x0, the weight times the first coordinate of the centre of gravity")
    z0: float = Field(default=1.0, description="mg z0, the weight times the third coordinate of the centre of gravity")

    @model_validator(mode="after")
    def _has_weight(self) -> HessAppelrot:
        if self.x0 == 0.0 == self.z0:
            raise ValueError("x0 and z0 are both zero, and then nothing determines B; use the top 'euler'")
        return self

    @property
    def B(self) -> float:
        """Second moment of inertia, by the condition of Hess."""
        x, z = self.x0 * self.x0, self.z0 * self.z0
        return self.A * self.C * (x + z) / (self.A * x + self.C * z)

    def constants(self) -> Floats:
        """Return ``(A, B, C, x0, z0, 0)``."""
        return (self.A, self.B, self.C, self.x0, self.z0, 0.0)

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations."""
        return EulerPoisson((self.A, self.B, self.C), (self.x0, 0.0, self.z0))
