"""Motion of the Kowalevski top in closed form at any time, by Kowalevski's separation of variables.

The set-up of ``closed_form``, once for each initial state, computes half periods in multiprecision and tabulates their
inverses; a state then costs the solution of one scalar equation and a rational formula.
"""

from __future__ import annotations

import math
import threading
from fractions import Fraction
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Accuracy, Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.kowalevski.closed_form import EPS, Motion, set_up
from topcli.schemes.registry import scheme

KEPT = 64
"""Motions kept in memory."""


@cache
def _kept() -> dict[tuple[Floats, float], Motion]:
    """Motions by initial state and c; not a global, whose content would count as code of the scheme."""
    return {}


@cache
def _lock() -> Any:
    return threading.Lock()


_lock()


def _keep(key: tuple[Floats, float], motion: Motion) -> Motion:
    with _lock():
        known = _kept()
        known.pop(key, None)
        known[key] = motion
        while len(known) > KEPT:
            del known[next(iter(known))]
    return motion


def _motion(y: Floats, c: float) -> Motion:
    """Motion from the state ``y`` (6,), of the order of one; set up if it is not in memory."""
    return _kept().get((y, c)) or _keep((y, c), set_up(y, c))


def _at_rest(y: Floats, c: float) -> bool:
    """True if the state is an equilibrium, exactly."""
    w1, w2, w3, g1, g2, g3 = map(Fraction, y)
    f = Fraction(c)
    return not any((w2 * w3, f * g3 - w3 * w1, f * g2, g2 * w3 - g3 * w2, g3 * w1 - g1 * w3, g1 * w2 - g2 * w1))


def _is_free(y: Floats, c: float) -> bool:
    """True if the motion is that of a free symmetric top."""
    return c == 0.0 or not any(y[3:])


class _Units(NamedTuple):
    """Motion in units of time of 2^-``unit``, in which omega and c gamma are of the order of one: state and c."""

    unit: int
    y: Floats
    c: float


def _in_units(y: Floats, c: float) -> _Units:
    """Motion from the state ``y`` (6,) in units of its own; powers of two round nothing. Raises RunError."""
    size = max(*(abs(v) for v in y[:3]), math.sqrt(abs(c)) * math.sqrt(max(abs(v) for v in y[3:])))
    unit = math.frexp(size)[1]
    try:
        scaled, omega = math.ldexp(c, -2 * unit), tuple(math.ldexp(v, -unit) for v in y[:3])
    except OverflowError:
        scaled, omega = 0.0, y[:3]
    if abs(scaled) < 1e-200:
        raise RunError("kowalevski, scheme exact: gravity is too weak to be resolved; use scheme 'taylor'")
    return _Units(unit, (*omega, *y[3:]), scaled)


def exact_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the motion after ``n`` (m,) steps of ``h`` from ``y0`` (6,); ``p`` are the constants of the top.

    Raises RunError for motions that are not covered.
    """
    y, c = tuple(float(v) for v in y0), float(p[0])
    if _at_rest(y, c):
        return np.tile(np.array(y), (len(n), 1))
    if _is_free(y, c):
        from topcli.schemes.euler.exact import exact_states as free_states

        return free_states(np.array(y), h, n, (2.0, 2.0, 1.0))  # the free symmetric top
    unit, scaled, gravity = _in_units(y, c)
    try:
        step = math.ldexp(h, unit)
    except OverflowError:
        raise RunError(f"kowalevski, scheme exact: a step of {h:g} is too long for |omega| of 2^{unit}") from None
    found = _motion(scaled, gravity).states(n, step)
    found[:, :3] = np.ldexp(found[:, :3], unit)
    return found


def exact_accuracy(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Accuracy:
    """Bound of the round-off of a motion, and its sensitivity at the steps ``n`` (m,)."""
    y, c = tuple(float(v) for v in y0), float(p[0])
    gamma = math.hypot(*y[3:])
    # omega1² + omega2² + omega3²/2 = E - c gamma1
    speed_sq = 2.0 * (y[0] ** 2 + y[1] ** 2 + 0.5 * y[2] ** 2 + abs(c) * (abs(y[3]) + gamma))
    reason, round_off = "eps |omega|²/c in gamma", 0.0
    if _is_free(y, c):
        reason, round_off = "eps |omega|", EPS * math.sqrt(speed_sq)
    elif not _at_rest(y, c):
        round_off = EPS * max(1.0, math.sqrt(speed_sq), gamma, speed_sq / abs(c))
    moved = np.nextafter(y0, np.where(y0 == 0.0, 0.0, np.inf))
    try:
        change = exact_states(moved, h, n, p) - exact_states(np.array(y), h, n, p)
    except RunError:
        return Accuracy(round_off, reason, None)
    return Accuracy(round_off, reason, float(np.abs(change).max()))


@scheme(
    "exact",
    top="kowalevski",
    title="Closed form by separation of variables",
    order=None,
    explicit=True,
    self_adjoint=True,
    conserves=("gamma_sq", "two_l", "energy", "k_sq"),
    citation="Kowalevski 1889; Kötter 1893; Golubev, Lectures on Integration of the Equations of Motion",
    formula=r"""
(s_1 - s_2)^2\,\dot s_i^2 = -\Phi(s_i), \qquad \Phi(s) = 4\prod_{i=1}^5 (s - e_i)
""",
    equations="(K1) and (K2) of the paper, solved by hyperelliptic integrals of genus two",
    limits={
        "huge": "The product c gamma is computed as a difference of terms of the size of |omega|², so gamma has an "
        "error of about eps |omega|²/c, with the machine epsilon eps and c = c0/C. A motion is refused if |omega| "
        "exceeds about 1e100 sqrt(c).",
        "critical orbits": "A motion is refused if s1 or s2 stays at a double root of the cubic factor of Phi, as for "
        "omega = (0, 1, 2), gamma = (0, 0, 1), c0 = 2. Motions near such a motion are computed.",
        "weak gravity": "The error eps |omega|²/c of gamma is about 1e-10 for c = 1e-6 and |omega| = 1. A motion is "
        "refused if its states differ from those of a Taylor series by more than 1e-10 (1 + |omega|²/c).",
        "near a separatrix": "The initial state is taken as exact. Near an unstable motion, an error of one ulp (unit "
        "in the last place) in the initial state grows exponentially, and this limits the accuracy of later states.",
    },
)
def build_exact(top: Top, options: NoOptions) -> Sampler:
    """The scheme evaluates the exact motion of the Kowalevski top at any time, from Kowalevski's variables s1 and s2.

    The set-up for an initial state takes about a tenth of a second.
    """
    return Sampler(exact_states, exact_accuracy)
