"""Free rigid body in four dimensions: the Euler top on so(4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Top


def field(y: Floats, p: Floats) -> Floats:
    """Return the components ij of [M, Omega] with Omega_ij = M_ij/(J_i + J_j); ``p`` is (J1, J2, J3, J4)."""
    m12, m13, m14, m23, m24, m34 = y
    J1, J2, J3, J4 = p
    w12, w13, w14 = m12 / (J1 + J2), m13 / (J1 + J3), m14 / (J1 + J4)
    w23, w24, w34 = m23 / (J2 + J3), m24 / (J2 + J4), m34 / (J3 + J4)
    return (
        m23 * w13 - m13 * w23 + m24 * w14 - m14 * w24,
        m12 * w23 - m23 * w12 + m34 * w14 - m14 * w34,
        m12 * w24 - m24 * w12 + m13 * w34 - m34 * w13,
        m13 * w12 - m12 * w13 + m34 * w24 - m24 * w34,
        m14 * w12 - m12 * w14 + m23 * w34 - m34 * w23,
        m14 * w13 - m13 * w14 + m24 * w23 - m23 * w24,
    )


PAIRS = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))


def m_sq(y: Floats, p: Floats) -> Any:
    """Sum of the squares of the six components of the angular momentum."""
    return y[0] ** 2 + y[1] ** 2 + y[2] ** 2 + y[3] ** 2 + y[4] ** 2 + y[5] ** 2


def pfaffian(y: Floats, p: Floats) -> Any:
    """Quadratic invariant m₁₂m₃₄ - m₁₃m₂₄ + m₁₄m₂₃, the Pfaffian of the angular momentum."""
    return y[0] * y[5] - y[1] * y[4] + y[2] * y[3]


def energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    return sum(m**2 / (p[i] + p[j]) for m, (i, j) in zip(y, PAIRS, strict=True)) / 2


def manakov(y: Floats, p: Floats) -> Any:
    """Quadratic integral of Manakov."""
    return sum((p[i] ** 2 + p[j] ** 2) * m**2 for m, (i, j) in zip(y, PAIRS, strict=True))


class So4(Top):
    """Euler top on so(4) (free rigid body in four dimensions).

    The angular momentum is M_ij = (J_i + J_j) Ω_ij, where Ω is the angular velocity and J_i the second moment of the
    mass along axis i. All four integrals of the motion are quadratic. The Hirota-Kimura (HK) map is integrable, and the
    degrees of its iterates grow like n². The four integrals of the map are quotients of the coefficients of HK bases
    (sets of linear relations that hold between monomials along an orbit). We know no simple form of these integrals.
    """

    kind = "so4"
    title = "Euler top on so(4) (free rigid body in four dimensions)"
    citation = "Manakov 1976; Petrera, Pfadler, Suris 2009 (HK map)"
    formula = r"""
\dot M = [M, \Omega], \qquad M_{ij} = (J_i + J_j)\,\Omega_{ij}
"""
    components = ("m12", "m13", "m14", "m23", "m24", "m34")
    field = staticmethod(field)
    integrals: ClassVar[Mapping[str, Integral]] = {
        "m_sq": m_sq,
        "pfaffian": pfaffian,
        "energy": energy,
        "manakov": manakov,
    }
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "m_sq": ("M²", "M^2"),
        "pfaffian": ("Pf M", r"\mathrm{Pf}\,M"),
        "energy": ("E", "E"),
        "manakov": ("I", "I"),
    }

    J1: float = Field(default=0.25, gt=0.0, description="second moment of the mass along the first axis; positive")
    J2: float = Field(default=0.5, gt=0.0, description="second moment of the mass along the second axis; positive")
    J3: float = Field(default=0.75, gt=0.0, description="second moment of the mass along the third axis; positive")
    J4: float = Field(default=1.5, gt=0.0, description="second moment of the mass along the fourth axis; positive")
