"""Kowalevski's curve: integrals, roots, s1 and s2 of a state, and the ovals on which these move, in multiprecision.

With x1 = omega1 + i omega2, xi = x1² - c (gamma1 + i gamma2), k = |xi|, l1 = E/3, L = l c and G = c² gamma² the motion
separates on the curve w² = -Phi(s), (s1 - s2)² s_i'² = -Phi(s_i), with

    R(x) = -x⁴ + 6 l1 x² - 4 L x + G - k²,    Phi(s) = (4 s³ - g2 s - g3)(s - e4)(s - e5) = 4 prod (s - e_i),
    g2 = k² - G + 3 l1²,    g3 = l1 (k² - G - l1²) + L²,    e4, e5 = (l1 ± k)/2

(Kowalevski 1889; Golubev, Lectures on Integration, chapter 4).

**Ovals.** On a bounded oval s = a + (b - a) sin² theta, on the one through infinity s = a - H tan² theta, with theta in
[0, pi/2] on half of it. With w² = -Phi(s) and sigma between the two ovals of a motion, A is the integral of ds/|w| and
p that of |s - sigma| ds/|w|; in theta both integrands are smooth, also at the ends. They are made of *forms*, linear
functions of sin² theta, each computed from its value at the nearest *anchor* (an end of the oval, or the angle next to
a conjugate pair of roots), so that it keeps its digits next to a double root. Offsets are angles from an anchor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from mpmath.calculus.quadrature import GaussLegendre
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from topcli.arithmetic.multiprecision import DIGITS, Real, cubic_roots, digits, mp, real
from topcli.contracts import Array, check_stop
from topcli.errors import RunError

Integers = NDArray[np.int64]
REFUSED = "kowalevski, scheme exact: {}; use scheme 'taylor'"
_NODES = 20
"""Chebyshev nodes of a panel."""
NARROWNESS = 9.0
"""Smallest Bernstein parameter of a panel: integrals by 24 Gauss nodes converge to 9^-48 = 2e-46.

