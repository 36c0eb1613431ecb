"""Lyapunov exponents of a scheme's map, from the growth of tangent vectors, and verdicts: regular or chaotic.

A tangent vector v follows the derivative of the map along an orbit. Its growth is G = ln(|v(t)|/|v(0)|), and G/t tends
to the largest Lyapunov exponent. On a regular orbit v grows like t: G/t falls like ln(t)/t and is never zero. On a
chaotic orbit G grows like t.

A verdict rests on the excess of G over the logarithm of the elapsed time, counted in units of |y|/|dy/dt|; on the
growth in the second half of the time, which has to be there at all times and to exceed its falls and its error; and on
the recurrence of the orbit. A regular orbit near a separatrix has a large excess, but G rises and falls again and again
by the logarithm of its distance from the separatrix. If that is near the precision of the numbers, round-off decides
on which side of the separatrix the orbit goes on, and there is no verdict.

Several exponents come from as many vectors, which are made orthogonal on the way (Benettin, Galgani, Giorgilli,
Strelcyn, Meccanica 15 (1980) 9).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.recurrence import Recurrence, at_rest, recurrence_of
from topcli.contracts import Array, Method, Scheme, Top, check_stop
from topcli.engine.drive import default_threads
from topcli.engine.machine import lanes_of
from topcli.engine.tangent import TangentRun, tangent_code
from topcli.errors import UsageError
from topcli.field.integrals import slopes

MOST_STEPS = 64
"""Most steps from one orthogonalisation of the vectors to the next."""
CALL_STEPS = 1 << 22
"""Steps of all orbits of a call of compiled code: about 0.1 s."""
LEAST_STEPS = 1000
"""Fewest steps of an orbit."""
_PARTS = 256
"""Parts of the time, at whose ends a curve of the growth has a point."""
REGULAR, CHAOTIC = 3.0, 6.0
"""Excess of the growth below which an orbit may be regular, and above which it may be chaotic."""
LATE = 5.0
"""Growth in the second half of the time of a chaotic orbit; regular ones reach 3.4."""
FALLS = 2.0
"""Growth in the second half of the time of a chaotic orbit, in units of the largest fall."""
DEEP = 8.0
"""Largest fall of the growth on a chaotic orbit; those of random orbits reach 6."""
BATCHES, STUDENT = (4, 8), 3.2
"""Numbers of equal parts of the time from which the error of an exponent is taken, and Student's factor of four parts
for 95 %: growth is correlated over long times where orbits stick to regular islands, so the parts are few."""
TRANSIENT, UNLIKE = 16, 5.0
"""Parts of the time that may be a transient, and their distance from the later parts, in standard deviations."""
UNSURE = 2.0
"""Growth of a vector that its direction at the beginning and the end leaves open."""
SEED = 20250101
"""Seed of the first tangent vectors."""


class Verdict(StrEnum):
    """Kind of an orbit, as far as its length can tell."""

    REGULAR = "regular"
    CHAOTIC = "chaotic"
    UNDECIDED = "undecided"
    BROKE_OFF = "broke off"
    EQUILIBRIUM = "equilibrium"
    UNSTABLE = "unstable"
    ESCAPING = "escaping"


OF_RECURRENCE = {
    Recurrence.REPEATS: Verdict.UNSTABLE,
    Recurrence.WANDERS: Verdict.CHAOTIC,
    Recurrence.LEAVES: Verdict.ESCAPING,
}
"""Verdicts on orbits whose tangent vectors grow exponentially."""


def shares_of_chaos(verdicts: Sequence[Verdict]) -> Array:
    """1 for each orbit that is chaotic, 0 for one that is regular or at rest, nan for others (m,)."""
    shares = {Verdict.CHAOTIC: 1.0, Verdict.REGULAR: 0.0, Verdict.EQUILIBRIUM: 0.0}
    return np.array([shares.get(verdict, math.nan) for verdict in verdicts])


def checkpoints(N: int) -> NDArray[np.int64]:
    """Numbers of steps, from 0 on, of the ``_PARTS + 1`` points of a curve."""
    return np.round(np.linspace(0, N, _PARTS + 1)).astype(np.int64)


def _moments(parts: Array) -> tuple[Array, Array]:
    """Mean and standard deviation of each column of ``parts`` (k, m), whose bits do not depend on the other columns."""
    rows = np.ascontiguousarray(parts.T)
    return rows.mean(axis=1), rows.std(axis=1, ddof=1)


@dataclass(frozen=True)
class Growth:
    """Growth of tangent vectors along orbits.

    Attributes
    ----------
    n : ndarray of int64, shape (_PARTS + 1,)
        Step numbers of the points of ``checkpoints``.
    h : float
        Step size.
    logs : ndarray, shape (_PARTS + 1, m)
        Growth G of the vector of each orbit, nan after the end of an orbit that broke off.
    rate : ndarray, shape (m,)
        Typical |dy/dt|/|y| of each orbit, its unit of inverse time.
    skipped : ndarray of int64, shape (m,)
        Parts of the time, of ``TRANSIENT``, that the exponents leave out at the beginning.
    recurrences : sequence of Recurrence or None
        Of each orbit that rests or whose vector grows exponentially.
    """

    n: NDArray[np.int64]
    h: float
    logs: Array
    rate: Array
    skipped: NDArray[np.int64]
    recurrences: Sequence[Recurrence | None]

    @property
    def t(self) -> Array:
        """Times of the points."""
        return self.n * abs(self.h)

    @property
    def T(self) -> float:
        """Time of the last point."""
        return float(self.t[-1])

    @property
    def transients(self) -> NDArray[np.int64]:
        """First parts of the time, of ``TRANSIENT``, in which the growth is unlike that in the second half (m,).

        None of those of an orbit that grows no more than a regular one.
        """
        parts, half = np.diff(self.logs[:: _PARTS // TRANSIENT], axis=0), TRANSIENT // 2
        mean, scatter = _moments(parts[half:])
        unlike = np.abs(parts[:half] - mean) > UNLIKE * scatter
        return np.where(self.excess > CHAOTIC, np.cumprod(unlike, axis=0).sum(axis=0), 0)

    @property
    def _settled(self) -> tuple[Array, Array, Array]:
        """Growth after the transient, half the width of its confidence interval of 95 %, and the time (m,)."""
        begin = self.skipped * (_PARTS // TRANSIENT)
        growth, margin = np.empty_like(self.rate), np.empty_like(self.rate)
        for row in set(begin.tolist()):
            columns = begin == row
            curves = self.logs[row:, columns]
            spread = np.zeros(curves.shape[1])
            for count in BATCHES:
                edges = np.round(np.linspace(0, len(curves) - 1, count + 1)).astype(int)
                spread = np.maximum(spread, math.sqrt(count) * _moments(np.diff(curves[edges], axis=0))[1])
            growth[columns], margin[columns] = curves[-1] - curves[0], np.hypot(STUDENT * spread, UNSURE)
        return growth, margin, self.T - self.t[begin]

    @property
    def exponents(self) -> Array:
        """Exponent of each orbit per unit of time, after its transient (m,)."""
        growth, _, time = self._settled
        return growth / time

    @property
    def errors(self) -> Array:
        """Half the widths of the confidence intervals of the exponents, 95 % (m,)."""
        _, margin, time = self._settled
        return margin / time

    @property
    def beyond(self) -> Array:
        """Growth beyond the logarithm of the time, counted in the unit of each orbit (_PARTS + 1, m)."""
        return self.logs - np.log1p(self.rate * np.linspace(0.0, self.T, _PARTS + 1)[:, None])

    @property
    def excess(self) -> Array:
        """Growth beyond the logarithm of the time at the end (m,)."""
        return self.beyond[-1]

    @property
    def detectable(self) -> Array:
        """Exponent above which an orbit as long as these would be called chaotic (m,)."""
        return np.maximum(CHAOTIC + np.log1p(self.rate * self.T), 2.0 * LATE) / self.T

    @property
    def largest_fall(self) -> Array:
        """Largest fall of the growth from an earlier value, but for the first eighth of the time (m,)."""
        late = self.logs[_PARTS // 8 :]
        return (np.maximum.accumulate(late, axis=0) - late).max(axis=0)

    @property
    def grows(self) -> NDArray[np.bool_]:
        """True for each vector that grows exponentially, as far as its growth can tell (m,)."""
        growth, margin, _ = self._settled
        quarters = np.diff(self.logs[_PARTS // 2 :: _PARTS // 8], axis=0)
        late = self.logs[-1] - self.logs[_PARTS // 2]
        enough = (self.excess > CHAOTIC) & (late > LATE) & (late > FALLS * self.largest_fall)
        return enough & (quarters > 0.0).all(axis=0) & (growth > margin)

    @property
    def verdicts(self) -> list[Verdict]:
        """Verdict on each orbit; there is none on orbits of less than ``LEAST_STEPS`` steps."""
        excess, grows, falls = self.excess, self.grows, self.largest_fall
        lowest = self.beyond[_PARTS // 2 :].min(axis=0)
        fell_back = (lowest < REGULAR) & (excess < REGULAR + falls)
        settled = self.logs[-1] - self.logs[_PARTS // 8] < math.log(8.0) + 1.0
        verdicts = []
        for i, recurrence in enumerate(self.recurrences):
            verdict = Verdict.UNDECIDED
            if not np.isfinite(excess[i]):
                verdict = Verdict.BROKE_OFF
            elif self.n[-1] < LEAST_STEPS:
                pass
            elif recurrence is Recurrence.AT_REST:
                verdict = Verdict.EQUILIBRIUM
            elif recurrence is not None and grows[i]:
                verdict = OF_RECURRENCE.get(recurrence, Verdict.UNDECIDED)
                verdict = Verdict.UNDECIDED if verdict is Verdict.CHAOTIC and falls[i] > DEEP else verdict
            elif fell_back[i] or settled[i]:
                verdict = Verdict.REGULAR
            verdicts.append(verdict)
        return verdicts


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
    rates = slopes(top, states.reshape(-1, states.shape[-1])).reshape(states.shape)
    with np.errstate(all="ignore"):
        return _mean(np.linalg.norm(rates / units, axis=2) / np.linalg.norm(states / units, axis=2))


def _advance(run: TangentRun, steps: int) -> None:
    """Take ``steps`` steps. Raises StopAsked if asked to stop."""
    most = CALL_STEPS // run.code.lanes
    for done in range(0, steps, most):
        check_stop()
        run.advance(min(most, steps - done))


_STATES = 8
"""States along an orbit from which its units are taken."""
SMALLEST = 1e-8
"""Size of a component relative to that of all below which it is not a unit of its own."""


def _growth(top: Top, h: float, points: NDArray[np.int64], logs: Array, states: Array, discard: int | None) -> Growth:
    """Growth ``logs`` (_PARTS + 1, m) at the ``points``, with ``states`` (_PARTS + 1, orbits, d).

    Each vector is on an orbit of its own, or all are on a single one. Unless steps were discarded, the exponents leave
    out a transient.
    """
    m, orbits = logs.shape[1], states.shape[1]
    units = _units(top, states[:: _PARTS // _STATES])
    rate = np.repeat(_rates(top, states[:: _PARTS // _STATES], units), m // orbits)
    growth = Growth(points, h, logs - logs[0], rate, np.zeros(m, dtype=np.int64), [None] * m)
    if discard is None:  # the same time for all of an orbit, so that the exponents add up to the mean divergence
        growth = replace(growth, skipped=np.repeat(growth.transients[:orbits], m // orbits))
    with np.errstate(all="ignore"):
        scaled = states / units
        looked = at_rest(scaled) | growth.grows[:orbits]
        kinds = [recurrence_of(scaled[:, i], points) if look else None for i, look in enumerate(looked.tolist())]
    return replace(growth, recurrences=kinds * (m // orbits))


def growth_of(
    top: Top,
    scheme: Scheme,
    method: Method,
    h: float,
    N: int,
    y0: Array,
    *,
    discard: int | None = None,
) -> Growth:
    """Growth of a tangent vector along each orbit of ``N`` steps from the states ``y0`` (m, d).

    The curves begin after ``discard`` steps; by default at the first, and the exponents leave out a transient. The
    orbits run side by side, on all processors; the growth along each does not depend on the others. Raises UsageError
    for a method without a tangent map, StopAsked if the work is to stop.
    """
    points = checkpoints(N - (discard or 0))
    code = tangent_code(scheme, top, method, 1 if len(y0) == 1 else lanes_of(len(y0)))
    logs, (vectors, states) = np.zeros((len(points), len(y0))), np.zeros((2, len(points), *y0.shape))

    def follow(first: int) -> None:
        """Fill in the columns of a tile."""
        here, done = slice(first, first + code.lanes), 0
        # the same vector for all orbits, each in its own units, so that its growth does not depend on the others
        start = np.random.default_rng(SEED).normal(size=y0.shape[1]) * _units(top, y0[None, here])
        run = TangentRun(code, h, y0[here], start)
        _advance(run, discard or 0)
        for k, n in enumerate(points.tolist()):
            _advance(run, n - done)
            logs[k, here], vectors[k, here], states[k, here], done = run.scales, run.vectors, run.states, n

    starts = range(0, len(y0), code.lanes)
    with ThreadPoolExecutor(min(default_threads(), len(starts))) as pool:
        for tile in [pool.submit(copy_context().run, follow, first) for first in starts]:
            tile.result()
    with np.errstate(all="ignore"):
        # all powers of 2 go into the scales, since those of a vector depend on when the others were scaled
        sizes, powers = np.frexp(np.linalg.norm(vectors / _units(top, states[:: _PARTS // _STATES]), axis=2))
        logs = (logs + powers) * math.log(2.0) + np.log(sizes)
    return _growth(top, h, points, logs, states, discard)


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
    discard: int | None = None,
    watch: Callable[[int, int], None] = lambda done, total: None,
) -> Growth:
    """Growth of d orthogonal tangent vectors along one orbit: ``logs`` (k, d), the fastest first.

    The vectors are made orthogonal as often as their growth demands. As in ``growth_of``, the curves begin after
    ``discard`` steps. Raises UsageError for a method without a tangent map, and for one of which a step alone stretches
    vectors too differently.
    """
    d, begin = len(y0), discard or 0
    code = tangent_code(scheme, top, method, max(d, lanes_of(d)))
    points = checkpoints(N - begin)
    y, vectors = np.array(y0, dtype=float), np.linalg.qr(np.random.default_rng(SEED).normal(size=(d, d)))[0]
    total, states, done, every = np.zeros(d), np.full((len(points), 1, d), np.nan), 0, 1
    logs = np.full((len(points), d), np.nan)
    for k, n in enumerate((begin + points).tolist()):
        while done < n:
            steps = min(every, n - done)
            run = TangentRun(code, h, np.tile(y, (d, 1)), vectors)  # all vectors on the same orbit
            run.advance(steps)
            with np.errstate(all="ignore"):
                q, r = np.linalg.qr(run.images.T)
                grown = np.log(np.abs(np.diag(r)))
            difference = float(np.ptp(grown))
            if not difference <= WIDEST and steps > 1:  # nan included
                every = steps // 2
                continue
            if not np.isfinite(run.images).all():
                return _growth(top, h, points, logs, states, discard)
            if difference > WIDEST:
                raise UsageError(
                    f"after one step at t = {done * h:g}, the growths of tangent vectors differ by a factor "
                    f"exp({difference:.0f}), too much for a spectrum; take the largest exponent alone, or a smaller h"
                )
            if difference < WIDEST / 4.0 and steps == every:
                every = min(2 * every, MOST_STEPS)
            y, vectors, total, done = run.states[0], q.T, total + grown, done + steps
        logs[k], states[k, 0] = total, y
        watch(done, N)
    return _growth(top, h, points, logs[:, np.argsort(-logs[-1], kind="stable")], states, discard)
