"""Independent reference solution of the equations of motion, accurate to one ulp of the state's size.

A Taylor series integrator of order 37 in double-double arithmetic with output at any time; it shares no code with the
schemes that it judges but the polynomial of the field and its units. Order and step follow Jorba and Zou,
Experimental Mathematics 14 (2005) 99-117, for a relative local error of 1e-31.

The field is a polynomial, so its Taylor coefficients follow from Cauchy products: every monomial is a product of two
shorter ones, and each of these has a series. Buffers (one-dimensional, float64; pointers when compiled):

``table``  the numbers d of components, of products and of terms; for each product the two series that it multiplies;
           for each term of the field the component, the series and the coefficient as hi, lo. Series 0..d-1 are those
           of the components, d and above those of the products, -1 is the constant 1
``state``  2 d + 4: hi of the components (d), lo of them (d), the time they belong to, outputs written, steps taken,
           outputs wanted
``work``   2 (order + 1) for each series: the hi parts of its coefficients, then their lo parts

The problem is expected in units in which the rates of change are of the order of one.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from topcli.arithmetic.fused import dd_add, dd_div, dd_mul, dd_scale, two_prod, two_sum
from topcli.contracts import Array, Top, check_stop
from topcli.errors import RunError, UsageError
from topcli.field.polynomial import Field, Monomial, required_field
from topcli.field.units import NaturalUnits

if TYPE_CHECKING:
    from topcli.engine.native import Native

GRID = 67108864.0
"""Steps are multiples of 1/GRID = 2^-26: times below 2^27 and offsets from them are then exact in double."""


LONGEST, SAFE = 4.0, 0.125
"""The longest step: of a state at rest, and if the last coefficients vanish otherwise."""


_NEAR_ZERO = 2.0**-10
"""Size of a state relative to its motion in the step, below which the latter counts."""


DONE, MORE, NOT_FINITE, STEP_TOO_SMALL = 0, 1, -1, -2
"""Return codes of ``advance``."""


def cauchy(work: Array, a: int, b: int, j: int, n: int) -> tuple[float, float]:
    """Coefficient j of the product of series a and b: the sum of a_k b_(j-k) over k = 0..j, as hi, lo.

    A compensated dot product (Dot2 of Ogita, Rump and Oishi, SIAM J. Sci. Comput. 26, 2005) of double-doubles:
    exact products of the hi parts, the rounding errors and the mixed products gathered in one more double.
    """
    x0 = 2 * a * n
    y0 = 2 * b * n + j
    s = 0.0
    c = 0.0
    for k in range(j + 1):
        x = work[x0 + k]
        y = work[y0 - k]
        p, e = two_prod(x, y)
        s, t = two_sum(s, p)
        c += t + (e + (x * work[y0 + n - k] + work[x0 + n + k] * y))
    return two_sum(s, c)


def expansion(table: Array, work: Array, order: int) -> int:
    """Fill ``work`` with the coefficients 1..order of the components' series from the coefficients 0 in it."""
    n = order + 1
    d = int(table[0])
    products = int(table[1])
    terms = int(table[2])
    first = 3 + 2 * products
    # each order needs the lower ones only: first the products, then their sums, then division by m + 1
    for m in range(order):
        for k in range(products):
            ph, pl = cauchy(work, int(table[3 + 2 * k]), int(table[4 + 2 * k]), m, n)
            work[2 * n * (d + k) + m] = ph
            work[2 * n * (d + k) + n + m] = pl
        for i in range(d):
            work[2 * n * i + m + 1] = 0.0
            work[2 * n * i + n + m + 1] = 0.0
        for k in range(first, first + 4 * terms, 4):
            i = 2 * n * int(table[k]) + m + 1
            series = int(table[k + 1])
            if series >= 0:
                at = 2 * n * series + m
                ah, al = dd_mul(work[at], work[at + n], table[k + 2], table[k + 3])
            elif m == 0:
                ah, al = table[k + 2], table[k + 3]
            else:
                ah, al = 0.0, 0.0
            ah, al = dd_add(work[i], work[i + n], ah, al)
            work[i] = ah
            work[i + n] = al
        for i in range(d):
            at = 2 * n * i + m + 1
            ah, al = dd_div(work[at], work[at + n], m + 1.0)
            work[at] = ah
            work[at + n] = al
    return order


def magnitude(work: Array, d: int, j: int, n: int) -> float:
    """The 1-norm of the coefficients j of the d components; unlike the maximum it cannot hide a NaN."""
    total = 0.0
    for i in range(d):
        total += abs(work[2 * i * n + j])
    return total


