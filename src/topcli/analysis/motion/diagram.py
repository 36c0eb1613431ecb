"""Bifurcation diagram of the Kowalevski top: classes of tori, critical curves, and the nearest critical motions.

For given L = l c and G = c² gamma² two roots of Phi (``separation``) coincide on the curves

    k² = (E - 2 L²/G)²,    k = 0 (Delone),    E = x² + L/x, k² = G + x⁴ - 2 L x (a double root x of R).

What happens there follows from the place of the double root among the ovals of s1 and s2: (-inf, r] and [a, b]. Where
two roots of the cubic meet between r and a, half of the tori shrink to a motion of Bobylev and Steklov, omega1 = x and
omega2 = 0, and nothing happens to the others.
Source: Kharlamov, Prikl. Mat. Mekh. 47 (1983) 922-930; Bolsinov, Richter, Fomenko, Sb. Math. 191 (2000) 151-188.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

from topcli.schemes.kowalevski.separation import DIGITS, Curve, Integrals, Real, cubic_roots, real

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
    pair = of.pair or "cubic" in of.of.double_roots
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
        from topcli.schemes.kowalevski.multiprecision import mpc, sqrt

        k, l1 = sqrt(self.k_sq), self.l1
        cubic = cubic_roots(self.k_sq - self.G + 3 * l1**2, l1 * (self.k_sq - self.G - l1**2) + self.L**2)
        return [*cubic, mpc((l1 + k) / 2), mpc((l1 - k) / 2)]

    def with_energy(self, E: Real) -> Level:
        """The level with another energy E."""
        return Level(E / 3, self.k_sq, self.L, self.G)

    def with_k_sq(self, k_sq: Real) -> Level:
        """The level with another k²."""
        return Level(self.l1, k_sq, self.L, self.G)

    def critical_energies(self) -> list[Real]:
        """Energies at which two roots coincide for the same k², L and G."""
        from topcli.schemes.kowalevski.multiprecision import sqrt

        k, middle = sqrt(self.k_sq), 2 * self.L**2 / self.G
        double = _real_zeros([self.G - self.k_sq, -2 * self.L, 0, 0, 1])
        return [middle + k, middle - k, *(x * x + self.L / x for x in double if x)]

    def critical_k_sq(self) -> list[Real]:
        """Values of k² at which two roots coincide for the same E, L and G."""
        E = 3 * self.l1
        curve = (self.G + x**4 - 2 * self.L * x for x in _real_zeros([self.L, -E, 0, 1]))
        return [0 * E, (E - 2 * self.L**2 / self.G) ** 2, *(value for value in curve if value > 0)]


def _real_zeros(coefficients: Sequence[Real]) -> list[Real]:
    """Real zeros of a polynomial, constant term first; a double zero may be missing."""
    from topcli.schemes.kowalevski.multiprecision import mp, mpf, polyroots

    if not any(coefficients[:-1]):
        return [mpf(0)]
    try:
        found = polyroots(coefficients, maxsteps=400, extraprec=4 * mp.prec, asc=True)
    except mp.NoConvergence:
        return []
    size = max(abs(x) for x in found)
    return [x.real for x in found if abs(x.imag) <= size * mpf(10) ** (-mp.dps // 3)]


def collision(level: Level) -> str:
    """Kind of the critical motion that a level is next to: where its two nearest roots are, relative to the ovals.

    ``bobylev-steklov`` concerns only half of the tori.
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
        return DELONE if ends == {3, 4} else PERIODIC
    if ends == {r, a}:
        return PINCH
    if ends <= set(between(roots)):
        return BOBYLEV
    return SEPARATRIX if r in ends or a in ends else REGULAR


def pendulum_is_stable(of: Curve) -> bool | None:
    """True if a motion of Bobylev and Steklov on this curve is stable: the double root is between the ovals.

    None if the cubic has no double root, or a triple root is involved.
    """
    roots = of.e
    if "cubic" not in of.of.double_roots or roots[1] != roots[2]:
        return None
    double = roots[1].real
    low, middle, high = sorted(roots[i].real for i in (0, 3, 4))
    if double in (low, middle, high):
        return None
    return bool(low < double < middle or double > high)


class Critical(NamedTuple):
    """Critical value of an integral, its difference from the value of the motion, and the kind of critical motion."""

    value: Real
    distance: Real
    kind: str


def nearest_critical(of: Integrals, shrinks: bool) -> dict[str, list[Critical]]:
    """Nearest critical values of E and of k² on either side, by ``energy`` and ``k_sq``, that concern a motion.

    ``shrinks`` is true if its torus is one of those that shrink to a motion of Bobylev and Steklov.
    """
    from topcli.schemes.kowalevski.multiprecision import digits

    passed = (REGULAR,) if shrinks else (REGULAR, BOBYLEV)
    with digits(2 * DIGITS):
        level = Level.of(of)
        return {
            "energy": _both_sides(3 * level.l1, level.critical_energies(), level.with_energy, passed),
            "k_sq": _both_sides(level.k_sq, level.critical_k_sq(), level.with_k_sq, passed),
        }


def _both_sides(
    here: Real, values: Iterable[Real], at: Callable[[Real], Level], passed: Sequence[str]
) -> list[Critical]:
    """Nearest critical value below and above, without the kinds that are ``passed``."""
    values, found = sorted(values), []
    for side in (reversed([v for v in values if v < here]), [v for v in values if v > here]):
        for value in side:
            kind = collision(at(value + (here - value) * BESIDE))
            if kind not in passed:
                found.append(Critical(value, value - here, kind))
                break
    return found
