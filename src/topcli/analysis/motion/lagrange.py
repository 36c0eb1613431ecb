"""Motion of the Lagrange top: nutation, precession, and the curve that the axis traces on the sphere.

With the momenta bv about the vertical and ba about the axis, divided by A, nu = mu |gamma|/A, the energy e without that
of the spin, and c = cos(theta) = gamma3/|gamma|,

    c'² = 2 (e - nu c)(1 - c²) - (bv - ba c)²,    phi' = (bv - ba c)/(1 - c²)

(Whittaker, Analytical Dynamics, section 71). The precession in a period is a complete elliptic integral of the third
kind.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext

from topcli.analysis.motion.euler import free_motion_of
from topcli.analysis.motion.result import Motion, Quantity, integrals_of
from topcli.arithmetic.elliptic import DIGITS, PI, carlson_rf, carlson_rj
from topcli.contracts import Floats
from topcli.schemes.lagrange.oscillation import derivative, horner, oscillation
from topcli.tops.lagrange import Lagrange, LagrangeInertial

CUSP = Decimal("1e-12")
"""Largest rate of precession at a turning point, relative to its terms, that counts as a cusp."""
ONE = Decimal(1)
NOTHING = Decimal("1e-60")
"""Differences of numbers of the order of one below this are rounding errors of the decimal arithmetic."""


@dataclass(frozen=True)
class Nutation:
    """Constants of one motion; ``c`` is its initial cos(theta)."""

    bv: Decimal
    ba: Decimal
    nu: Decimal
    e: Decimal
    c: Decimal

    @property
    def polynomial(self) -> list[Decimal]:
        """Coefficients of c'², highest degree first."""
        bv, ba, nu, e = self.bv, self.ba, self.nu, self.e
        return [Decimal(0), 2 * nu, -2 * e - ba * ba, 2 * bv * ba - 2 * nu, 2 * e - bv * bv]

    def turn(self, c: Decimal) -> Decimal:
        """Rate of precession times 1 - c²."""
        return self.bv - self.ba * c

    def mirrored(self) -> Nutation:
        """The same motion seen with the axis reversed, which changes the sign of nu."""
        return Nutation(self.bv, -self.ba, -self.nu, self.e, -self.c)

    def precession(self, low: Decimal, high: Decimal) -> Decimal:
        """Angle of precession in one period of the nutation between ``low`` and ``high``."""
        if self.nu < 0:
            return self.mirrored().precession(-high, -low)
        apart = high - low
        if self.nu:
            third = (2 * self.e + self.ba**2) / (2 * self.nu) - low - high
            rate, m1 = (2 * self.nu * (third - low)).sqrt(), (third - high) / (third - low)
        else:
            rate, m1 = (2 * self.e + self.ba**2).sqrt(), ONE
        total = Decimal(0)
        # 1/(1 - c²) in partial fractions; each integral over sin² with its own characteristic
        for weight, start, sign in ((self.bv - self.ba, 1 - low, 1), (self.bv + self.ba, 1 + low, -1)):
            if abs(weight) > NOTHING and start:
                n = sign * apart / start
                total += weight / 2 / start * _complete_third(n, m1)
        return 4 * total / rate


def _complete_third(n: Decimal, m1: Decimal) -> Decimal:
    """Complete elliptic integral of the third kind for the characteristic n < 1, with complementary parameter m1."""
    zero = Decimal(0)
    if n == 0:
        return carlson_rf(zero, m1, ONE)
    return carlson_rf(zero, m1, ONE) + n / 3 * carlson_rj(zero, m1, ONE, 1 - n)


def lagrange_motion(top: Lagrange | LagrangeInertial, y: Floats) -> Motion:
    """Motion of the Lagrange top from the state ``y`` (6,), in the body frame or the inertial frame."""
    conserved = integrals_of(top, y)
    if not any(y[3:]):
        if isinstance(top, Lagrange):
            return free_motion_of(top.form, (top.A, top.A, top.C), y, conserved)
        return Motion(top.form, "equilibrium", "equilibrium: m and a are constant", y, conserved)
    with localcontext(prec=DIGITS):
        found = _nutation(top, [Decimal(float(v)) for v in y])
        try:
            between = oscillation(found.polynomial, found.c, True, -ONE, ONE)
        except ValueError:
            return _asymptotic(top, y, found, conserved)
        if between.gap == 0.0:
            return _steady(top, y, found, conserved)
        low, high = max(between.lower, -ONE), min(between.upper, ONE)
        turned = float(found.precession(low, high) / (2 * PI))
        kind, title = _curve(found, low, high)
        period = between.period
        quantities = (
            *conserved,
            Quantity("frequency.nutation", 1.0 / period, "cycles of cos θ per unit time"),
            Quantity("period.nutation", period, "time of one oscillation of cos θ"),
            Quantity("frequency.precession", turned / period, "mean revolutions about the vertical per unit time"),
            Quantity("precession.per_nutation", turned, "revolutions about the vertical in one nutation"),
            Quantity("cos_theta.min", float(low), "smallest cosine of the angle θ between axis and vertical"),
            Quantity("cos_theta.max", float(high), "largest cosine of this angle"),
            Quantity("separatrix.m1", between.kc2, "complementary parameter 1 - k², 0 on the separatrix"),
            *_sleeping(found),
        )
    return Motion(top.form, kind, title, y, quantities)


