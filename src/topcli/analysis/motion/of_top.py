"""Description of the motion of any top from a state, as far as a closed form is known.

That of the Euler top: class of the polhode, its period, and the rotation of the body about the momentum. That of the
Lagrange top: nutation, precession, and the curve that the axis traces on the sphere.

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
from fractions import Fraction

from topcli.analysis.motion import Motion, MotionQuantity, integrals_of
from topcli.arithmetic.elliptic import third_kind
from topcli.arithmetic.multiprecision import Real, digits, mp, real
from topcli.contracts import Floats, Top
from topcli.errors import UsageError
from topcli.schemes.classical.euler import free_motion
from topcli.schemes.classical.lagrange import CUBIC_DIGITS, AsymptoticError, oscillation
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

_AXES = "ABC"
Described = tuple[str, str, Sequence[MotionQuantity]]
"""Kind, title and quantities of a motion."""
LARGEST = 1e70
"""Largest number of a state or a top; the fourth power of larger ones overflows."""
CUSP = 1e-12
"""Largest rate of precession at a turning point, relative to its terms, that counts as a cusp."""
_NOTHING = 1e-50
"""Differences of numbers of the order of one below this are rounding errors of the multiprecision."""


def motion_of(top: Top, y0: Floats) -> Motion:
    """Motion of ``top`` from the state ``y0`` (d,); of a top without a closed form only its integrals.

    Raises UsageError if the integrals overflow.
    """
    y = tuple(float(v) for v in y0)
    if max(map(abs, (*y, *top.constants()))) > LARGEST:
        raise UsageError(f"motion: the state or the parameters are too large: more than {LARGEST:g} in magnitude")
    top = closed_form_top(top)
    free = isinstance(top, Euler) or (isinstance(top, Lagrange) and not any(y[3:]))
    if isinstance(top, Kowalevski):
        if top.constants()[0] != 0.0 and any(y[3:]):
            from topcli.analysis.motion.kowalevski import kowalevski_motion  # imports mpmath

            return kowalevski_motion(top, y)
        free = True
    described: Described = "no closed form", "no closed form is known for a top with these parameters in these axes", ()
    conserved = integrals_of(top, y)
    with digits(CUBIC_DIGITS):
        if free:
            described = _free(y[:3], tuple(map(float, top.euler_poisson().moments)))
        elif isinstance(top, Lagrange | LagrangeInertial):
            described = _lagrange(top, y)
    kind, title, quantities = described
    return Motion(top.form, kind, title, y, (*conserved, *quantities))


def closed_form_top(top: Top) -> Top:
    """Return ``top``; in place of a heavy top the Euler, Lagrange or Kowalevski top with its parameters, if any."""
    if top.form != "heavy":
        return top
    (A, B, C), (x0, y0, z0) = top.euler_poisson().moments, top.euler_poisson().gravity
    if x0 == y0 == z0 == 0.0:
        return EulerGamma(A=A, B=B, C=C)
    if A == B and x0 == y0 == 0.0:
        return Lagrange(A=A, C=C, mu=z0)
    if A == B == 2.0 * C and y0 == z0 == 0.0:
        return Kowalevski(A=A, c0=x0)
    return top


def _free(omega: Floats, moments: Floats) -> Described:
    """Motion without gravity from ``omega``, for the moments of inertia ``moments``."""
    w, J = ([Fraction(v) for v in values] for values in (omega, moments))
    # exact fractions, so that a separatrix and a symmetric top are decided and not guessed
    square = sum((a * b) ** 2 for a, b in zip(J, w, strict=True))
    twice = sum(a * b * b for a, b in zip(J, w, strict=True))
    if not twice:
        return "equilibrium", "at rest", ()
    effective = square / twice
    low, middle, high = sorted(J)
    different = low < middle < high
    motion = free_motion(omega, moments)
    if motion is None:
        speed = math.hypot(*omega) / (2.0 * math.pi)
        quantity = MotionQuantity("frequency.rotation", speed, "revolutions of the body per unit time")
        stability = "" if not different else "unstable " if effective == middle else "stable "
        return "steady rotation", f"{stability}steady rotation about a principal axis", (quantity,)
    # otherwise omega moves on a polhode about one axis, or along the separatrix, whose period is infinite
    axis, argument = motion.elliptic.axes[0], motion.elliptic.argument
    if argument.quarter is None:
        period = MotionQuantity("period", math.inf, "time from one steady rotation about the middle axis to the other")
        return "separatrix", "separatrix: asymptotic to the rotation about the middle axis", (period,)
    half, name = 2 * argument.quarter / argument.rate, _AXES[axis]
    quantities = [
        MotionQuantity("frequency", float(0.5 / half), "cycles of ω along the polhode per unit time"),
        MotionQuantity("period", float(2 * half), "time in which ω traverses the polhode"),
        MotionQuantity(
            "frequency.precession", float(motion.turn), f"mean revolutions of the axis {name} about m per unit time"
        ),
    ]
    title = f"regular precession of a symmetric top; ω circles about the axis of {name}"
    if different:
        distance, meaning = float(effective - middle), f"m²/(m·ω) - {float(middle):g}; 0 on the separatrix"
        quantities.append(MotionQuantity("separatrix.distance", distance, meaning))
        size = "smallest" if J[axis] == low else "largest"
        title = f"polhode about the axis of the {size} moment, {name} = {float(J[axis]):g}"
    return f"polhode about {name}", title, quantities


@dataclass(frozen=True)
class Nutation:
    """Constants of one motion; ``c`` is its initial cos(theta)."""

    bv: Real
    ba: Real
    nu: Real
    e: Real
    c: Real

    @property
    def polynomial(self) -> list[Real]:
        """Coefficients of c'², highest degree first."""
        bv, ba, nu, e = self.bv, self.ba, self.nu, self.e
        return [2 * nu, -2 * e - ba * ba, 2 * bv * ba - 2 * nu, 2 * e - bv * bv]

    def turn(self, c: Real) -> Real:
        """Rate of precession times 1 - c²."""
        return self.bv - self.ba * c

    def mirrored(self) -> Nutation:
        """The same motion seen with the axis reversed, which changes the sign of nu."""
        return Nutation(self.bv, -self.ba, -self.nu, self.e, -self.c)

    def precession(self, low: Real, high: Real) -> Real:
        """Angle of precession in one period of the nutation between ``low`` and ``high``."""
        if self.nu < 0:
            return self.mirrored().precession(-high, -low)
        apart = high - low
        if self.nu:
            third = (2 * self.e + self.ba**2) / (2 * self.nu) - low - high
            rate, m1 = mp.sqrt(2 * self.nu * (third - low)), (third - high) / (third - low)
        else:
            rate, m1 = mp.sqrt(2 * self.e + self.ba**2), mp.mpf(1)
        total, quarter = mp.mpf(0), mp.elliprf(0, m1, 1)
        # 1/(1 - c²) in partial fractions; each integral over sin² with its own characteristic
        for weight, start, sign in ((self.bv - self.ba, 1 - low, 1), (self.bv + self.ba, 1 + low, -1)):
            if abs(weight) > _NOTHING and start:
                n = sign * apart / start
                total += weight / 2 / start * third_kind(quarter, mp.mpf(1), mp.mpf(0), m1, n)
        return 4 * total / rate


