"""Motion of the Kowalevski top in closed form: any time directly, by Kowalevski's separation of variables.

The motion separates into two hyperelliptic integrals of genus two (``separation``). The set-up, once for each initial
state, computes their half periods in multiprecision and tabulates their inverses (``oval``, ``oval_table``); a state
then costs the solution of one scalar equation (``separated_motion``) and a rational formula (``state_of_factors``).
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.kowalevski.pendulum import Pendulum, is_pendulum
from topcli.schemes.kowalevski.separated_motion import SeparatedMotion
from topcli.schemes.registry import scheme

TRIPLE_ROOT = (
    "At k = 0 and E = 2 l²/gamma² three roots of the curve coincide, for example for a body that spins about the "
    "vertical third axis; these motions are refused."
)


@lru_cache(maxsize=64)
def _motion(y: Floats, c: float) -> Pendulum | SeparatedMotion:
    return Pendulum.of(y, c) if is_pendulum(y, c) else SeparatedMotion(y, c)


def _at_rest(y: Floats, c: float) -> bool:
    """True if the state is an equilibrium, exactly."""
    w1, w2, w3, g1, g2, g3 = map(Fraction, y)
    f = Fraction(c)
    return not any((w2 * w3, f * g3 - w3 * w1, f * g2, g2 * w3 - g3 * w2, g3 * w1 - g1 * w3, g1 * w2 - g2 * w1))


def exact_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the motion after ``n`` (m,) steps of ``h`` from ``y0`` (6,); ``p`` are the constants of the top.

    Raises RunError for motions that are not covered.
    """
    y, c = tuple(float(v) for v in y0), float(p[0])
    if _at_rest(y, c):
        return np.tile(np.array(y), (len(n), 1))
    if c == 0.0 or not any(y[3:]):
        from topcli.schemes.euler.exact import exact_states as free_states

        return free_states(np.array(y), h, n, (2.0, 2.0, 1.0))  # the free symmetric top
    # in units of time of 2^-unit the state is of the order of one; powers of two round nothing
    size = max(*(abs(v) for v in y[:3]), math.sqrt(abs(c)) * math.sqrt(max(abs(v) for v in y[3:])))
    unit = math.frexp(size)[1]
    try:
        scaled = math.ldexp(c, -2 * unit)
        omega = tuple(math.ldexp(v, -unit) for v in y[:3])
        step = math.ldexp(h, unit)
    except OverflowError:
        scaled, omega, step = 0.0, y[:3], h
    if abs(scaled) < 1e-200:
        raise RunError("kowalevski, scheme exact: gravity is too weak to be resolved; use scheme 'taylor'")
    found = _motion((*omega, *y[3:]), scaled).states(n, step)
    found[:, :3] = np.ldexp(found[:, :3], unit)
    return found


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
    equations="(K1), (K2), solved by hyperelliptic integrals of genus two",
    limits={
        "delone-sleeping": TRIPLE_ROOT,
        "rest-on-axis": TRIPLE_ROOT,
        "huge": "c gamma is found as a difference of terms of the size of |omega|², with an error of eps |omega|²/c in "
        "gamma; beyond |omega| of about 1e100 sqrt(c) the motion is refused.",
        "weak gravity": "The error eps |omega|²/c of gamma is 1e-10 for c = 1e-6 and |omega| = 1. A motion is refused "
        "if its states differ from steps of Taylor series by more than 1e-10 (1 + |omega|²/c).",
        "near a separatrix": "The initial state is taken as exact. Next to an unstable motion an error of one ulp in "
        "it grows exponentially, and the state is as accurate as that allows.",
    },
)
def build_exact(top: Top, options: NoOptions) -> Sampler:
    """Every state directly from the initial one, at any time, by Kowalevski's variables; no time stepping.

    The set-up of an initial state takes some tenths of a second.
    """
    return Sampler(exact_states)
