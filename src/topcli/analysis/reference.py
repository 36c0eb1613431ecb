"""Independent reference solution of the equations of motion, to an ulp of the state's size.

A Taylor series integrator of order 37 in double-double arithmetic with output at any time; it shares no code with the
schemes that it judges. Order and step follow Jorba and Zou, Experimental Mathematics 14 (2005) 99-117, for a relative
local error of 1e-31.

The right-hand side is quadratic, so its Taylor coefficients follow from Cauchy products. With I = (A, B, C),
g = mg(x0, y0, z0) and i, j, k cyclic, Sogo's eqs. (Euler) and (Poisson) read

    omega_i' = alpha_i omega_j omega_k + (g_k/I_i) gamma_j - (g_j/I_i) gamma_k,    alpha_i = (I_j - I_k)/I_i,
    gamma_i' = gamma_j omega_k - gamma_k omega_j.

Buffers (one-dimensional, float64; pointers when compiled):

``coef``   18: for i = 1, 2, 3 the pairs hi, lo of alpha_i, g_k/I_i, g_j/I_i
``state``  16: hi of omega and gamma (6), lo of them (6), the time they belong to, outputs written, steps taken,
           outputs wanted
``work``   12 (order + 1): for each of the six series the hi parts of its coefficients, then their lo parts

The problem is expected in units in which the rates of change are of the order of one.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from topcli.arithmetic.fused import dd_add, dd_div, dd_mul, dd_scale, two_prod, two_sum
from topcli.contracts import Array, EulerPoisson, Top, check_stop, checked_equations
from topcli.errors import RunError, UsageError

if TYPE_CHECKING:
    from topcli.engine.native import Native

GRID = 67108864.0
"""Steps are multiples of 1/GRID = 2^-26: times below 2^27 and offsets from them are then exact in double."""


LONGEST = 4.0
"""The longest step, for motions whose series end (equilibria)."""


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


def expand(coef: Array, work: Array, order: int) -> int:
    """Fill ``work`` with the coefficients 1..order of the six series from the coefficients 0 in it."""
    n = order + 1
    for m in range(order):
        for i in range(3):
            j = (i + 1) % 3
            k = (i + 2) % 3
            gj = 2 * (3 + j) * n + m
            gk = 2 * (3 + k) * n + m
            q = 6 * i
            ah, al = cauchy(work, j, k, m, n)
            ah, al = dd_mul(ah, al, coef[q], coef[q + 1])
            bh, bl = dd_mul(work[gj], work[gj + n], coef[q + 2], coef[q + 3])
            ah, al = dd_add(ah, al, bh, bl)
            bh, bl = dd_mul(work[gk], work[gk + n], coef[q + 4], coef[q + 5])
            ah, al = dd_add(ah, al, -bh, -bl)
            ah, al = dd_div(ah, al, m + 1.0)
            work[2 * i * n + m + 1] = ah
            work[2 * i * n + n + m + 1] = al

            ah, al = cauchy(work, 3 + j, k, m, n)
            bh, bl = cauchy(work, 3 + k, j, m, n)
            ah, al = dd_add(ah, al, -bh, -bl)
            ah, al = dd_div(ah, al, m + 1.0)
            work[2 * (3 + i) * n + m + 1] = ah
            work[2 * (3 + i) * n + n + m + 1] = al
    return order


def size(work: Array, j: int, n: int) -> float:
    """The 1-norm of the coefficients j of the six series; unlike the maximum it cannot hide a NaN."""
    total = 0.0
    for i in range(6):
        total += abs(work[2 * i * n + j])
    return total


def radius(work: Array, order: int) -> float:
    """Radius of convergence after Jorba and Zou (Exp. Math. 14, 2005, section 3.2), from the last two coefficients.

    Their relative form, (|x_0|/|x_j|)^(1/j) for j = order - 1 and order. Infinite when both vanish.
    """
    n = order + 1
    first = size(work, 0, n)
    least = math.inf
    for j in range(order - 1, n):
        last = size(work, j, n)
        if last > 0.0:
            least = min(least, (first / last) ** (1.0 / j))
    return least


def write(work: Array, out: Array, row: int, d: float, order: int) -> int:
    """Put the series at offset d from the centre into ``out[6 row : 6 row + 6]``, rounded once.

    All but the leading term is small against the state within a step, so that plain doubles do.
    """
    n = order + 1
    for i in range(6):
        x = 2 * i * n
        tail = 0.0
        for j in range(order, 0, -1):
            tail = (tail + work[x + j]) * d
        out[6 * row + i] = work[x] + (work[x + n] + tail)
    return row


def shift(state: Array, work: Array, d: float, order: int) -> float:
    """Put the series at offset d into ``state``, in double-double; 0.0, or NaN when it is not finite."""
    n = order + 1
    check = 0.0
    for i in range(6):
        x = 2 * i * n
        th = 0.0
        tl = 0.0
        for j in range(order, 0, -1):
            th, tl = dd_add(th, tl, work[x + j], work[x + n + j])
            th, tl = dd_scale(th, tl, d)
        th, tl = dd_add(th, tl, work[x], work[x + n])
        state[i] = th
        state[6 + i] = tl
        check += (th - th) + (tl - tl)
    return check


def advance(
    coef: Array, state: Array, times: Array, out: Array, work: Array, order: int, reach: float, budget: int
) -> int:
    """Follow the motion through ``times`` (m, monotone, all on one side of zero), at most ``budget`` steps.

    Writes the states at ``times`` into ``out`` (6 m). ``reach`` is the length of a step in units of the radius
    of convergence. Returns DONE; MORE when the budget is spent (call again with the same buffers); NOT_FINITE;
    STEP_TOO_SMALL when a step would fall below 2^-26.
    """
    n = order + 1
    row = int(state[13])
    m = int(state[15])
    sign = 1.0 if row < m and times[m - 1] >= 0.0 else -1.0
    for _ in range(budget):
        if row == m:
            return DONE
        for i in range(6):
            work[2 * i * n] = state[i]
            work[2 * i * n + n] = state[6 + i]
        expand(coef, work, order)
        bound = size(work, order - 1, n) + size(work, order, n)
        if bound - bound != 0.0:
            return NOT_FINITE
        step = math.floor(min(reach * radius(work, order), LONGEST) * GRID) / GRID
        if step == 0.0:
            return STEP_TOO_SMALL
        centre = state[12]
        while row < m and sign * (times[row] - centre) <= step:
            write(work, out, row, times[row] - centre, order)
            row += 1
        state[13] = float(row)
        if row == m:
            return DONE
        if shift(state, work, sign * step, order) != 0.0:
            return NOT_FINITE
        state[12] = centre + sign * step
        state[14] += 1.0
    return MORE


NAME = "the reference"
EPSILON = 1e-31
ORDER = math.ceil(-0.5 * math.log(EPSILON) + 1.0)
"""Jorba and Zou's order for ``EPSILON``: 37."""
REACH = math.exp(-0.7 / (ORDER - 1)) / math.e**2
"""Their step in units of the radius of convergence, with their safety factor."""
BODY = ("omega1", "omega2", "omega3", "gamma1", "gamma2", "gamma3")

