"""Bäcklund steps that carry the rounding errors of the sums state + change (``arithmetic.increments``).

The changes are of size h, and so are their rounding errors. After 1e6 steps, deviations of the integrals are
smaller by a factor of 32 at h = 0.01 and of 2.1 at h = 0.1 (``benchmarks/documented.py compensated``); at h = 0.5 the
changes are as large as the state, and nothing is gained. A step takes 1.16 times as long.

Each working state is that of the step without compensation, with six rounding errors after the first six slots.
"""

from __future__ import annotations

import math

from topcli.arithmetic.increments import compensated_sums, first6
from topcli.contracts import Floats, StepFunction, Stepper
from topcli.schemes.kowalevski.backlund_constants import SHORTEST, rounded_tau, tau_at, tau_of
from topcli.schemes.kowalevski.backlund_step import physical_change, scaled_change


def frozen_step(s: Floats, h: float, p: Floats) -> Floats:
    """One step of a run with steps of one length: scaled omega, gamma; errors; tau; the status."""
    z, e = (s[0], s[1], s[2], s[3], s[4], s[5]), (s[6], s[7], s[8], s[9], s[10], s[11])
    z, e = compensated_sums(z, e, scaled_change(z, (0.125 * p[0]) * (h * h), s[12]))
    return (*z, *e, s[12], s[13])


def stage(s: Floats, h: float, p: Floats) -> Floats:
    """One step of any length: omega, gamma; errors; the frozen constants; the longest step; the status."""
    y, e = (s[0], s[1], s[2], s[3], s[4], s[5]), (s[6], s[7], s[8], s[9], s[10], s[11])
    fits = SHORTEST <= abs(h) <= s[17]
    tau = rounded_tau(tau_of(h, s[12], s[13], s[14], s[15]), h * h * s[16]) if fits else math.nan
    status = s[18] if fits else math.nan
    y, e = compensated_sums(y, e, physical_change(y, h, p[0], tau))
    return (*y, *e, s[12], s[13], s[14], s[15], s[16], s[17], status)


def recomputed_stage(s: Floats, h: float, p: Floats) -> Floats:
    """One step of any length, tau from the current state: omega, gamma; errors; the longest step; the status."""
    y, e = (s[0], s[1], s[2], s[3], s[4], s[5]), (s[6], s[7], s[8], s[9], s[10], s[11])
    fits = SHORTEST <= abs(h) <= s[12]
    tau = tau_at(y, h, p[0]) if fits else math.nan
    status = s[13] if fits else math.nan
    y, e = compensated_sums(y, e, physical_change(y, h, p[0], tau))
    return (*y, *e, s[12], status)


def compensated(step: StepFunction, plain: Stepper, composable: Stepper | None = None) -> Stepper:
    """Stepper of a compensated ``step``, which is entered and left like ``plain``."""
    first = plain.enter
    assert first is not None

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        s = first(y, h, p)
        return (*s[:6], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *s[6:])

    leave = plain.leave or first6
    return Stepper(step, plain.width + 6, enter, leave, iterative=True, checked=6, composable=composable)