def radius(work: Array, d: int, order: int) -> float:
    """Radius of convergence after Jorba and Zou (Exp. Math. 14, 2005, section 3.2), from the last two coefficients.

    Their relative form, (|x_0|/|x_j|)^(1/j) for j = order - 1 and order; near zero, the term is compared with |x_1| t
    instead of |x_0|. Infinite when both vanish.
    """
    n = order + 1
    first = magnitude(work, d, 0, n)
    motion = _NEAR_ZERO * magnitude(work, d, 1, n)
    least = math.inf
    for j in range(order - 1, n):
        last = magnitude(work, d, j, n)
        if last > 0.0:
            least = min(least, max((first / last) ** (1.0 / j), (motion / last) ** (1.0 / (j - 1))))
    return least


def write(work: Array, out: Array, row: int, d: int, t: float, order: int) -> int:
    """Put the series at offset t from the centre into ``out[d row : d row + d]``, rounded once.

    All but the leading term is small against the state within a step, so that plain doubles do.
    """
    n = order + 1
    for i in range(d):
        x = 2 * i * n
        tail = 0.0
        for j in range(order, 0, -1):
            tail = (tail + work[x + j]) * t
        out[d * row + i] = work[x] + (work[x + n] + tail)
    return row


def shift(state: Array, work: Array, d: int, t: float, order: int) -> float:
    """Put the series at offset t into ``state``, in double-double; 0.0, or NaN when it is not finite."""
    n = order + 1
    check = 0.0
    for i in range(d):
        x = 2 * i * n
        th = 0.0
        tl = 0.0
        for j in range(order, 0, -1):
            th, tl = dd_add(th, tl, work[x + j], work[x + n + j])
            th, tl = dd_scale(th, tl, t)
        th, tl = dd_add(th, tl, work[x], work[x + n])
        state[i] = th
        state[d + i] = tl
        check += (th - th) + (tl - tl)
    return check


def advance(
    table: Array, state: Array, times: Array, out: Array, work: Array, order: int, reach: float, budget: int
) -> int:
    """Follow the motion through ``times`` (m, monotone, all on one side of zero), at most ``budget`` steps.

    Writes the states at ``times`` into ``out`` (d m). ``reach`` is the length of a step in units of the radius
    of convergence. Returns DONE; MORE when the budget is spent (call again with the same buffers); NOT_FINITE;
    STEP_TOO_SMALL when a step would fall below 2^-26.
    """
    n = order + 1
    d = int(table[0])
    row = int(state[2 * d + 1])
    m = int(state[2 * d + 3])
    # times grow in the direction of the motion, backwards too; a call ends after some expansions so that it can stop
    sign = 1.0 if row < m and times[m - 1] >= 0.0 else -1.0
    for _ in range(budget):
        if row == m:
            return DONE
        for i in range(d):
            work[2 * i * n] = state[i]
            work[2 * i * n + n] = state[d + i]
        expansion(table, work, order)
        bound = magnitude(work, d, order - 1, n) + magnitude(work, d, order, n)
        if bound - bound != 0.0:
            return NOT_FINITE
        # a step is rounded to a grid, so that the centres of the series are exact numbers
        longest = SAFE if bound == 0.0 < magnitude(work, d, 1, n) else LONGEST
        step = math.floor(min(reach * radius(work, d, order), longest) * GRID) / GRID
        if step == 0.0:
            return STEP_TOO_SMALL
        centre = state[2 * d]
        while row < m and sign * (times[row] - centre) <= step:
            write(work, out, row, d, times[row] - centre, order)
            row += 1
        state[2 * d + 1] = float(row)
        if row == m:
            return DONE
        if shift(state, work, d, sign * step, order) != 0.0:
            return NOT_FINITE
        state[2 * d] = centre + sign * step
        state[2 * d + 2] += 1.0
    return MORE


_NAME = "the reference"
_EPSILON = 1e-31
ORDER = math.ceil(-0.5 * math.log(_EPSILON) + 1.0)
"""Jorba and Zou's order for ``_EPSILON``: 37."""
REACH = math.exp(-0.7 / (ORDER - 1)) / math.e**2
"""Their step in units of the radius of convergence, with their safety factor."""
BUDGET = 2000
"""Steps between two possible interruptions: 0.1 s, and 0.3 s where numbers are denormal."""
MAX_TAYLOR_STEPS = 20_000_000
"""Longest reference that is computed, some fifteen minutes. Times are exact up to 2^25 of the longest steps."""


@cache
def _compiled() -> Native:
    from topcli.engine.native import native

    return native(advance, "pppppqdq")


