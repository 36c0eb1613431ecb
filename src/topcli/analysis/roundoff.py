"""Growth of round-off: drifts after 1, 2, 4, ... steps, the exponent of their growth, and its kind.

Independent rounding errors add up as the square root of the number of steps (Brouwer 1937), biased ones in proportion
to it. The deviation X of an invariant is averaged over blocks of steps, which takes out the rounding of its evaluation
and, because the weights (``frequencies.weights``) vanish with all their derivatives at both ends of a block, any quasi-
periodic oscillation much faster than a block. The root mean square of X(n + lag) - X(n), over all n and over copies of
the run whose states differ in the last two digits and hence in every rounding, is fitted by a power of the lag.

*random walk*  the power is compatible with 1/2: ``WALK`` is above the lower end of its confidence interval.
*biased*       the whole interval is above ``WALK``: errors of one sign add up.
*flat*         it is below ``FLAT``: nothing adds up, later steps undo the errors of earlier ones.
*moves*        the differences are far too large to be round-off: the invariant is not conserved.

The errors follow from the scatter of the copies (jackknife).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from topcli.contracts import Array

WALK = 0.6
FLAT = 0.3
MOVES = 1e3
"""Round-off is at most this many times the last bit of the invariant's terms and the root of the number of steps."""
MIN_BLOCKS = 16

_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class RoundOffGrowth:
    """Growth of one invariant's round-off; dimensionless, and None where there is no fit.

    ``rms[i]`` is the root mean square of the drift over ``steps[i]`` steps. ``bias`` is the mean drift per step. The
    errors are half the widths of confidence intervals of 95 %.
    """

    steps: list[int]
    rms: list[float]
    exponent: float | None
    exponent_error: float | None
    bias: float
    bias_error: float
    verdict: str


def growth(means: Array, block_steps: int, scale: float) -> RoundOffGrowth:
    """Growth estimated from block means of the deviation, (copies, blocks), of ``block_steps`` steps per block.

    ``scale`` is the size of the terms that make up the invariant. Raises ValueError for fewer than 16 blocks or two
    copies.
    """
    copies, blocks = means.shape
    if blocks < MIN_BLOCKS or copies < 2:
        raise ValueError(f"{blocks} blocks of {copies} copies: at least {MIN_BLOCKS} blocks of two copies are needed")
    # a mean over a block blurs what happens within one: lags 2, 4, 8, ...
    lags = 2 ** np.arange(1, int(math.log2(blocks / 2)) + 1)
    squares = np.stack([np.mean((means[:, lag:] - means[:, :-lag]) ** 2, axis=1) for lag in lags], axis=1)
    others = (squares.sum(axis=0) - squares) / (copies - 1)  # without one copy
    rms = np.sqrt(squares.mean(axis=0))
    quantile = float(stdtrit(copies - 1, 0.975))
    exponent = error = None
    if others.min() > 0.0:
        exponent = float(np.polyfit(np.log(lags), np.log(rms), 1)[0])
        scatter = 0.5 * np.polyfit(np.log(lags), np.log(others).T, 1)[0]
        error = quantile * math.sqrt(copies - 1) * float(scatter.std())
    drifts = (means[:, -1] - means[:, 0]) / (blocks - 1) / block_steps
    return RoundOffGrowth(
        steps=(lags * block_steps).tolist(),
        rms=rms.tolist(),
        exponent=exponent,
        exponent_error=error,
        bias=float(drifts.mean()),
        bias_error=quantile * float(drifts.std()) / math.sqrt(copies - 1),
        verdict=_verdict(exponent, error, float(rms.max()) / (_EPS * math.sqrt(blocks * block_steps) * (scale or 1.0))),
    )


def _verdict(exponent: float | None, error: float | None, size: float) -> str:
    if size > MOVES:
        return "moves"
    if exponent is None or error is None or exponent < FLAT:
        return "flat"
    return "biased" if exponent - error > WALK else "random walk"