def _nutation(top: Lagrange | LagrangeInertial, y: Sequence[Decimal]) -> Nutation:
    """Constants of the motion, from the state in the body frame or the inertial frame."""
    first, vertical = y[:3], y[3:]
    size = sum((v * v for v in vertical), Decimal(0)).sqrt()
    along = sum((a * b for a, b in zip(first, vertical, strict=True)), Decimal(0)) / size
    c = vertical[2] / size
    if isinstance(top, LagrangeInertial):
        across = sum((v * v for v in first), Decimal(0)) - along**2
        return Nutation(first[2], along, size, across / 2 + size * c, c)
    A = Decimal(top.A)
    spin = Decimal(top.C) / A * first[2]
    nu = Decimal(top.mu) / A * size
    flat = first[0] * vertical[0] + first[1] * vertical[1]
    return Nutation(flat / size + spin * c, spin, nu, (first[0] ** 2 + first[1] ** 2) / 2 + nu * c, c)


def _curve(found: Nutation, low: Decimal, high: Decimal) -> tuple[str, str]:
    """Kind of the curve of the axis on the sphere, and the motion in words."""
    bv, ba = found.bv, found.ba
    if not bv and not ba:
        return "pendulum", "planar pendulum"
    poles = [name for name, at in (("upright", 1 - high), ("hanging", 1 + low)) if at <= NOTHING]
    if poles:
        return "through the pole", f"nutation through the {' and the '.join(poles)} position"
    if not ba:
        return "waves", "spherical pendulum: no momentum about the axis, precession in one sense"
    ends = [found.turn(c) for c in (low, high)]
    scale = CUSP * (abs(bv) + abs(ba))
    if any(abs(value) <= scale for value in ends):
        return "cusps", "nutation with cusps: the axis stops at one of the bounds"
    if ends[0] * ends[1] < 0:
        return "loops", "nutation with loops: the precession changes its sense"
    return "waves", "nutation with waves: precession in one sense"


def _sleeping(found: Nutation) -> list[Quantity]:
    if not found.nu:
        return []
    ratio = float(found.ba**2 / (4 * abs(found.nu)))
    return [Quantity("sleeping.ratio", ratio, "(C ω3)²/(4 A |μγ|); upright spinning is stable from 1 on")]


def _steady(top: Lagrange | LagrangeInertial, y: Floats, found: Nutation, conserved: Sequence[Quantity]) -> Motion:
    """Regular precession, or a top that spins or rests about the vertical; theta is constant."""
    square = -horner(derivative(derivative(found.polynomial)), found.c) / 2
    quantities = [*conserved]
    if square > 0:
        small = float(square.sqrt() / (2 * PI))
        quantities.append(Quantity("frequency.nutation", small, "cycles of cos θ per unit time in small nutations"))
    if abs(found.c) != 1:
        turn = float(found.turn(found.c) / (1 - found.c**2) / (2 * PI))
        quantities.append(Quantity("frequency.precession", turn, "revolutions about the vertical per unit time"))
        quantities.append(Quantity("cos_theta.min", float(found.c), "constant cosine of the angle θ"))
        title = "regular precession: θ is constant" if turn else "at rest in a tilted position"
        return Motion(top.form, "regular precession", title, y, (*quantities, *_sleeping(found)))
    below = found.c * found.nu < 0
    what = "hanging" if below else "sleeping" if found.ba else "upright"
    stable = below or found.ba**2 >= 4 * abs(found.nu)
    title = f"{what} top: the axis stays vertical; {'stable' if stable else 'unstable'}"
    return Motion(top.form, what, title, y, (*quantities, *_sleeping(found)))


def _asymptotic(top: Lagrange | LagrangeInertial, y: Floats, found: Nutation, conserved: Sequence[Quantity]) -> Motion:
    """Motion whose axis tends to the position in which the top would stand upright."""
    lowest = float(found.ba**2 / (2 * abs(found.nu)) - 1)
    bounds = (lowest, 1.0) if found.nu > 0 else (-1.0, -lowest)
    quantities = (
        *conserved,
        Quantity("period.nutation", math.inf, "time of one oscillation of cos θ"),
        Quantity("cos_theta.min", bounds[0], "smallest cosine of the angle θ between axis and vertical"),
        Quantity("cos_theta.max", bounds[1], "largest cosine of this angle"),
        Quantity("separatrix.m1", 0.0, "complementary parameter 1 - k², 0 on the separatrix"),
        *_sleeping(found),
    )
    return Motion(top.form, "separatrix", "separatrix: asymptotic to the upright position", y, quantities)