def table_of(field: Field) -> Array:
    """Table of ``advance`` for a polynomial field."""
    products: dict[tuple[int, int], int] = {}
    terms: list[float] = []

    def series(monomial: Monomial) -> int:
        if len(monomial) < 2:
            return monomial[0] if monomial else -1
        factors = series(monomial[:-1]), monomial[-1]
        return products.setdefault(factors, len(field) + len(products))

    for i, rate in enumerate(field):
        for monomial, c in sorted(rate.terms.items()):
            hi = float(c)
            terms.extend((i, series(monomial), hi, float(c - Fraction(hi))))
    return np.array([len(field), len(products), len(terms) // 4, *chain(*products), *terms], dtype=float)


def reference_obstacle(top: Top) -> str:
    """Reason why the reference cannot follow ``top``, one line; empty if it can."""
    try:
        required_field(top, _NAME)
    except UsageError as error:
        return str(error)
    return ""


def distances(states: Array, reference: Array) -> Array:
    """Euclidean distances (...,) of ``states`` from ``reference``, both (..., d); infinite beyond double precision."""
    with np.errstate(all="ignore"):
        square = np.zeros(states.shape[:-1])
        for i in range(states.shape[-1]):  # in this order for arrays of any shape
            square += (states[..., i] - reference[..., i]) ** 2
        return np.sqrt(square)


def reference_states(top: Top, y0: Sequence[float], times: Array, max_steps: int = MAX_TAYLOR_STEPS) -> Array:
    """Return the reference solution at given times, computed in double-double arithmetic.

    Each state differs from the exact solution by at most one ulp (unit in the last place) of its size, unless the
    motion amplifies the error of a Taylor step (1e-31) to more than one ulp. The computation calls
    ``contracts.check_stop``, so that it can be stopped.

    Parameters
    ----------
    top : Top
        Top whose equations of motion are integrated.
    y0 : sequence of float, shape (d,)
        State at time zero, in the order of ``top.components``.
    times : ndarray, shape (m,)
        Times, taken as exact numbers. They are either all >= 0 and ascending, or all <= 0 and descending.
    max_steps : int, optional
        Largest number of Taylor steps. A motion that certainly needs more steps is refused before the first step. Any
        other motion is refused as soon as the steps already taken show that it needs more.

    Returns
    -------
    ndarray, shape (m, d)
        States at the times.

    Raises
    ------
    ValueError
        If the times have different signs or are not ordered by magnitude.
    RunError
        If the motion leaves the range of a double, if the steps become too short for the resolution of time, or if the
        motion needs too many steps.
    """
    field, y, t = required_field(top, _NAME, exact=Fraction), np.array(y0, dtype=float), np.array(times, dtype=float)
    if ((t < 0.0).any() and (t > 0.0).any()) or not (np.diff(np.abs(t)) >= 0.0).all():
        raise ValueError("reference: times must lead away from zero, all forward or all backward")
    d = len(y)
    scaled, k, units = NaturalUnits(field, ORDER).at(y.tolist())
    state, out = np.zeros(2 * d + 4), np.zeros((t.size, d))
    table = table_of(scaled)
    work = np.zeros(2 * (d + int(table[1])) * (ORDER + 1))
    with np.errstate(all="ignore"):
        state[:d] = np.ldexp(y, [-unit for unit in units])
        state[-1] = t.size
        tau = np.ldexp(t, k)
    if t.size and not abs(tau[-1]) <= LONGEST * max_steps:
        least = min(abs(float(tau[-1])) / LONGEST, sys.float_info.max)
        raise _too_long(f"at least {least:.2g}", float(t[-1]), max_steps)
    run, code = _compiled(), MORE
    while code == MORE:  # in parts, so that it can be stopped
        check_stop()
        code = run(table, state, tau, out.reshape(-1), work, ORDER, REACH, BUDGET)
        at, steps = abs(state[-4]), state[-2]
        if code == MORE and steps * abs(tau[-1]) > max_steps * at:
            raise _too_long(f"about {steps * (abs(tau[-1]) / at):.2g}", float(t[-1]), max_steps)
    if code != DONE:
        why = "its step shrinks below the resolution of time" if code == STEP_TOO_SMALL else "it is not finite"
        where = math.ldexp(state[-4], -k)
        raise RunError(f"reference: the motion cannot be followed beyond t = {where:.6g}: {why}")
    with np.errstate(all="ignore"):
        states = np.ldexp(out, units)
    if not np.isfinite(states).all():
        raise RunError("reference: the motion leaves the range of double precision")
    return states


def _too_long(steps: str, t: float, most: int) -> RunError:
    """Error for a motion of too many steps."""
    return RunError(f"the reference would need {steps} Taylor steps to reach t = {t:.6g}; at most {most} are taken")
