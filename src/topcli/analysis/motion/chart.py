"""Bifurcation diagram of the Kowalevski top in the plane of E and k², as arrays: regions and curves.

The regions and the kinds of critical motions are those of ``diagram``, here from closed formulas for whole arrays.
Energies are divided by the third moment of inertia; L = l c and G = c² gamma².
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.motion.diagram import BOBYLEV, DELONE, PERIODIC, PINCH, REGULAR, SEPARATRIX
from topcli.contracts import Array

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
    found = np.where(above > k, outside, np.where(pair, 1, 2))
    return np.where((above < -k) | (largest > e4), 0, found)


def branches(L: float, G: float, E: tuple[float, float], k_sq: tuple[float, float]) -> list[Branch]:
    """Parts of the critical curves between the given energies and k², one kind each."""
    found = [*_parabola(L, G, E, k_sq), *_double_root_of_r(L, G, E, k_sq)]
    if k_sq[0] == 0.0:
        line = np.linspace(*E, POINTS)
        exists = np.where(regions(line, np.full(POINTS, 1e-9), L, G) > 0, DELONE, "")
        found += _parts(line, np.zeros(POINTS), exists)
    return found


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