Where p grows like the square of an offset, the parameter in p is 5, and the tables converge to 5^-20 / 20 = 5e-16.
"""
MAX_PANELS = 2000
_NEWTON_STEPS = 14
"""Newton steps that invert an integral on a panel, where it is almost linear."""


@dataclass(frozen=True)
class Integrals:
    """Exact integrals of a state, and the coefficients of its curve."""

    l1: Fraction
    L: Fraction
    G: Fraction
    k_sq: Fraction

    @classmethod
    def of(cls, y: Sequence[float | Fraction], c: float) -> Integrals:
        """Integrals of the state ``y`` (6,)."""
        w1, w2, w3, g1, g2, g3 = (Fraction(v) for v in y)
        f = Fraction(c)
        l1 = (w1 * w1 + w2 * w2 + w3 * w3 / 2 + f * g1) / 3
        L = f * (2 * (w1 * g1 + w2 * g2) + w3 * g3) / 2
        k_sq = (w1 * w1 - w2 * w2 - f * g1) ** 2 + (2 * w1 * w2 - f * g2) ** 2
        return cls(l1, L, f * f * (g1 * g1 + g2 * g2 + g3 * g3), k_sq)

    @property
    def g2(self) -> Fraction:
        """Coefficient of the cubic 4 s³ - g2 s - g3."""
        return self.k_sq - self.G + 3 * self.l1**2

    @property
    def g3(self) -> Fraction:
        """Coefficient of the cubic 4 s³ - g2 s - g3."""
        return self.l1 * (self.k_sq - self.G - self.l1**2) + self.L**2

    def discriminants(self) -> tuple[Fraction, Fraction, Fraction]:
        """Numbers that vanish if e4 = e5, if one of these is a root of the cubic, and if two roots of that coincide."""
        on_cubic = (2 * self.L**2 - 3 * self.l1 * self.G) ** 2 - self.k_sq * self.G**2
        return self.k_sq, on_cubic, self.g2**3 - 27 * self.g3**2


@dataclass(frozen=True)
class Curve:
    """Roots ``e`` of Phi, of which ``e[3]`` and ``e[4]`` are e4 and e5, and the root ``x0`` of R.

    With ``pair``, e[1] and e[2] are conjugate. ``r1`` = R'(x0)/4, ``r2`` = R''(x0)/24.
    """

    of: Integrals
    e: tuple[Real, ...]
    x0: Real
    r1: Real
    r2: Real

    @classmethod
    def with_integrals(cls, of: Integrals) -> Curve:
        """Curve of the given integrals, in the precision of the context."""
        l1, L, k = real(of.l1), real(of.L), mp.sqrt(real(of.k_sq))
        e = cubic_roots(real(of.g2), real(of.g3), of.discriminants()[2] >= 0)
        x0 = _isolated_root(e, l1, L)
        r1, r2 = -(x0**3) + 3 * l1 * x0 - L, (l1 - x0 * x0) / 2
        return cls(of, (*e, mp.mpc((l1 + k) / 2), mp.mpc((l1 - k) / 2)), x0, r1, r2)

    @property
    def pair(self) -> bool:
        """True if two roots are conjugate."""
        return self.e[1].imag != 0

    def occupied(self) -> tuple[int, int, int]:
        """Indices of the ends of the ovals: s2 <= e[first], e[second] <= s1 <= e[third] for every real motion."""
        order = sorted((i for i in range(5) if self.e[i].imag == 0), key=lambda i: self.e[i].real)
        return order[0], order[-2], order[-1]


def _isolated_root(e: Sequence[Real], l1: Real, L: Real) -> Real:
    """Root of R that is furthest from the others; x = q1 + q2 + q3 with q_i² = e_i + l1 and q1 q2 q3 = -L/2."""
    q = [mp.sqrt(v + l1) for v in e]
    if abs(q[0] * q[1] * q[2] + L / 2) > abs(q[0] * q[1] * q[2] - L / 2):
        largest = max(range(3), key=lambda i: abs(q[i]))
        q[largest] = -q[largest]
    tiny = mp.mpf(10) ** (-mp.dps // 3)
    best, isolated = mp.mpf(-1), mp.mpc(0)
    for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        a, b, d = (s * v for s, v in zip(signs, q, strict=True))
        x, apart = a + b + d, min(abs(a + b), abs(b + d), abs(a + d))
        if abs(x.imag) <= tiny * (1 + abs(x)):  # a real root is preferred
            x, apart = mp.mpc(x.real), 2 * apart
        if apart > best:
            best, isolated = apart, x
    return isolated


def separated(of: Integrals, y: Sequence[Real]) -> tuple[Real, Real]:
    """Kowalevski's variables s1 >= s2 of a state; s2 is minus infinity where omega2 = 0.

    Raises ZeroDivisionError where both omega2 and R(omega1) vanish.
    """
    l1, L, rest = real(of.l1), real(of.L), real(of.G - of.k_sq)
    x, w2 = mp.mpc(y[0], y[1]), y[1]
    n = abs(x) ** 2
    size = abs(x * (x * (6 * l1 - x * x) - 4 * L) + rest)
    R12 = -n * n + 6 * l1 * n - 4 * L * x.real + rest
    R1 = (6 * l1 - 4 * x.real**2) * (rest - n * n) - (2 * L - 2 * n * x.real) ** 2
    if R12 >= 0:
        low = l1 / 2 - (R12 + size) / (8 * w2**2) if w2 else mp.mpf("-inf")
        return l1 / 2 - R1 / (2 * (size + R12)), low
    return l1 / 2 + (size - R12) / (8 * w2**2), l1 / 2 - R1 / (2 * (R12 - size))


@cache
def _gauss() -> list[tuple[Real, Real]]:
    """Nodes and weights on [-1, 1]."""
    with digits(DIGITS):
        return GaussLegendre(mp).calc_nodes(4, mp.prec)


@cache
def _chebyshev() -> tuple[Array, Array, Array]:
    """Nodes in ascending order, the matrix from values there to coefficients, and that of the integral from -1."""
    nodes = -np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    values = np.linalg.inv(chebyshev.chebvander(nodes, _NODES - 1))
    return nodes[:, None], values, chebyshev.chebint(np.eye(_NODES), lbnd=-1)


class Panel(NamedTuple):
    """Offsets ``begin`` to ``end`` from an anchor in a direction; (A, p) from the anchor to its begin, and over it."""

    anchor: int
    direction: int
    begin: Real
    end: Real
    before: Any
    over: Any


class Place(NamedTuple):
    """Points of an oval: signed sine and cosine of theta, panel, and sin² theta minus that of the panel's anchor."""

    S: Array
    C: Array
    panel: Integers
    beyond: Array


