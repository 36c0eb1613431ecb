"""Motion of the Kowalevski top: class of the torus, frequencies, actions, and the nearest separatrix.

All from the roots of Kowalevski's curve and integrals over its two real ovals (``curve`` and ``oval`` in
``schemes.kowalevski.closed_form``). With a, b the integrals of ds/|w| over the ovals of s1 and s2, and P, Q those of
|s - sigma| ds/|w|, the periods of s1 and s2 are 2 (P b + Q a)/b and 2 (P b + Q a)/a.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import product

from topcli.analysis.motion import Motion, Neighbour, Quantity
from topcli.analysis.motion.diagram import (
    DELONE,
    PERIODIC,
    PINCH,
    SEPARATRIX,
    Region,
    between,
    nearest_critical,
    pendulum_is_stable,
    region,
)
from topcli.analysis.motion.torus import actions
from topcli.contracts import Floats
from topcli.errors import RunError
from topcli.schemes.kowalevski.closed_form.curve import (
    DIGITS,
    Curve,
    Integrals,
    Real,
    curve,
    integrals,
    real,
    separated,
    series_step,
)
from topcli.schemes.kowalevski.closed_form.multiprecision import digits, ellipk, isinf, mpc, mpf, sqrt
from topcli.schemes.kowalevski.closed_form.oval import Oval, ovals_of
from topcli.schemes.kowalevski.closed_form.setup import is_pendulum
from topcli.tops.kowalevski import Kowalevski, field

SHIFTS = (0, 3, 5)
"""Times, in 1/32 of the time in which the state turns, at which s1 and s2 are computed until they are determined."""
HALVES = 2
"""Half periods of s2 after which all signs of the state are those of the start."""


@dataclass(frozen=True)
class Ovals:
    """Curve of a motion and the ovals of s1 and s2."""

    curve: Curve
    first: Oval
    second: Oval

    @classmethod
    def of(cls, integrals: Integrals) -> Ovals | None:
        """Ovals of the given integrals; None if three roots of the curve coincide at an end of an oval."""
        with digits(2 * DIGITS):
            roots = curve(integrals)
        if any(roots.e.count(roots.e[i]) > 2 for i in roots.occupied()[:2]):
            return None
        with digits(DIGITS):
            return cls(roots, *ovals_of(roots))

    @property
    def turns(self) -> tuple[int, int]:
        """Half periods of s1 and of s2 after which all signs of the state are those of the start."""
        return 1 if self.first.low == 4 else 2, HALVES

    @cached_property
    def kind(self) -> str:
        """``separatrix``, ``pinch``, ``delone``, ``periodic`` or ``torus``."""
        if self.touched[0] and self.touched[1] and self.first.a == self.second.a:
            return PINCH
        if any(self.touched):
            return SEPARATRIX
        if not self.first.length:
            return DELONE if "k" in self.curve.of.double_roots else PERIODIC
        return "torus"

    @property
    def touched(self) -> tuple[bool, bool]:
        """For s1 and s2, true if an end of the oval is a double root."""
        return any(self.first.touched), any(self.second.touched)

    @cached_property
    def periods(self) -> tuple[float, float]:
        """Periods of s1 and s2, infinite for a variable that tends to a double root."""
        if self.kind == PINCH:
            total = 2 * (self.first.half_periods[1] + self.second.half_periods[1])
            return float(total), float(total)
        if all(self.touched):
            return math.inf, math.inf
        (a, P), (b, Q) = (
            _slope(oval) if any(oval.touched) else oval.half_periods for oval in (self.first, self.second)
        )
        determinant = 2 * (P * b + Q * a)
        one, two = (math.inf if away else float(determinant / v) for away, v in zip(self.touched, (b, a), strict=True))
        return one, two

    def half_periods(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Integrals of ds/|w| and s ds/|w| over the oval of s1 and that of s2."""
        (a, P), (b, Q) = self.first.half_periods, self.second.half_periods
        sigma = self.first.sigma
        return (float(a), float(P + sigma * a)), (float(b), float(sigma * b - Q))

    def separated(self, y: Floats, c: float) -> tuple[list[Real], Real, Real] | None:
        """State on the orbit of ``y`` with its finite s1 and s2; None if they are undetermined at all times tried."""
        rate = max(*map(abs, y[:3]), math.sqrt(abs(c) * max(map(abs, y[3:]))))
        for shift in SHIFTS:
            with digits(2 * DIGITS):
                start = [mpf(v) for v in y]
                if shift:
                    start = series_step(start, mpf(c), mpf(shift) / 32 / mpf(rate), 90)
                try:
                    one, two = separated(self.curve.of, start)
                except ZeroDivisionError:
                    continue
                if not isinf(two):
                    return start, one, two
        return None

    def rests(self, y: Floats, c: float) -> bool:
        """True if s1 or s2 of the state ``y`` is in the double root at an end of its oval, for ever."""
        separated = self.separated(y, c)
        if separated is None:
            return False
        with digits(DIGITS):
            pairs = zip(self.touched, (self.first, self.second), separated[1:], strict=True)
            return any(touched and _is_end(oval, s) for touched, oval, s in pairs)

    def shrinks(self, y: Floats, c: float) -> bool:
        """True if the torus of the state ``y`` shrinks to a motion of Bobylev and Steklov where two roots meet.

        Then f_i g_i f_j g_j > 0 for the two roots between the ovals, with f_i g_i = ± sqrt(s1 - e_i) sqrt(s2 - e_i).
        The state decides the signs by omega1 + i omega2 = x0 + r1 La/N (``state_of_factors``).
        """
        roots, gap = self.curve.e[:3], between(self.curve.e)
        separated = self.separated(y, c)
        if len(gap) < 2 or separated is None:
            return False
        state, s1, s2 = separated
        with digits(DIGITS):
            factors = [sqrt(s1 - e) * sqrt(s2 - e) for e in roots]
            lam = [1 / ((roots[i] - roots[i - 1]) * (roots[i] - roots[i - 2])) for i in range(3)]

            def missed(signs: Sequence[int]) -> float:
                terms = [s * v * w for s, v, w in zip(signs, factors, lam, strict=True)]
                N = 1 + sum(v * (e - self.curve.r2) for v, e in zip(terms, roots, strict=True))
                return float(abs(self.curve.x0 + self.curve.r1 * sum(terms) / N - mpc(state[0], state[1])))

            signs = min(product((1, -1), repeat=3), key=missed)
            i, j = gap
            return bool((signs[i] * signs[j] * factors[i] * factors[j]).real > 0)


