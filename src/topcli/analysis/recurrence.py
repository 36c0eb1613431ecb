"""Recurrence of an orbit, from states evenly spaced in time: at rest, repeating, wandering or leaving.

Exponential growth of tangent vectors means chaos only on an orbit that comes back without repeating itself. The test
uses the changes from one state to the next, so that an angle may turn and a time may run. Those of the last quarter set
two levels for each component, their ``_LEVELS`` quantiles; an orbit that comes back has passed from beyond one level to
beyond the other in the two quarters before. An orbit repeats itself if its last half or three quarters, shifted by some
time, cover themselves: the mean squared distance of states, relative to that of independent ones, is then small. So it
is on an orbit whose chaos is confined to narrow bands about a periodic one.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.swings import passages
from topcli.contracts import Array

STILL = 1e-9
"""Range of a component, in its unit, below which it does not move."""
_LEVELS = 0.3, 0.7
PASSAGES = 6
"""Fewest passages of every component between its levels on an orbit that comes back: three oscillations."""
COVERED = 0.1
"""Relative squared distance below which an orbit repeats itself; most chaotic orbits have 0.4 to 1."""
APART = 0.5
"""Relative squared distance of states that are apart."""
LEFT = 5.0
"""Range of the changes in the last quarter, relative to that in the two before, from which on an orbit leaves."""


class Recurrence(StrEnum):
    """Kinds of return of an orbit to where it was."""

    AT_REST = "at rest"
    REPEATS = "repeats"
    WANDERS = "wanders"
    LEAVES = "leaves"
    TOO_SHORT = "too short"


def at_rest(states: Array) -> NDArray[np.bool_]:
    """True for each orbit of ``states`` (k, m, d), in units of each component, that rests in the last quarter."""
    return (np.ptp(states[3 * len(states) // 4 :], axis=0) <= STILL).all(axis=1)


def recurrence_of(states: Array, n: NDArray[np.int64]) -> Recurrence:
    """Recurrence of an orbit with ``states`` (k, d), in units of each component, at nearly even steps ``n`` (k,)."""
    if at_rest(states[:, None])[0]:
        return Recurrence.AT_REST
    changes = np.diff(states, axis=0) / (np.diff(n) / np.diff(n).mean())[:, None]
    quarter = len(changes) // 4
    middle, last = changes[quarter : 3 * quarter], changes[3 * quarter :]
    changing = np.ptp(last, axis=0) > STILL
    low, high = np.quantile(last[:, changing], _LEVELS, axis=0)
    columns = list(zip(middle[:, changing].T, low, high, strict=True))
    comes_back = bool(columns) and all(passages(x < under, x > over) >= PASSAGES for x, under, over in columns)
    if not comes_back and (np.ptp(last, axis=0) > LEFT * np.ptp(middle, axis=0)).any():
        return Recurrence.LEAVES
    if any(mismatch(states[start:]) < COVERED for start in (len(states) // 4, len(states) // 2)):
        return Recurrence.REPEATS
    return Recurrence.WANDERS if comes_back else Recurrence.TOO_SHORT


def mismatch(states: Array) -> float:
    """Smallest mean squared distance of ``states`` (k, d) from themselves, shifted by up to half of their number.

    It is that of the worst component, relative to the distance of independent states: 0 for a periodic orbit. Shifts
    over which the orbit hardly moves do not count; infinite if there are no others.
    """
    moving, m = np.ptp(states, axis=0) > STILL, len(states)
    x = (states - states.mean(axis=0))[:, moving] / states[:, moving].std(axis=0)
    shifts = np.arange(1, m // 2 + 1)[:, None]
    spectrum = np.fft.rfft(x, 1 << (3 * m // 2).bit_length(), axis=0)
    products = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, axis=0)[1 : m // 2 + 1]
    squares = np.cumsum(x**2, axis=0)
    distances = squares[::-1][1 : m // 2 + 1] + squares[-1] - squares[: m // 2] - 2.0 * products
    worst = (distances / (2.0 * (m - shifts))).max(axis=1)
    apart = np.flatnonzero(worst > APART)
    return float(worst[apart[0] :].min()) if len(apart) else np.inf
