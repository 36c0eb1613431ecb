"""Motion of the Kowalevski top from an initial state: curve, ovals, tables, phases and signs, in multiprecision."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from topcli.contracts import Array, Floats
from topcli.errors import RunError
from topcli.schemes.kowalevski.closed_form.course import EPS, Course, JacobiPhase, Lattice, Pinch
from topcli.schemes.kowalevski.closed_form.curve import DIGITS, Curve, curve, integrals, real, separated, series_step
from topcli.schemes.kowalevski.closed_form.motion import WEAK, Formula, Motion, Pendulum, SeparatedMotion, TripleRoot
from topcli.schemes.kowalevski.closed_form.multiprecision import (
    arg,
    asin,
    atan2,
    atanh,
    cos,
    digits,
    ellipf,
    ellipk,
    log,
    mpc,
    mpf,
    pi,
    sign,
    sin,
    sqrt,
    tan,
)
from topcli.schemes.kowalevski.closed_form.oval import Oval, ovals_of
from topcli.schemes.kowalevski.closed_form.table import OvalTable, Place

SHIFTS = (0, 2, 3, 5)
"""Times, in units of 1/32, from which the constants are tried; at the first one s1 may be undetermined."""
FIT = 1e-7
"""Largest difference, relative to the state, between the initial state and that of the right signs."""
NEAR = 0.05
"""Part of the roots; if |s - sigma| is smaller than it, the angle is found from the integral of ds/|w|."""
PROBES = (-12, 0, 105, 1311, 16543, 195_201, 2_336_007, 28_480_001)
"""Multiples of ``PROBE_STEP`` at which a motion is compared with Taylor series before it is used."""
PROBE_STEP = 2.0**-5
AGREEMENT = 1e-10
"""Largest difference relative to the terms of the equations."""
BOTH = (1, -1)
AT_END = 1e-45, 1e-26
"""Angles from 0 and pi/2 within which 60 digits do not show the direction."""
MOMENT = 2.0**-46
"""Time after the start at which the directions of s1 and s2 show."""
REFUSED = "kowalevski, scheme exact: {}; use scheme 'taylor'"


class _UnfitError(ArithmeticError):
    """No choice of the signs gives the initial state."""


def set_up(y: Floats, c: float) -> Motion:
    """Motion from the state ``y`` (6,); omega and c gamma should be of the order of one.

    Raises RunError for motions that are not covered.
    """
    if is_pendulum(y, c):
        return _pendulum(y, c)
    if has_triple_root(y, c):
        return _triple_root(y, c)
    try:
        return separated_motion(y, c)
    except RunError:
        off = EPS * sum(v * v for v in y[:3]) / abs(c)
        if off < WEAK * math.hypot(*y[3:]):
            raise
        why = f"gravity is too weak to be resolved: gamma would be uncertain by eps |omega|²/c = {off:.0e}"
        raise RunError(REFUSED.format(why)) from None


def separated_motion(y: Floats, c: float) -> SeparatedMotion:
    """Motion by separated variables. Raises RunError."""
    of = integrals(y, c)
    with digits(2 * DIGITS):
        roots = curve(of)
    failed = ""
    for shift in SHIFTS:
        try:
            motion = _started(y, c, roots, shift)
        except ZeroDivisionError:
            failed = "the separated variables are undetermined"
        except _UnfitError as error:
            failed = str(error)
        else:
            _verify(motion, y)
            return motion
    raise RunError(REFUSED.format(failed))


def _started(y: Floats, c: float, roots: Curve, shift: int) -> SeparatedMotion:
    """Motion with ovals, tables, phases and signs from the state ``shift``/32 after the start."""
    with digits(2 * DIGITS):
        start = [mpf(v) for v in y]
        if shift:
            start = series_step(start, mpf(c), mpf(shift) / 32, 90)
        now = separated(roots.of, start)
        later = separated(roots.of, series_step(start, mpf(c), mpf(MOMENT), 8))
    with digits(DIGITS):
        ovals = ovals_of(roots)
        angles, moved = ([oval.angle(s) for oval, s in zip(ovals, both, strict=True)] for both in (now, later))
        ways = [_direction(before, after) for before, after in zip(angles, moved, strict=True)]
        begun = [oval.from_regular_end(angle) for oval, angle in zip(ovals, angles, strict=True)]
        course, begun = _course(ovals, begun)
        motion = SeparatedMotion(
            c=c,
            gamma_sq=float(roots.of.G / Fraction(c) ** 2),
            two_l=float(2 * roots.of.L / Fraction(c)),
            near=NEAR * float(max(abs(v) for v in roots.e)),
            apart=float(ovals[0].a - ovals[1].a),
            course=course,
            formula=_formula(roots, c),
        )
        state, elapsed = np.array([float(v) for v in start]), Fraction(shift, 32)
        fitted = _fitted(motion, begun, angles, ways, state, elapsed)
        if fitted is None and ways != [BOTH, BOTH]:
            fitted = _fitted(motion, begun, angles, [BOTH, BOTH], state, elapsed)
    if fitted is None:
        raise _UnfitError("no choice of the signs of the square roots gives the initial state")
    return fitted


def _fitted(
    motion: SeparatedMotion, begun: Any, angles: Any, ways: Any, start: Array, time: Fraction
) -> SeparatedMotion | None:
    """The motion with those of the directions ``ways`` and the signs that give the state and its change at a time."""
    (A, p), (B, q) = begun
    course = motion.course
    size = 1.0 + float(np.abs(start).max())
    later = np.array(series_step(list(start), motion.c, PROBE_STEP, 20))
    least, best = np.inf, None
    stands = course.stands if isinstance(course, Pinch) else 0
    for one, two in product(*ways):
        # a variable that rests in the double root is there at the end of its half period
        ends = one if stands != 1 else -1, two if stands != 2 else 1
        difference = -2 * (A + B) if stands else one * A - two * B
        begin = course.started(ends[0] * p + ends[1] * q, difference, real(time))
        for signs in product((1, -1), repeat=3):
            trial = replace(motion, course=begin).with_signs(signs)
            with np.errstate(all="ignore"):
                missed = float(np.abs(_at_angles(trial, angles, (one, two)) - start).max())
            if not missed < FIT * size:
                continue
            ahead = trial.states(np.array([0, 1]), Fraction(PROBE_STEP) + time)[1]
            missed = max(missed, float(np.abs(ahead - later).max()))
            if missed < least:
                least, best = missed, trial
    return best if least < FIT * size else None


def _at_angles(motion: SeparatedMotion, angles: Any, directions: tuple[int, int]) -> Array:
    """State (6,) at the given angles in [0, pi/2], each on its way up (1) or down (-1)."""
    places = []
    for table, angle, direction in zip((motion.course.first, motion.course.second), angles, directions, strict=True):
        S, C = np.array([direction * float(sin(angle))]), np.array([float(cos(angle))])
        if table.touched[0]:
            S, C = direction * S, direction * C
        past = S * S - np.sin(table.anchors[1]) ** 2 if len(table.anchors) == 3 else None
        places.append(Place(np.zeros(1, dtype=np.int64), S, C, past))
    return motion.at(*places)[0]


def _verify(motion: SeparatedMotion, y: Floats) -> None:
    """Compare states over long times with Taylor series of the equations; raise RunError if they differ."""
    n = np.array(PROBES)
    states = motion.states(np.concatenate([n, n + 1, [0]]), PROBE_STEP)
    here, there = states[: len(n)], states[len(n) : -1]
    with np.errstate(all="ignore"):
        expected = np.array(series_step(list(here.T), motion.c, PROBE_STEP, 24)).T
        size = 1.0 + (np.abs(here).max() ** 2) / min(1.0, abs(motion.c))
        missed = max(float(np.abs(expected - there).max()), float(np.abs(states[-1] - y).max())) / size
    if not missed < AGREEMENT:
        why = f"too close to a degenerate motion: a Taylor step differs by {missed:.0e} of the terms"
        raise RunError(REFUSED.format(why))


def _direction(before: Any, after: Any) -> tuple[int, ...]:
    """Directions in which an angle in [0, pi/2] may move that is ``after`` soon; both at an end, where they agree.

    Next to a turning point both fit the state, and the wrong one is a shift of time.
    """
    clear = min(before, pi / 2 - before, abs(after - before)) > AT_END[before > 1]
    return BOTH if not clear else (1,) if after > before else (-1,)


def _course(ovals: tuple[Oval, Oval], begun: list[Any]) -> tuple[Course, list[Any]]:
    """Course on the ovals, without its start, and the integrals of the start, also for points in a double root."""
    first, second = ovals
    if first.touched[0] and second.touched[0] and first.a == second.a:
        stands = next((i + 1 for i in (0, 1) if begun[i] is None), 0)
        periods = [oval.half_periods for oval in ovals]
        begun = [periods[i] if begun[i] is None else begun[i] for i in (0, 1)]
        around = 1
        for root in first.curve.e:
            around *= abs(root - first.a) if root != first.a else 1
        cut = first.length * sin(first.panels[0].begin) ** 2, second.length * tan(second.panels[0].begin) ** 2
        jump = periods[0][0] - periods[1][0] + log(cut[0] / cut[1]) / (2 * sqrt(around))
        if stands:
            jump = mpf(0)
            begun = [periods[i] if i + 1 == stands else begun[i] for i in (0, 1)]
        one, two = (OvalTable(oval, mpf(0), False) for oval in ovals)
        return Pinch(one, two, (periods[0][1], periods[1][1]), jump, stands), begun
    tables, periods, starts = [], [], []
    for oval, at in zip(ovals, begun, strict=True):
        if all(oval.touched):
            raise RunError(REFUSED.format("an oval of the curve has a double root at both ends"))
        a, P = oval.half_periods
        if any(oval.touched):
            root = oval.a if oval.touched[0] else oval.b
            P, a = mpf(1), 1 / abs(root - oval.sigma)
        tables.append(OvalTable(oval, a / P, at is None))
        periods += [P, a]
        starts.append((mpf(0), mpf(0)) if at is None else at)
    P, a, Q, b = periods
    return Lattice(tables[0], tables[1], (P, a, Q, b)), starts


def _formula(of: Curve, c: float) -> Formula:
    e = of.e
    one, two, three = (complex(e[j] - e[i]) for i, j in ((0, 1), (1, 2), (2, 0)))
    a, b, d = (complex(e[i] - of.r2) for i in range(3))
    return Formula((one, two, three), (a, b, d), complex(of.x0), complex(of.r1), c)


def is_pendulum(y: Floats, c: float) -> bool:
    """True if omega2 = 0 and c gamma3 = omega1 omega3, exactly."""
    w1, w2, w3, _, _, g3 = map(Fraction, y)
    return w2 == 0 and Fraction(c) * g3 == w1 * w3


def _pendulum(y: Floats, c: float) -> Pendulum:
    """Pendulum of the state ``y`` (6,), which is not at rest."""
    w1, _, w3, g1, g2, _ = map(Fraction, y)
    square = (w1 * w1 - Fraction(c) * g1, -Fraction(c) * g2)
    energy, k_sq = w3 * w3 - 2 * square[0], square[0] ** 2 + square[1] ** 2
    with digits(DIGITS):
        k = sqrt(real(k_sq))
        half, v, n = arg(mpc(real(square[0]), real(square[1]))) / 2, -real(w3), sqrt(k)
        size = sqrt(v * v / (4 * k) + sin(half) ** 2)
        if energy >= 0 and energy**2 == 4 * k_sq:
            way = sign(v)
            phase = JacobiPhase.of(atanh(sin(half)), way * n, None, 0)
            return Pendulum(float(w1), c, float(k), phase, 1.0, False)
        past = (cos(half) ** 2 - v * v / (4 * k)).real  # 1 - size²
        if past > 0:
            start = ellipf(atan2(sin(half) / size, v / (2 * n * size)), size**2)
            phase = JacobiPhase.of(start, n, ellipk(size**2), past)
            return Pendulum(float(w1), c, float(k), phase, float(size), False)
        m = 1 / size**2
        start, rate = ellipf(half, m), sign(v) * n * size
        return Pendulum(float(w1), c, float(k), JacobiPhase.of(start, rate, ellipk(m), -past * m), float(size), True)


def has_triple_root(y: Floats, c: float) -> bool:
    """True if k = 0 and E = 2 l²/gamma², exactly."""
    of = integrals(y, c)
    return of.k_sq == 0 and 3 * of.l1 * of.G == 2 * of.L**2


def _triple_root(y: Floats, c: float) -> TripleRoot:
    """Motion from the state ``y`` (6,), which is not at rest."""
    of = integrals(y, c)
    way = -1 if of.L < 0 else 1
    w1, w2, _, _, _, g3 = map(Fraction, y)
    with digits(DIGITS):
        a, E = sqrt(real(of.G)), 3 * real(of.l1)
        m, critical = mpf(1) / 2 + E / (4 * a), (3 * of.l1) ** 2 == 4 * of.G
        # cn = (1 - x)/(1 + x) with x = tan(phi/2), and the sign of sn is that of phi'
        cosine = way * real(Fraction(c) * g3) / a
        sine = real(w1 * w1 + w2 * w2) / a
        cn = cosine / (1 + sine)
        sn, upwards = sqrt(2 * sine / (1 + sine)) if sine else mpf(0), way * w2 >= 0
        rate = sqrt(a / 2)
        folded, mirrored = critical or m > 1, False
        if not folded:
            start = ellipf(atan2(sn if upwards else -sn, cn), m)
            phase = JacobiPhase.of(start, rate, ellipk(m), 1 - m)
        else:
            m = mpf(1) if critical else m
            mirrored = cn < 0
            upwards ^= bool(mirrored)
            amplitude = asin(min(sqrt(m) * sn, mpf(1)))
            rate = sqrt(m) * rate if upwards else -sqrt(m) * rate
            start = atanh(sn) if critical else ellipf(amplitude, 1 / m)
            phase = JacobiPhase.of(start, rate, None if critical else ellipk(1 / m), 0 if critical else 1 - 1 / m)
        return TripleRoot(c, float(sqrt(2 * E)), float(a), float(way), phase, float(sqrt(m)), folded, bool(mirrored))
