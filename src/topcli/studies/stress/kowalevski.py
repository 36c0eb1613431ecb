"""The hard cases of the Kowalevski top."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

from topcli.contracts import Floats
from topcli.studies.stress.case import Case, config, state_before
from topcli.studies.stress.checks import keeps_order, swings_at
from topcli.studies.stress.general import general_cases, swing_time
from topcli.tops.kowalevski import Kowalevski

FORM = Kowalevski.form
TOP = Kowalevski()
GENERIC = (0.7, -0.4, 1.3, 0.6, 0.48, 0.64)
DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))
"""xi = 0 exactly."""
TORUS_E4 = (
    -0.3336095391673479,
    -0.8069759961673685,
    1.0071602889659599,
    -0.25098702032854125,
    0.7545542238714854,
    -0.6063443236844068,
)
"""S(e4) = 0: S(e4) >= 0 on all motions, and where it vanishes the torus has shrunk to a closed orbit and the gradients
of the four integrals are dependent. Found by Newton's method on the gradient of S(e4) with 40 digits."""
EVENT = 1.0
"""Time at which the motion passes the hard place."""
STEP, STEPS = 0.02, 100
"""h and N of most cases: the hard place lies in the middle, on a step."""


def separation(state: Floats) -> tuple[float, float, float]:
    """``(S(e4), S(e5), g2³ - 27 g3²)`` of Kowalevski's curve for A = B = 2, C = c0 = 1: 0 on degenerate tori.

    S(s) = 4 s³ - g2 s - g3; e4, e5 = (l1 ± k)/2 (Kowalevski 1889).
    """
    w1, w2, w3, g1, g2, g3 = state
    l1 = (w1 * w1 + w2 * w2 + 0.5 * w3 * w3 + g1) / 3.0
    ell = w1 * g1 + w2 * g2 + 0.5 * w3 * g3
    k = math.hypot(w1 * w1 - w2 * w2 - g1, 2.0 * w1 * w2 - g2)
    q2 = k * k - 1.0 + 3.0 * l1 * l1
    q3 = l1 * (k * k - 1.0 - l1 * l1) + ell**2

    def cubic(s: float) -> float:
        return 4.0 * s**3 - q2 * s - q3

    return cubic(0.5 * (l1 + k)), cubic(0.5 * (l1 - k)), q2**3 - 27.0 * q3**2


@cache
def degenerate(which: int, low: float, high: float) -> Floats:
    """Scale omega of the generic state, by a factor in (low, high), to a zero of ``separation(...)[which]``."""

    def at(factor: float) -> Floats:
        return (*(factor * w for w in GENERIC[:3]), *GENERIC[3:])

    sign = math.copysign(1.0, separation(at(low))[which])
    while low < 0.5 * (low + high) < high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if sign * separation(at(middle))[which] > 0.0 else (low, middle)
    return at(low)


def _near_homoclinic(eps: float) -> Case:
    def made() -> Mapping[str, Any]:
        state = (2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps)
        return config(TOP, state, 1e-3, round((swing_time(eps) + 6.0) / 1e-3))

    exponent = round(math.log10(eps))
    question = (
        f"gamma3(0) = 1e{exponent}: does the first swing come at sqrt 2 ln(8 sqrt 7/eps) = {swing_time(eps):.4f}?"
    )
    return Case(f"homoclinic-1e{exponent}", FORM, question, made, swings_at(swing_time(eps)))


def _passing(name: str, question: str, state: Floats) -> Case:
    """Case of a motion that reaches ``state`` at ``EVENT``, on a step."""
    return Case(
        name, FORM, question, lambda: config(TOP, tuple(state_before(TOP, state, EVENT)), STEP, STEPS), keeps_order
    )


def _from(name: str, question: str, state: Floats, top: Kowalevski = TOP, h: float = STEP, N: int = 200) -> Case:
    return Case(name, FORM, question, lambda: config(top, state, h, N), keeps_order)


KOWALEVSKI: tuple[Case, ...] = (
    *map(_near_homoclinic, (1e-3, 1e-6, 1e-9)),
    Case(
        "homoclinic-spacing",
        FORM,
        f"gamma3(0) = 1e-3, the paper's scene: does the second swing follow after {2.0 * swing_time(1e-3):.4f}?",
        lambda: config(TOP, (2.0, 0.0, 0.0, math.sqrt(1.0 - 1e-6), 0.0, 1e-3), 1e-3, 50_000),
        swings_at(2.0 * swing_time(1e-3), spacing=True),
    ),
    _passing(
        "pole", "gamma passes -e3, where the paper's stereographic z is infinite", (0.7, -0.4, 1.3, 0.0, 0.0, -1.0)
    ),
    _passing(
        "branch-point",
        "omega1 + i omega2 passes 0, where the square root is singular",
        (0.0, 0.0, 1.3, 0.6, 0.48, 0.64),
    ),
    _passing(
        "near-branch-point",
        "omega1 + i omega2 passes 0 at a distance of 1e-3",
        (0.0, 1e-3, 1.3, 0.6, 0.48, 0.64),
    ),
    _from("at-rest", "omega = 0 at the start", (0.0, 0.0, 0.0, 0.6, 0.48, 0.64)),
    _from("rest-on-axis", "omega = 0 and gamma = e3 at the start, where xi = 0 too", (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)),
    _passing(
        "real-axis",
        "omega1 + i omega2 crosses the negative real axis, where the angle has its cut; branch: sign errs there",
        (-0.8, 0.0, 0.5, 0.6, -0.48, -0.64),
    ),
    _from("delone", "k = 0, Delone's motion: k² has no gradient", DELONE),
    _from(
        "delone-sleeping",
        "k = 0 and E = 2 l²: gamma = omega = e3 at the start, where all gradients are dependent",
        (0.0, 0.0, 1.0, 0.0, 0.0, 1.0),
    ),
    _from("torus-e4", "S(e4) = 0: the torus is a closed orbit, the gradients are dependent", TORUS_E4),
    Case(
        "torus-e5",
        FORM,
        "S(e5) = 0, a degenerate torus",
        lambda: config(TOP, degenerate(1, 0.585, 0.59), STEP, 200),
        keeps_order,
    ),
    Case(
        "torus-double-root",
        FORM,
        "g2³ = 27 g3², a degenerate torus",
        lambda: config(TOP, degenerate(2, 0.62, 0.625), STEP, 200),
        keeps_order,
    ),
    _from("free", "c0 = 0: no gravity", GENERIC, Kowalevski(c0=0.0)),
    _from("strong-gravity", "c0 = 1e6, h = 2e-5", GENERIC, Kowalevski(c0=1e6), 2e-5),
    _from("negative-gravity", "c0 = -1", GENERIC, Kowalevski(c0=-1.0)),
    _from(
        "vanishing", "c0 = 0 and omega of size 1e-310", (7e-311, -4e-311, 1.3e-310, 0.6, 0.48, 0.64), Kowalevski(c0=0.0)
    ),
    *general_cases(TOP, GENERIC, GENERIC, (3.0, -2.0, 6.0, 0.6, 0.48, 0.64), 1.0),
)
