"""Growth of round-off: drifts after 1, 2, 4, ... steps, the exponent of their growth, and its kind.

Independent rounding errors add up as the square root of the number of steps (Brouwer 1937), biased ones in proportion
to it. The deviation X of an invariant is averaged over blocks of steps, which takes out the rounding of its evaluation
and, because the weights vanish with all their derivatives at both ends of a block, any quasi-periodic oscillation much
faster than a block. The root mean square of X(n + lag) - X(n), over all n and over copies of the run whose states
differ in the last two digits and hence in every rounding, is fitted by a power of the lag.

*random walk*  the power is compatible with 1/2: below ``WALK`` within two standard errors.
*biased*       it is above that: errors of one sign add up.
*flat*         it is below ``FLAT``: nothing adds up, later steps undo the errors of earlier ones.
*moves*        the differences are far too large to be round-off: the invariant is not conserved.

The standard error is found by repeating the fit on simulated series of the same length, the sum of a trend, a random
walk and noise of the sizes found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant

WALK = 0.6
FLAT = 0.3
MOVES = 1e3
"""Round-off is at most this many times the last bit of the invariant's terms and the root of the number of steps."""
MIN_BLOCKS = 16
SIMULATIONS = 100

_EPS = float(np.finfo(np.float64).eps)


def block_weights(rows: int) -> Array:
    """Weights (rows,) of a mean over a block: they add up to one and vanish smoothly at both ends."""
    x = (np.arange(rows) + 0.5) / rows
    weights = np.exp(-1.0 / (x * (1.0 - x)))
    return weights / weights.sum()


class BlockMeans:
    """Mean deviations of invariants over blocks of ``rows`` recorded rows each, fed with chunks.

    Deviations are from the values at the first state, which belongs to no block.
    """

    def __init__(self, invariants: Sequence[Invariant], blocks: int, rows: int) -> None:
        self._invariants, self._rows = invariants, rows
        self._weights = block_weights(rows)
        self._first: list[float] = []
        self._next = 0
        self.means = np.zeros((len(invariants), blocks))
        self.largest = np.zeros(len(invariants))
        """Largest magnitude of the deviation of any row."""
        self.scale = np.zeros(len(invariants))
        """Largest sum of the magnitudes of an invariant's terms."""

    def add(self, states: Array) -> None:
        """Add the next rows, states (m, d); the very first row is the reference."""
        if not self._first:
            self._first = [float(invariant.value(states[:1])[0]) for invariant in self._invariants]
            states = states[1:]
        index = np.arange(self._next, self._next + len(states))
        self._next += len(states)
        block, weights = index // self._rows, self._weights[index % self._rows]
        for i, (invariant, first) in enumerate(zip(self._invariants, self._first, strict=True)):
            deviation = invariant.value(states) - first
            self.means[i] += np.bincount(block, weights=weights * deviation, minlength=self.means.shape[1])
            self.largest[i] = np.abs(deviation).max(initial=self.largest[i])
            self.scale[i] = invariant.scale(states).max(initial=self.scale[i])


@dataclass(frozen=True)
class Growth:
    """Growth of one invariant's round-off; dimensionless, and None where there is no fit.

    ``rms[i]`` is the root mean square of the drift over ``steps[i]`` steps. ``bias`` is the mean drift per step.
    """

    steps: tuple[int, ...]
    rms: tuple[float, ...]
    exponent: float | None
    exponent_error: float | None
    bias: float
    bias_error: float
    verdict: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return asdict(self) | {"steps": list(self.steps), "rms": list(self.rms)}


def doubling_lags(blocks: int) -> NDArray[np.int64]:
    """2, 4, 8, ... up to half the number of blocks; a mean over a block blurs what happens within one."""
    return 2 ** np.arange(1, int(math.log2(blocks / 2)) + 1)


def structure(series: Array, lags: NDArray[np.int64]) -> Array:
    """Root mean squares (lags,) of the differences over ``lags`` along the last axis of ``series`` (..., blocks).

    Means are taken over the last two axes, so that a stack of experiments (k, copies, blocks) gives (k, lags).
    """
    return np.stack(
        [np.sqrt(np.mean((series[..., lag:] - series[..., :-lag]) ** 2, axis=(-2, -1))) for lag in lags], axis=-1
    )


def _slopes(rms: Array, lags: NDArray[np.int64]) -> Array:
    """Exponents of the powers of ``lags`` that fit ``rms`` (..., lags)."""
    x = np.log(lags) - np.log(lags).mean()
    return np.log(rms) @ x / (x @ x)


def _simulated(lags: NDArray[np.int64], shape: tuple[int, int], bias: float, walk: float, noise: float) -> Array:
    """Exponents found on simulated experiments of ``shape`` (copies, blocks)."""
    random = np.random.default_rng(1)
    steps = random.normal(bias, walk, (SIMULATIONS, *shape))
    return _slopes(structure(np.cumsum(steps, axis=-1) + random.normal(0.0, noise, steps.shape), lags), lags)


def growth(means: Array, block_steps: int, scale: float) -> Growth:
    """Growth estimated from block means of the deviation, (copies, blocks), of ``block_steps`` steps per block.

    ``scale`` is the size of the terms that make up the invariant. Raises ValueError for fewer than 16 blocks.
    """
    copies, blocks = means.shape
    if blocks < MIN_BLOCKS:
        raise ValueError(f"{blocks} blocks are too few for a fit; at least {MIN_BLOCKS}")
    lags = doubling_lags(blocks)
    rms = structure(means, lags)
    ends = (means[:, -1] - means[:, 0]) / (blocks - 1)
    bias = float(ends.mean())
    # mean squares without the bias: the walk's part is proportional to the lag, the noise's part is constant
    squares = np.maximum(rms**2 - (bias * lags) ** 2, 0.0) / max(float(rms.max()) ** 2, 1e-300)
    size = float(rms.max())
    walk_sq, noise_sq = np.polyfit(lags, squares, 1)
    walk, noise = size * math.sqrt(max(walk_sq, 0.0)), size * math.sqrt(max(0.5 * noise_sq, 0.0))
    error = math.sqrt(walk**2 / (blocks - 1) + 2.0 * (noise / (blocks - 1)) ** 2) / math.sqrt(copies)
    exponent = spread = None
    if rms.min() > 0.0:
        exponent = float(_slopes(rms, lags))
        spread = float(_simulated(lags, means.shape, bias, walk, noise).std()) if walk + noise > 0.0 else 0.0
    return Growth(
        steps=tuple(int(lag) * block_steps for lag in lags),
        rms=tuple(map(float, rms)),
        exponent=exponent,
        exponent_error=spread,
        bias=bias / block_steps,
        bias_error=error / block_steps,
        verdict=_verdict(exponent, spread, size / (_EPS * math.sqrt(blocks * block_steps) * (scale or 1.0))),
    )


def _verdict(exponent: float | None, error: float | None, size: float) -> str:
    if size > MOVES:
        return "moves"
    if exponent is None or error is None or exponent < FLAT:
        return "flat"
    return "biased" if exponent - 2.0 * error > WALK else "random walk"
