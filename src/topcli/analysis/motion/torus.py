"""Torus of a Kowalevski motion: actions by quadrature.

With x = s + E/3, Z = (2 x - E)² - k² and the two factors S = x (Z + G) - L² and Z/4 of Phi, the momentum conjugate
to x is

    pi(x) = (1/2) int dZ / sqrt(-Z (x Z + x G - L²)),    d pi/dE = (s - E/6)/w,    d pi/dk² = 1/(4 w),

so that (x1, pi1, x2, pi2) are canonical up to functions of x (Veselov, Novikov, Proc. Steklov Inst. 165 (1985) 53-65).
The actions are the integrals over the cycles of the torus, divided by 2 pi:

    J1 = (n1/pi) (int_a^b f dx + pi sqrt(a) - pi |L|/sqrt(G)),    J2 = (n2/pi) (int_-inf^r f dx - pi sqrt(r)),
    f = arcsin(sqrt(x |Z|/|x G - L²|))/sqrt(x),

where the terms with a and r are absent if the end of the oval is e4 or e5. J1 vanishes where the oval of s1 shrinks to
a point. The integral to minus infinity diverges; sqrt(y) ln(16 y²/G) - 4 sqrt(y), y = -x, is subtracted. Then
dE/dJ_i = 2 pi nu_i. The same cycles give other values in Euler angles, which are singular where gamma is parallel to
the third axis: they differ by multiples of 2l, a constant of the leaf.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from topcli.schemes.kowalevski.closed_form.curve import Real, real
from topcli.schemes.kowalevski.closed_form.multiprecision import asin, asinh, cos_sin, digits, log, mpf, pi, quad, sqrt
from topcli.schemes.kowalevski.closed_form.oval import Oval

WORKING_DIGITS = 20
"""Decimal digits of the quadrature (tanh-sinh, which allows for the logarithm at infinity)."""
INNER_DIGITS = 80
"""Decimal digits of the integrand, whose terms cancel to twice the digits of the quadrature near infinity."""


def actions(first: Oval, second: Oval, turns: tuple[int, int]) -> tuple[float, float]:
    """Actions J1, J2 of the cycles that pass ``turns`` half periods of s1 and of s2."""
    with digits(INNER_DIGITS):
        first_action, second_action = _of_first(first), _of_second(second)
        return float(turns[0] * first_action / pi), float(turns[1] * second_action / pi)


def _momentum(of: Oval, x: Real) -> Real:
    """Return f = arcsin(sqrt(x |Z|/|x G - L²|))/sqrt(x) at ``x``, analytic across x = 0."""
    exact = of.curve.of
    Z = (2 * x - 3 * real(exact.l1)) ** 2 - real(exact.k_sq)
    a = x * real(exact.G) - real(exact.L) ** 2
    if not Z or not a:
        return mpf(0)
    if not x:
        return sqrt(abs(Z / a))
    part = sqrt(abs(x * Z / a))
    return asin(min(part, mpf(1))) / sqrt(x) if x > 0 else asinh(part) / sqrt(-x)


def _integral(density: Callable[[Real], Real], anchors: Sequence[Real]) -> Real:
    """Integral between the ``anchors`` with ``WORKING_DIGITS``, of a density computed with ``INNER_DIGITS``."""

    def precise(theta: Real) -> Real:
        with digits(INNER_DIGITS):
            return density(theta)

    with digits(WORKING_DIGITS):
        return quad(precise, anchors)


def _root_of_end(of: Oval) -> Real:
    """Root of x at the end of the oval with theta = 0; x >= 0 there, but for rounding."""
    return sqrt(max(of.a + real(of.curve.of.l1), mpf(0)))


def _of_first(of: Oval) -> Real:
    exact = of.curve.of
    l1, total = real(exact.l1), mpf(0)

    def density(theta: Real) -> Real:
        C, S = cos_sin(theta)
        return _momentum(of, of.a + l1 + of.length * S * S) * 2 * of.length * S * C

    if of.length:
        total = _integral(density, of.anchors)
    if of.low < 3:
        total += pi * (_root_of_end(of) - abs(real(exact.L)) / sqrt(real(exact.G)))
    return total


def _of_second(of: Oval) -> Real:
    exact, H = of.curve.of, of.length
    l1, scale, root = real(exact.l1), 16 * H * H / real(exact.G), sqrt(H)

    def density(theta: Real) -> Real:
        C, S = cos_sin(theta)
        tan = S / C
        momentum = _momentum(of, of.a + l1 - H * tan * tan)
        return (2 * H * momentum * tan / C - root * tan * log(scale / C**4)) / C

    total = _integral(density, of.anchors) - (root * log(scale) - 4 * root)
    return total - pi * _root_of_end(of) if of.low < 3 else total
