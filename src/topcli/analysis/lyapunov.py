"""Lyapunov exponents of a scheme's map, from the growth of tangent vectors, and verdicts: regular or chaotic.

A tangent vector v follows the derivative of the map along an orbit. Its growth is G = ln(|v(t)|/|v(0)|), and G/t tends
to the largest Lyapunov exponent. On a regular orbit v grows like t: G/t falls like ln(t)/t and is never zero. On a
chaotic orbit G grows like t. The verdict rests on the excess of G over the logarithm of the elapsed time, counted in
units of |y|/|dy/dt|, and on the growth in the second half of the time. Measured on 896 orbits of seven tops: the excess
is below 2 on regular orbits; a regular orbit near a separatrix may have a large one, but stops growing.

Several exponents come from as many vectors, which are made orthogonal on the way (Benettin, Galgani, Giorgilli,
Strelcyn, Meccanica 15 (1980) 9).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Method, Scheme, Top, check_stop, stop_asked
from topcli.engine.ensemble import default_threads, tile_of
from topcli.engine.tangent import BlockCode, BlockRun, TangentCode, TangentRun, tangent_code
from topcli.errors import UsageError

FEWEST_STEPS, MOST_STEPS = 8, 64
"""Steps from one renormalisation of the vectors to the next."""
CALL_STEPS = 1 << 22
"""Steps of all orbits of a call of compiled code: about 0.1 s."""
LEAST_STEPS = 1000
"""Fewest steps of an orbit."""
POINTS, LATE_POINTS = 64, 16
"""Points of a curve of the growth: evenly spread on a logarithmic axis, and on a linear one over the second half."""
REGULAR, CHAOTIC = 3.0, 6.0
"""Excess of the growth below which an orbit may be regular, and above which it may be chaotic."""
LATE = 5.0
"""Growth in the second half of the time of a chaotic orbit; regular ones reach 3.4."""
SEED = 20250101
"""Seed of the first tangent vectors."""


class Verdict(StrEnum):
    """Kind of an orbit, as far as its length can tell."""

    REGULAR = "regular"
    CHAOTIC = "chaotic"
    UNDECIDED = "undecided"
    BROKE_OFF = "broke off"


def interval(h: float, N: int) -> int:
    """Steps from one renormalisation to the next: about a unit of time."""
    return min(max(FEWEST_STEPS, min(MOST_STEPS, int(1.0 / abs(h)))), max(1, N // POINTS))


def checkpoints(N: int) -> NDArray[np.int64]:
    """Numbers of steps at which a curve has a point; N, N/2 and N/10 are among them."""
    early, late = np.geomspace(min(10, N), N, POINTS), np.linspace(N // 2, N, LATE_POINTS + 1)
    return np.unique(np.concatenate([np.round(early), np.round(late), [N // 10, N // 2, N]]).clip(1).astype(np.int64))


@dataclass(frozen=True)
class Growth:
    """Growth of tangent vectors along orbits.

    Attributes
    ----------
    n : ndarray of int64, shape (k,)
        Step numbers.
    h : float
        Step size.
    logs : ndarray, shape (k, m)
        Growth G of the vector of each orbit, nan after the end of an orbit that broke off.
    rate : ndarray, shape (m,)
        Typical |dy/dt|/|y| of each orbit, its unit of inverse time.
    """

    n: NDArray[np.int64]
    h: float
    logs: Array
    rate: Array

    @property
    def t(self) -> Array:
        """Times of the points, from 0 on."""
        return self.n * abs(self.h)

    def at(self, n: int) -> Array:
        """Growth after ``n`` steps, of a point of the curve (m,)."""
        return self.logs[int(np.searchsorted(self.n, n))]

    @property
    def exponents(self) -> Array:
        """Exponent of each orbit over the whole time, per unit of time (m,)."""
        return self.logs[-1] / self.t[-1]

    @property
    def errors(self) -> Array:
        """Standard error of the exponents, from the growth in equal parts of the second half (m,)."""
        late = np.round(np.linspace(self.n[-1] // 2, self.n[-1], LATE_POINTS + 1)).astype(np.int64).clip(1)
        parts = np.diff(self.logs[np.searchsorted(self.n, late)], axis=0)
        return parts.std(axis=0, ddof=1) * math.sqrt(LATE_POINTS / 2.0) / self.t[-1]

    @property
    def excess(self) -> Array:
        """Growth beyond the logarithm of the time, counted in the unit of each orbit (m,)."""
        return self.logs[-1] - np.log1p(self.rate * self.t[-1])

    @property
    def detectable(self) -> Array:
        """Exponent above which an orbit as long as these would be called chaotic (m,)."""
        return np.maximum(CHAOTIC + np.log1p(self.rate * self.t[-1]), 2.0 * LATE) / self.t[-1]

    @property
    def verdicts(self) -> list[Verdict]:
        """Verdict on each orbit; there is none on orbits of less than ``LEAST_STEPS`` steps."""
        N = int(self.n[-1])
        half, tenth, excess = self.at(max(1, N // 2)), self.at(max(1, N // 10)), self.excess
        late, last = self.logs[-1] - half, self.logs[-1] - tenth
        found = []
        for i in range(len(excess)):
            if not np.isfinite(excess[i]):
                found.append(Verdict.BROKE_OFF)
            elif N < LEAST_STEPS:
                found.append(Verdict.UNDECIDED)
            elif excess[i] > CHAOTIC and late[i] > LATE:
                found.append(Verdict.CHAOTIC)
            elif excess[i] < REGULAR or last[i] < math.log(10.0) + 1.0:
                found.append(Verdict.REGULAR)
            else:
                found.append(Verdict.UNDECIDED)
        return found


def _mean(values: Array) -> Array:
    """Mean of the finite values along the first axis; 0 if there are none.

    Python's sum adds row by row, so that the bits of a mean do not depend on the number of columns.
    """
    finite = np.isfinite(values)
    return sum(np.where(finite, values, 0.0)) / np.maximum(finite.sum(axis=0), 1)


def _units(top: Top, states: Array) -> Array:
    """Typical size of each component over the states (k, m, d) of each orbit (m, d): that of the vector it is in."""
    units = np.empty(states.shape[1:])
    with np.errstate(all="ignore"):
        for start, stop in type(top).vectors.values():
            size = np.sqrt(_mean((states[:, :, start:stop] ** 2).sum(axis=2)))
            units[:, start:stop] = size[:, None]
        typical = np.sqrt((units**2).mean(axis=1, keepdims=True))
        return np.where(units > SMALLEST * typical, units, np.where(typical > 0.0, typical, 1.0))


def _rates(top: Top, states: Array, units: Array) -> Array:
    """Typical |dy/dt|/|y| over the states (k, m, d) of each orbit (m,), all components in their ``units`` (m, d)."""
    p = top.constants()
    with np.errstate(all="ignore"):
        slopes = np.array([[top.field(tuple(y), p) for y in row] for row in states.tolist()])
        speed = np.linalg.norm(slopes / units, axis=2) / np.linalg.norm(states / units, axis=2)
        return _mean(speed)


def _taken(run: TangentRun | BlockRun, steps: int, every: int, stop: Callable[[], bool]) -> bool:
    """Take ``steps`` steps with renormalisations every ``every``; False if asked to stop."""
    blocks = max(1, CALL_STEPS // (every * run.code.lanes))
    whole, rest = divmod(steps, every)
    while whole:
        if stop():
            return False
        run.advance(min(blocks, whole), every)
        whole -= min(blocks, whole)
    if rest:
        run.advance(1, rest)
    return True


STATES = 8
"""States along an orbit from which its units are taken."""
SMALLEST = 1e-8
"""Size of a component relative to that of all below which it is not a unit of its own."""


def _tile_growth(
    code: TangentCode | BlockCode,
    top: Top,
    h: float,
    points: NDArray[np.int64],
    y: Array,
    seed: int,
    stop: Callable[[], bool],
) -> tuple[Array, Array]:
    """Growth (k, m) and rates (m,) of the orbits of a tile from ``y`` (m, d)."""
    # the same vector for all orbits, each in its own units, so that its growth does not depend on the others
    first = np.random.default_rng(seed).normal(size=y.shape[1]) * _units(top, y[None])
    every = interval(h, int(points[-1]))
    run, states, done = code.run(h, y, first), [y], 0
    logs, vectors = np.full((len(points), len(y)), np.nan), np.full((len(points), *y.shape), np.nan)
    looked = set(np.linspace(0, len(points) - 1, STATES).round().astype(int).tolist())
    for k, n in enumerate(points.tolist()):
        if not _taken(run, n - done, every, stop):
            break
        logs[k], vectors[k], done = run.growth, run.vectors, n
        if k in looked:
            states.append(run.states)
    along = np.array(states)
    units = _units(top, along)
    with np.errstate(all="ignore"):
        lengths = np.log(np.linalg.norm(vectors / units, axis=2)) - np.log(np.linalg.norm(first / units, axis=1))
    return logs + lengths, _rates(top, along, units)


def growth_of(
    top: Top,
    scheme: Scheme,
    method: Method,
    h: float,
    N: int,
    y0: Array,
    *,
    seed: int = SEED,
) -> Growth:
    """Growth of a tangent vector along each orbit of ``N`` steps from the states ``y0`` (m, d).

    The orbits run side by side, on all processors; the growth along each does not depend on the others. Raises
    UsageError for a method without a tangent map, StopAsked if the work is to stop.
    """
    stop = stop_asked.get()
    code = tangent_code(scheme, top, method, 1 if len(y0) == 1 else tile_of(len(y0)))
    points = checkpoints(N)
    starts = range(0, len(y0), code.lanes)

    def tile(first: int) -> tuple[Array, Array]:
        return _tile_growth(code, top, h, points, y0[first : first + code.lanes], seed, stop)

    with ThreadPoolExecutor(min(default_threads(), len(starts))) as pool:
        found = list(pool.map(tile, starts))
    check_stop()
    return Growth(points, h, np.concatenate([f[0] for f in found], axis=1), np.concatenate([f[1] for f in found]))


WIDEST = 16.0
"""Largest difference of the logarithms of the growth of vectors between two orthogonalisations: the slowest vector is
then accurate to about exp(16) roundings."""


def spectrum_of(
    top: Top,
    scheme: Scheme,
    method: Method,
    h: float,
    N: int,
    y0: Sequence[float],
    *,
    seed: int = SEED,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> Growth:
    """Growth of d orthogonal tangent vectors along one orbit: ``logs`` (k, d), the fastest first.

    The vectors are made orthogonal as often as their growth demands. Raises UsageError for a method without a tangent
    map, and for one of which a step alone stretches vectors too differently.
    """
    d = len(y0)
    code = tangent_code(scheme, top, method, max(d, tile_of(d)))
    points = checkpoints(N)
    y, vectors = np.array(y0, dtype=float), np.linalg.qr(np.random.default_rng(seed).normal(size=(d, d)))[0]
    total, states, done, every = np.zeros(d), [y[None]], 0, 1
    logs = np.full((len(points), d), np.nan)
    for k, n in enumerate(points.tolist()):
        while done < n:
            steps = min(every, n - done)
            run = code.run(h, np.tile(y, (d, 1)), vectors)  # all vectors on the same orbit
            run.advance(1, steps, renormalise=False)
            with np.errstate(all="ignore"):
                q, r = np.linalg.qr(run.vectors.T)
                grown = np.log(np.abs(np.diag(r)))
            difference = float(np.ptp(grown))
            if not difference <= WIDEST and steps > 1:  # nan included
                every = steps // 2
                continue
            if not np.isfinite(run.vectors).all():
                return Growth(points, h, logs, np.zeros(d))
            if difference > WIDEST:
                raise UsageError(
                    f"after one step at t = {done * h:g}, the growths of tangent vectors differ by a factor "
                    f"exp({difference:.0f}), too much for a spectrum; take the largest exponent alone, or a smaller h"
                )
            if difference < WIDEST / 4.0 and steps == every:
                every = min(2 * every, MOST_STEPS)
            y, vectors, total, done = run.states[0], q.T, total + grown, done + steps
        logs[k] = total
        states.append(y[None])
        watch(done, N)
    largest_first = np.argsort(-logs[-1], kind="stable")
    along = np.array(states)
    return Growth(points, h, logs[:, largest_first], np.repeat(_rates(top, along, _units(top, along)), d))
