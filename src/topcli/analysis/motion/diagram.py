"""Bifurcation diagram of the Kowalevski top: classes of tori, critical curves, and the distance to a separatrix.

For given L = l c and G = c² gamma² two roots of Phi (``separation``) coincide on the curves

    k² = (E - 2 L²/G)²,    k = 0 (Delone),    E = x² + L/x, k² = G + x⁴ - 2 L x (a double root x of R).

What happens there follows from the place of the double root among the ovals of s1 and s2: (-inf, r] and [a, b]. Where
two roots of the cubic meet between r and a, half of the tori shrink to a motion of Bobylev and Steklov, omega1 = x and
omega2 = 0, and nothing happens to the others.
The regions and curves are computed twice: exactly for one motion, in multiprecision, and from closed formulas for whole
arrays, for pictures. Energies are divided by the third moment of inertia; L = l c and G = c² gamma².
Source: Kharlamov, Prikl. Mat. Mekh. 47 (1983) 922-930; Bolsinov, Richter, Fomenko, Sb. Math. 191 (2000) 151-188.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.multiprecision import DIGITS, Real, cubic_roots, digits, mp, real
from topcli.contracts import Array
from topcli.schemes.kowalevski.curve import Curve, Integrals

SEPARATRIX, PINCH, PERIODIC, DELONE, BOBYLEV = "separatrix", "pinch", "periodic", "delone", "bobylev-steklov"
REGULAR = "regular"
"""A double root that changes nothing for any motion."""
BESIDE = 10.0**-20
"""Part of the way to a critical value at which the roots are compared."""


class Region(NamedTuple):
    """Part of the bifurcation diagram: its name and the number of tori on each level of the integrals."""

    name: str
    tori: int


REGIONS = {name: Region(name, tori) for name, tori in (("I", 1), ("II", 2), ("III", 2), ("IV", 2), ("V", 4))}


def region(of: Curve) -> Region:
    """Region of a curve: by sign(|E - 2 L²/G| - k), a conjugate pair or double root, and the lower end of s1."""
    pair = of.pair or of.of.discriminants()[2] == 0
    k, above = (of.e[3] - of.e[4]).real, real(3 * of.of.l1 - 2 * of.of.L**2 / of.of.G)
    if abs(above) < k:
        return REGIONS["I" if pair else "II"]
    if pair:
        return REGIONS["IV"]
    return REGIONS["III" if of.occupied()[1] < 3 else "V"]


def between(roots: Sequence[Any]) -> list[int]:
    """Indices of the real roots of the cubic between the ovals of s1 and s2."""
    order = sorted((i for i in range(5) if roots[i].imag == 0), key=lambda i: roots[i].real)
    return [i for i in order[1:-2] if i < 3]


@dataclass(frozen=True)
class Level:
    """Integrals as numbers of mpmath: l1 = E/3, k²; L and G."""

    l1: Real
    k_sq: Real
    L: Real
    G: Real

    @classmethod
    def of(cls, integrals: Integrals) -> Level:
        """Level of exact integrals."""
        return cls(*(real(v) for v in (integrals.l1, integrals.k_sq, integrals.L, integrals.G)))

    def roots(self) -> list[Any]:
        """The three roots of the cubic, e4 and e5."""
        k, l1 = mp.sqrt(self.k_sq), self.l1
        cubic = cubic_roots(self.k_sq - self.G + 3 * l1**2, l1 * (self.k_sq - self.G - l1**2) + self.L**2)
        return [*cubic, mp.mpc((l1 + k) / 2), mp.mpc((l1 - k) / 2)]

    def with_energy(self, E: Real) -> Level:
        """The level with another energy E."""
        return Level(E / 3, self.k_sq, self.L, self.G)

    def with_k_sq(self, k_sq: Real) -> Level:
        """The level with another k²."""
        return Level(self.l1, k_sq, self.L, self.G)

    def critical_energies(self) -> list[Real]:
        """Energies at which two roots coincide for the same k², L and G."""
        k, middle = mp.sqrt(self.k_sq), 2 * self.L**2 / self.G
        double = _real_zeros([self.G - self.k_sq, -2 * self.L, 0, 0, 1])
        return [middle + k, middle - k, *(x * x + self.L / x for x in double if x)]

    def critical_k_sq(self) -> list[Real]:
        """Values of k² at which two roots coincide for the same E, L and G."""
        E = 3 * self.l1
        curve = (self.G + x**4 - 2 * self.L * x for x in _real_zeros([self.L, -E, 0, 1]))
        return [0 * E, (E - 2 * self.L**2 / self.G) ** 2, *(value for value in curve if value > 0)]


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


def collision(level: Level) -> str:
    """Kind of the critical motions that a level is next to: where its two nearest roots are, relative to the ovals.

    It is ``separatrix``, ``periodic`` or, where only half of the tori shrink, ``bobylev-steklov``.
    """
    roots = level.roots()
    order = sorted((i for i in range(5) if roots[i].imag == 0), key=lambda i: roots[i].real)
    r, a, b = order[0], order[-2], order[-1]
    i, j = min(combinations(range(5), 2), key=lambda ij: abs(roots[ij[0]] - roots[ij[1]]))
    if roots[i].imag != 0:
        d = roots[i].real
        inside = d < roots[r].real or roots[a].real < d < roots[b].real
        return SEPARATRIX if inside else REGULAR
    ends = {i, j}
    if ends == {a, b}:
        return PERIODIC
    if ends <= set(between(roots)):
        return BOBYLEV
    return SEPARATRIX if r in ends or a in ends else REGULAR


def separatrix_distance(of: Integrals, shrinks: bool) -> float | None:
    """Smallest change of E or of k that leads from a motion to a separatrix; None if no such change does.

    ``shrinks`` is true if its torus is one of those that shrink to a motion of Bobylev and Steklov.
    """
    passed = (REGULAR,) if shrinks else (REGULAR, BOBYLEV)
    with digits(2 * DIGITS):
        level = Level.of(of)
        E, k_sq = 3 * level.l1, level.k_sq
        changes = [abs(v - E) for v in _nearest(E, level.critical_energies(), level.with_energy, passed)]
        for value in _nearest(k_sq, level.critical_k_sq(), level.with_k_sq, passed):
            changes.append(abs(value - k_sq) / (mp.sqrt(value) + mp.sqrt(k_sq)))
        return float(min(changes)) if changes else None


def _nearest(here: Real, values: Iterable[Real], at: Callable[[Real], Level], passed: Sequence[str]) -> Iterator[Real]:
    """Nearest critical value below and above, without those of the kinds ``passed``, where it is of a separatrix."""
    values = sorted(values)
    for side in (reversed([v for v in values if v < here]), [v for v in values if v > here]):
        for value in side:
            kind = collision(at(value + (here - value) * BESIDE))
            if kind == SEPARATRIX:
                yield value
            if kind not in passed:
                break


POINTS = 1000
"""Points of a curve."""


class Branch(NamedTuple):
    """Part of a critical curve of one kind: energies and k², (m,) each."""

    kind: str
    E: Array
    k_sq: Array


def _real_cubic(E: Array, k_sq: Array, L: float, G: float) -> tuple[NDArray[np.bool_], Array]:
    """True where 4 s³ - g2 s - g3 has a conjugate pair, and its largest real root."""
    m = E / 3.0
    p, q = (k_sq - G + 3.0 * m * m) / 12.0, (m * (k_sq - G - m * m) + L * L) / 8.0  # s³ = 3 p s + 2 q
    pair = q * q > p * p * p
    root = np.sqrt(np.maximum(q * q - p**3, 0.0))
    u = np.cbrt(np.where(q >= 0.0, q + root, q - root))
    single = u + p / np.where(u == 0.0, 1.0, u)
    size = np.sqrt(np.maximum(p, 0.0))
    cosine = np.clip(q / np.where(size == 0.0, 1.0, size**3), -1.0, 1.0)
    return pair, np.where(pair, single, 2.0 * size * np.cos(np.arccos(cosine) / 3.0))


def regions(E: Array, k_sq: Array, L: float, G: float) -> NDArray[np.int64]:
    """Numbers 1 to 5 of the regions I to V at points of the plane; 0 where there is no motion."""
    k, above = np.sqrt(k_sq), E - 2.0 * L * L / G
    pair, largest = _real_cubic(E, k_sq, L, G)
    e4, e5 = (E / 3.0 + k) / 2.0, (E / 3.0 - k) / 2.0
    outside = np.where(pair, 4, np.where(largest > e5, 3, 5))
    region = np.where(above > k, outside, np.where(pair, 1, 2))
    return np.where((above < -k) | (largest > e4), 0, region)


def branches(L: float, G: float, E: tuple[float, float], k_sq: tuple[float, float]) -> list[Branch]:
    """Parts of the critical curves between the given energies and k², one kind each."""
    parts = [*_parabola(L, G, E, k_sq), *_double_root_of_r(L, G, E, k_sq)]
    if k_sq[0] == 0.0:
        line = np.linspace(*E, POINTS)
        exists = np.where(regions(line, np.full(POINTS, 1e-9), L, G) > 0, DELONE, "")
        parts += _parts(line, np.zeros(POINTS), exists)
    return parts


def _parts(E: Array, k_sq: Array, kinds: NDArray[np.str_]) -> Iterator[Branch]:
    """Split a curve where its kind changes; points of no kind are left out."""
    cuts = [0, *(np.flatnonzero(kinds[1:] != kinds[:-1]) + 1), len(kinds)]
    for begin, end in pairwise(cuts):
        if kinds[begin]:
            upto = min(end + 1, len(kinds))  # to the first point of the next part
            yield Branch(str(kinds[begin]), E[begin:upto], k_sq[begin:upto])


def _parabola(L: float, G: float, limits: tuple[float, float], heights: tuple[float, float]) -> Iterator[Branch]:
    """k = |E - 2 L²/G|: the cubic vanishes at e4 (left) or e5 (right)."""
    middle = 2.0 * L * L / G
    for side in (-1.0, 1.0):
        k = np.linspace(heights[0] ** 0.5, heights[1] ** 0.5, POINTS)
        E = middle + side * k
        inside = (limits[0] <= E) & (limits[1] >= E)
        double = (E / 3.0 - side * k) / 2.0  # e5 right, e4 left
        p = (k * k - G + E * E / 3.0) / 4.0
        square = 4.0 * p - 3.0 * double * double  # of twice the half distance of the other two roots of the cubic
        pair, half = square < 0.0, np.sqrt(np.maximum(square, 0.0))
        low, high = (-double - half) / 2.0, (-double + half) / 2.0
        e4 = (E / 3.0 + k) / 2.0
        if side < 0.0:
            kinds = np.where(pair | (high <= e4), PERIODIC, "")
        else:
            between = np.where((double < low) | (double > high), SEPARATRIX, REGULAR)
            kinds = np.where(pair, PINCH, np.where(high > e4, "", between))
        yield from _parts(E, k * k, np.where(inside, kinds, ""))


def _double_root_of_r(
    L: float, G: float, limits: tuple[float, float], heights: tuple[float, float]
) -> Iterator[Branch]:
    """E = x² + L/x, k² = G + x⁴ - 2 L x: the cubic has the roots x² - E/3 and twice (E/3 - x²)/2."""
    reach = 2.0 * max(abs(v) for v in (*limits, *heights, 1.0))
    for sign in (-1.0, 1.0):
        x = sign * np.geomspace(1e-4, reach, 8 * POINTS)
        E, k_sq = x * x + L / x, G + x**4 - 2.0 * L * x
        inside = (limits[0] <= E) & (limits[1] >= E) & (heights[0] <= k_sq) & (heights[1] >= k_sq)
        if not inside.any():
            continue
        k, m = np.sqrt(np.maximum(k_sq, 0.0)), E / 3.0
        single, double, e4, e5 = x * x - m, (m - x * x) / 2.0, (m + k) / 2.0, (m - k) / 2.0
        lowest, middle = np.minimum(single, e5), np.maximum(single, e5)
        exists = (single <= e4) & (-k <= E - 2.0 * L * L / G)
        met = (double < lowest) | ((double > middle) & (double < e4))
        kinds = np.where(exists & inside & (double < e4), np.where(met, SEPARATRIX, BOBYLEV), "")
        yield from _parts(E, k_sq, kinds)
