"""Checks of the printed methods A, B, C and of Bohlin's: roots of w² = z, and states without a step."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from topcli.paper import printed
from topcli.paper.algebra import Draws, Numbers, exact, plane
from topcli.paper.claim import Measurement
from topcli.runs.simulate import simulate_ensemble
from topcli.schemes.kowalevski.bohlin import direct

ROOT_POINTS = 50
PERIODS = 3
"""Multiples of a period of the angle, of either sign, that are tried."""


def _farthest(fraction: float, period: float) -> float:
    """Largest distance, relative to |w|, of a root w of w² = z from the nearest sqrt(R) e^{i phi}.

    z = R e^{i Phi} with Phi from atan2, and phi = ``fraction`` Phi modulo ``period``.
    """
    draws, distance = Draws(1), 0.0
    for _ in range(ROOT_POINTS):
        root = complex(float(draws.number()), float(draws.number()))
        z = root * root
        angle, size = fraction * math.atan2(z.imag, z.real), math.sqrt(abs(z))
        listed = [cmath.rect(size, angle + k * period) for k in range(-PERIODS, PERIODS + 1)]
        for wanted in (root, -root):
            distance = max(distance, min(abs(wanted - w) for w in listed) / size)
    return distance


def angles(fraction: float, halves: int, corrected: int | None = None) -> Measurement:
    """Distance of the farther root of w² = z from the angles ``fraction`` Phi modulo ``halves`` pi.

    ``corrected`` is the right number of times pi.
    """
    return Measurement(
        _farthest(fraction, halves * math.pi), corrected=corrected and _farthest(fraction, corrected * math.pi)
    )


def _wrong(orbits: Mapping[str, Any]) -> tuple[int, int]:
    """Number of orbits on which a step takes the root farther from its prediction, and number of orbits."""
    runs = simulate_ensemble("kowalevski_bohlin_a", **orbits)
    wrong = 0
    for index in range(len(runs)):
        run = runs.trajectory(index)
        old, new = run.states[:-1].T, run.states[1:].T
        x, y = direct(tuple(old), run.h, run.top.constants())
        # the other root, minus this one, is nearer to the prediction where their scalar product is negative
        wrong += bool((new[0] * x + new[1] * y < 0.0).any())
    return wrong, len(runs)


SIGN = {"name": "bohlin-a", "branch": "sign"}


def roots(orbits: dict[str, Any], crossing: int = 0, beside_axis: float | None = None) -> Measurement:
    """Number of orbits of Bohlin's method with a wrong root.

    With ``crossing`` the orbits begin at so many states whose omega_1 + i omega_2 crosses the negative real axis, where
    the argument jumps. The note adds the number at states beside that axis, in one step of ``beside_axis``.
    """
    if crossing:
        states = [{"omega": [-0.8, 1e-3 * k, 0.5], "gamma": [0.6, -0.48, -0.64]} for k in range(crossing)]
        orbits = orbits | {"ensemble": {"states": states, "store": "trajectories"}}
    wrong, count = _wrong(orbits)
    note = ""
    if beside_axis is not None:
        near = "{} of {} states".format(*_wrong(next_to_axis(beside_axis)))
        note = f"{near} next to the negative real axis, in a step of {beside_axis:g}"
    return Measurement(float(wrong), note=note, unit=f"of {count} orbit{'s' if count > 1 else ''}")


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


H = 0.01


def _method_a(w: Numbers, c: Numbers) -> Numbers:
    """Solve (A), which is linear in the new gamma."""
    turn = 0.5 * H * printed.hat(w).astype(float)
    return np.linalg.solve(np.eye(3) - turn, (np.eye(3) + turn) @ c.astype(float))


def _method_b(w: Numbers, c: Numbers) -> Numbers:
    """Euler's rule for z of (B), and back."""
    z = plane(c) / (1.0 + c[2])
    z += H * printed.stereographic_rate(plane(w), w[2], z)
    size = (z * z.bar).first
    gamma = 2.0 * z / (1.0 + size)
    return exact(gamma.first, gamma.second, (1.0 - size) / (1.0 + size))


def _method_c(w: Numbers, c: Numbers) -> Numbers:
    """The rotation (C) with n = theta/|theta|."""
    size = math.hypot(*(H * w))
    return printed.rotation(H * w / size, math.cos(size), math.sin(size)) @ c


METHODS: Mapping[str, Callable[[Numbers, Numbers], Numbers]] = {"A": _method_a, "B": _method_b, "C": _method_c}
"""New gamma from old omega and gamma by the printed formulas, with the step ``H``."""


def undefined_steps(states: dict[str, tuple[list[float], list[float]]]) -> Measurement:
    """Number of methods whose printed formulas divide by zero in the first step from one of the states."""
    singular: dict[str, list[str]] = {}
    for letter, method in METHODS.items():
        for name, (w, c) in states.items():
            try:
                method(exact(*w), exact(*c))
            except ZeroDivisionError:
                singular.setdefault(letter, []).append(name)
    note = "; ".join(f"({letter}) at {', '.join(names)}" for letter, names in singular.items())
    return Measurement(float(len(singular)), note=note)
