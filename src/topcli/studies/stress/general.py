"""Cases that every top has: long, singular, negative and single steps, the ends of the range, long runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

from topcli.contracts import Floats, Top, checked_equations
from topcli.schemes.heavy.hk import heavy_determinant
from topcli.studies.stress.case import Case, config
from topcli.studies.stress.checks import Check, does_not_drift, keeps_order, returns, stays_bounded

LARGEST_STEP = 60.0


@cache
def singular_step(top: Top, state: Floats) -> float:
    """Return the least h > 0 at which the determinant of HK's linear system changes sign at ``state``, by bisection.

    Raises ValueError if there is none up to ``LARGEST_STEP``.
    """
    equations = checked_equations(top, "the stress case singular-step")
    p = (*equations.moments, *equations.gravity)
    y = (*(equations.omega_sign * w for w in state[:3]), *(state[3:] or (0.0, 0.0, 0.0)))

    def determinant(h: float) -> float:
        return heavy_determinant(y, h, p)[0]

    low, step = 0.0, 0.01
    while low < LARGEST_STEP:
        if determinant(low + step) <= 0.0:
            high = low + step
            while low < 0.5 * (low + high) < high:
                middle = 0.5 * (low + high)
                low, high = (middle, high) if determinant(middle) > 0.0 else (low, middle)
            return low
        low += step
    raise ValueError(f"{top!r}: the determinant does not vanish at {state} up to h = {LARGEST_STEP:g}")


def _scaled(state: Floats, factor: float) -> Floats:
    return tuple(value * factor if i < 3 else value for i, value in enumerate(state))


def general_cases(
    top: Top, generic: Floats, regular: Floats, fast: Floats, resonant: float, singular: bool = True
) -> tuple[Case, ...]:
    """Return the cases for the schemes of ``top``'s form.

    ``generic``, ``regular`` and ``fast`` are states: ``regular`` of a motion that is not chaotic, ``fast`` of a fast
    rotation with a period of about ``resonant``. ``singular`` is False if HK's determinant cannot vanish.
    """

    def case(name: str, question: str, state: Floats, h: float | None, N: int, check: Check) -> Case:
        def made() -> Mapping[str, Any]:
            step = singular_step(top, state) if h is None else h  # pyright: ignore[reportArgumentType] (hashable)
            return config(top, state, step, N)

        return Case(name, top.form, question, made, check)

    cases = [
        case("backwards", "h < 0: is the order what it is for h > 0?", generic, -0.02, 200, keeps_order),
        case("one-step", "N = 1: does a single step have the error of its order?", generic, 0.1, 1, keeps_order),
        case(
            "resonance",
            f"h = {resonant:g}, about a turn a step: does it stay bounded, and does the iteration converge?",
            *(fast, resonant, 2000, stays_bounded),
        ),
        case(
            "huge",
            "omega of size 1e150, h of size 1e-152: is the order kept?",
            *(_scaled(generic, 1e150), 2e-152, 200, keeps_order),
        ),
        case(
            "denormal",
            "omega of size 1e-310: is the order kept?",
            *(_scaled(generic, 1e-310), 0.02, 200, keeps_order),
        ),
        case(
            "there-and-back",
            "1e5 steps forward and 1e5 back: is only round-off's growth left?",
            *(regular, 0.02, 100_000, returns),
        ),
        case(
            "drift",
            "t = 1e5: do the claimed invariants have a slope beyond its uncertainty?",
            *(regular, 0.1, 1_000_000, does_not_drift),
        ),
        case(
            "singular-step",
            "h at which HK's determinant vanishes in the first step: does omega stay of the motion's size?",
            *(generic, None, 50, stays_bounded),
        ),
    ]
    return tuple(cases if singular else cases[:-1])


def swing_time(eps: float) -> float:
    """Time of the first swing of the Kowalevski top from gamma3 = eps near the relative equilibrium at omega1 = 2.

    sqrt 2 ln(8 sqrt 7/eps), to leading order in eps, for A = B = 2, C = 1, c0 = 1.
    """
    return math.sqrt(2.0) * math.log(8.0 * math.sqrt(7.0) / eps)