class Oval:
    """Oval between the roots ``low`` and ``high`` of the curve; from minus infinity to ``low`` if ``high`` is None.

    ``a`` is the point with theta = 0, ``length`` is b - a or H, the mean distance of the other roots from a. ``half``
    contains A and p over theta from 0 to pi/2. ``forms`` are known by their values at theta = 0 and pi/2: by i,
    |s - e_i|, or s - e_i for one root of a conjugate pair; |s - sigma| as "gap", and 1 as "unit". On the unbounded oval
    e_i - s replaces s - e_i, and all are multiplied by cos² theta.
    """

    def __init__(self, curve: Curve, low: int, high: int | None, sigma: Real) -> None:
        e, self.low, self.high, self.pair = curve.e, low, high, curve.pair
        self.a = a = e[low].real
        others = [i for i in range(5) if i not in (low, high)]
        self.below = {i for i in others if high is not None and (e[i].imag or e[i].real <= a)}
        if high is None:
            self.length = self.scale = H = sum(abs(e[i] - a) for i in others) / 4
            ends = {i: (e[i] - a, mp.mpc(H)) for i in others} | {"gap": (sigma - a, H), "unit": (mp.mpf(1), mp.mpf(0))}
        else:
            b = e[high].real
            self.length, self.scale = b - a, mp.mpf(1)
            ends = {i: (a - e[i], b - e[i]) for i in others}
            ends |= {"gap": (a - sigma, b - sigma), "unit": (mp.mpf(1), mp.mpf(1))}
        # the second root of a pair gives the conjugate of the first
        self.forms = {
            i: form if self.pair and i == 1 else (abs(form[0].real), abs(form[1].real))
            for i, form in ends.items()
            if not (self.pair and i == 2)
        }
        self.anchors = self._anchors()
        self.at_anchors = {i: self._at_anchors(form) for i, form in self.forms.items()}
        self.panels, self.totals = self._panels()
        self.half = self.totals[-1]

    def _anchors(self) -> list[Real]:
        """Angles of both ends and, if it is on the oval, of the point next to a conjugate pair."""
        low, high = (v.real for v in self.forms[1]) if self.pair else (1, 1)
        middle = [mp.asin(mp.sqrt(low / (low - high)))] if low * high < 0 else []
        return [mp.mpf(0), *middle, mp.pi / 2]

    def _at_anchors(self, form: tuple[Real, Real]) -> tuple[list[Real], Real]:
        """Values of a form at the anchors and its slope in sin² theta, to ``DIGITS`` digits."""
        low, high = form
        values = [low, *(low + (high - low) * mp.sin(v) ** 2 for v in self.anchors[1:-1]), high]
        with digits(DIGITS):
            return [+v for v in values], +(high - low)

    def _densities(self, forms: dict[Any, Any], scale: Any, *names: str) -> list[Any]:
        """Forms times 1/(|w| dtheta/ds); "unit" gives dA/dtheta, and "gap" dp/dtheta."""
        values = [abs(v) ** 2 if self.pair and i == 1 else v for i, v in forms.items() if i in range(5)]
        density = (scale / math.prod(values[1:], start=values[0])) ** 0.5
        return [density * forms[name] for name in names]

    def _panels(self) -> tuple[list[Panel], list[Any]]:
        """Panels from theta = 0 to pi/2, short where a singularity is near, and (A, p) from 0 to each anchor."""
        singular: list[Real] = []
        for i, (low, high) in self.forms.items():
            if i != "unit" and high != low:
                z = mp.asin(mp.mpc(mp.sqrt(low / (low - high))))
                singular += [v for w in (z, -z, mp.pi - z, z - mp.pi) for v in (w, mp.conj(w))]
        panels: list[Panel] = []
        totals = [np.array([mp.mpf(0), mp.mpf(0)])]
        for j, (low, high) in enumerate(pairwise(self.anchors)):
            half, totals = (high - low) / 2, [*totals, totals[-1]]
            for anchor, direction in ((j, 1), (j + 1, -1)):
                near = np.array([complex((z - self.anchors[anchor]) * direction) for z in singular])
                row, before = [], np.array([mp.mpf(0), mp.mpf(0)])
                for begin, end in pairwise(_cuts(near, float(half))):
                    ends = mp.mpf(begin), mp.mpf(end) if end < float(half) else half
                    over = self._integrals(anchor, direction, *ends)
                    row.append(Panel(anchor, direction, *ends, before, over))
                    before = before + over
                panels += row[::direction]
                totals[-1] = totals[-1] + before
        return panels, totals

    def _integrals(self, anchor: int, direction: int, begin: Real, end: Real) -> Any:
        """(A, p) over offsets from an anchor."""
        check_stop()
        with digits(DIGITS):
            middle, half = (begin + end) / 2, (end - begin) / 2
            cosine2, sine2 = mp.cos_sin(2 * self.anchors[anchor])
            constants = [(i, values[anchor], slope) for i, (values, slope) in self.at_anchors.items()]
            time = weighted = mp.mpf(0)
            for x, weight in _gauss():
                beyond = _beyond(cosine2, sine2, direction, *mp.cos_sin(middle + half * x))
                forms = {i: value + slope * beyond for i, value, slope in constants}
                rate, other = self._densities(forms, self.scale, "unit", "gap")
                time, weighted = time + weight * rate, weighted + weight * other
            return np.array([half * time, half * weighted])

    def angle(self, s: Real) -> Real:
        """Theta in [0, pi/2] of a point of the oval."""
        if self.high is None:
            return mp.pi / 2 if mp.isinf(s) else mp.atan(mp.sqrt(max(self.a - s, mp.mpf(0)) / self.length))
        return mp.asin(mp.sqrt(min(max((s - self.a) / self.length, mp.mpf(0)), mp.mpf(1))))

    def up_to(self, theta: Real) -> Any:
        """(A, p) over the angles from 0 to ``theta``."""

        def outside(panel: Panel) -> Real:
            offset = (theta - self.anchors[panel.anchor]) * panel.direction
            return max(panel.begin - offset, offset - panel.end)

        anchor, direction, begin, _, before, _ = min(self.panels, key=outside)
        offset = (theta - self.anchors[anchor]) * direction
        return self.totals[anchor] + direction * (before + self._integrals(anchor, direction, begin, offset))

    def tabulate(self) -> None:
        """Build, by panels, the Chebyshev series of theta over A and over p, and of the excess A - slope p over p.

        The mean slope makes the excess vanish at both ends of the oval.
        """
        slope = self.half[0] / self.half[1]
        low, high = (self.forms["unit"][i] - slope * self.forms["gap"][i] for i in (0, 1))
        constants = self.at_anchors | {"rest": self._at_anchors((low, high))}
        self.slope, self.halves = float(slope), self.half.astype(float)
        anchor, self.direction = (np.array([panel[i] for panel in self.panels]) for i in (0, 1))
        rounded = {i: complex if self.pair and i == 1 else float for i in constants}
        self.by_panel: dict[Any, Any] = {
            i: (np.array(values).astype(rounded[i])[anchor], rounded[i](rate))
            for i, (values, rate) in constants.items()
        }
        # sine and cosine of the anchors and of twice their angles
        turns = np.array([[*mp.cos_sin(v), *mp.cos_sin(2 * v)] for v in self.anchors]).astype(float)
        turns[0], turns[-1] = (1, 0, 1, 0), (0, 1, -1, 0)
        self.turns = turns[anchor].T
        # A, p and the excess where the panels begin
        start = np.array([self.totals[panel.anchor] + panel.direction * panel.before for panel in self.panels])
        excess_before = (start[:, 0] - slope * start[:, 1]).astype(float)
        nodes, values, integral = _chebyshev()
        begin, end = (np.array([float(panel[i]) for panel in self.panels]) for i in (2, 3))
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
        offset = middle + half * nodes
        beyond = _beyond(self.turns[2], self.turns[3], self.direction, np.cos(offset), np.sin(offset))
        forms = self.at(beyond, np.arange(len(self.panels)))
        densities = self._densities(forms, float(self.scale), "unit", "gap", "rest")
        A, p, excess = (integral @ (values @ f) * half for f in densities)
        self.tables = [values @ (middle + half * _inverse(A, nodes))]
        x = _inverse(p, nodes)
        self.tables += [values @ (middle + half * x), values @ chebyshev.chebval(x, excess, tensor=False)]
        self.tables[2][0] += self.direction * excess_before
        self.width = 2.0 / np.array([A.sum(axis=0), p.sum(axis=0)])
        # where the panels begin, and where each meets the next, as measured from theta = 0 and from pi/2
        self.begin = np.array([start, self.half - start]).astype(float).transpose(0, 2, 1)
        over = np.array([panel.over for panel in self.panels]) * (self.direction[:, None] > 0)
        meet = (start + over)[:-1]
        self.meet = np.array([*(meet - self.half), *meet]).astype(float).T

    def at(self, beyond: Array, panel: Integers) -> dict[Any, Any]:
        """Values of the forms."""
        return {i: values.take(panel) + slope * beyond for i, (values, slope) in self.by_panel.items()}

    def place(self, quarter: Integers, x: Array, of: int) -> tuple[Place, Array]:
        """Place where A (``of`` = 0) or p (1) is ``x`` beyond ``quarter`` half periods, and the excess for p."""
        half = self.halves[of]
        whole = np.rint(x / half)
        quarter, x = quarter + whole.astype(np.int64), x - whole * half
        end, size = quarter & 1, np.abs(x)
        n = np.searchsorted(self.meet[of], np.where(end, -size, size)) - (len(self.panels) - 1) * (1 - end)
        direction = self.direction.take(n)
        z = direction * (1 - 2 * end) * (size - self.begin[end, of, n]) * self.width[of].take(n) - 1.0
        quarter = quarter - (x < 0.0)
        offset = _clenshaw(self.tables[of], n, z)
        cosine, sine = np.cos(offset), np.sin(offset)
        C0, S0, cosine2, sine2 = (values.take(n) for values in self.turns)
        beyond = _beyond(cosine2, sine2, direction, cosine, sine)
        sine = direction * sine
        S, C = S0 * cosine + C0 * sine, C0 * cosine - S0 * sine
        S, C = np.where(quarter & 2, -S, S), np.where((quarter + 1) & 2, -C, C)
        excess = np.where(quarter & 1, -direction, direction) * _clenshaw(self.tables[2], n, z) if of else z
        return Place(S, C, n, beyond), excess

    def gap(self, at: Place) -> Array:
        """|s - sigma|, multiplied by cos² theta on the unbounded oval."""
        values, slope = self.by_panel["gap"]
        return values.take(at.panel) + slope * at.beyond

    def factors(self, at: Place) -> list[Any]:
        """sqrt(s - e_i), i = 1..5, times cos theta if unbounded; smooth in the signed sine and cosine."""
        roots = {i: np.sqrt(form) for i, form in self.at(at.beyond, at.panel).items() if i in range(5)}
        return self._factors(roots, at.S, at.C, float(self.length) ** 0.5)

    def factors_at(self, theta: Real, way: int) -> list[Any]:
        """Factors at one angle in [0, pi/2], which grows or falls, in multiprecision."""
        cosine, sine = mp.cos_sin(theta)
        forms = {i: low + (high - low) * sine**2 for i, (low, high) in self.forms.items() if i in range(5)}
        return self._factors({i: mp.sqrt(v) for i, v in forms.items()}, way * sine, cosine, mp.sqrt(self.length))

    def _factors(self, roots: dict[Any, Any], S: Any, C: Any, scale: Any) -> list[Any]:
        factors = {i: root if i in self.below else 1j * root for i, root in roots.items()}
        if self.pair:
            factors[2] = roots[1].conjugate() if 1 in self.below else 1j * roots[1].conjugate()
        factors[self.low] = (1j * scale if self.high is None else scale) * S
        if self.high is not None:
            factors[self.high] = 1j * scale * C
        return [factors[i] for i in range(5)]


