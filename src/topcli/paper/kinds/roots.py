"""The roots of w² = z: the angles that the paper gives for them, and the choice between them."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from topcli.paper.algebra import Draws
from topcli.paper.claim import Bound, Finding, Kind
from topcli.runs.simulate_ensemble import simulate_ensemble
from topcli.schemes.kowalevski.bohlin import direct

POINTS = 50
PERIODS = 3
"""Multiples of a period of the angle, of either sign, that are tried."""


def _farthest(fraction: float, period: float) -> float:
    """Largest distance, relative to |w|, of a root w of w² = z from the nearest sqrt(R) e^{i phi}.

    z = R e^{i Phi} with Phi from atan2, and phi = ``fraction`` Phi modulo ``period``.
    """
    draws, largest = Draws(1), 0.0
    for _ in range(POINTS):
        root = complex(float(draws.number()), float(draws.number()))
        z = root * root
        angle, size = fraction * math.atan2(z.imag, z.real), math.sqrt(abs(z))
        found = [cmath.rect(size, angle + k * period) for k in range(-PERIODS, PERIODS + 1)]
        for wanted in (root, -root):
            largest = max(largest, min(abs(wanted - w) for w in found) / size)
    return largest


def both_roots(fraction: float, period: float, corrected: float | None = None) -> Finding:
    """Distance of the farther root of w² = z from the angles ``fraction`` Phi mod ``period``, or mod ``corrected``."""
    bound = Bound(0.0, 1e-14, "rounding of a square, a root and an angle in doubles")
    return Finding(_farthest(fraction, period), bound, None if corrected is None else _farthest(fraction, corrected))


def _wrong(changes: Mapping[str, Any]) -> tuple[int, int]:
    """Number of orbits on which a step takes the root farther from its prediction, and number of orbits."""
    found = simulate_ensemble("kowalevski_bohlin_a", **changes)
    wrong = 0
    for index in range(len(found)):
        run = found.trajectory(index)
        old, new = run.states[:-1].T, run.states[1:].T
        x, y = direct(tuple(old), run.h, run.top.constants())
        # the other root, minus this one, is nearer to the prediction where their scalar product is negative
        wrong += bool((new[0] * x + new[1] * y < 0.0).any())
    return wrong, len(found)


def wrong_roots(changes: Mapping[str, Any], also: Mapping[str, Any] | None = None) -> Finding:
    """Number of orbits of Bohlin's method with a wrong root; the note adds that of other orbits."""
    wrong, count = _wrong(changes)
    bound = Bound(0.0, 0.0, "the right root is the nearer one", f"of {count} orbit{'s' if count > 1 else ''}")
    note = ""
    if also is not None:
        note = "{} of {} states next to the negative real axis, in a step of {h:g}".format(*_wrong(also), **also)
    return Finding(float(wrong), bound, note=note)


SIGN = {"name": "bohlin-a", "branch": "sign"}
FIGURE_2: dict[str, Any] = {
    "scheme": SIGN,
    "ensemble": {"states": [{"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]}], "store": "trajectories"},
}
BY_SIGN: dict[str, Any] = {
    "h": 0.05,
    "N": 2000,
    "scheme": SIGN,
    "ensemble": {
        "random": {"count": 200, "seed": 1, "gamma": "sphere", "omega": {"energy": 5.0}},
        "store": "trajectories",
    },
}


def next_to_axis(h: float, count: int = 200) -> dict[str, Any]:
    """Choice by sign at random states whose predicted omega is within h² of the negative real axis."""
    draws = np.random.default_rng(1)
    states = []
    for _ in range(count):
        omega1, omega3, gamma = -draws.uniform(0.3, 2.0), draws.uniform(-1.5, 1.5), draws.normal(size=3)
        gamma /= np.linalg.norm(gamma)
        omega2 = 0.5 * h * (omega3 * omega1 - gamma[2]) + h * h * draws.uniform(-1.0, 1.0)
        states.append({"omega": [omega1, omega2, omega3], "gamma": gamma.tolist()})
    return {"h": h, "N": 1, "scheme": SIGN, "ensemble": {"states": states, "store": "trajectories"}}


CROSSING: dict[str, Any] = {
    "ensemble": {
        "states": [{"omega": [-0.8, 1e-3 * k, 0.5], "gamma": [0.6, -0.48, -0.64]} for k in range(40)],
        "store": "trajectories",
    },
    "h": 0.2,
    "N": 2,
}
"""Orbits whose omega_1 + i omega_2 crosses the negative real axis, where the argument jumps."""
ANGLES = Kind(
    "angles of the roots",
    "largest distance of a root of w² = z from the nearest angle, relative to |w|, for 50 random z",
    "Φ modulo π, not halved",
    lambda: both_roots(1.0, math.pi),
)
ROOTS = Kind(
    "choice of the root",
    "number of orbits on which a step takes the root farther from its prediction",
    "40 states whose omega crosses the negative real axis, under the choice by sign",
    lambda: wrong_roots(BY_SIGN | CROSSING),
)