BUDGET = 2000
"""Steps between two possible interruptions: 0.1 s, and 0.3 s where numbers are denormal."""
MAX_TAYLOR_STEPS = 20_000_000
"""Longest reference that is computed, some fifteen minutes. Times are exact up to 2^25 of the longest steps."""


@cache
def _compiled() -> Native:
    from topcli.engine.native import native

    return native(advance, "pppppqdq")


def coefficients(equations: EulerPoisson) -> Array:
    """Quotients of the equations as double-doubles, shape (18,), in the layout of ``advance``.

    The moments and mg(x0, y0, z0) are taken as exact; no quotient is rounded to a double. Raises RunError
    if one is not finite.
    """
    moments, gravity = equations.moments, equations.gravity
    quotients: list[float] = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for hi, lo in (two_sum(moments[j], -moments[k]), (gravity[k], 0.0), (gravity[j], 0.0)):
            quotients.extend(dd_div(hi, lo, moments[i]))
    if not np.isfinite(quotients).all():
        raise RunError(f"reference: the moments {moments} with gravity {gravity} are beyond double precision")
    return np.array(quotients)


def _units(coef: Array, y: Array) -> tuple[int, int]:
    """``(k, m)``: with time in units of 2^k and gamma in units of 2^m the rates of change are at most about one.

    Powers of two, so that changing the units rounds nothing. Without them, coefficients of order 37 would overflow at
    an angular velocity of 1e8.
    """
    alpha, g = np.abs(coef[0::6]).max(), max(np.abs(coef[2::6]).max(), np.abs(coef[4::6]).max())
    omega, gamma = float(np.abs(y[:3]).max()), float(np.abs(y[3:]).max())
    rate = max(omega * max(1.0, float(alpha)), math.sqrt(g) * math.sqrt(gamma))
    if not math.isfinite(rate):
        raise RunError("reference: the initial angular velocity is beyond double precision")
    return -math.frexp(rate)[1], math.frexp(gamma)[1]


def _form_fault(top: Top, equations: EulerPoisson) -> str:
    """Reason why the state of ``top`` is not one of the reference; empty if it is."""
    if equations.omega_sign != 1.0 or tuple(top.components) in (BODY, BODY[:3]):
        return ""
    return f"top {top.kind!r} has the state ({', '.join(top.components)}); expected omega and gamma"


def reference_obstacle(top: Top) -> str:
    """Reason why the reference cannot follow ``top``, one line; empty if it can."""
    try:
        return _form_fault(top, checked_equations(top, NAME))
    except UsageError as error:
        return str(error)