def _slope(oval: Oval) -> tuple[Real, Real]:
    """Ratio of the integrals of ds/|w| and |s - sigma| ds/|w| of a variable that tends to the end of its oval."""
    root = oval.a if oval.touched[0] else oval.b
    return 1 / abs(root - oval.sigma), 1


def _is_end(oval: Oval, s: Real) -> bool:
    try:
        return oval.from_regular_end(oval.angle(s)) is None
    except RunError:  # too close to be distinguished
        return False


def kowalevski_motion(top: Kowalevski, y: Floats) -> Motion:
    """Motion of the Kowalevski top from the state ``y`` (6,), with gravity."""
    c = float(top.constants()[0])
    of = integrals(y, c)
    conserved = _integrals(top, of, c)
    if _at_rest(y, c):
        return Motion(top.form, "equilibrium", "equilibrium: omega and gamma are constant", y, conserved)
    if is_pendulum(y, c):
        return _pendulum(top, y, c, conserved)
    ovals = Ovals.of(of)
    if ovals is None:
        note = "no frequencies: at k = 0 and E = 2 l²/gamma² three roots of the curve coincide"
        return Motion(top.form, "triple root", "Delone's class at its triple root", y, conserved, notes=(note,))
    if ovals.kind == "torus":
        return _torus(top, y, ovals, conserved, c)
    return _degenerate(top, y, ovals, conserved, c)


def _at_rest(y: Floats, c: float) -> bool:
    """True if the state is an equilibrium, exactly."""
    return not any(field(tuple(map(Fraction, y)), (Fraction(c),)))  # type: ignore[arg-type]


def _integrals(top: Kowalevski, of: Integrals, c: float) -> tuple[Quantity, ...]:
    """Place in the bifurcation diagram."""
    unit = Fraction(top.C)
    return (
        Quantity("energy", float(3 * of.l1 * unit), "E"),
        Quantity("two_l", float(2 * of.L / Fraction(c) * unit), "2l, angular momentum about the vertical"),
        Quantity("gamma_sq", float(of.G / Fraction(c) ** 2), "γ²"),
        Quantity("k_sq", float(of.k_sq), "k², Kowalevski's integral"),
    )


