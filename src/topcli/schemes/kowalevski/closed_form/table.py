"""Angle on an oval of Kowalevski's curve as a function of its integrals, in double precision.

The angle theta and the excess of the integral of ds/|w| are piecewise Chebyshev series in p, the integral of
|s - sigma| ds/|w|; theta is also one in the integral of ds/|w|. Offsets are measured from the ends of the oval, and
from the angle next to a conjugate pair of roots, so that they keep their relative accuracy there.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array

if TYPE_CHECKING:
    from topcli.schemes.kowalevski.closed_form.oval import Oval

Real = Any
"""A number of mpmath."""
NODES = 20
"""Chebyshev nodes of a panel."""
Complexes = NDArray[np.complex128]
SLOW = 200.0
"""Half period, in a unit of time of the order of one, of which the motion next to theta = 0 takes nearly all; times are
then measured from theta = pi/2, so that the fast part keeps its accuracy."""
NEWTON_STEPS = 14
"""Newton steps that invert an integral on a panel, where it is almost linear."""


class Place(NamedTuple):
    """Points on an oval: sine and cosine of theta, unsigned, and the number of the quadrant."""

    quadrant: NDArray[np.int64]
    S: Array
    C: Array
    past_pair: Array | None
    """sin² theta - sin² of the anchor next to a conjugate pair, without cancellation."""

    def signed(self) -> Place:
        """The same with signed sine and cosine."""
        m = self.quadrant & 3
        return self._replace(S=np.where(m < 2, self.S, -self.S), C=np.where((m == 1) | (m == 2), -self.C, self.C))


@cache
def _chebyshev() -> tuple[Array, Array]:
    """Chebyshev nodes in ascending order, and the matrix that turns values there into coefficients."""
    nodes = -np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    return nodes, np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, NODES - 1))


class Series:
    """Several quantities as Chebyshev series of a variable, by panels in ascending order.

    A panel is measured from the value ``origin`` of its anchor, in its ``direction``; if the anchor is a double root,
    from the end that is none.
    """

    def __init__(self, origin: Array, direction: Array, begin: Array, end: Array, tables: list[Array]) -> None:
        self.origin, self.direction, self.begin, self.end = origin, direction, begin, end
        with np.errstate(divide="ignore"):  # a motion that rests in a triple root has empty panels and uses none
            self.width = 2.0 / (end - begin)
        upper = np.where(direction > 0, origin + end, origin - begin)
        self.uppers = upper[:-1]
        self.tables = [np.ascontiguousarray(table.T) for table in tables]

    def __call__(self, x: Array, which: int) -> tuple[NDArray[np.intp], Array, list[Array]]:
        """Panels of ``x`` (m,), their offsets, and the values of the first ``which`` quantities."""
        panel = np.searchsorted(self.uppers, x)
        offset = (x - self.origin[panel]) * self.direction[panel]
        z = np.minimum(np.maximum((offset - self.begin[panel]) * self.width[panel] - 1.0, -1.0), 1.0)
        twice = z + z
        values = []
        for table in self.tables[:which]:
            now, before = table[-1].take(panel), np.zeros_like(z)
            for row in table[-2:0:-1]:
                now, before = twice * now - before + row.take(panel), now
            values.append(z * now - before + table[0].take(panel))
        return panel, offset, values


class OvalTable:
    """Oval in double precision: ``weighted`` and ``time`` are its half periods, ``length`` its b - a or H.

    The integrals p and A of a motion are measured from theta = 0, or from the end that is not a double root; A is given
    as its ``excess`` A - slope p, which is bounded by ``largest_excess``. With ``at_root`` the motion rests there. The
    oval is ``endless`` if p grows without bounds towards a double root. With ``from_high``, p and A are measured from
    theta = pi/2, because theta = 0 is this root, or next to it.
    """

    def __init__(self, oval: Oval, slope: Real, at_root: bool) -> None:
        e = oval.curve.e
        self.touched, self.slope, self.at_root = oval.touched, float(slope), at_root
        self.endless = any(oval.touched) and slope != 0
        slow = oval.half_periods[1] > SLOW and not any(oval.touched) and not at_root
        self.from_high = slow or (self.endless and oval.touched[0])
        # the density of the excess is that of the low end, whose s - sigma is exact, and a rest
        self.low_slope = float(1 / abs(oval.a - oval.sigma)) if self.from_high else 0.0
        self.slope_rest = float(1 / abs(oval.a - oval.sigma) - slope) if slow else 0.0
        self.unbounded, self.low, self.high = oval.high is None, oval.low, oval.high
        self.others, self.length = oval.others, float(oval.length)
        self.time, self.weighted = (float(v) for v in oval.half_periods)
        self.whole_excess = float(oval.half_periods[0] - slope * oval.half_periods[1])
        # towards a double root 1 - slope |s - sigma| has one sign; at a triple root only its integral is bounded
        whole = abs(self.whole_excess) if any(oval.touched) else self.time + self.slope * self.weighted
        self.largest_excess = whole
        self.apart: dict[int, tuple[str, complex]] = {}
        for i in oval.others:
            if oval.curve.pair and i in (1, 2):
                self.apart[i] = "pair", complex(e[i] - oval.a)
            elif e[i].real <= oval.a and not self.unbounded:
                self.apart[i] = "below", complex(oval.a - e[i].real)
            else:
                self.apart[i] = "above", complex(e[i].real - (oval.a if self.unbounded else oval.b))
        self.from_sigma = float(oval.sigma - oval.a)
        self.sigma_past_end = 0.0 if oval.high is None else float(oval.sigma - oval.b)
        self.anchors = np.array([float(v) for v in oval.anchors])
        self.pair_scale = 0.0
        if len(self.anchors) == 3:
            centre = e[1].real
            self.pair_scale = float(oval.length + oval.a - centre if self.unbounded else oval.length)
        self.anchor, self.direction = (
            np.array(v) for v in zip(*((p.anchor, p.direction) for p in oval.panels), strict=True)
        )
        self._tabulate(oval, slope)

    def _tabulate(self, oval: Oval, slope: Real) -> None:
        """Build the series of theta and of the time over p, and of theta over the time."""
        last = len(oval.anchors) - 1
        zero = oval.half_periods if self.from_high else (0, 0)
        at_anchor, time, weighted = {0: (-float(zero[0]), -float(zero[1]), 0.0)}, 0, 0
        far: dict[int, list[tuple[float, float]]] = {}
        for n, panel in enumerate(oval.panels):
            before = time, weighted
            time, weighted = time + panel.time, weighted + panel.weighted
            if panel.direction == -1:
                integrals = float(time - zero[0]), float(weighted - zero[1])
                at_anchor[panel.anchor] = *integrals, float(time - slope * weighted)
            if (panel.anchor != last) if self.from_high else (self.endless and panel.anchor == last):
                # measured from the other end, because it takes very long or for ever to come here
                ends, to = (before, (time, weighted))[:: panel.direction], panel.direction
                far[n] = [(to * float(t - zero[0]), to * float(p - zero[1])) for t, p in ends]
        rows: dict[int, tuple[float, float, Array, Array, Array]] = {}
        offsets: dict[tuple[int, int], tuple[float, float, float]] = {}
        ends = {}
        for n in sorted(range(len(oval.panels)), key=lambda n: oval.panels[n].begin):
            panel = oval.panels[n]
            key = panel.anchor, panel.direction
            t0, p0, e0 = offsets.get(key, (0.0, 0.0, 0.0))
            u, v = float(panel.begin), float(panel.end)
            (dt, dp, more), tables = self._panel(panel.anchor, panel.direction, u, v)
            angle_of_p, excess_of_p, angle_of_time = tables
            excess_of_p[0] += e0
            rows[n] = t0, p0, angle_of_p, excess_of_p, angle_of_time
            ends[n] = t0 + dt, p0 + dp
            offsets[key] = (*ends[n], e0 + more)
            if n in far:
                rows[n], ends[n] = (*far[n][0], *rows[n][2:]), far[n][1]
        count = range(len(oval.panels))
        anchors = [at_anchor[p.anchor] for p in oval.panels]
        first, second, self.excess_at_anchor = (np.array([a[i] for a in anchors]) for i in range(3))
        for n in far:
            first[n] = second[n] = 0.0
        begin, end = ([np.array([source[n][i] for n in count]) for i in (0, 1)] for source in (rows, ends))
        tables = [np.array([rows[n][i] for n in count]) for i in (2, 3, 4)]
        self.over_p = Series(second, self.direction, begin[1], end[1], [tables[1], tables[0]])
        self.over_time = Series(first, self.direction, begin[0], end[0], [tables[2]])

    def _panel(self, anchor: int, direction: int, u: float, v: float) -> tuple[list[float], list[Array]]:
        """Increments of time, p and excess over a panel; coefficients of theta(p), excess(p) and theta(time)."""
        cheb = np.polynomial.chebyshev
        nodes, transform = _chebyshev()
        middle, half = 0.5 * (u + v), 0.5 * (v - u)
        here = np.full(NODES, anchor)
        densities = self._densities(*self._functions(here, np.full(NODES, direction), middle + half * nodes))
        time, p, excess = (cheb.chebint(transform @ f, lbnd=-1) * half for f in densities)
        grown = [float(cheb.chebval(1.0, f)) for f in (time, p, excess)]
        x, y = _inverse(p, grown[1], nodes), _inverse(time, grown[0], nodes)
        tables = [middle + half * x, cheb.chebval(x, excess), middle + half * y]
        return grown, [transform @ values for values in tables]

    def _functions(
        self, anchor: NDArray[np.intp], direction: Array, offset: Array
    ) -> tuple[Array, Array, Array | None]:
        """Sine and cosine of theta in the first quadrant, and ``Place.past_pair``."""
        sine, cosine = np.sin(offset), np.cos(offset)
        if len(self.anchors) == 2:
            lower = anchor == 0
            return np.where(lower, sine, cosine), np.where(lower, cosine, sine), None
        theta = self.anchors[anchor] + direction * offset
        S = np.where(anchor == 0, sine, np.where(anchor == 2, cosine, np.sin(theta)))
        C = np.where(anchor == 0, cosine, np.where(anchor == 2, sine, np.cos(theta)))
        past = np.where(anchor == 1, direction * offset, theta - self.anchors[1])
        return S, C, np.sin(past) * np.sin(2.0 * self.anchors[1] + past)

    def _densities(self, S: Array, C: Array, past_pair: Array | None) -> tuple[Array, Array, Array]:
        """ds/(|w| dtheta), the same times |s - sigma|, and times 1 - slope |s - sigma|."""
        squares = self.squares(S, C, past_pair)
        product = np.ones_like(S)
        for i in self.others:
            product = product * np.abs(squares[i])
        density = np.sqrt((self.length if self.unbounded else 1.0) / product)
        gap, unit = self.gap(S, C), C * C if self.unbounded else 1.0
        if self.from_high:
            rest = self.slope_rest * gap - self.low_slope * self.length * S * S
        elif self.endless:  # slope is 1/|root - sigma|
            rest = self.slope * self.length * C * C
        else:
            rest = unit - self.slope * gap
        return density * unit, density * gap, density * rest

    def gap(self, S: Array, C: Array) -> Array:
        """|s - sigma|; times cos² theta on the unbounded oval."""
        along = self.length * S * S
        if self.unbounded:
            return self.from_sigma * C * C + along
        return np.where(S < 0.7, along - self.from_sigma, -self.length * C * C - self.sigma_past_end)

    def squares(self, S: Array, C: Array, past_pair: Array | None) -> dict[int, Array | Complexes]:
        """|s - e_i| of the real roots that are no ends, s - e_i (e_i - s if unbounded) of the complex ones.

        On the unbounded oval they are multiplied by cos² theta.
        """
        C2 = C * C
        along, found = self.length * S * S, {}
        for i, (kind, apart) in self.apart.items():
            if kind == "pair":
                if past_pair is not None:
                    x = self.pair_scale * past_pair
                else:
                    x = along + apart.real * C2 if self.unbounded else along - apart.real
                found[i] = x + 1j * apart.imag * (C2 if self.unbounded else -1.0)
            elif self.unbounded:
                found[i] = apart.real * C2 + along
            else:
                found[i] = apart.real + (along if kind == "below" else self.length * C2)
        return found

    def factors(self, place: Place) -> list[Array | Complexes]:
        """sqrt(s - e_i), i = 1..5, times cos theta if unbounded; smooth in the signed sine and cosine."""
        found: dict[int, Array | Complexes] = {}
        for i, square in self.squares(place.S, place.C, place.past_pair).items():
            root = np.sqrt(square)
            below = not self.unbounded and self.apart[i][0] != "above"
            found[i] = root if below else 1j * root
        scale = np.sqrt(self.length)
        found[self.low] = (1j * scale if self.unbounded else scale) * place.S
        if self.high is not None:
            found[self.high] = 1j * scale * place.C
        return [found[i] for i in range(5)]

    def _folded(self, x: Array, half: float) -> tuple[NDArray[np.int64], Array, Array]:
        """Quadrant of the value ``x`` of an integral, the integral from theta = 0 in [0, half], and its direction.

        With ``from_high`` the integral is that from theta = pi/2, in [-half, 0].
        """
        if any(self.touched):
            negative, size = x < 0.0, np.minimum(np.abs(x), half)
            sign = np.where(negative, -1.0, 1.0)
            if self.touched[0]:
                return np.where(negative, 0, 1), -size if self.from_high else half - size, -sign
            return np.where(negative, 3, 0), size, sign
        if self.from_high:
            ends = np.rint(0.5 * x / half)
            from_end = x - 2.0 * ends * half
            past = from_end >= 0.0
            return (2.0 * ends + past).astype(np.int64), -np.minimum(np.abs(from_end), half), np.where(past, -1.0, 1.0)
        quadrant = np.floor(x / half)
        odd = quadrant - 2.0 * np.floor(0.5 * quadrant)
        rest = x - quadrant * half
        sign = 1.0 - 2.0 * odd
        return quadrant.astype(np.int64), odd * half + sign * rest, sign

    def at(self, p: Array) -> tuple[Place, Array, Array]:
        """Places with the integral ``p`` (m,), the ``excess`` of A, and ``gap``."""
        if self.at_root:
            S, C = (np.full_like(p, float(self.touched[i])) for i in (1, 0))
            return Place(np.zeros(len(p), dtype=np.int64), S, C, None), np.zeros_like(p), self.gap(S, C)
        quadrant, rest, sign = self._folded(p, self.weighted)
        panel, _, (excess, offset) = self.over_p(rest, 2)
        direction = self.direction[panel]
        excess = sign * (self.excess_at_anchor[panel] + direction * excess)
        if self.touched[0]:
            excess -= sign * self.whole_excess
        S, C, past = self._functions(self.anchor[panel], direction, offset)
        return Place(quadrant, S, C, past), excess, self.gap(S, C)

    def at_time(self, time: Array) -> Place:
        """Places with the integral A = ``time``; where |s - sigma| is small, p does not determine them well."""
        quadrant, rest, _ = self._folded(time, self.time)
        panel, _, (offset,) = self.over_time(rest, 1)
        return Place(quadrant, *self._functions(self.anchor[panel], self.direction[panel], offset))


def _inverse(series: Array, total: float, nodes: Array) -> Array:
    """Arguments at which a growing series takes the values ``total`` (1 + nodes)/2, by Newton's method."""
    evaluate: Callable[[Array, Array], Array] = np.polynomial.chebyshev.chebval
    slope, wanted, x = np.polynomial.chebyshev.chebder(series), 0.5 * total * (1.0 + nodes), nodes.copy()
    for _ in range(NEWTON_STEPS):
        step = (evaluate(x, series) - wanted) / evaluate(x, slope)
        x = np.clip(x - step, -1.2, 1.2)
        if np.abs(step).max() < 3e-16:
            break
    return x
