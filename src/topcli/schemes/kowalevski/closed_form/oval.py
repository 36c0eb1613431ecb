"""One real oval of Kowalevski's curve: its angle, half periods in multiprecision, and panels for the tables.

On a bounded oval s = a + (b - a) sin² theta, on the one through infinity s = a - H tan² theta, with theta in [0, pi/2]
on half of it. The integrals are those of ds/|w| and |s - sigma| ds/|w|, w² = -Phi(s), sigma between the two ovals of
the motion; in theta both integrands are smooth, also at the ends. Differences with roots are sums of positive terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from topcli.contracts import check_stop
from topcli.errors import RunError
from topcli.schemes.kowalevski.closed_form.curve import DIGITS, Curve, Real
from topcli.schemes.kowalevski.closed_form.multiprecision import (
    asin,
    atan,
    conj,
    cos_sin,
    digits,
    isinf,
    mpc,
    mpf,
    pi,
    sqrt,
)

NARROWNESS = 9.0
"""Smallest Bernstein parameter of a panel: the integrals converge to 9^-40 = 7e-39.

Where p grows like the square of an offset, the parameter in p is 5, and the tables converge to 5^-20 / 20 = 5e-16.
"""
MAX_DEPTH = 200
MAX_PANELS = 2000
"""Panels of half an oval; usually there are some tens."""
TAIL = 2.0**-64
"""Part of an interval of angles before a double root that is left out; the distance from the root is its square."""


NODES = 20
"""Gauss-Legendre nodes of a panel."""


@cache
def _gauss_legendre() -> tuple[list[Real], list[Real]]:
    """Nodes and weights on [-1, 1]."""
    nodes, weights = [], []
    with digits(DIGITS):
        for start in np.polynomial.legendre.leggauss(NODES)[0]:
            x, slope = mpf(float(start)), mpf(1)
            for _ in range(4):
                before, now = mpf(1), x
                for m in range(2, NODES + 1):
                    before, now = now, ((2 * m - 1) * x * now - (m - 1) * before) / m
                slope = NODES * (x * now - before) / (x * x - 1)
                x -= now / slope
            nodes.append(x)
            weights.append(2 / ((1 - x * x) * slope * slope))
    return nodes, weights


@dataclass(frozen=True)
class GaussPanel:
    """Interval of offsets ``begin`` to ``end`` of theta from an anchor, in the given direction, with its integrals."""

    anchor: int
    direction: int
    begin: Real
    end: Real
    time: Real
    """Integral of ds/|w|."""
    weighted: Real
    """Integral of |s - sigma| ds/|w|."""


class Oval:
    """Oval between the roots ``low`` and ``high`` of the curve; from minus infinity to ``low`` if ``high`` is None.

    ``a`` is the point with theta = 0, ``b`` the other end; ``length`` is b - a, or H: the mean distance of the other
    roots. ``touched`` is true for theta = 0 and theta = pi/2 if another root lies there, so that it takes infinitely
    long to reach. Offsets are measured from the ``anchors``: both ends, and the angle nearest to a conjugate pair.
    ``half_periods`` are the integrals over theta from 0 to pi/2, without the tail: of ds/|w|, and weighted by
    |s - sigma|.
    """

    def __init__(self, curve: Curve, low: int, high: int | None, sigma: Real) -> None:
        e = curve.e
        self.curve, self.low, self.high, self.sigma = curve, low, high, sigma
        self.a = e[low].real
        self.b = None if high is None else e[high].real
        self.others = tuple(i for i in range(5) if i not in (low, high))
        self.length = sum(abs(e[i] - self.a) for i in self.others) / 4 if high is None else self.b - self.a
        at_low, at_high = (end is not None and any(e[i] == e[end] for i in self.others) for end in (low, high))
        self.touched = at_low, at_high
        self.anchors = self._anchors()
        self.panels = self._panels()
        self.half_periods = sum(p.time for p in self.panels), sum(p.weighted for p in self.panels)

    def densities(self, S: Real, C: Real) -> tuple[Real, Real]:
        """ds/(|w| dtheta) and the same times |s - sigma|, at sine S and cosine C of theta."""
        e, product = self.curve.e, 1
        S2, C2 = S * S, C * C
        along, across = self.length * S2, self.length * C2
        if self.high is None:
            for i in self.others:
                apart = (e[i].real - self.a) * C2 + along
                # the two factors of a pair are equal
                product *= apart if not self._complex(i) else sqrt(apart**2 + (e[i].imag * C2) ** 2)
            density = sqrt(self.length / product)
            return density * C2, density * abs((self.sigma - self.a) * C2 + along)
        for i in self.others:
            apart = self.a - e[i].real + along
            if self._complex(i):
                product *= sqrt(apart**2 + e[i].imag ** 2)
            else:
                product *= apart if e[i].real <= self.a else e[i].real - self.b + across
        density = 1 / sqrt(product)
        return density, density * abs(self.a - self.sigma + along)

    def _complex(self, i: int) -> bool:
        return self.curve.pair and i in (1, 2)

    def _anchors(self) -> list[Real]:
        """Angles from which offsets are measured: both ends, and the angle nearest to a conjugate pair."""
        ends = [mpf(0), pi / 2]
        if not self.curve.pair or not self.length:
            return ends
        centre = self.curve.e[1].real
        if self.high is None:
            square = (self.a - centre) / (self.length + self.a - centre) if centre < self.a else mpf(-1)
        else:
            square = (centre - self.a) / self.length
        return [ends[0], asin(sqrt(square)), ends[1]] if 0 < square < 1 else ends

    def angle(self, s: Real) -> Real:
        """Theta in [0, pi/2] of a point of the oval."""
        if self.high is None:
            return pi / 2 if isinf(s) else atan(sqrt(max(self.a - s, mpf(0)) / self.length))
        if not self.length:
            return mpf(0)
        return asin(sqrt(min(max((s - self.a) / self.length, mpf(0)), mpf(1))))

    def _singularities(self) -> list[Real]:
        """Complex angles at which s is another root, or sigma, where the inverse of the weighted integral branches."""
        found: list[Real] = []
        if not self.length:
            return found
        for point in (*(self.curve.e[i] for i in self.others), mpc(self.sigma)):
            square = (point - self.a) / self.length
            if self.high is None:
                if abs(square - 1) < mpf(10) ** -20:
                    continue  # at an infinite angle
                z = atan(mpc(sqrt(-square)))
            else:
                z = asin(mpc(sqrt(square)))
            for w in (z, -z, pi - z, z - pi):
                found += [w, conj(w)]
        return found

    def _panels(self) -> list[GaussPanel]:
        """Panels from theta = 0 to pi/2, short where a singularity is near."""
        singular, found = self._singularities(), []
        for j in range(len(self.anchors) - 1):
            half = (self.anchors[j + 1] - self.anchors[j]) / 2
            for anchor, direction in ((j, 1), (j + 1, -1)):
                near = np.array([complex((z - self.anchors[anchor]) * direction) for z in singular] or [1e9 + 0j])
                if self._infinite(anchor):
                    near = np.where(np.abs(near) < 1e-25, 0.0, near)
                cuts = _cuts(near, TAIL * float(half) if self._infinite(anchor) else 0.0, float(half))
                row = [
                    self._panel(anchor, direction, begin, end if end < float(half) else half)
                    for begin, end in pairwise(cuts)
                ]
                found += row[::direction]
        return found

    def _infinite(self, anchor: int) -> bool:
        """True if the anchor is an end of the oval in a double root."""
        return (anchor == 0 and self.touched[0]) or (anchor == len(self.anchors) - 1 and self.touched[1])

    def _panel(self, anchor: int, direction: int, begin: float, end: Real) -> GaussPanel:
        u, v = mpf(begin), mpf(end)
        return GaussPanel(anchor, direction, u, v, *self.integrals(anchor, direction, u, v))

    def integrals(self, anchor: int, direction: int, begin: Real, end: Real) -> tuple[Real, Real]:
        """Integrals of the densities over offsets from an anchor."""
        check_stop()
        middle, half = (begin + end) / 2, (end - begin) / 2
        time = weighted = mpf(0)
        for x, weight in zip(*_gauss_legendre(), strict=True):
            C, S = cos_sin(self.anchors[anchor] + direction * (middle + half * x))
            one, other = self.densities(S, C)
            time += weight * one
            weighted += weight * other
        return time * half, weighted * half

    def from_regular_end(self, theta: Real) -> tuple[Real, Real] | None:
        """Integrals to the angle ``theta`` in [0, pi/2] from an end that is no double root, negative from pi/2.

        None if the point is the double root. Raises RunError if it is so close that it cannot be distinguished.
        """
        low, high = self.touched
        if low or high:
            panel = self.panels[0] if low else self.panels[-1]
            rest = theta if low else self.anchors[-1] - theta
            if rest < panel.begin:
                if rest > 1e-40:
                    raise RunError(
                        "kowalevski, scheme exact: the state is too close to a separatrix; use scheme 'taylor'"
                    )
                return None
        time, weighted = self._up_to(theta)
        return (time - self.half_periods[0], weighted - self.half_periods[1]) if low else (time, weighted)

    def _up_to(self, theta: Real) -> tuple[Real, Real]:
        """Integrals over the angles from 0 to ``theta``."""
        time = weighted = mpf(0)
        for panel in self.panels:
            A = self.anchors[panel.anchor]
            low, high = sorted((A + panel.direction * panel.begin, A + panel.direction * panel.end))
            if low >= theta:
                break
            part = (panel.time, panel.weighted)
            if high > theta:
                offsets = (panel.begin, theta - A) if panel.direction == 1 else (A - theta, panel.end)
                part = self.integrals(panel.anchor, panel.direction, *offsets)
            time, weighted = time + part[0], weighted + part[1]
        return time, weighted


def _cuts(singular: Sequence[complex] | np.ndarray, begin: float, end: float) -> list[float]:
    """Ends of panels between ``begin`` and ``end``, such that no singularity is within their Bernstein ellipses.

    Raises RunError if there are too many.
    """
    cuts, left = [begin], [(end, 0)]
    while left:
        begin, (end, depth) = cuts[-1], left[-1]
        with np.errstate(all="ignore"):  # infinite parameters are large ones; nan divides without end
            zeta = (2.0 * np.asarray(singular) - begin - end) / (end - begin)
            size = np.abs(zeta + np.sqrt(zeta - 1.0) * np.sqrt(zeta + 1.0))
            least = np.min(np.maximum(size, 1.0 / size))
        if least >= NARROWNESS or depth > MAX_DEPTH:
            cuts.append(end)
            left.pop()
        else:
            left[-1:] = [(end, depth + 1), (0.5 * (begin + end), depth + 1)]
        if len(cuts) + len(left) > MAX_PANELS:
            raise RunError(
                f"kowalevski, scheme exact: the set-up would need more than {MAX_PANELS} panels; use scheme 'taylor'"
            )
    return cuts


def ovals_of(of: Curve) -> tuple[Oval, Oval]:
    """The ovals of s1 and s2; sigma is in the middle of the gap between them."""
    top, low, high = of.occupied()
    sigma = (of.e[top].real + of.e[low].real) / 2
    return Oval(of, low, high, sigma), Oval(of, top, None, sigma)
