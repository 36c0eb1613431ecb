"""Motion of the Kowalevski top: class of the torus, frequencies, distance to a separatrix.

All from the roots of Kowalevski's curve and integrals over its two real ovals (``curve`` and ``oval`` in
``schemes.kowalevski.closed_form``). With a, b the integrals of ds/|w| over the ovals of s1 and s2, and P, Q those of
|s - sigma| ds/|w|, the periods of s1 and s2 are 2 (P b + Q a)/b and 2 (P b + Q a)/a.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

from topcli.analysis.motion import Motion, Quantity
from topcli.analysis.motion.diagram import Region, between, region, separatrix_distance
from topcli.contracts import Floats
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
DISTANCE = "distance to the nearest separatrix: the smallest change of E/C or of k that leads there"


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

    @property
    def on_separatrix(self) -> bool:
        """True if an end of an oval is a double root."""
        return any(self.first.touched) or any(self.second.touched)

    @property
    def periods(self) -> tuple[float, float]:
        """Periods of s1 and s2."""
        (a, P), (b, Q) = self.first.half_periods, self.second.half_periods
        determinant = 2 * (P * b + Q * a)
        return float(determinant / b), float(determinant / a)

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
    if ovals is not None and ovals.first.length and not ovals.on_separatrix:
        return _torus(top, y, ovals, conserved, c)
    what = "roots of Kowalevski's curve coincide, so there are no frequencies"
    if ovals is None or not ovals.on_separatrix:
        return Motion(top.form, "critical", f"critical motion: {what}", y, conserved)
    distance = Quantity("separatrix.distance", 0.0, DISTANCE)
    return Motion(top.form, "separatrix", f"at the integrals of a separatrix: {what}", y, (*conserved, distance))


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
    return [
        *frequencies,
        Quantity("frequency.ratio", first / second, "rotation number frequency.1/frequency.2"),
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
    distance = separatrix_distance(ovals.curve.of, ovals.shrinks(y, c))
    if distance is not None:
        quantities.append(Quantity("separatrix.distance", distance, DISTANCE))
    return Motion(top.form, f"torus {where.name}", torus_title(where, ovals), y, tuple(quantities))


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
    quantities = (
        *conserved,
        Quantity("frequency", 1.0 / time, "cycles per unit time"),
        Quantity("period", time, "time of one rotation" if rotates else "time of one oscillation"),
    )
    way = "rotates" if rotates else "oscillates"
    return Motion(top.form, "pendulum", f"{what}; it {way}", y, quantities)