def _frequencies(ovals: Ovals) -> list[Quantity]:
    period1, period2 = ovals.periods
    n1, n2 = ovals.turns
    about = {1: "once", 2: "twice"}
    first, second = 1.0 / (n1 * period1), 1.0 / (n2 * period2)
    frequencies = [
        Quantity(
            "frequency.1", first, f"cycles per unit time of the first angle; s1 oscillates {about[n1]} in a cycle"
        ),
        Quantity(
            "frequency.2", second, f"cycles per unit time of the second angle; s2 oscillates {about[n2]} in a cycle"
        ),
    ]
    if second:
        frequencies.append(Quantity("frequency.ratio", first / second, "rotation number frequency.1/frequency.2"))
    return [
        *frequencies,
        Quantity("period.s1", period1, "time of one oscillation of s1"),
        Quantity("period.s2", period2, "time of one oscillation of s2, from one zero of ω2 to the next"),
        Quantity("period.omega2", n2 * period2, "mean time of a full oscillation of ω2"),
    ]


def _torus(top: Kowalevski, y: Floats, ovals: Ovals, conserved: Sequence[Quantity], c: float) -> Motion:
    where = region(ovals.curve)
    quantities = [
        *conserved,
        Quantity("tori", where.tori, "number of tori with these integrals"),
        *_frequencies(ovals),
    ]
    for name, both in zip(("s1", "s2"), ovals.half_periods(), strict=True):
        quantities += [
            Quantity(f"half_period.{name}.0", both[0], f"integral of ds/|w| over the oval of {name}"),
            Quantity(f"half_period.{name}.1", both[1], f"integral of s ds/|w| over the oval of {name}"),
        ]
    both = (value * top.C for value in actions(ovals.first, ovals.second, ovals.turns))
    for i, value in enumerate(both, 1):
        meaning = f"action J of this angle, up to multiples of 2l; dE/dJ = 2π frequency.{i}"
        quantities.append(Quantity(f"action.{i}", value, meaning))
    neighbours = critical_neighbours(ovals.curve.of, ovals.shrinks(y, c), top.C)
    quantities += _distances(ovals.curve.of, neighbours, top.C)
    return Motion(top.form, f"torus {where.name}", torus_title(where, ovals), y, tuple(quantities), tuple(neighbours))


def torus_title(where: Region, ovals: Ovals) -> str:
    """Class of a torus in words."""
    number = "the only torus" if where.tori == 1 else f"one of {where.tori} tori"
    names = _root_names(ovals)
    ends = f"s1 in [{names[ovals.first.low]}, e4], s2 in (-∞, {names[ovals.second.low]}]"
    return f"quasi-periodic on {number} in region {where.name} of the bifurcation diagram; {ends}"


def _root_names(ovals: Ovals) -> dict[int, str]:
    """Names of the real roots: e4, e5, and e1 > e2 > e3 of the cubic."""
    roots = ovals.curve.e
    cubic = sorted((i for i in range(3) if roots[i].imag == 0), key=lambda i: -roots[i].real)
    return {3: "e4", 4: "e5"} | {i: f"e{n}" for n, i in enumerate(cubic, 1)}


def critical_neighbours(of: Integrals, shrinks: bool, unit: float) -> list[Neighbour]:
    """Nearest critical motions along E and along k²; ``unit`` is the third moment of inertia."""
    scale = {"energy": unit, "k_sq": 1.0}
    return [
        Neighbour(name, float(critical.value) * scale[name], float(critical.distance) * scale[name], critical.kind)
        for name, nearest in nearest_critical(of, shrinks).items()
        for critical in nearest
    ]


def _distances(of: Integrals, neighbours: Sequence[Neighbour], unit: float) -> list[Quantity]:
    """Distances to the nearest separatrix in the plane of E/C and k, along either axis."""
    distances = []
    for neighbour in neighbours:
        if neighbour.kind not in (SEPARATRIX, PINCH):
            continue
        change = neighbour.distance
        if neighbour.along == "energy":
            distances.append(abs(change) / unit)
        else:
            with digits(DIGITS):
                k_sq = real(of.k_sq)
                distances.append(float(abs(mpf(change) / (sqrt(k_sq + mpf(change)) + sqrt(k_sq)))))
    meaning = "distance to the nearest separatrix: the smallest change of E/C or of k that leads there"
    return [Quantity("separatrix.distance", min(distances), meaning)] if distances else []


