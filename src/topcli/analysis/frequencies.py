"""Frequencies and convergence of averages, from evenly spaced rows of an orbit.

Rows enter averages and Fourier integrals with the weight exp(-1/(u(1 - u))), u in (0, 1) along the orbit. On a
quasi-periodic orbit both converge faster than any power of the number of rows m; on a chaotic orbit averages converge
like 1/sqrt(m) (Das, Saiki, Sander, Yorke, Nonlinearity 30 (2017) 4111). The average therefore agrees between the two
halves of a regular orbit to many digits, which needs no tangent map.

The frequency of a column is that of the strongest line of its spectrum: the maximum of the Fourier integral, sought
from the largest value of the fast Fourier transform (Laskar, Icarus 88 (1990) 266, with a smoother window).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from topcli.contracts import Array

LEAST_ROWS = 16
"""Fewest rows from which a frequency or digits are taken."""
MOST_DIGITS = 16.0
"""Digits of averages that agree exactly."""
_NEWTON_STEPS = 12
NEWTON_TOLERANCE = 1e-15
"""Step of Newton's method, in cycles per row times the rows, at which it ends."""
QUIET = 1e-13
"""Amplitude of the strongest line, relative to the largest value, below which a column is constant."""
LEAST_CYCLES = 2.5
"""Fewest cycles over all rows: the mean of a slower line is unknown, and its spectrum has the peak at 1.2 to 2.5."""


@lru_cache(maxsize=8)
def weights(m: int) -> Array:
    """Weights (m,) of the rows of an orbit; their sum is 1."""
    u = (np.arange(m) + 0.5) / m
    weight = np.exp(-1.0 / (u * (1.0 - u)))
    weight /= weight.sum()
    weight.flags.writeable = False
    return weight


def weighted_mean(values: ArrayLike) -> Array:
    """Weighted Birkhoff average over the last axis of ``values`` (..., m)."""
    rows = np.asarray(values, dtype=float)
    weight = weights(rows.shape[-1])
    # orbit by orbit, which stays in the cache; about the first value, so that a constant column has its own average
    means = [row[0] + (weight * (row - row[0])).sum() for row in rows.reshape(-1, len(weight))]
    return np.array(means).reshape(rows.shape[:-1])


def agreement_digits(values: ArrayLike) -> Array:
    """Digits to which the averages over the two halves of an orbit agree.

    Parameters
    ----------
    values : array_like, shape (..., m)
        Rows of a column, evenly spaced in time.

    Returns
    -------
    ndarray, shape (...)
        -log10 of the difference relative to half of the range of the values, from 0 to 16; 16 for a constant column,
        nan for less than 16 rows, and if a value is not finite.
    """
    rows = np.asarray(values, dtype=float)
    half = rows.shape[-1] // 2
    if 2 * half < LEAST_ROWS:
        return np.full(rows.shape[:-1], np.nan)
    with np.errstate(all="ignore"):
        apart = np.abs(weighted_mean(rows[..., :half]) - weighted_mean(rows[..., half : 2 * half]))
        high, low = rows.max(axis=-1), rows.min(axis=-1)
        amplitude, size = 0.5 * high - 0.5 * low, np.maximum(high, -low)
        digits = -np.log10(np.clip(apart / amplitude, 10.0**-MOST_DIGITS, 1.0))
    digits = np.where(amplitude <= QUIET * size, MOST_DIGITS, digits)
    return np.where(np.isfinite(size), digits, np.nan)


@dataclass(frozen=True)
class SpectralLine:
    """Line of a spectrum: ``frequency`` in cycles per row, and ``amplitude`` of the oscillation."""

    frequency: float
    amplitude: float


NO_LINE = SpectralLine(math.nan, math.nan)


def strongest_line(values: ArrayLike) -> SpectralLine:
    """Strongest line in the spectrum of a column ``values`` (m,) about its mean.

    nan for less than 16 rows, if a value is not finite, and for less than ``LEAST_CYCLES`` over all rows; the frequency
    0 for a constant column. Frequencies above half a cycle per row appear as lower ones.
    """
    rows = np.asarray(values, dtype=float)
    m = len(rows)
    if m < LEAST_ROWS or not np.isfinite(rows).all():
        return NO_LINE
    size = float(np.abs(rows).max())
    with np.errstate(over="ignore"):
        windowed = weights(m) * (rows - weighted_mean(rows))
        spectrum = np.abs(np.fft.rfft(windowed, 4 * m))
    # the window turns the mean into a line of some width, which is not quite gone
    peak = int(np.argmax(spectrum))
    if not 2.0 * spectrum[peak] > QUIET * size:
        return SpectralLine(0.0, 0.0)
    u = (np.arange(m) - (m - 1) / 2.0) / m
    f = _maximum(windowed, u, peak / 4.0)
    if not abs(f) >= LEAST_CYCLES:
        return NO_LINE
    return SpectralLine(abs(f) / m, 2.0 * abs(_fourier(windowed, u, f)[0]))


def _fourier(windowed: Array, u: Array, f: float) -> tuple[complex, complex, complex]:
    """Fourier integral at ``f``, in cycles over all rows, and its first two derivatives."""
    turning = windowed * np.exp(-2j * math.pi * f * u)
    turned = -2j * math.pi * u
    return complex(turning.sum()), complex((turned * turning).sum()), complex((turned**2 * turning).sum())


def _maximum(windowed: Array, u: Array, f: float) -> float:
    """Place of the maximum of the power of the Fourier integral next to ``f``, by Newton's method."""
    for _ in range(_NEWTON_STEPS):
        F, F1, F2 = _fourier(windowed, u, f)
        slope = (F.conjugate() * F1).real
        bend = abs(F1) ** 2 + (F.conjugate() * F2).real
        if not bend < 0.0:
            break
        step = -slope / bend
        f += max(-0.25, min(0.25, step))
        if abs(step) < NEWTON_TOLERANCE * max(1.0, abs(f)):
            break
    return f
