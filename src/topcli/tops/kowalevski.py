"""Kowalevski top: A = B = 2C, centre of gravity on the first axis (Sogo, section 3)."""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field, model_validator

from topcli.contracts import EulerPoisson, Floats, Invariant, invariant_of
from topcli.tops import BodyTop, gamma_sq


def kowalevski_field(y: Floats, p: Floats) -> Floats:
    """Right-hand side of Sogo's (K1), (K2), with c = mg x0/C = ``p[0]``."""
    w1, w2, w3, g1, g2, g3 = y
    c = p[0]
    return (
        0.5 * w2 * w3,
        0.5 * (c * g3 - w3 * w1),
        -c * g2,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


class Kowalevski(BodyTop):
    r"""Kowalevski top (A = B = 2C, centre of gravity on the first axis).

    The moments of inertia are (A, A, A/2), and mg(x0, y0, z0) = (c0, 0, 0). All quantities are dimensionless. The paper
    (Sogo, Discrete Spinning Tops) sets A = B = 2, C = 1 "without loss of generality"; these are the defaults. For
    another A, the equations of motion divided by C = A/2 are those of the paper with c = c0/C instead of c0. The
    angular momentum 2l about the vertical and the energy E are then C times the expressions of the paper, and k² =
    |(omega1 + i omega2)² - c (gamma1 + i gamma2)|². With c0 = 0 the top is the free symmetric top.

    Source
    ------
    Kowalevski 1889; Sogo, Discrete Spinning Tops, section 3

    Formula
    -------
    2\dot\omega_1 = \omega_2\omega_3, \qquad 2\dot\omega_2 = -\omega_3\omega_1 + c\,\gamma_3, \qquad
    \dot\omega_3 = -c\,\gamma_2, \qquad \dot\gamma = \gamma\times\omega, \qquad c = \frac{c_0}{C}
    """

    kind = "kowalevski"
    form = "kowalevski"
    swing = "gamma1"
    step_constants = ("c = c0/C",)
    field = staticmethod(kowalevski_field)

    c0: float = Field(
        default=1.0,
        description="mg x0, the weight times the first coordinate of the centre of gravity; may be negative",
    )
    A: float = Field(default=2.0, gt=0.0, description="first and second moment of inertia; the third is A/2")

    @model_validator(mode="after")
    def _in_range(self) -> Kowalevski:
        if not (self.C > 0.0 and math.isfinite(self.c0 / self.C)):
            raise ValueError(f"A = {self.A!r} and c0 = {self.c0!r} are out of range: c0/(A/2) is not finite")
        return self

    @property
    def C(self) -> float:
        """Third moment of inertia, A/2."""
        return self.A / 2

    def constants(self) -> Floats:
        """Return ``(c,)`` with c = c0/C."""
        return (self.c0 / self.C,)

    def euler_poisson(self) -> EulerPoisson:
        """Return the coefficients of this top in the general Euler-Poisson equations."""
        return EulerPoisson((self.A, self.A, self.C), (self.c0, 0.0, 0.0))

    def invariants(self) -> tuple[Invariant, ...]:
        """Return gamma², 2l = m·gamma, E and Kowalevski's k²; Sogo, section 3.1."""
        C, c0, c = self.C, self.c0, self.c0 / self.C

        def two_l(y: Floats, p: Floats) -> Any:
            """Angular momentum about the vertical."""
            return C * (2 * (y[0] * y[3] + y[1] * y[4]) + y[2] * y[5])

        def energy(y: Floats, p: Floats) -> Any:
            """Energy."""
            return C * (y[0] ** 2 + y[1] ** 2 + y[2] ** 2 / 2) + c0 * y[3]

        def k_sq(y: Floats, p: Floats) -> Any:
            """Kowalevski's integral |(ω₁ + iω₂)² - c(γ₁ + iγ₂)|²."""
            return (y[0] ** 2 - y[1] ** 2 - c * y[3]) ** 2 + (2 * y[0] * y[1] - c * y[4]) ** 2

        return (
            invariant_of("gamma_sq", gamma_sq, (), ("γ²", r"\gamma^2")),
            invariant_of("two_l", two_l, (), ("2l", r"2\ell")),
            invariant_of("energy", energy, (), ("E", "E")),
            invariant_of("k_sq", k_sq, (), ("k²", "k^2")),
        )