def _pendulum(top: Kowalevski, y: Floats, c: float, conserved: Sequence[Quantity]) -> Motion:
    """Motion with omega2 = 0: a pendulum theta'' = -k sin theta (``schemes.kowalevski.closed_form.setup``)."""
    what = "pendulum (Bobylev-Steklov): ω2 = 0 at all times"
    w1, _, w3, g1, g2, _ = map(Fraction, y)
    xi = (w1 * w1 - Fraction(c) * g1, -Fraction(c) * g2)
    energy, k_sq = w3 * w3 - 2 * xi[0], xi[0] ** 2 + xi[1] ** 2
    if energy >= 0 and energy**2 == 4 * k_sq:
        period = Quantity("period", math.inf, "time of the homoclinic motion")
        return Motion(top.form, "separatrix", f"{what}; homoclinic to its upper equilibrium", y, (*conserved, period))
    with digits(2 * DIGITS):
        k = sqrt(real(k_sq))
        m = (real(energy) + 2 * k) / (4 * k)  # of sin²(theta/2) at the turning points
        rotates = m > 1
        time = float(2 * ellipk(1 / m) / sqrt(k * m) if rotates else 4 * ellipk(m) / sqrt(k))
        stable = pendulum_is_stable(curve(integrals(y, c)))
    quantities = (
        *conserved,
        Quantity("frequency", 1.0 / time, "cycles per unit time"),
        Quantity("period", time, "time of one rotation" if rotates else "time of one oscillation"),
    )
    way = "rotates" if rotates else "oscillates"
    word = {True: "; stable", False: "; unstable", None: ""}[stable]
    return Motion(top.form, "pendulum", f"{what}; it {way}{word}", y, quantities)


def _degenerate(top: Kowalevski, y: Floats, ovals: Ovals, conserved: Sequence[Quantity], c: float) -> Motion:
    """Motion on a critical curve of the bifurcation diagram, decided exactly."""
    kind = ovals.kind
    if kind in (DELONE, PERIODIC):
        what = "Delone's class, k = 0" if kind == DELONE else "E - 2 l²/γ² = -k"
        return Motion(top.form, kind, f"periodic: {what}; s1 is constant", y, (*conserved, *_cycle(ovals)))
    if all(ovals.touched) and kind == SEPARATRIX:
        period = Quantity("period", math.inf, "time of one cycle; the motion is homoclinic or heteroclinic")
        title = "separatrix: s1 and s2 tend to double roots; asymptotic to an equilibrium"
        return Motion(top.form, kind, title, y, (*conserved, period))
    rests = ovals.rests(y, c)
    if kind == PINCH:
        passage = ovals.periods[0]
        time = Quantity("period.passages", passage, "time from one passage of the double root to the next")
        what = "pinch: s1 and s2 meet in a double root between their ovals"
        period = Quantity("period", 2.0 * passage, "time of one cycle")
    else:
        i, which = (1, "s1") if ovals.touched[0] else (0, "s2")
        cycle = ovals.turns[i] * ovals.periods[i]
        time = Quantity("period.limit", cycle, "period of the motion that this one tends to")
        what = f"separatrix: {which} tends to a double root"
        period = Quantity("period", cycle, "time of one cycle")
    if rests:
        title = "unstable periodic motion: a separated variable stays in a double root"
        return Motion(top.form, "unstable", title, y, (*conserved, period))
    return Motion(top.form, kind, f"{what}; asymptotic to a periodic motion", y, (*conserved, time))


def _cycle(ovals: Ovals) -> list[Quantity]:
    """Frequencies of a motion with constant s1."""
    period1, period2 = ovals.periods
    cycle = HALVES * period2
    return [
        Quantity("frequency", 1.0 / cycle, "cycles per unit time"),
        Quantity("frequency.normal", 1.0 / (ovals.turns[0] * period1), "cycles per unit time of small deviations"),
        Quantity("period", cycle, "time of one cycle, in which s2 oscillates twice"),
        Quantity("period.omega2", cycle, "time of a full oscillation of ω2"),
    ]