def _beyond(cosine2: Any, sine2: Any, direction: Any, cosine: Any, sine: Any) -> Any:
    """sin² theta minus that of an anchor, from the functions of twice its angle and of the offset."""
    return sine * (cosine2 * sine + direction * sine2 * cosine)


def _cuts(singular: Array, end: float) -> list[float]:
    """Ends of panels from 0 to ``end`` such that no singularity is within their Bernstein ellipses."""
    cuts, left = [0.0], [end]
    while left:
        u, v = cuts[-1], left[-1]
        zeta = (2.0 * singular - u - v) / (v - u)
        size = np.abs(zeta + np.sqrt(zeta - 1.0) * np.sqrt(zeta + 1.0))
        if np.min(np.maximum(size, 1.0 / size)) >= NARROWNESS:
            cuts.append(left.pop())
        else:
            left.append(0.5 * (u + v))
        if len(cuts) + len(left) > MAX_PANELS:
            raise RunError(REFUSED.format(f"the set-up would need more than {MAX_PANELS} panels"))
    return cuts


def _inverse(series: Array, nodes: Array) -> Array:
    """Arguments (m, k) at which growing series (n, k) take the values total (1 + nodes)/2, by Newton's method."""
    slope, x = chebyshev.chebder(series), np.broadcast_to(nodes, (len(nodes), series.shape[1]))
    expected = 0.5 * series.sum(axis=0) * (1.0 + nodes)
    for _ in range(_NEWTON_STEPS):
        value, rate = (chebyshev.chebval(x, each, tensor=False) for each in (series, slope))
        x = np.clip(x - (value - expected) / rate, -1.2, 1.2)
    return x


def _clenshaw(table: Array, n: Integers, z: Array) -> Array:
    """Sums at ``z`` (m,) of the Chebyshev series in the columns ``n`` (m,) of a table."""
    now, before, twice = table[-1].take(n), np.zeros_like(z), z + z
    for row in table[-2:0:-1]:
        now, before = twice * now - before + row.take(n), now
    return z * now - before + table[0].take(n)
