"""Many Taylor series at once: eight trajectories of one top in the lanes of the vector unit, blocks of them in threads.

The same method, tolerance and times as the scheme ``taylor``; the arithmetic is ordered otherwise, so that a trajectory
agrees with its single run to round-off, not bit for bit. With eight series to share them the sums of products are what
costs, and a lower order pays: see ``batch_order``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from topcli.contracts import Array, Top, checked_equations
from topcli.engine.driver import SIGNATURE
from topcli.engine.native import Native, native_text
from topcli.kernels.series_batch import ALPHA, BETA, COUNT, DELTA, HI, LANES, LEVEL, SLOTS, TIME, UNIT, batch_loop
from topcli.schemes.taylor import log2_of, quotients, scales

NAME = "scheme 'taylor'"
ORDERS = (12, 28)
"""The least and the greatest order."""


def batch_order(tol: float) -> int:
    """The order that reaches ``tol`` at the least cost, as measured: a multiple of four."""
    digits = -log2_of(tol) * math.log10(2.0)
    return min(max(4 * round((1.3 * digits + 5.0) / 4.0), ORDERS[0]), ORDERS[1])


def batch_code(top: Top, tol: float) -> Native:
    """The time loop of eight trajectories of ``top`` as machine code."""
    named = zip(("alpha", "beta", "delta"), quotients(checked_equations(top, NAME)), strict=True)
    lacks = frozenset(f"{name}{i}" for name, values in named for i, value in enumerate(values) if value == 0.0)
    return native_text(batch_loop(len(top.components), batch_order(tol), lacks), "advance", SIGNATURE)


def prepared(top: Top, y0: Array, tol: float) -> Array:
    """The working state for eight initial states (8, d), shape (SLOTS, 8)."""
    equations, d = checked_equations(top, NAME), y0.shape[1]
    work = np.zeros((SLOTS, LANES))
    work[LEVEL] = log2_of(tol)
    tables = np.array(quotients(equations))
    for lane, y in enumerate(y0):
        k, m = scales(equations, y)
        units = np.repeat((equations.omega_sign * 2.0**k, 2.0**m), 3)[:d]
        with np.errstate(all="ignore"):
            work[HI : HI + d, lane] = y / units
            work[BETA : BETA + 3, lane], work[DELTA : DELTA + 3, lane] = np.ldexp(tables[1:], m - 2 * k)
        work[ALPHA : ALPHA + 3, lane] = tables[0]
        work[UNIT : UNIT + d, lane] = units
        work[TIME, lane] = 2.0**k
    return work


def taylor_batch(
    top: Top,
    y0: Sequence[Sequence[float]] | Array,
    h: float,
    N: int,
    every: int = 1,
    tol: float = 1e-17,
    threads: int = 1,
) -> tuple[Array, Array]:
    """The motions of ``top`` from the states ``y0`` (m, d) over N steps of ``h``, every ``every``-th recorded.

    Returns the states, shape (m, 1 + N // every, d), the first of them ``y0``, and the numbers of series that each
    motion took, (m,). A motion that cannot be followed (its state is not finite, or its steps shrink below 1e-13 of
    h) is nan from there on. Raises ValueError for states of another length than the top's.
    """
    first = np.ascontiguousarray(y0, dtype=np.float64)
    d = len(top.components)
    if first.ndim != 2 or first.shape[1] != d:
        raise ValueError(f"taylor_batch: initial states of shape {first.shape}; expected (m, {d})")
    if N < 1 or every < 1 or threads < 1:
        raise ValueError(f"taylor_batch: N = {N}, every = {every}, threads = {threads}; expected 1 or more")
    code, rows, m = batch_code(top, tol), N // every, len(first)
    states, series = np.empty((m, 1 + rows, d)), np.zeros(m)
    states[:, 0] = first

    def block(begin: int) -> None:
        kept = min(LANES, m - begin)
        lanes = first[np.minimum(np.arange(begin, begin + LANES), m - 1)]
        work, out = prepared(top, lanes, tol), np.full((rows, d, LANES), np.nan)
        code(work.reshape(-1), out.reshape(-1), work[0], h, N, every, every)
        states[begin : begin + kept, 1:] = out.transpose(2, 0, 1)[:kept]
        series[begin : begin + kept] = work[COUNT, :kept]

    begins = range(0, m, LANES)
    if threads == 1:
        for begin in begins:
            block(begin)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(block, begins))
    return states, series
