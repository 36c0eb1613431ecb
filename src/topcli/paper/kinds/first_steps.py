"""States at which the printed formulas of Methods (A), (B) and (C) give no new gamma."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from topcli.paper import printed
from topcli.paper.algebra import Vector
from topcli.paper.claim import Bound, Finding, Kind

H = 0.01


def _a(w: Vector, c: Vector) -> Sequence[float]:
    """Solve (A), which is linear in the new gamma."""
    turn = 0.5 * H * np.array(printed.hat(w), dtype=float)
    return np.linalg.solve(np.eye(3) - turn, (np.eye(3) + turn) @ np.array(c)).tolist()


def _b(w: Vector, c: Vector) -> Sequence[float]:
    """Euler's rule for z of (B), and back."""
    z = complex(c[0], c[1]) / (1.0 + c[2])
    omega = complex(w[0], w[1])
    z += 0.5j * H * (omega - 2.0 * w[2] * z - omega.conjugate() * z * z)
    size = abs(z) ** 2
    return [2.0 * z.real / (1.0 + size), 2.0 * z.imag / (1.0 + size), (1.0 - size) / (1.0 + size)]


def _c(w: Vector, c: Vector) -> Sequence[float]:
    """The rotation (C) with n = theta/|theta|."""
    theta = [H * x for x in w]
    size = math.hypot(*theta)
    R = printed.rotation((theta[0] / size, theta[1] / size, theta[2] / size), math.cos(size), math.sin(size))
    return (np.array(R) @ np.array(c)).tolist()


METHODS = {"A": _a, "B": _b, "C": _c}
STATES: Mapping[str, tuple[Vector, Vector]] = {
    "γ₃ = -1": ((0.7, -0.4, 1.3), (0.0, 0.0, -1.0)),
    "ω = 0": ((0.0, 0.0, 0.0), (0.6, 0.48, 0.64)),
}


def undefined(states: Mapping[str, tuple[Vector, Vector]]) -> Finding:
    """Number of methods whose printed formulas divide by zero in the first step from one of the states."""
    found: dict[str, list[str]] = {}
    for letter, method in METHODS.items():
        for name, (w, c) in states.items():
            try:
                assert np.isfinite(method(w, c)).all()
            except ZeroDivisionError:
                found.setdefault(letter, []).append(name)
    note = "; ".join(f"({letter}) at {', '.join(names)}" for letter, names in found.items())
    bound = Bound(1.0, reason="a method without a singular state divides by zero nowhere", unit="of 3 methods")
    return Finding(float(len(found)), bound, note=note)


UNDEFINED = Kind(
    "undefined step",
    "number of the methods (A), (B), (C) whose formulas, as printed, divide by zero in a step from one of the states",
    "a state in general position",
    lambda: undefined({"general": ((0.7, -0.4, 1.3), (0.6, 0.48, 0.64))}),
)
