"""Taylor series of the Euler-Poisson equations in double-double arithmetic, with output at any time.

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

from topcli.arithmetic.double_double import dd_add, dd_div, dd_mul, dd_scale, two_prod, two_sum
from topcli.contracts import Array

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
