"""The hard cases of the other tops: tennis racket, spherical top, sleeping top, and the general ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from topcli.contracts import Floats, Top
from topcli.studies.stress.case import Case, config
from topcli.studies.stress.checks import flips, keeps_order
from topcli.studies.stress.general import general_cases
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.lagrange import Lagrange, LagrangeInertial

OMEGA = (0.7, -0.4, 1.3)
GAMMA = (0.6, 0.48, 0.64)
FAST = (3.0, -2.0, 6.0)
RATE = math.sqrt(1.0 / 3.0)
"""Growth rate away from the middle axis for moments 3, 2, 1 and omega2 = 1."""


def _racket(offset: float, gamma: bool = False) -> Case:
    """Case of the tennis racket; omega2 first crosses 0 after about ln(constant/offset)/rate."""
    top: Top = EulerGamma() if gamma else Euler()

    def made() -> Mapping[str, Any]:
        state = (offset, 1.0, 0.0, *((0.0, 1.0, 0.0) if gamma else ()))
        return config(top, state, 0.01, round((math.log(4.0 / offset) / RATE + 4.0) / 0.01))

    name = f"racket-1e{round(math.log10(offset))}"
    question = f"turns about the middle axis, {offset:g} off: does it flip when the closed form says?"
    return Case(name, top.form, question, made, flips)


def _from(name: str, question: str, top: Top, state: Floats, h: float = 0.02, N: int = 200) -> Case:
    return Case(name, top.form, question, lambda: config(top, state, h, N), keeps_order)


_LAGRANGE = Lagrange()
_SLEEPING = math.sqrt(4.0 * _LAGRANGE.A * _LAGRANGE.mu) / _LAGRANGE.C
"""omega3 at which the upright top is just stable: C omega3 = 2 sqrt(A mu)."""
_TILT = 1e-6

OTHERS: tuple[Case, ...] = (
    *map(_racket, (1e-3, 1e-6, 1e-9, 1e-12)),
    _from("spherical", "A = B = C: omega is constant", Euler(A=1.5, B=1.5, C=1.5), OMEGA),
    _from("middle-axis", "turns about the middle axis exactly, a fixed point", Euler(), (0.0, 1.0, 0.0)),
    *general_cases(Euler(), OMEGA, OMEGA, FAST, 1.0),
    _racket(1e-9, gamma=True),
    _from(
        "spherical",
        "A = B = C: omega is constant, gamma turns steadily",
        EulerGamma(A=1.5, B=1.5, C=1.5),
        (*OMEGA, *GAMMA),
    ),
    *general_cases(EulerGamma(), (*OMEGA, *GAMMA), (*OMEGA, *GAMMA), (*FAST, *GAMMA), 1.0),
    _from("at-rest", "omega = 0 at the start", Heavy(), (0.0, 0.0, 0.0, *GAMMA)),
    _from("spherical", "A = B = C with gravity", Heavy(A=1.5, B=1.5, C=1.5), (*OMEGA, *GAMMA)),
    *general_cases(
        Heavy(),
        (*OMEGA, *GAMMA),
        (0.05, -0.04, 0.06, -0.70, -0.42, -0.577581),
        (*FAST, *GAMMA),
        1.0,
    ),
    _from(
        "sleeping-threshold",
        "upright but for 1e-6, C omega3 = 2 sqrt(A mu): the edge of stability",
        _LAGRANGE,
        (0.0, 0.0, _SLEEPING, math.sin(_TILT), 0.0, math.cos(_TILT)),
        0.02,
        1000,
    ),
    _from("sleeping", "upright exactly, a fixed point", _LAGRANGE, (0.0, 0.0, 5.0, 0.0, 0.0, 1.0)),
    _from("at-rest", "omega = 0 at the start: a plane pendulum", _LAGRANGE, (0.0, 0.0, 0.0, 0.6, 0.0, 0.8)),
    _from("hanging", "mu < 0, gamma near e3: hangs", Lagrange(mu=-1.0), (*OMEGA, *GAMMA)),
    *general_cases(_LAGRANGE, (*OMEGA, *GAMMA), (*OMEGA, *GAMMA), (*FAST, *GAMMA), 1.0),
    _from(
        "sleeping-threshold",
        "upright but for 1e-6, m.a = 2: the edge of stability",
        LagrangeInertial(),
        (2.0 * math.sin(_TILT), 0.0, 2.0 * math.cos(_TILT), math.sin(_TILT), 0.0, math.cos(_TILT)),
        0.02,
        1000,
    ),
    *general_cases(LagrangeInertial(), (*OMEGA, *GAMMA), (*OMEGA, *GAMMA), (*FAST, *GAMMA), 1.0, singular=False),
)
