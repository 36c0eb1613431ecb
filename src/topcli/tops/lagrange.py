"""The Lagrange top: A = B, centre of gravity on the third axis; in the body frame and in the inertial frame.

The two forms of its state and the conversion between them are related by the attitude R of the body: with p = e_z the
vertical and a the top's axis, both in the inertial frame, gamma = R^T p and a = R e_3, hence gamma_3 = a.p.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from topcli.contracts import Array, EulerPoisson, Floats, Invariant, Top


def field(y: Floats, p: Floats) -> Floats:
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
    """m' = p x a, a' = m x a with p = e_z: the limit of Sogo's (L1), (L2)."""
    m1, m2, m3, a1, a2, a3 = y
    return (-a2, a1, 0.0, m2 * a3 - m3 * a2, m3 * a1 - m1 * a3, m1 * a2 - m2 * a1)


class Lagrange(Top):
    """Lagrange top with moments (A, A, C) and mg(x0, y0, z0) = (0, 0, mu), in the body frame; dimensionless.

    mu > 0 puts the centre of gravity above the fixed point when gamma_3 = 1; any real number will do, mu = 0 is the
    free symmetric top. The state is (omega, gamma).
    """

    kind: ClassVar[str] = "lagrange"
    form: ClassVar[str] = "lagrange"
    title: ClassVar[str] = "Lagrange top (A = B, centre of gravity on the third axis)"
    citation: ClassVar[str] = "Lagrange 1788; Sogo, Discrete Spinning Tops, section 2"
    components: ClassVar[tuple[str, ...]] = ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"omega": (0, 3), "gamma": (3, 6)}
    unit_vectors: ClassVar[tuple[str, ...]] = ("gamma",)
    swing: ClassVar[str] = "gamma3"
    field: ClassVar = staticmethod(field)

    A: float = Field(default=1.0, gt=0.0, description="first and second moment of inertia")
    B: float | None = Field(
        default=None, gt=0.0, validate_default=True, description="second moment of inertia: A, also when left out"
    )
    C: float = Field(default=0.5, gt=0.0, description="third moment of inertia")
    mu: float = Field(default=1.0, description="mg z0, the moment of gravity about the fixed point; any real number")

    @field_validator("B")
    @classmethod
    def _symmetric(cls, value: float | None, info: ValidationInfo) -> float | None:
        first = info.data.get("A")
        if value is None or first is None or value == first:
            return first
        raise ValueError(
            f"must equal A = {first!r} for a Lagrange top, not {value!r}; leave it out, or take the top 'heavy'"
        )

    def constants(self) -> Floats:
        """``(alpha, nu)`` with alpha = (A - C)/A and nu = mu/A."""
        return ((self.A - self.C) / self.A, self.mu / self.A)

    def euler_poisson(self) -> EulerPoisson:
        """The same top in the general Euler-Poisson equations."""
        return EulerPoisson((self.A, self.A, self.C), (0.0, 0.0, self.mu))

    def warnings(self) -> tuple[str, ...]:
        """A line when the moments break the triangle inequality: no rigid body has such moments."""
        if self.C <= 2.0 * self.A:
            return ()
        return (
            f"top: no rigid body has moments with C = {self.C:g} > A + B = {2.0 * self.A:g} (triangle inequality); "
            "the equations are integrated all the same",
        )

    def invariants(self) -> tuple[Invariant, ...]:
        """gamma², m·gamma, E (Sogo, constant) and Lagrange's integral m·e3 = C omega3."""
        A, C, mu = self.A, self.C, self.mu

        def gamma_sq(y: Array) -> Array:
            return y[:, 3] ** 2 + y[:, 4] ** 2 + y[:, 5] ** 2

        def m_gamma(y: Array) -> Array:
            return A * (y[:, 0] * y[:, 3] + y[:, 1] * y[:, 4]) + C * y[:, 2] * y[:, 5]

        def energy(y: Array) -> Array:
            return 0.5 * (A * (y[:, 0] ** 2 + y[:, 1] ** 2) + C * y[:, 2] ** 2) + mu * y[:, 5]

        def energy_scale(y: Array) -> Array:
            return 0.5 * (A * (y[:, 0] ** 2 + y[:, 1] ** 2) + C * y[:, 2] ** 2) + np.abs(mu * y[:, 5])

        return (
            Invariant("gamma_sq", "γ²", r"\gamma^2", "length of the vertical, squared", gamma_sq, gamma_sq),
            Invariant(
                "m_gamma",
                "m·γ",
                r"m\cdot\gamma",
                "angular momentum about the vertical",
                m_gamma,
                lambda y: m_gamma(np.abs(y)),
            ),
            Invariant("energy", "E", r"E", "energy", energy, energy_scale),
            Invariant(
                "m_axis",
                "m·e₃",
                r"m\cdot e_3",
                "angular momentum about the top's axis, Cω₃ (Lagrange's integral)",
                lambda y: C * y[:, 2],
                lambda y: np.abs(C * y[:, 2]),
            ),
        )


