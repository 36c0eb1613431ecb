"""Motion of the Kowalevski top: class of the torus, frequencies, distance to a separatrix, bifurcation diagram.

All from the roots of Kowalevski's curve and integrals over its two real ovals (``schemes.kowalevski.curve``).

For given L = l c and G = c² gamma² two roots of Phi (``curve``) coincide on the curves

    k² = (E - 2 L²/G)²,    k = 0 (Delone),    E = x² + L/x, k² = G + x⁴ - 2 L x (a double root x of R).

What happens there follows from the place of the double root among the ovals of s1 and s2: (-inf, r] and [a, b]. Where
two roots of the cubic meet between r and a, half of the tori shrink to a motion of Bobylev and Steklov, omega1 = x and
omega2 = 0, and nothing happens to the others.
The kinds of the curves are computed for arrays, for pictures, and for numbers of mpmath, for a single motion. Energies
are divided by the third moment of inertia; L = l c and G = c² gamma².
Source: Kharlamov, Prikl. Mat. Mekh. 47 (1983) 922-930; Bolsinov, Richter, Fomenko, Sb. Math. 191 (2000) 151-188.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.motion import Motion, MotionQuantity, integrals_of
from topcli.arithmetic.multiprecision import DIGITS, Real, digits, mp, real
from topcli.contracts import Array, Floats
from topcli.schemes.kowalevski.curve import Curve, Integrals
from topcli.schemes.kowalevski.separation import ROOT_DIGITS, Separated
from topcli.tops.kowalevski import Kowalevski, kowalevski_field

DISTANCE = "distance to the nearest separatrix: the smallest change of E/C or of k that leads there"


def _coincide(curve: Curve) -> tuple[bool, bool]:
    """True if an end of an oval is a double root, and true if the oval of s1 is a point."""
    e, (top, low, high) = curve.e, curve.occupied()
    equal = [{i, j} for i in range(5) for j in range(i) if abs(e[i] - e[j]) < mp.mpf(10) ** (-mp.dps // 4)]
    return any(pair & {top, low, high} and pair != {low, high} for pair in equal), {low, high} in equal


def kowalevski_motion(top: Kowalevski, y: Floats) -> Motion:
    """Motion of the Kowalevski top from the state ``y`` (6,), with gravity."""
    c = float(top.constants()[0])
    of = Integrals.of(y, c)
    conserved = integrals_of(top, y)
    w1, w2, w3, _, _, g3 = exact = tuple(map(Fraction, y))
    if not any(kowalevski_field(exact, (Fraction(c),))):  # type: ignore[arg-type]
        return Motion(top.form, "equilibrium", "equilibrium: omega and gamma are constant", y, conserved)
    if w2 == 0 and Fraction(c) * g3 == w1 * w3:  # beside the torus with the same integrals
        return Motion(top.form, "pendulum", "pendulum (Bobylev-Steklov): ω2 = 0 at all times", y, conserved)
    with digits(ROOT_DIGITS):
        curve = Curve.with_integrals(of)
        on_separatrix, point = _coincide(curve) if 0 in of.discriminants() else (False, False)
        if not (on_separatrix or point):
            return _torus(top, y, Separated(curve, c), conserved)
    what = "roots of Kowalevski's curve coincide, so there are no frequencies"
    if point:
        return Motion(top.form, "critical", f"critical motion: {what}", y, conserved)
    distance = MotionQuantity("separatrix.distance", 0.0, DISTANCE)
    return Motion(top.form, "separatrix", f"at the integrals of a separatrix: {what}", y, (*conserved, distance))


def _torus(top: Kowalevski, y: Floats, motion: Separated, conserved: Sequence[MotionQuantity]) -> Motion:
    where = region(motion.curve)
    period1, period2 = (float(2 / rate) for rate in motion.rates)
    # oscillations of s1 and s2 after which all signs of the state are those of the start
    n1, n2 = 1 if motion.one.low == 4 else 2, 2
    times = {1: "once", 2: "twice"}
    angle = "cycles per unit time of the {} angle; {} oscillates {} in a cycle".format
    first, second = 1.0 / (n1 * period1), 1.0 / (n2 * period2)
    quantities = [
        *conserved,
        MotionQuantity("frequency.1", first, angle("first", "s1", times[n1])),
        MotionQuantity("frequency.2", second, angle("second", "s2", times[n2])),
        MotionQuantity("frequency.ratio", first / second, "rotation number frequency.1/frequency.2"),
        MotionQuantity("period.s1", period1, "time of one oscillation of s1"),
        MotionQuantity("period.s2", period2, "time of one oscillation of s2, from one zero of ω2 to the next"),
        MotionQuantity("period.omega2", n2 * period2, "mean time of a full oscillation of ω2"),
    ]
    distance = separatrix_distance(motion.curve.of)
    if distance is not None:
        quantities.append(MotionQuantity("separatrix.distance", distance, DISTANCE))
    number = "the only torus" if TORI[where] == 1 else f"one of {TORI[where]} tori"
    title = f"quasi-periodic on {number} in region {where} of the bifurcation diagram"
    return Motion(top.form, f"torus {where}", title, y, tuple(quantities))


SEPARATRIX, PINCH, PERIODIC, DELONE, BOBYLEV = "separatrix", "pinch", "periodic", "delone", "bobylev-steklov"
REGULAR = "regular"
"""A double root that changes nothing for any motion."""
Kinds = list[tuple[str, Any]]
"""Kinds of critical motions, each with a condition; the first that holds counts, and without any there is no motion."""


TORI = {"I": 1, "II": 2, "III": 2, "IV": 2, "V": 4}
"""Regions of the bifurcation diagram, and the number of tori on each level of the integrals."""


def region(curve: Curve) -> str:
    """Region of a curve, by sign(E - 2 L²/G - k), a conjugate pair or double root, and the lower end of s1."""
    of, highest = curve.of, curve.occupied()[1] == 4  # e5 is next to e4
    if curve.pair or of.discriminants()[2] == 0:
        return "IV" if highest else "I"
    above = 3 * of.l1 - 2 * of.L**2 / of.G
    return "V" if highest else "III" if above > 0 and above**2 >= of.k_sq else "II"


def on_parabola(k: Any, side: float, L: Any, G: Any) -> tuple[Any, Kinds]:
    """Energy E = 2 L²/G + side k, and the kinds of its motions: the cubic vanishes at e4 (side -1) or e5 (side 1)."""
    E = 2 * L * L / G + side * k
    double = (E / 3 - side * k) / 2
    square = k * k - G + E * E / 3 - 3 * double * double  # of twice the half distance of the other two roots
    pair, half = square < 0, _root(square)
    low, high = (-double - half) / 2, (-double + half) / 2
    exists = pair | (high <= (E / 3 + k) / 2)
    if side < 0:
        return E, [(PERIODIC, exists)]
    return E, [(PINCH, pair), (REGULAR, exists & (low <= double) & (double <= high)), (SEPARATRIX, exists)]


def on_double_root(x: Any, E: Any, L: Any, G: Any) -> tuple[Any, Kinds]:
    """k² = G + x⁴ - 2 L x for E = x² + L/x, and the kinds of its motions.

    The cubic has the roots x² - E/3 and twice (E/3 - x²)/2.
    """
    k_sq = G + x**4 - 2 * L * x
    k, m = _root(k_sq), E / 3
    single, double, e4, e5 = x * x - m, (m - x * x) / 2, (m + k) / 2, (m - k) / 2
    exists = (single <= e4) & (double < e4) & (-k <= E - 2 * L * L / G)
    # outside the gap between the ovals; a triple root is at its end
    outside = (double <= single) & (double < e5) | (double >= single) & (double > e5)
    return k_sq, [(SEPARATRIX, exists & outside), (BOBYLEV, exists)]


def _root(square: Any) -> Any:
    """Square root of the positive part."""
    return ((square + abs(square)) / 2) ** 0.5


def separatrix_distance(of: Integrals) -> float | None:
    """Smallest change of E or of k that leads from a motion to a separatrix.

    None if no such change does, and if the answer is not the same for all tori with these integrals: some of them
    shrink to a motion of Bobylev and Steklov on the way.
    """
    with digits(2 * DIGITS):
        E, L, G, k = 3 * real(of.l1), real(of.L), real(of.G), mp.sqrt(real(of.k_sq))
        energies = [on_parabola(k, side, L, G) for side in (-1, 1)]
        for x in _real_zeros([G - k * k, -2 * L, 0, 0, 1]):
            if x:
                energies.append((x * x + L / x, on_double_root(x, x * x + L / x, L, G)[1]))
        beside = E - 2 * L * L / G
        roots = [(mp.mpf(0), [(PERIODIC, True)]), (abs(beside), on_parabola(abs(beside), mp.sign(beside), L, G)[1])]
        for x in _real_zeros([L, -E, 0, 1]):
            k_sq, kinds = on_double_root(x, E, L, G)
            if k_sq > 0:
                roots.append((mp.sqrt(k_sq), kinds))
        all_tori, some = (
            min([*_separatrices(E, energies, passed), *_separatrices(k, roots, passed)], default=None)
            for passed in ({REGULAR, BOBYLEV, ""}, {REGULAR, ""})
        )
        return float(all_tori) if all_tori is not None and all_tori == some else None


def _separatrices(here: Real, values: Sequence[tuple[Real, Kinds]], passed: Collection[str]) -> Iterator[Real]:
    """Distances of the nearest critical values below and above that are not ``passed``, if of a separatrix."""
    kinds = [(value - here, next((kind for kind, holds in kinds if holds), "")) for value, kinds in values]
    for sign in (-1, 1):
        stops = sorted((sign * change, kind) for change, kind in kinds if sign * change > 0 and kind not in passed)
        if stops and stops[0][1] in (SEPARATRIX, PINCH):
            yield stops[0][0]


def _real_zeros(coefficients: Sequence[Real]) -> list[Real]:
    """Real zeros of a polynomial, constant term first; a double zero may be missing."""
    if not any(coefficients[:-1]):
        return [mp.mpf(0)]
    try:
        zeros = mp.polyroots(coefficients, maxsteps=400, extraprec=4 * mp.prec, asc=True)
    except mp.NoConvergence:
        return []
    size = max(abs(x) for x in zeros)
    return [x.real for x in zeros if abs(x.imag) <= size * mp.mpf(10) ** (-mp.dps // 3)]


_POINTS = 1000
"""Points of a curve."""


class Branch(NamedTuple):
    """Part of a critical curve of one kind: energies and k², (m,) each."""

    kind: str
    E: Array
    k_sq: Array


def regions(E: Array, k_sq: Array, L: float, G: float) -> NDArray[np.int64]:
    """Numbers 1 to 5 of the regions I to V at points of the plane; 0 where there is no motion.

    By the place of (E/3 ± k)/2 among the roots of the cubic 4 s³ - g2 s - g3, which follows from its signs there.
    """
    m, k, above = E / 3.0, np.sqrt(k_sq), E - 2.0 * L * L / G
    g2, g3 = k_sq - G + 3.0 * m * m, m * (k_sq - G - m * m) + L * L
    pair = 27.0 * g3 * g3 > g2**3

    def exceeded(s: Array) -> NDArray[np.bool_]:
        """True where a root exceeds s; of a cubic with three real roots also if a derivative is negative (Budan)."""
        return ((4.0 * s * s - g2) * s < g3) | ~pair & ((12.0 * s * s < g2) | (s < 0.0))

    outside = np.where(pair, 4, np.where(exceeded((m - k) / 2.0), 3, 5))
    region = np.where(above > k, outside, np.where(pair, 1, 2))
    return np.where((above < -k) | exceeded((m + k) / 2.0), 0, region)


def branches(L: float, G: float, E: tuple[float, float], k_sq: tuple[float, float]) -> Iterator[Branch]:
    """Parts of the critical curves between the given energies and k², one kind each."""
    k = np.linspace(k_sq[0] ** 0.5, k_sq[1] ** 0.5, _POINTS)
    for side in (-1.0, 1.0):
        energies, kinds = on_parabola(k, side, L, G)
        yield from _parts(energies, k * k, kinds, (energies >= E[0]) & (energies <= E[1]))
    reach = 2.0 * max(abs(v) for v in (*E, *k_sq, 1.0))
    for sign in (-1.0, 1.0):
        x = sign * np.geomspace(1e-4, reach, 8 * _POINTS)
        energies = x * x + L / x
        squares, kinds = on_double_root(x, energies, L, G)
        inside = (energies >= E[0]) & (energies <= E[1]) & (squares >= k_sq[0]) & (squares <= k_sq[1])
        yield from _parts(energies, squares, kinds, inside)
    if k_sq[0] == 0.0:
        line = np.linspace(*E, _POINTS)
        yield from _parts(line, 0.0 * line, [(DELONE, regions(line, np.full(_POINTS, 1e-9), L, G) > 0)], line == line)


def _parts(E: Array, k_sq: Array, kinds: Kinds, inside: NDArray[np.bool_]) -> Iterator[Branch]:
    """Split a curve where its kind changes; points of no kind are left out."""
    names = np.where(inside, np.select([holds for _, holds in kinds], [kind for kind, _ in kinds], ""), "")
    cuts = [0, *(np.flatnonzero(names[1:] != names[:-1]) + 1), len(names)]
    for begin, end in pairwise(cuts):
        if names[begin]:
            upto = min(end + 1, len(names))  # to the first point of the next part
            yield Branch(str(names[begin]), E[begin:upto], k_sq[begin:upto])