def _checked(top: Top, y0: Sequence[float], times: Array) -> tuple[Array, Array]:
    """Initial state as omega, gamma (6,), and the times (m,), both checked."""
    equations = checked_equations(top, NAME)
    sign = equations.omega_sign
    if fault := _form_fault(top, equations):
        raise RunError(f"reference: {fault}")
    if len(y0) != len(top.components):
        raise ValueError(f"reference: the state has {len(y0)} components; expected {len(top.components)}")
    y = np.zeros(6)
    y[: len(y0)] = y0
    y[:3] *= sign
    t = np.ascontiguousarray(times, dtype=np.float64)
    if t.ndim != 1 or not np.isfinite(t).all() or not np.isfinite(y).all():
        raise ValueError("reference: initial state and times must be finite, times of one dimension")
    if ((t < 0.0).any() and (t > 0.0).any()) or (np.diff(np.abs(t)) < 0.0).any():
        raise ValueError("reference: times must lead away from zero, all forward or all backward")
    return y, t


def distances(states: Array, reference: Array) -> Array:
    """Euclidean distances (...,) of ``states`` from ``reference``, both (..., d); infinite beyond double precision."""
    with np.errstate(all="ignore"):
        square = np.zeros(states.shape[:-1])
        for i in range(states.shape[-1]):  # in this order for arrays of any shape
            square += (states[..., i] - reference[..., i]) ** 2
        return np.sqrt(square)


def reference_states(top: Top, y0: Sequence[float], times: Array, max_steps: int = MAX_TAYLOR_STEPS) -> Array:
    """Reference solution at given times; it heeds a request to stop (``contracts.check_stop``).

    Each state is within an ulp of its own size of the solution, as long as the motion's sensitivity has not amplified
    the local error of 1e-31 to that.

    Parameters
    ----------
    top : Top
        Top whose equations are solved.
    y0 : sequence of float, shape (d,)
        State at time zero, in the order of ``top.components``.
    times : ndarray, shape (m,)
        Times, taken as exact numbers, leading away from zero: all forward (>= 0) or all backward (<= 0).
    max_steps : int, optional
        Largest number of Taylor steps. A motion that surely needs more is refused before the first one, any other as
        soon as its steps so far show it.

    Returns
    -------
    ndarray, shape (m, d)

    Raises
    ------
    RunError
        If the motion leaves the range of a double, its steps shrink below the resolution of time, or it needs too many
        of them.
    ValueError
        For times that do not lead away from zero.
    """
    y, t = _checked(top, y0, times)
    equations = checked_equations(top, NAME)
    coef = coefficients(equations)
    k, m = _units(coef, y)
    unit = np.repeat((-k, m), 3)
    state, out, work = np.zeros(16), np.zeros((t.size, 6)), np.zeros(12 * (ORDER + 1))
    with np.errstate(all="ignore"):
        state[:6] = np.ldexp(y, -unit)
        state[15] = t.size
        tau = np.ldexp(t, -k)
        quotients = coef.reshape(3, 6)
        quotients[:, 2:] = np.ldexp(quotients[:, 2:], 2 * k + m) if y[3:].any() else 0.0
    if t.size and not abs(tau[-1]) <= LONGEST * max_steps:
        least = min(abs(float(tau[-1])) / LONGEST, sys.float_info.max)
        raise _too_long(f"at least {least:.2g}", float(t[-1]), max_steps)
    _follow(coef, state, tau, out.reshape(-1), work, lambda at: math.ldexp(at, k), max_steps)
    with np.errstate(all="ignore"):
        states = np.ldexp(out, unit)[:, : len(top.components)]
    states[:, :3] *= equations.omega_sign
    if not np.isfinite(states).all():
        raise RunError("reference: the motion leaves the range of double precision")
    return np.ascontiguousarray(states)


def _too_long(steps: str, t: float, most: int) -> RunError:
    """Error for a motion of too many steps."""
    return RunError(f"the reference would need {steps} Taylor steps to reach t = {t:.6g}; at most {most} are taken")


def _follow(
    coef: Array,
    state: Array,
    tau: Array,
    out: Array,
    work: Array,
    physical: Callable[[float], float],
    max_steps: int,
) -> None:
    """Call ``advance`` until all outputs are written, in parts so that it can be interrupted."""
    run = _compiled()
    while True:
        check_stop()
        code = run(coef, state, tau, out, work, ORDER, REACH, BUDGET)
        if code == DONE:
            return
        at, steps = abs(state[12]), state[14]
        if code != MORE:
            why = "its step shrinks below the resolution of time" if code == STEP_TOO_SMALL else "it is not finite"
            raise RunError(f"reference: the motion cannot be followed beyond t = {physical(state[12]):.6g}: {why}")
        expected = steps * (abs(tau[-1]) / at)
        if expected > max_steps:
            raise _too_long(f"about {expected:.2g}", physical(tau[-1]), max_steps)
