"""Verdicts on an invariant along one trajectory.

*exact*     no deviation beyond the round-off bound ``ROUND_OFF_ULPS * eps * sqrt(steps) * scale``, where scale is
            the largest sum of magnitudes of the terms that make up the invariant (Brouwer's law: independent
            rounding errors add up as sqrt(steps)).
*lost*      the deviation is of the order of the invariant itself: more than ``LOST`` times the first value, or times
            ``TERMS`` of the scale where the first value is a smaller difference of large terms.
*undecided* deviations beyond round-off, but the recorded rows are too few for a slope, or the run covers fewer than
            ``OSCILLATIONS`` oscillations of the motion (of its slowest component): what looks like a drift may be a
            part of an oscillation, and a drift may not have begun. Or the slope of the deviation in time
            (``analysis.trend``) is between ``DOUBTFUL`` and ``SIGNIFICANCE`` standard errors, or makes up less than
            ``PART`` of the range of the deviation.
*drifting*  the slope is more than ``SIGNIFICANCE`` standard errors, and makes up more of the range.
*no drift seen*  the slope is not larger than ``DOUBTFUL`` standard errors, changes at the ends left out of these. With
            95 % confidence, the mean rate of change over the run is at most the slope and two standard errors. This
            does not cover a change in the first or last tenth of the run that is smaller than the range of the
            oscillation.

*unjudged*  numbers that are not finite, or no step at all; or an invariant of motions on a level (``Invariant.on``)
            where this one does not begin.

How often these verdicts are wrong is measured by ``benchmarks/verdicts.py``.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from topcli.analysis.trend import Trend
from topcli.table import plus_minus, rounded_up, two_digits

ROUND_OFF_ULPS = 20.0
SIGNIFICANCE = 4.0
DOUBTFUL = 2.5
OSCILLATIONS = 2.0
PART = 1.0 / 3.0
LOST = 0.25
TERMS = 0.1
NEEDS_EVEN_TIMES = "a drift needs rows at even times"
"""Reason why deviations at uneven times have no slope."""
ULP = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class InvariantRow:
    """Report on one invariant: dimensionless deviations from the first value.

    Figures whose name ends in ``relative`` are None if the first value is 0, and ``drift`` figures if there are too few
    rows.
    """

    name: str
    symbol: str
    first: float
    min: float
    max: float
    max_deviation: float
    max_deviation_relative: float | None
    rms_deviation: float
    rms_deviation_relative: float | None
    drift: float | None
    """Linear drift per unit time."""
    drift_error: float | None
    """One standard error of ``drift``."""
    drift_bound: float | None
    """Bound of the magnitude of the mean rate of change over the run, with 95 % confidence."""
    drift_over_run: float | None
    """``drift`` times the length of the run."""
    model: str | None
    """Model of the deviation beside the drift, which determines its error: "linear trend" or "random walk"."""
    round_off_bound: float
    verdict: str
    statement: str
    """The verdict with its figures, as it can be quoted."""
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return asdict(self)


def round_off_bound(steps: Any, scale: Any, eps: float = ULP) -> Any:
    """Largest deviation that rounding explains after ``steps`` steps; numbers or arrays."""
    return ROUND_OFF_ULPS * eps * np.sqrt(np.maximum(steps, 1)) * scale


def judged(
    deviation: float, spread: float, bound: float, size: float, fit: Trend | None, short: str, span: float
) -> tuple[str, str, str]:
    """Verdict on a deviation from an invariant of this ``size``, its statement with figures, and its reason.

    ``deviation`` is the largest, and ``spread`` the difference between the largest and the smallest value.
    """
    if not (math.isfinite(deviation) and math.isfinite(bound)):
        reason = "the invariant or its terms are not finite"
        return "unjudged", f"unjudged: {reason}", reason
    if deviation > LOST * size:
        statement = f"lost (deviation {deviation:.1e})"
        reason = f"max deviation {deviation:.1e} exceeds {LOST:g} times the invariant's size {size:.1e}"
        return "lost", statement, reason
    if deviation <= bound:
        if span == 0.0:
            return "unjudged", "unjudged: no recorded step", "the run has no recorded step"
        reason = f"max deviation {deviation:.1e} is within the round-off bound {bound:.1e}"
        return "exact", f"exact (deviation {deviation:.1e} is round-off)", reason
    beyond = f"max deviation {deviation:.1e} exceeds the round-off bound {bound:.1e}"
    if fit is None:
        why = NEEDS_EVEN_TIMES if short == NEEDS_EVEN_TIMES else "too few rows for a slope"
        return "undecided", f"undecided: {why}", f"{beyond}; {why}"
    if short:
        return "undecided", f"undecided: {short}", f"{beyond}; the run {short}"
    # a slope counts if it is significant, and if it explains more than a part of what is seen over the run
    ratio = abs(fit.slope) / fit.error if fit.error else math.inf
    reason = f"{beyond}; slope {fit.slope:.1e} ± {fit.error:.1e} ({ratio:.1f} standard errors, {fit.model})"
    if ratio > SIGNIFICANCE and abs(fit.slope * span) > PART * spread:
        return "drifting", f"drifting ({plus_minus(fit.slope, fit.margin)} per unit time, 95 %)", reason
    if abs(fit.slope) > DOUBTFUL * fit.scatter:
        why = (
            "a slope that may belong to a slow oscillation"
            if fit.ends <= fit.scatter
            else "changes at an end of the run"
        )
        doubt = f"{why}; run T >= {rounded_up(2.0 * abs(span)):g}"
        return "undecided", f"undecided: {doubt}", f"{reason}, {doubt}"
    return "no drift seen", f"no drift seen (below {two_digits(rounded_up(fit.bound))} per unit time, 95 %)", reason
