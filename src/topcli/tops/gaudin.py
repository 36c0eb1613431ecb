"""Gaudin magnet of two spins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from pydantic import Field

from topcli.contracts import Floats, Integral, Top


def field(y: Floats, p: Floats) -> Floats:
    """Return (lambda1 e3 + b) x a and (lambda2 e3 + a) x b; ``p`` is (lambda1, lambda2)."""
    a1, a2, a3, b1, b2, b3 = y
    u, v = p[0] + b3, p[1] + a3
    return (
        b2 * a3 - u * a2,
        u * a1 - b1 * a3,
        b1 * a2 - b2 * a1,
        a2 * b3 - v * b2,
        v * b1 - a1 * b3,
        a1 * b2 - a2 * b1,
    )


def a_sq(y: Floats, p: Floats) -> Any:
    """First spin, squared."""
    return y[0] ** 2 + y[1] ** 2 + y[2] ** 2


def b_sq(y: Floats, p: Floats) -> Any:
    """Second spin, squared."""
    return y[3] ** 2 + y[4] ** 2 + y[5] ** 2


def energy(y: Floats, p: Floats) -> Any:
    """Energy."""
    return y[0] * y[3] + y[1] * y[4] + y[2] * y[5] + p[0] * y[2] + p[1] * y[5]


def total(y: Floats, p: Floats) -> Any:
    """Sum of the components of the spins along the field."""
    return y[2] + y[5]


class Gaudin(Top):
    """Gaudin magnet (two spins of su(2) in a field along the third axis).

    In the rational Gaudin model, the spins a and b turn about each other and about the field. The strength of the field
    is λ₁ for a and λ₂ for b. The Hirota-Kimura (HK) map is integrable, and the degrees of its iterates grow like n².
    Two of its four integrals are polynomials. One is a₃ + b₃. The other is H + (a² + b²)/2 plus a term of size h²,
    where H is the energy.
    """

    kind = "gaudin"
    title = "Gaudin magnet (two spins in a field)"
    citation = "Gaudin 1976; Petrera, Pfadler, Suris 2011 (HK map)"
    formula = r"""
\dot a = (\lambda_1 e_3 + b)\times a, \qquad \dot b = (\lambda_2 e_3 + a)\times b
"""
    components = ("a1", "a2", "a3", "b1", "b2", "b3")
    vectors: ClassVar[Mapping[str, tuple[int, int]]] = {"a": (0, 3), "b": (3, 6)}
    swing = "a3"
    field = staticmethod(field)
    integrals: ClassVar[Mapping[str, Integral]] = {"a_sq": a_sq, "b_sq": b_sq, "energy": energy, "total": total}
    symbols: ClassVar[Mapping[str, tuple[str, str]]] = {
        "a_sq": ("a²", r"\boldsymbol{a}^2"),
        "b_sq": ("b²", r"\boldsymbol{b}^2"),
        "energy": ("H", "H"),
        "total": ("a₃+b₃", "a_3 + b_3"),
        "hk_energy": ("H mod", r"\widetilde{H}"),
    }

    lambda1: float = Field(default=0.5, description="strength of the field on the first spin")
    lambda2: float = Field(default=1.5, description="strength of the field on the second spin")

    def integrals_of(self, scheme: str, h: float) -> Mapping[str, Integral]:
        """Return H + (a² + b²)/2 - h²/8 |e3 x (lambda1 a + lambda2 b)|², which the HK map conserves."""

        def hk_energy(y: Floats, p: Floats) -> Any:
            """Energy plus (a² + b²)/2, modified so that the HK map conserves it."""
            u, v = p[0] * y[0] + p[1] * y[3], p[0] * y[1] + p[1] * y[4]
            return energy(y, p) + (a_sq(y, p) + b_sq(y, p)) / 2 - h**2 / 8 * (u**2 + v**2)

        return {"hk_energy": hk_energy} if scheme == "hk" else {}
