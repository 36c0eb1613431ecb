"""Lagrange top: A = B, centre of gravity on the third axis; in the body frame and in the inertial frame.

The two forms are related by the attitude R of the body. With the vertical p = e_z and the axis a of the top, both in
the inertial frame, gamma = R^T p and a = R e_3, hence gamma_3 = a.p.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field, ValidationInfo, field_validator

from topcli.contracts import EulerPoisson, Floats, Integral, Invariant, Top, invariant_of
from topcli.tops import BodyTop, gamma_of, gamma_sq


def lagrange_field(y: Floats, p: Floats) -> Floats:
    """Right-hand side of Sogo's (Euler), (Poisson) with A = B, x0 = y0 = 0; ``p`` is ((A - C)/A, mg z0/A)."""
    w1, w2, w3, g1, g2, g3 = y
    k = p[0] * w3
    nu = p[1]
    return (
        k * w2 + nu * g2,
        -(k * w1 + nu * g1),
        0.0,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def inertial_field(y: Floats, p: Floats) -> Floats:
    """Right-hand side of m' = p x a, a' = m x a with p = e_z, the limit of Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = y
    return (-a2, a1, 0.0, m2 * a3 - m3 * a2, m3 * a1 - m1 * a3, m1 * a2 - m2 * a1)


def spherical_omega(y: Floats, p: Floats) -> Floats:
    """Angular velocity -m of the spherical top that has the axis a as its vertical."""
    return (-y[0], -y[1], -y[2])


class Lagrange(BodyTop):
    r"""Lagrange top (A = B, centre of gravity on the third axis).

    The moments of inertia are (A, A, C), and mg(x0, y0, z0) = (0, 0, mu). All quantities are dimensionless. mu is the
    weight times the third coordinate of the centre of gravity. If mu > 0, the centre of gravity is above the fixed
    point when gamma3 = 1. With mu = 0 the top is the free symmetric top. The state consists of omega, the angular
    velocity, and gamma, the vertical as seen from the body.

    Source
    ------
    Lagrange 1788; Sogo, Discrete Spinning Tops, section 2

    Formula
    -------
    A\dot\omega_1 = (A - C)\,\omega_2\omega_3 + \mu\,\gamma_2, \qquad
    A\dot\omega_2 = -(A - C)\,\omega_3\omega_1 - \mu\,\gamma_1, \qquad
    \dot\omega_3 = 0, \qquad \dot\gamma = \gamma\times\omega
    """

    kind = "lagrange"
    form = "lagrange"
    swing = "gamma3"
    step_constants = ("alpha = (A - C)/A", "nu = mu/A")
    field = staticmethod(lagrange_field)

    A: float = Field(default=1.0, gt=0.0, description="first and second moment of inertia")
    B: float | None = Field(
        default=None,
        gt=0.0,
        validate_default=True,
        description="second moment of inertia; must equal A, which is its default",
    )
    C: float = Field(default=0.5, gt=0.0, description="third moment of inertia")
    mu: float = Field(
        default=1.0,
        description="mg z0, the weight times the third coordinate of the centre of gravity; may be negative",
    )

    @field_validator("B")
    @classmethod
    def _symmetric(cls, value: float | None, info: ValidationInfo) -> float | None:
        first = info.data.get("A")
        if value is None or first is None or value == first:
            return first
        raise ValueError(f"must equal A = {first!r} for a Lagrange top, not {value!r}; omit it, or use the top 'heavy'")

    def constants(self) -> Floats:
        """Return ``(alpha, nu)`` with alpha = (A - C)/A and nu = mu/A."""
        return ((self.A - self.C) / self.A, self.mu / self.A)

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations."""
        return EulerPoisson((self.A, self.A, self.C), (0.0, 0.0, self.mu))

    def invariants(self) -> tuple[Invariant, ...]:
        """Return gamma², m·gamma, E (Sogo, constant) and Lagrange's integral m·e3 = C omega3."""
        A, C, mu = self.A, self.C, self.mu

        def m_gamma(y: Floats, p: Floats) -> Any:
            """Angular momentum about the vertical."""
            return A * (y[0] * y[3] + y[1] * y[4]) + C * y[2] * y[5]

        def energy(y: Floats, p: Floats) -> Any:
            """Energy."""
            return (A * (y[0] ** 2 + y[1] ** 2) + C * y[2] ** 2) / 2 + mu * y[5]

        def m_axis(y: Floats, p: Floats) -> Any:
            """Angular momentum about the top's axis, Cω₃ (Lagrange's integral)."""
            return C * y[2]

        return (
            invariant_of("gamma_sq", gamma_sq, (), ("γ²", r"\gamma^2")),
            invariant_of("m_gamma", m_gamma, (), ("m·γ", r"m\cdot\gamma")),
            invariant_of("energy", energy, (), ("E", "E")),
            invariant_of("m_axis", m_axis, (), ("m·e₃", r"m\cdot e_3")),
        )


def a_sq(y: Floats, p: Floats) -> Any:
    """Length of the axis, squared."""
    return y[3] ** 2 + y[4] ** 2 + y[5] ** 2


def m_p(y: Floats, p: Floats) -> Any:
    """Angular momentum about the vertical."""
    return y[2]


def m_a(y: Floats, p: Floats) -> Any:
    """Angular momentum about the top's axis."""
    return y[0] * y[3] + y[1] * y[4] + y[2] * y[5]


def inertial_energy(y: Floats, p: Floats) -> Any:
    """Energy m²/2 + a·p."""
    return (y[0] ** 2 + y[1] ** 2 + y[2] ** 2) / 2 + y[5]


class LagrangeInertial(Top):
    r"""Lagrange top in the inertial frame (dimensionless: A = B = mg z0 = 1).

    The state is the angular momentum m and the unit vector a of the top's axis. The third moment of inertia C does not
    occur in the equations. The initial state determines the angular momentum m·a about the axis, which is C omega3 in
    the body frame.

    Source
    ------
    Bobenko, Suris 1999; Sogo, Discrete Spinning Tops, section 2.3

    Formula
    -------
    \dot m = p\times a, \qquad \dot a = m\times a, \qquad p = e_3
    """

    kind = "lagrange"
    form = "lagrange/inertial"
    components = ("m1", "m2", "m3", "a1", "a2", "a3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"m": (0, 3), "a": (3, 6)}
    unit_vectors = ("a",)
    in_space = True
    angular_velocity = staticmethod(spherical_omega)
    vertical = staticmethod(gamma_of)
    swing = "a3"
    step_constants = ("1",)
    field = staticmethod(inertial_field)
    integrals: ClassVar[Mapping[str, Integral]] = {"a_sq": a_sq, "m_p": m_p, "m_a": m_a, "energy": inertial_energy}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "a_sq": ("a²", "a^2"),
        "m_p": ("m·p", r"m\cdot p"),
        "m_a": ("m·a", r"m\cdot a"),
        "energy": ("E", "E"),
    }

    def constants(self) -> Floats:
        """Return ``(1,)``, which is mg z0/A in these units."""
        return (1.0,)

    def euler_poisson(self) -> EulerPoisson:
        """Return the spherical top with omega = -m and gamma = a, whose Euler-Poisson equations are the same."""
        return EulerPoisson((1.0, 1.0, 1.0), (0.0, 0.0, 1.0), omega_sign=-1.0)