class LagrangeInertial(Top):
    """Lagrange top in the inertial frame, in units where A = mg z0 = 1 (Sogo, section 2.3).

    The state is the angular momentum m and the axis a. The third moment of inertia plays no part: the angular
    momentum m·a about the axis, which the body frame calls C omega3, stands in its place.
    """

    kind: ClassVar[str] = "lagrange"
    form: ClassVar[str] = "lagrange/inertial"
    title: ClassVar[str] = "Lagrange top in the inertial frame (dimensionless: A = B = mg z0 = 1)"
    citation: ClassVar[str] = "Bobenko, Suris 1999; Sogo, Discrete Spinning Tops, section 2.3"
    components: ClassVar[tuple[str, ...]] = ("m1", "m2", "m3", "a1", "a2", "a3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"m": (0, 3), "a": (3, 6)}
    unit_vectors: ClassVar[tuple[str, ...]] = ("a",)
    swing: ClassVar[str] = "a3"
    field: ClassVar = staticmethod(inertial_field)

    def constants(self) -> Floats:
        """``(1,)``: mg z0/A in these units."""
        return (1.0,)

    def euler_poisson(self) -> EulerPoisson:
        """The spherical top with omega = -m and gamma = a, whose Euler-Poisson equations are the same as these."""
        return EulerPoisson((1.0, 1.0, 1.0), (0.0, 0.0, 1.0), omega_sign=-1.0)

    def invariants(self) -> tuple[Invariant, ...]:
        """a², m·p, m·a and the energy m²/2 + a·p of the continuous motion (Sogo, section 2.3)."""

        def a_sq(y: Array) -> Array:
            return y[:, 3] ** 2 + y[:, 4] ** 2 + y[:, 5] ** 2

        def m_a(y: Array) -> Array:
            return y[:, 0] * y[:, 3] + y[:, 1] * y[:, 4] + y[:, 2] * y[:, 5]

        def kinetic(y: Array) -> Array:
            return 0.5 * (y[:, 0] ** 2 + y[:, 1] ** 2 + y[:, 2] ** 2)

        return (
            Invariant("a_sq", "a²", r"a^2", "length of the axis, squared", a_sq, a_sq),
            Invariant(
                "m_p",
                "m·p",
                r"m\cdot p",
                "angular momentum about the vertical",
                lambda y: y[:, 2],
                lambda y: np.abs(y[:, 2]),
            ),
            Invariant(
                "m_a", "m·a", r"m\cdot a", "angular momentum about the top's axis", m_a, lambda y: m_a(np.abs(y))
            ),
            Invariant(
                "energy",
                "E",
                r"E",
                "energy m²/2 + a·p",
                lambda y: kinetic(y) + y[:, 5],
                lambda y: kinetic(y) + np.abs(y[:, 5]),
            ),
        )


def units(top: Lagrange) -> tuple[float, float]:
    """``(momentum, time)``: what the inertial form's units of angular momentum and time are for ``top``.

    From m' = mu p x a, a' = m x a/A: momentum = sqrt(A mu), time = sqrt(A/mu), so that the step of the inertial form
    is h/time and its energy (E - C omega3²/2)/mu + (C omega3)²/(2 A mu). Raises ValueError unless mu > 0.
    """
    if not top.mu > 0.0:
        raise ValueError(f"lagrange: the inertial form needs mu > 0, not {top.mu!r}")
    return math.sqrt(top.A * top.mu), math.sqrt(top.A / top.mu)


def _turned(x: Array, y: Array, cosine: Array, sine: Array) -> tuple[Array, Array]:
    return cosine * x - sine * y, sine * x + cosine * y


def _direction(x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Length of (x, y) and its direction's cosine and sine; (1, 0) where the length is 0."""
    length = np.hypot(x, y)
    safe = np.where(length > 0.0, length, 1.0)
    return length, np.where(length > 0.0, x / safe, 1.0), y / safe


def to_inertial(top: Lagrange, states: Array, precession: Array) -> tuple[Array, Array]:
    """From the body frame, ``states`` (n, 6) of ``top``, to the inertial form: its states (n, 6) and the spin (n,).

    The attitude is R = R_z(precession) R_x(theta) R_z(spin), Euler's angles: (omega, gamma) determine theta and the
    spin, not the precession, which therefore is given, (n,), and the spin is handed back, so that ``to_body`` undoes
    the conversion. Where the axis is vertical the two angles are one, handed back as the spin. Raises ValueError unless
    mu > 0.
    """
    momentum, _ = units(top)
    sine, cos_spin, sin_spin = _direction(states[:, 4], states[:, 3])
    cosine = states[:, 5]
    x, y = _turned(top.A * states[:, 0], top.A * states[:, 1], cos_spin, sin_spin)
    z = top.C * states[:, 2]
    y, z = _turned(y, z, cosine, sine)
    x, y = _turned(x, y, np.cos(precession), np.sin(precession))
    a = (sine * np.sin(precession), -sine * np.cos(precession), cosine)
    spin = np.where(sine > 0.0, np.arctan2(sin_spin, cos_spin), np.copysign(1.0, cosine) * precession)
    return np.column_stack([x / momentum, y / momentum, z / momentum, *a]), spin


def to_body(top: Lagrange, states: Array, spin: Array) -> tuple[Array, Array]:
    """From the inertial form, ``states`` (n, 6), to the body frame of ``top``: its states (n, 6), the precession (n,).

    The inverse of ``to_inertial``: (m, a) determine theta and the precession, the spin is given, (n,). Where the axis
    is vertical the precession is counted as 0. m·a must be C omega3/sqrt(A mu) of the top meant: it gives omega3.
    Raises ValueError unless mu > 0.
    """
    momentum, _ = units(top)
    sine, cos_precession, sin_precession = _direction(-states[:, 4], states[:, 3])
    cosine = states[:, 5]
    x, y = _turned(states[:, 0], states[:, 1], cos_precession, -sin_precession)
    y, z = _turned(y, states[:, 2], cosine, -sine)
    x, y = _turned(x, y, np.cos(spin), -np.sin(spin))
    omega = (momentum * x / top.A, momentum * y / top.A, momentum * z / top.C)
    gamma = (sine * np.sin(spin), sine * np.cos(spin), cosine)
    return np.column_stack([*omega, *gamma]), np.arctan2(sin_precession, cos_precession)
