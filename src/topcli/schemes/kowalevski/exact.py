"""Motion of the Kowalevski top in closed form at any time, by Kowalevski's separation of variables (``separation``).

The set-up, once for each initial state, computes half periods in multiprecision and tabulates their inverses; a state
then costs the solution of one scalar equation and a rational formula. It assumes that the roots of the curve differ. A
state with equal roots, which is decided in rational arithmetic, is replaced by two others about 2^-200 away, in
different distances; a state at a later time is returned if both agree on it, and refused otherwise. On a separatrix
they agree until the time in which a deviation grows by 2^150; on any other motion with equal roots, for ever.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Floats, NoOptions, Sampler, Top
from topcli.errors import RunError
from topcli.schemes.kowalevski.curve import REFUSED, Integrals
from topcli.schemes.kowalevski.separation import EPS, Separated, separated_motion
from topcli.schemes.registry import closed_form

MOVE = tuple(Fraction(n, 1024 << 200) for n in (713, -431, 577, 389, -631, 467))
"""Change of a state with equal roots, in no special direction."""
EQUAL = Fraction(1, 1 << 500)
"""Discriminants below this count as zero."""
_AGREEMENT = 1e-13
"""Largest difference of the two states, relative to the terms of the equations."""
_LONGEST = 1e30
"""Longest time, in units of 1/|omega|; phases have 50 digits."""
SIDEWAYS = 0.01
"""Part of gamma² across the angular momentum from which on gamma² determines its length."""
PLANES = [0, 2, 4], [0, 1, 5]
"""Components that are 0 in the invariant planes: a pendulum about the second axis, and one about the third."""
WEAK = 1e-7
"""Round-off eps |omega|²/c, relative to gamma, from which on gravity is too weak."""


@lru_cache(maxsize=64)
def _motions(y: Floats, c: float) -> tuple[Separated, ...]:
    """Motion from the state ``y`` (6,), of the order of one; two motions next to it if roots are equal."""
    exact = tuple(map(Fraction, y))
    if min(map(abs, Integrals.of(exact, c).discriminants())) > EQUAL:
        try:
            return (separated_motion(exact, c),)
        except ZeroDivisionError:  # s1 and s2 are undetermined at this moment, but not next to it
            pass
    return tuple(separated_motion([v + k * d for v, d in zip(exact, MOVE, strict=True)], c) for k in (1, -2))


def _states(y: Floats, c: float, h: float, n: NDArray[np.int64]) -> Array:
    """States (m, 6) of the motion from ``y`` (6,), of the order of one. Raises RunError."""
    motions = _motions(y, c)
    states = motions[0].states(n, h)
    if len(motions) == 2:
        size = 1.0 + np.abs(states).max(axis=1) ** 2 / min(1.0, abs(c))
        differ = ~(np.abs(motions[1].states(n, h) - states).max(axis=1) <= _AGREEMENT * size)
        if differ.any():
            last = int(np.abs(n[differ]).min())
            raise RunError(
                REFUSED.format(f"the motion is unstable; its state at step {last} depends on 2^-200 of the first")
            )
    return states


def _with_integrals(states: Array, y: Floats, c: float) -> Array:
    """``states`` (m, 6) with gamma² and m.gamma of the initial state ``y``, where they determine gamma well.

    gamma is computed as a difference of terms of the size of omega²/c, which matters if |m|² exceeds c |gamma|; a
    shorter m has no accurate direction. A component that is 0 in an invariant plane stays 0.
    """
    w1, w2, w3 = y[:3]
    total, moment = y[3] * y[3] + y[4] * y[4] + y[5] * y[5], 2.0 * (w1 * y[3] + w2 * y[4]) + w3 * y[5]
    m, gamma = states[:, :3] * (2.0, 2.0, 1.0), states[:, 3:]
    with np.errstate(all="ignore"):
        square_m = (m * m).sum(axis=1, keepdims=True)
        along = m / square_m
        across = gamma - along * (m * gamma).sum(axis=1, keepdims=True)
        square = (across * across).sum(axis=1, keepdims=True)
        due = total - moment * moment / square_m
        better = moment * along + across * np.sqrt(due / square)
        determined = (due > SIDEWAYS * total) & (square > SIDEWAYS * total) & (square_m > abs(c) * math.sqrt(total))
        states[:, 3:] = np.where(determined, better, gamma)
    for plane in PLANES:
        if not any(y[i] for i in plane):
            states[:, plane] = 0.0
    return states


def _at_rest(y: Floats, c: float) -> bool:
    """True if the state is an equilibrium, exactly."""
    w1, w2, w3, g1, g2, g3 = map(Fraction, y)
    f = Fraction(c)
    return not any((w2 * w3, f * g3 - w3 * w1, f * g2, g2 * w3 - g3 * w2, g3 * w1 - g1 * w3, g1 * w2 - g2 * w1))


def kowalevski_states(y0: Array, h: float, n: NDArray[np.int64], p: Floats) -> Array:
    """States (m, 6) of the motion after ``n`` (m,) steps of ``h`` from ``y0`` (6,); ``p`` are the constants of the top.

    Raises RunError for motions that are not covered.
    """
    y, c = tuple(float(v) for v in y0), float(p[0])
    if _at_rest(y, c):
        return np.tile(np.array(y), (len(n), 1))
    if c == 0.0 or not any(y[3:]):
        from topcli.schemes.classical.euler import euler_states as free_states

        return free_states(np.array(y), h, n, (2.0, 2.0, 1.0))  # the free symmetric top
    off = EPS * sum(v * v for v in y[:3]) / abs(c)
    if off > WEAK * math.hypot(*y[3:]):
        why = f"gravity is too weak to be resolved: gamma would be uncertain by eps |omega|²/c = {off:.0e}"
        raise RunError(REFUSED.format(why))
    # units of time of 2^-unit, in which omega and c gamma are of the order of one; powers of two round nothing
    size = max(*(abs(v) for v in y[:3]), math.sqrt(abs(c)) * math.sqrt(max(abs(v) for v in y[3:])))
    unit = math.frexp(size)[1]
    try:
        scaled, step, omega = math.ldexp(c, -2 * unit), math.ldexp(h, unit), [math.ldexp(v, -unit) for v in y[:3]]
    except OverflowError:
        raise RunError(REFUSED.format(f"a step of {h:g} is too long for |omega| of 2^{unit}")) from None
    if not abs(step) * float(np.abs(n).max(initial=0)) < _LONGEST:
        raise RunError(REFUSED.format(f"a run of {n[-1]:g} steps of {h:g} is longer than the digits of its phases"))
    states = _states((*omega, *y[3:]), scaled, step, n)
    states[:, :3] = np.ldexp(states[:, :3], unit)
    return _with_integrals(states, y, c)


@closed_form(top="kowalevski")
def build_kowalevski(top: Top, options: NoOptions) -> Sampler:
    r"""Closed form by separation of variables.

    The scheme evaluates the exact motion of the Kowalevski top at any time, from Kowalevski's variables s1 and s2.

    The set-up for an initial state takes about a tenth of a second.

    Source
    ------
    Kowalevski 1889; Kötter 1893; Golubev, Lectures on Integration of the Equations of Motion

    Equations
    ---------
    (K1) and (K2) of the paper, solved by hyperelliptic integrals of genus two

    Formula
    -------
    (s_1 - s_2)^2\,\dot s_i^2 = -\Phi(s_i), \qquad \Phi(s) = 4\prod_{i=1}^5 (s - e_i)

    Limits
    ------
    huge
        The product c gamma is computed as a difference of terms of the size of |omega|², so gamma has an error of about
        eps |omega|²/c, with the machine epsilon eps and c = c0/C. A motion is refused if this exceeds 1e-7 |gamma|.
    critical orbits
        A motion is refused if s1 or s2 stays at a double root of the cubic factor of Phi, as for omega = (0, 1, 2),
        gamma = (0, 0, 1), c0 = 2. Motions near such a motion are computed.
    weak gravity
        The error eps |omega|²/c of gamma is about 1e-10 for c = 1e-6 and |omega| = 1. A motion is refused if it exceeds
        1e-7 |gamma|.
    near a separatrix
        The initial state is taken as exact. Near an unstable motion, an error of one ulp (unit in the last place) in
        the initial state grows exponentially, and this limits the accuracy of later states. A state exactly on a
        separatrix, or on an unstable motion, is computed until a deviation has grown by 2^150, and refused at later
        times.
    """
    return Sampler(kowalevski_states)
