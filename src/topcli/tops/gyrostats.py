"""Heavy tops with a rotor: the gyrostats of Lagrange and of Kowalevski, and their shared parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral
from topcli.tops import BodyTop
from topcli.tops.lagrange import hk_corrections


def field(y: Floats, p: Floats) -> Floats:
    """Return the rates of a body with the centre of gravity (x, 0, z) and a rotor on the third axis.

    ``p`` is (A, B, C, mg x, mg z, k) with the momentum k of the rotor.
    """
    w1, w2, w3, g1, g2, g3 = y
    A, B, C, x, z, k = p
    return (
        ((B - C) * w2 * w3 - k * w2 + z * g2) / A,
        ((C - A) * w3 * w1 + k * w1 + (x * g3 - z * g1)) / B,
        ((A - B) * w1 * w2 - x * g2) / C,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def gamma_sq(y: Floats, p: Floats) -> Any:
    """Length of the vertical, squared."""
    return y[3] ** 2 + y[4] ** 2 + y[5] ** 2


def m_gamma(y: Floats, p: Floats) -> Any:
    """Angular momentum about the vertical."""
    return p[0] * (y[0] * y[3]) + p[1] * (y[1] * y[4]) + (p[2] * y[2] + p[5]) * y[5]


def energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    return (p[0] * y[0] ** 2 + p[1] * y[1] ** 2 + p[2] * y[2] ** 2) / 2 + p[3] * y[3] + p[4] * y[5]


def m_axis(y: Floats, p: Floats) -> Any:
    """Angular momentum about the top's axis, Cω₃ + k."""
    return p[2] * y[2] + p[5]


def k_sq(y: Floats, p: Floats) -> Any:
    """Integral of Kowalevski, |(ω₁ + iω₂)² - c₀(γ₁ + iγ₂)|², plus terms with the momentum k of the rotor."""
    w1, w2, w3, g1, g2, g3 = y
    c, k = p[3], p[5]
    rotor = k * (2 * (c * k) * g1 - 4 * c * (g3 * w1) + k * w3**2 + 2 * w3 * (w1**2 + w2**2))
    return (w1**2 - w2**2 - c * g1) ** 2 + (2 * (w1 * w2) - c * g2) ** 2 + rotor


class HeavyGyrostat(BodyTop):
    """Heavy top with the centre of gravity in the plane of the first and third axes, and a rotor on the third."""

    swing = "gamma1"
    field = staticmethod(field)
    formula = r"""
J\dot\omega = (J\omega + k\,e_3)\times\omega + \gamma\times r, \qquad \dot\gamma = \gamma\times\omega
"""
    integrals: ClassVar[Mapping[str, Integral]] = {"gamma_sq": gamma_sq, "m_gamma": m_gamma, "energy": energy}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "gamma_sq": ("γ²", r"\gamma^2"),
        "m_gamma": ("m·γ", r"m\cdot\gamma"),
        "energy": ("E", "E"),
    }


class LagrangeGyrostat(HeavyGyrostat):
    """Lagrange top with a rotor on its axis.

    With the angular momentum k of the rotor, the total angular momentum is m = (Aω₁, Aω₂, Cω₃ + k). Since ω₃ is
    constant, the rotor acts like a change of C. Therefore the Hirota-Kimura (HK) map is integrable, like that of the
    Lagrange top: it has modified integrals of the same form, and the degree of its n-th iterate grows like n². With the
    rotor on another axis, neither the motion nor the HK map would be integrable.
    """

    kind = "lagrange-gyrostat"
    title = "Lagrange gyrostat (A = B, rotor and centre of gravity on the third axis)"
    citation = "Lagrange 1788; Volterra 1899; Kimura, Hirota 2000 (HK map)"
    formula = (
        HeavyGyrostat.formula
        + r"""
J = \mathrm{diag}(A, A, C), \qquad r = (0, 0, \mu)
"""
    )
    swing = "gamma3"
    step_constants = ("A", "A", "C", "0", "mu", "k")
    integrals: ClassVar[Mapping[str, Integral]] = {**HeavyGyrostat.integrals, "m_axis": m_axis}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        **HeavyGyrostat.symbols,
        "m_axis": ("m·e₃", r"m\cdot e_3"),
        "modified_gamma_sq": ("γ² mod", r"\widetilde{\gamma^2}"),
        "modified_m_gamma": ("m·γ mod", r"\widetilde{m\cdot\gamma}"),
        "modified_energy": ("E mod", r"\widetilde{E}"),
    }

    A: float = Field(default=1.0, gt=0.0, description="first and second moment of inertia; positive")
    C: float = Field(default=0.5, gt=0.0, description="third moment of inertia, without that of the rotor; positive")
    mu: float = Field(default=1.0, description="mg z0, the weight times the third coordinate of the centre of gravity")
    k: float = Field(default=0.4, description="angular momentum of the rotor on the third axis")

    def constants(self) -> Floats:
        """Return ``(A, A, C, 0, mu, k)``."""
        return (self.A, self.A, self.C, 0.0, self.mu, self.k)

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return γ², m·γ and E with the corrections of the HK map of the Lagrange top."""

        def made(index: int, plain: Integral) -> Integral:
            def modified(y: Floats, p: Floats) -> Any:
                A, _, C, _, mu, k = p
                return plain(y, p) + hk_corrections(A, mu / A, ((A - C) * y[2] - k) / A, h, y)[index]

            modified.__doc__ = f"{str(plain.__doc__).rstrip('.')}, modified so that the HK map conserves it"
            return modified

        plain = HeavyGyrostat.integrals.items()
        return {f"modified_{name}": made(i, one) for i, (name, one) in enumerate(plain) if scheme == "hk"}


class KowalevskiGyrostat(HeavyGyrostat):
    """Kowalevski top with a rotor on its third axis.

    The moments of inertia are A = B = 2 and C = 1 without loss of generality. The motion has four integrals; the
    fourth, K, is of degree four. The Hirota-Kimura (HK) map conserves none of them exactly. The degrees of its iterates
    grow like (3 + √6)^n, so the map is not integrable.
    """

    kind = "kowalevski-gyrostat"
    title = "Kowalevski gyrostat (A = B = 2C, rotor on the third axis)"
    citation = "Kowalevski 1889; Yehia 1986; Komarov 1987; Bobenko, Reyman, Semenov-Tian-Shansky 1989"
    formula = (
        HeavyGyrostat.formula
        + r"""
J = \mathrm{diag}(2, 2, 1), \qquad r = (c_0, 0, 0)
"""
    )
    step_constants = ("2", "2", "1", "c0", "0", "k")
    integrals: ClassVar[Mapping[str, Integral]] = {**HeavyGyrostat.integrals, "k_sq": k_sq}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {**HeavyGyrostat.symbols, "k_sq": ("K", "K")}

    c0: float = Field(default=1.0, description="mg x0, the weight times the first coordinate of the centre of gravity")
    k: float = Field(default=0.4, description="angular momentum of the rotor on the third axis")

    def constants(self) -> Floats:
        """Return ``(2, 2, 1, c0, 0, k)``."""
        return (2.0, 2.0, 1.0, self.c0, 0.0, self.k)
