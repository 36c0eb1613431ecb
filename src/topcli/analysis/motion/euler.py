"""Motion of the Euler top: class of the polhode, its period, and the rotation of the body about the momentum."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Decimal, localcontext

from topcli.analysis.motion.result import Motion, Quantity
from topcli.arithmetic.elliptic import DIGITS
from topcli.contracts import Floats
from topcli.schemes.euler.exact import free_motion

AXES = "ABC"
Vector = tuple[Decimal, Decimal, Decimal]


def free_motion_of(
    form: str, moments: Sequence[float], y: Floats, conserved: Sequence[Quantity], notes: tuple[str, ...] = ()
) -> Motion:
    """Free motion from omega ``y[:3]`` for three moments of inertia."""
    with localcontext(prec=DIGITS):
        w, J = _vector(y[:3]), _vector(moments)
        square = sum(((a * b) ** 2 for a, b in zip(J, w, strict=True)), Decimal(0))
        twice = sum((a * b * b for a, b in zip(J, w, strict=True)), Decimal(0))
        if not twice:
            return Motion(form, "equilibrium", "at rest", y, tuple(conserved), notes=notes)
        effective = square / twice
        kind, title, quantities = _classified(w, J, effective)
    place = Quantity("moment", float(effective), "m²/(m·ω), the moment of inertia about the axis of rotation")
    return Motion(form, kind, title, y, (*conserved, place, *quantities), notes=notes)


def _vector(values: Sequence[float]) -> Vector:
    a, b, c = (Decimal(float(v)) for v in values)
    return a, b, c


def _classified(w: Vector, J: Vector, effective: Decimal) -> tuple[str, str, list[Quantity]]:
    """Kind, title and the quantities of the motion; the precision is that of the caller."""
    low, middle, high = sorted(J)
    speed = sum((v * v for v in w), Decimal(0)).sqrt()
    turning = Quantity("frequency.rotation", float(speed) / (2.0 * math.pi), "revolutions of the body per unit time")
    steady = all((J[i] - J[j]) * w[i] * w[j] == 0 for i, j in ((0, 1), (1, 2), (2, 0)))
    different = low < middle < high
    if steady:
        if low == high:
            return "steady rotation", "steady rotation of the spherical top", [turning]
        unstable = different and effective == middle
        word = "unstable" if unstable else "stable" if different or effective != middle else "neutral"
        return "steady rotation", f"{word} steady rotation about a principal axis", [turning]
    found = free_motion(w, J, Decimal(1))
    rate = found.step[0] + found.step[1]
    assert found.precession is not None
    if found.quarter is None:
        period = Quantity("period", math.inf, "time from one steady rotation about the middle axis to the other")
        rate_quantity = Quantity("rate", rate, "rate at which the steady rotation is approached, e-foldings")
        return "separatrix", "separatrix: asymptotic to the rotation about the middle axis", [period, rate_quantity]
    half = 2.0 * found.quarter[0] / rate
    about = found.precession.per_step[0] + found.precession.per_half[0] / half
    axis = found.axes[0]
    size = "smallest" if J[axis] == low else "largest"
    quantities = [
        Quantity("frequency", 0.5 / half, "cycles of ω along the polhode per unit time"),
        Quantity("period", 2.0 * half, "time in which ω traverses the polhode"),
        Quantity("frequency.precession", about, f"mean revolutions of the axis {AXES[axis]} about m per unit time"),
    ]
    if not different:
        title = f"regular precession of a symmetric top; ω circles about the axis of {AXES[axis]}"
        return f"polhode about {AXES[axis]}", title, quantities
    quantities += [
        Quantity(
            "separatrix.distance", float(effective - middle), f"m²/(m·ω) - {float(middle):g}, 0 on the separatrix"
        ),
        Quantity("separatrix.m1", found.m1, "complementary parameter 1 - k² of the elliptic functions"),
    ]
    title = f"polhode about the axis of the {size} moment, {AXES[axis]} = {float(J[axis]):g}"
    return f"polhode about {AXES[axis]}", title, quantities
