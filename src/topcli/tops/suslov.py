"""Suslov's problem: a rigid body that does not turn about one of its axes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Top


def field(y: Floats, p: Floats) -> Floats:
    """Return (-l omega2/I1, l omega1/I2) with l = I13 omega1 + I23 omega2; ``p`` is (I1, I2, I13, I23)."""
    w1, w2 = y
    I1, I2, I13, I23 = p
    torque = I13 * w1 + I23 * w2
    return (-torque * w2 / I1, torque * w1 / I2)


def omega(y: Floats, p: Floats) -> Floats:
    """Return the angular velocity (omega1, omega2, 0)."""
    return (y[0], y[1], 0.0)


def energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    return (p[0] * y[0] ** 2 + p[1] * y[1] ** 2) / 2


class Suslov(Top):
    """Suslov's problem (rigid body that does not turn about its third axis).

    A nonholonomic constraint keeps omega3 at zero. The ellipse of constant energy in the plane of omega1 and omega2
    consists of two steady rotations, for which the angular momentum l about the third axis is 0, and of two motions
    from one steady rotation to the other. The Hirota-Kimura (HK) map is integrable and conserves a modified energy. The
    degrees of its iterates grow like n.
    """

    kind = "suslov"
    title = "Suslov problem (nonholonomic constraint omega3 = 0)"
    citation = "Suslov 1946; Petrera, Pfadler, Suris 2011 (HK map)"
    formula = r"""
I_1\dot\omega_1 = -\ell\,\omega_2, \qquad I_2\dot\omega_2 = \ell\,\omega_1, \qquad
\ell = I_{13}\,\omega_1 + I_{23}\,\omega_2
"""
    components = ("omega1", "omega2")
    field = staticmethod(field)
    angular_velocity = staticmethod(omega)
    integrals: ClassVar[Mapping[str, Integral]] = {"energy": energy}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "energy": ("E", "E"),
        "modified_energy": ("E mod", r"\widetilde{E}"),
    }

    I1: float = Field(default=1.0, gt=0.0, description="first moment of inertia; positive")
    I2: float = Field(default=1.5, gt=0.0, description="second moment of inertia; positive")
    I13: float = Field(default=0.2, description="product of inertia of the first and third axes")
    I23: float = Field(default=0.5, description="product of inertia of the second and third axes")

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return E over 1 + h² l²/(4 I1 I2), which the HK map conserves."""

        def modified_energy(y: Floats, p: Floats) -> Any:
            """Energy, modified so that the HK map conserves it."""
            return energy(y, p) / (1 + (h / 2) ** 2 * (p[2] * y[0] + p[3] * y[1]) ** 2 / (p[0] * p[1]))

        return {"modified_energy": modified_energy} if scheme == "hk" else {}
