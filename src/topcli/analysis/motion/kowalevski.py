"""Motion of the Kowalevski top: class of the torus, frequencies, distance to a separatrix.

All from the roots of Kowalevski's curve and integrals over its two real ovals (``schemes.kowalevski.separation``).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from topcli.analysis.motion import Motion, MotionQuantity, integrals_of
from topcli.analysis.motion.diagram import TORI, region, separatrix_distance
from topcli.arithmetic.multiprecision import digits, mp
from topcli.contracts import Floats
from topcli.schemes.kowalevski.curve import Curve, Integrals
from topcli.schemes.kowalevski.separation import ROOT_DIGITS, Separated
from topcli.tops.kowalevski import Kowalevski, field

DISTANCE = "distance to the nearest separatrix: the smallest change of E/C or of k that leads there"


def _coincide(curve: Curve) -> tuple[bool, bool]:
    """True if an end of an oval is a double root, and true if the oval of s1 is a point."""
    e, (top, low, high) = curve.e, curve.occupied()
    equal = [{i, j} for i in range(5) for j in range(i) if abs(e[i] - e[j]) < mp.mpf(10) ** (-mp.dps // 4)]
    return any(pair & {top, low, high} and pair != {low, high} for pair in equal), {low, high} in equal


def kowalevski_motion(top: Kowalevski, y: Floats) -> Motion:
    """Motion of the Kowalevski top from the state ``y`` (6,), with gravity."""
    c = float(top.constants()[0])
    of = Integrals.of(y, c)
    conserved = integrals_of(top, y)
    w1, w2, w3, _, _, g3 = exact = tuple(map(Fraction, y))
    if not any(field(exact, (Fraction(c),))):  # type: ignore[arg-type]
        return Motion(top.form, "equilibrium", "equilibrium: omega and gamma are constant", y, conserved)
    if w2 == 0 and Fraction(c) * g3 == w1 * w3:  # beside the torus with the same integrals
        return Motion(top.form, "pendulum", "pendulum (Bobylev-Steklov): ω2 = 0 at all times", y, conserved)
    with digits(ROOT_DIGITS):
        curve = Curve.with_integrals(of)
        on_separatrix, point = _coincide(curve) if 0 in of.discriminants() else (False, False)
        if not (on_separatrix or point):
            return _torus(top, y, Separated(curve, c), conserved)
    what = "roots of Kowalevski's curve coincide, so there are no frequencies"
    if point:
        return Motion(top.form, "critical", f"critical motion: {what}", y, conserved)
    distance = MotionQuantity("separatrix.distance", 0.0, DISTANCE)
    return Motion(top.form, "separatrix", f"at the integrals of a separatrix: {what}", y, (*conserved, distance))


def _torus(top: Kowalevski, y: Floats, motion: Separated, conserved: Sequence[MotionQuantity]) -> Motion:
    where = region(motion.curve)
    period1, period2 = (float(2 / rate) for rate in motion.rates)
    # oscillations of s1 and s2 after which all signs of the state are those of the start
    n1, n2 = 1 if motion.one.low == 4 else 2, 2
    times = {1: "once", 2: "twice"}
    angle = "cycles per unit time of the {} angle; {} oscillates {} in a cycle".format
    first, second = 1.0 / (n1 * period1), 1.0 / (n2 * period2)
    quantities = [
        *conserved,
        MotionQuantity("frequency.1", first, angle("first", "s1", times[n1])),
        MotionQuantity("frequency.2", second, angle("second", "s2", times[n2])),
        MotionQuantity("frequency.ratio", first / second, "rotation number frequency.1/frequency.2"),
        MotionQuantity("period.s1", period1, "time of one oscillation of s1"),
        MotionQuantity("period.s2", period2, "time of one oscillation of s2, from one zero of ω2 to the next"),
        MotionQuantity("period.omega2", n2 * period2, "mean time of a full oscillation of ω2"),
    ]
    distance = separatrix_distance(motion.curve.of)
    if distance is not None:
        quantities.append(MotionQuantity("separatrix.distance", distance, DISTANCE))
    number = "the only torus" if TORI[where] == 1 else f"one of {TORI[where]} tori"
    title = f"quasi-periodic on {number} in region {where} of the bifurcation diagram"
    return Motion(top.form, f"torus {where}", title, y, tuple(quantities))