def _lagrange(top: Lagrange | LagrangeInertial, y: Floats) -> Described:
    """Motion of the Lagrange top from the state ``y`` (6,), in the body frame or the inertial frame."""
    if not any(y[3:]):
        return "equilibrium", "equilibrium: m and a are constant", ()
    nutation = _nutation(top, [real(float(v)) for v in y])
    try:
        between = oscillation(nutation.polynomial, nutation.c, True)
    except AsymptoticError:
        period = MotionQuantity("period.nutation", math.inf, "time of one oscillation of cos θ")
        return "separatrix", "separatrix: asymptotic to the upright position", (period,)
    if between.gap == 0.0:
        return _steady(nutation)
    low, high = max(between.lower, mp.mpf(-1)), min(between.upper, mp.mpf(1))
    turned, period = float(nutation.precession(low, high) / (2 * mp.pi)), between.period
    if abs(turned) < _NOTHING:  # the axis does not go round the vertical: the rest is rounding
        turned = 0.0
    quantities = (
        MotionQuantity("frequency.nutation", 1.0 / period, "cycles of cos θ per unit time"),
        MotionQuantity("period.nutation", period, "time of one oscillation of cos θ"),
        MotionQuantity("frequency.precession", turned / period, "mean revolutions about the vertical per unit time"),
        MotionQuantity("separatrix.distance", float(between.argument.m1), "1 - k² of the elliptic functions; 0 there"),
    )
    return *_curve(nutation, low, high), quantities


