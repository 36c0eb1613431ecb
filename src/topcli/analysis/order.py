"""Observed orders of convergence, their comparison with declared ones, and the order of the reversal defect."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Method, Sampler, Top
from topcli.engine.loops import Loop, interpreted, state_after

if TYPE_CHECKING:
    from topcli.engine.numbers import PreciseRun

PROBES = 16
"""States along a run from which its reversal is tried."""
FLOOR_ULPS = 64.0
FLOOR = FLOOR_ULPS * float(np.finfo(np.float64).eps)
PLATEAU = 1e-6
"""Errors above this one are not taken for round-off."""
ABOVE = 32.0
"""Errors within this factor of the plateau are not fitted."""
SUSPECT = 1e-11
"""Smaller errors may be close to a plateau not reached by any size; they are fitted only if others are too few."""
_FITTED = 3
"""Number of sizes that are fitted."""
SHORTFALL = 0.1
"""An observed order this far below the declared one refutes the declaration, if the fit is reliable."""
_SETTLED = 0.25
"""Largest difference of the two slopes within a reliable fit, relative to the shortfall."""
_CLOSE = 0.05
"""Largest estimate of the leading correction to the slope at the sizes of a reliable fit."""
NO_ORDER = 0.5
"""Errors of a smaller order may be as large as the motion: then no step is short enough to judge them."""


def observed_order(sizes: Sequence[float], errors: Sequence[float], floor: float) -> float | None:
    """Order of convergence estimated from errors at several step sizes.

    Fits log(error) against log(size) at the three smallest sizes whose errors exceed ``floor``; they lie deepest in the
    asymptotic range.

    Parameters
    ----------
    sizes : sequence of float
        Step sizes, in any order.
    errors : sequence of float
        Error at each step size.
    floor : float
        Errors up to this one are ignored, because round-off dominates them.

    Returns
    -------
    float or None
        Slope of the fit; None if fewer than three finite errors exceed ``floor``.

    Examples
    --------
    >>> round(observed_order([0.1, 0.05, 0.025], [1e-2, 2.5e-3, 6.25e-4], 1e-12), 6)
    2.0
    """
    return _fit(zip(sizes, errors, strict=True), floor)[0]


def _fit(
    points: Iterable[tuple[float, float]], floor: float
) -> tuple[float | None, tuple[float, ...], tuple[float, ...]]:
    """Slope at the smallest sizes whose errors exceed ``floor``, these sizes and errors; None if they are too few."""
    usable = sorted((s, e) for s, e in points if math.isfinite(e) and e > floor)[:_FITTED]
    if len(usable) < _FITTED:
        return None, (), ()
    sizes, errors = zip(*usable, strict=True)
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0]), sizes, errors


@dataclass(frozen=True)
class Convergence:
    """Errors over step sizes, described by a slope and a plateau.

    Attributes
    ----------
    order : float or None
        Slope of log(error) over log(h) at the smallest sizes above the plateau; None if there are fewer than three.
    fitted : tuple of float
        Sizes that were fitted, ascending; empty without an order.
    errors : tuple of float
        Errors at the fitted sizes.
    plateau : float or None
        Level of round-off: median error of the sizes up to ``onset``; None if the errors do not reach it.
    onset : float or None
        Largest size on the plateau.
    """

    order: float | None
    fitted: tuple[float, ...]
    errors: tuple[float, ...]
    plateau: float | None
    onset: float | None


def _plateau(points: Sequence[tuple[float, float]]) -> int | None:
    """Index of the first of ``points``, by decreasing size, that no smaller size improves on by a factor of two.

    None if it is not among the first but two, or if its error is too large to be round-off.
    """
    for i in range(len(points) - 2):
        error = points[i][1]
        if error < PLATEAU and min(e for _, e in points[i + 1 :]) > 0.5 * error:
            return i
    return None


def convergence(sizes: Sequence[float], errors: Sequence[float]) -> Convergence:
    """Observed order of convergence, and the plateau of round-off below which it is not looked for.

    The errors are on the plateau from the largest size on that no smaller one improves on by a factor of two, if there
    are at least two smaller ones. Only errors above ``ABOVE`` times its level are fitted, where round-off changes the
    slope by a few hundredths at most; without a plateau, those above ``SUSPECT`` if there are three.

    Parameters
    ----------
    sizes : sequence of float
        Step sizes, in any order.
    errors : sequence of float
        Error at each step size; those that are not finite and positive are ignored.

    Returns
    -------
    Convergence
        Slope, fitted sizes, level and onset of the plateau.

    Examples
    --------
    >>> errors = [1e-8, 2.5e-9, 6.25e-10, 2e-13, 3e-13, 1.5e-13]
    >>> observed = convergence([0.32, 0.16, 0.08, 0.04, 0.02, 0.01], errors)
    >>> round(observed.order, 6), observed.plateau, observed.onset
    (2.0, 2e-13, 0.04)
    """
    pairs = zip(sizes, errors, strict=True)
    points = sorted(((s, e) for s, e in pairs if math.isfinite(e) and e > 0.0), reverse=True)
    first = _plateau(points)
    level = None if first is None else float(np.median([e for _, e in points[first:]]))
    above = points[:first] if first is not None else points
    fit = _fit(above, SUSPECT if level is None else ABOVE * level)
    if fit[0] is None and level is None:
        fit = _fit(above, FLOOR)
    return Convergence(*fit, level, None if first is None else points[first][0])


class OrderVerdict(StrEnum):
    """Result of comparing an observed order with the declared one."""

    AS_DECLARED = "as declared"
    TOO_LOW = "too low"
    INCONSISTENT = "inconsistent"
    UNDECIDED = "undecided"


def judge_order(
    declared: int, observed: Convergence, size: float, consistent: Callable[[], bool] = lambda: True
) -> tuple[OrderVerdict, str]:
    """Compare an observed order with the declared one.

    The order is too low only if the fit leaves no other explanation: its errors are above round-off, they are so small
    that the next term of their expansion in h changes the slope by little, and its two slopes agree.

    Parameters
    ----------
    declared : int
        Declared order of convergence.
    observed : Convergence
        Observed order, from errors in the units of the state.
    size : float
        Size of the motion: the largest distance of its states from the first one.
    consistent : callable, optional
        ``consistent()`` is false if single steps are inconsistent (``is_consistent``); called only for errors that do
        not fall with h.

    Returns
    -------
    tuple of OrderVerdict and str
        Verdict and its reason, which is empty for ``AS_DECLARED``.

    Examples
    --------
    >>> sizes = [0.04, 0.02, 0.01]
    >>> judge_order(3, convergence(sizes, [1.6e-3, 4e-4, 1e-4]), 1.0)
    (<OrderVerdict.TOO_LOW: 'too low'>, 'the observed order 2.00 is below the declared order 3')
    """
    if observed.order is None:
        return OrderVerdict.UNDECIDED, "fewer than three step sizes have errors above round-off"
    h, e = np.log(observed.fitted), np.log(observed.errors)
    fine, coarse = np.diff(e) / np.diff(h)
    high = observed.order >= declared - SHORTFALL
    if high and min(fine, coarse) >= declared - 2.0 * SHORTFALL:
        return OrderVerdict.AS_DECLARED, ""
    changes = f"the slope changes from {coarse:.2f} to {fine:.2f}; use other step sizes"
    if high:
        return OrderVerdict.UNDECIDED, changes
    below = f"the observed order {observed.order:.2f} is below the declared order {declared}"
    if observed.order < NO_ORDER and not consistent():
        return OrderVerdict.INCONSISTENT, f"{below}: its step is not consistent with the equations of motion"
    # an error (h/h0)^p of a self-adjoint scheme has a correction of relative size (h/h0)^2
    if observed.order < NO_ORDER or observed.errors[-1] > size * _CLOSE ** (0.5 * declared):
        return OrderVerdict.UNDECIDED, f"{below}, but the errors are large; use smaller step sizes"
    if observed.plateau is None and observed.errors[0] <= SUSPECT * size:
        return OrderVerdict.UNDECIDED, f"{below}, but the errors are close to round-off; use larger step sizes"
    if abs(fine - coarse) > _SETTLED * (declared - observed.order):
        return OrderVerdict.UNDECIDED, f"{below}, but {changes}"
    return OrderVerdict.TOO_LOW, below


def is_consistent(top: Top, method: Method, y0: Array) -> bool:
    """True if the error of a single step from ``y0`` (d,) falls faster than h, as that of every consistent scheme.

    A step that fails, or whose error is round-off, does not refute it.
    """
    long = 2.0**-7 / (float(np.abs(y0).max()) or 1.0)
    sizes = np.array([0.25 * long, long])
    p = np.array(top.constants())
    loop = interpreted(method, len(y0), len(p))
    errors = []
    for h, expected in zip(sizes, reference_states(top, tuple(y0.tolist()), sizes), strict=True):
        end = state_after(loop, y0, p, float(h))
        if end is None:
            return True
        errors.append(float(np.abs(end - expected).max()))
    short, whole = errors
    return not (math.isfinite(whole) and short > 1e-12 * np.abs(y0).max() and short / sizes[0] > 0.5 * whole / sizes[1])


def one_step_back_and_forth(top: Top, method: Method, y: Sequence[float], h: float) -> float:
    """Largest component of the difference after one step with h and one with -h from ``y``, in plain Python.

    Infinite if one of the steps fails.
    """
    p = np.array(top.constants())
    return _back_and_forth(interpreted(method, len(y), len(p)), p, np.array(y, dtype=np.float64), h)


def _back_and_forth(loop: Loop, p: Array, start: NDArray[Any], h: Any) -> float:
    """Largest component of the difference after one step with h and one with -h; infinite if one of them fails."""
    there = state_after(loop, start, p, h)
    back = None if there is None else state_after(loop, there, p, -h)
    return math.inf if back is None else float(np.abs(back - start).max())


def probe_rows(rows: int) -> slice:
    """Rows, at most ``PROBES`` of ``rows``, from which the reversal of a run is tried."""
    stride = max(1, rows // PROBES)
    return slice(0, min(rows, PROBES * stride), stride)


def reversal(
    top: Top, method: Method, states: Array, h: float, precise: PreciseRun | None = None
) -> tuple[float, float | None]:
    """Reversal defect at ``h``, the largest over ``states`` (m, d), and its order in h.

    The order is fitted on the ladder h, 2h, 4h ... up to 0.4: at the h of an experiment the defect may be
    below round-off. A closed form, which may be set up for each state, is tried at two of the states. For a
    ``precise`` run of the method, all steps are taken in its arithmetic. The order is None if the defect is round-off
    at every step size tried, or zero in rational numbers: the scheme is self-adjoint there.
    """
    if isinstance(method, Sampler):
        states = states[:: max(1, len(states) // 2)][:2]
    factors = [1.0]
    while 2.0 * factors[-1] * abs(h) <= 0.4:
        factors.append(2.0 * factors[-1])
    while len(factors) < 4:
        factors.insert(0, 0.5 * factors[0])

    def defect(y: Array, factor: float) -> float:
        if precise is None:
            return one_step_back_and_forth(top, method, y.tolist(), factor * abs(h))
        number = precise.arithmetic.number
        start = np.array([number(Fraction(x)) for x in y.tolist()], dtype=np.object_)
        return _back_and_forth(precise.loop, np.empty(0), start, abs(precise.h) * number(Fraction(factor)))

    sizes = [factor * abs(h) for factor in factors]
    defects = [max(defect(y, factor) for y in states) for factor in factors]
    eps = precise.arithmetic.eps if precise else float(np.finfo(np.float64).eps)
    floor = FLOOR_ULPS * eps * max(1.0, float(np.abs(states).max()))
    return defects[factors.index(1.0)], observed_order(sizes, defects, floor)