def _nutation(top: Lagrange | LagrangeInertial, y: Sequence[Real]) -> Nutation:
    """Constants of the motion, from the state in the body frame or the inertial frame."""
    first, vertical = y[:3], y[3:]
    size = mp.sqrt(mp.fdot(vertical, vertical))
    along = mp.fdot(first, vertical) / size
    c = vertical[2] / size
    if isinstance(top, LagrangeInertial):
        across = mp.fdot(first, first) - along**2
        return Nutation(first[2], along, size, across / 2 + size * c, c)
    A = real(top.A)
    spin, nu = real(top.C) / A * first[2], real(top.mu) / A * size
    flat = first[0] * vertical[0] + first[1] * vertical[1]
    return Nutation(flat / size + spin * c, spin, nu, (first[0] ** 2 + first[1] ** 2) / 2 + nu * c, c)


def _curve(nutation: Nutation, low: Real, high: Real) -> tuple[str, str]:
    """Kind of the curve of the axis on the sphere, and the motion in words."""
    bv, ba = nutation.bv, nutation.ba
    if not bv and not ba:
        return "pendulum", "planar pendulum"
    poles = [name for name, at in (("upright", 1 - high), ("hanging", 1 + low)) if at <= _NOTHING]
    if poles:
        return "through the pole", f"nutation through the {' and the '.join(poles)} position"
    ends = [nutation.turn(c) for c in (low, high)]
    scale = CUSP * (abs(bv) + abs(ba))
    if any(abs(value) <= scale for value in ends):
        return "cusps", "nutation with cusps: the axis stops at one of the bounds"
    if ends[0] * ends[1] < 0:
        return "loops", "nutation with loops: the precession changes its sense"
    return "waves", "nutation with waves: precession in one sense"


def _steady(nutation: Nutation) -> Described:
    """Regular precession, or a top that spins or rests about the vertical; theta is constant."""
    cubic, quadratic, *_ = nutation.polynomial
    square = -(3 * cubic * nutation.c + quadratic)
    quantities = []
    if square > 0:
        small = float(mp.sqrt(square) / (2 * mp.pi))
        quantities.append(
            MotionQuantity("frequency.nutation", small, "cycles of cos θ per unit time in small nutations")
        )
    if abs(nutation.c) != 1:
        turn = float(nutation.turn(nutation.c) / (1 - nutation.c**2) / (2 * mp.pi))
        quantities.append(MotionQuantity("frequency.precession", turn, "revolutions about the vertical per unit time"))
        title = "regular precession: θ is constant" if turn else "at rest in a tilted position"
        return "regular precession", title, quantities
    below = nutation.c * nutation.nu < 0
    what = "hanging" if below else "sleeping" if nutation.ba else "upright"
    stable = below or nutation.ba**2 >= 4 * abs(nutation.nu)
    title = f"{what} top: the axis stays vertical; {'stable' if stable else 'unstable'}"
    return what, title, quantities
