"""Observed orders compared with declared ones: both sides of every threshold, on errors of a known law."""

from __future__ import annotations

import numpy as np
import pytest

from topcli.analysis.order import Convergence, OrderVerdict, convergence, is_consistent, judge_order
from topcli.contracts import Stepper
from topcli.tops.kowalevski import Kowalevski, field

SIZES = [0.04, 0.02, 0.01]
GENERIC = np.array([0.7, -0.4, 1.3, 0.6, 0.48, 0.64])


def power(order: float, first: float = 1e-3) -> Convergence:
    """Errors first (h/0.04)^order."""
    return convergence(SIZES, [first * (h / 0.04) ** order for h in SIZES])


@pytest.mark.parametrize(
    ("observed", "declared", "verdict"),
    [
        (1.91, 2, OrderVerdict.AS_DECLARED),
        (1.89, 2, OrderVerdict.TOO_LOW),
        (2.0, 2, OrderVerdict.AS_DECLARED),
        (2.0, 3, OrderVerdict.TOO_LOW),
        (3.0, 2, OrderVerdict.AS_DECLARED),
        (0.51, 1, OrderVerdict.TOO_LOW),
        (0.49, 1, OrderVerdict.UNDECIDED),
    ],
)
def test_shortfall_of_more_than_a_tenth_is_too_low(observed: float, declared: int, verdict: OrderVerdict) -> None:
    found, why = judge_order(declared, power(observed), 1.0)
    assert found is verdict
    assert (why == "") == (verdict is OrderVerdict.AS_DECLARED)
    if verdict is OrderVerdict.TOO_LOW:
        assert why == f"the observed order {observed:.2f} is below the declared order {declared}"


@pytest.mark.parametrize(("consistent", "verdict"), [(True, "undecided"), (False, "inconsistent")])
def test_errors_that_do_not_fall_are_blamed_on_the_step_only_if_it_is_inconsistent(
    consistent: bool, verdict: str
) -> None:
    assert judge_order(1, power(0.0), 1.0, lambda: consistent)[0] == verdict
    assert judge_order(1, power(1.0), 1.0, lambda: False)[0] == "as declared"


@pytest.mark.parametrize(("size", "verdict"), [(1.01, "too low"), (0.99, "undecided")])
def test_errors_must_be_small_beside_the_motion(size: float, verdict: str) -> None:
    """For a declared order of 2 the largest fitted error may be 5 % of the motion."""
    found, why = judge_order(2, power(1.0, first=0.05), size)
    assert found == verdict
    assert verdict == "too low" or why.endswith("the errors are large; use smaller steps")


@pytest.mark.parametrize(("last", "verdict"), [(1.01e-11, "too low"), (0.99e-11, "undecided")])
def test_errors_near_round_off_decide_nothing(last: float, verdict: str) -> None:
    found, why = judge_order(3, Convergence(2.0, (0.01, 0.02, 0.04), (last, 4 * last, 16 * last), None, None), 1.0)
    assert found == verdict
    assert verdict == "too low" or "close to round-off" in why


@pytest.mark.parametrize(("fine", "verdict"), [(2.22, "too low"), (2.32, "undecided")])
def test_slopes_of_the_fit_must_agree_within_a_quarter_of_the_shortfall(fine: float, verdict: str) -> None:
    """Slopes 2 and 2.22 are 0.89 short of 3, so that 0.22 is allowed; slopes 2 and 2.32 are 0.84 short: 0.21."""
    coarsest = 1e-3
    errors = [coarsest, coarsest / 4.0, coarsest / 4.0 / 2.0**fine]
    found, why = judge_order(3, convergence(SIZES, errors), 1.0)
    assert found == verdict
    assert verdict == "too low" or f"the slope changes from 2.00 to {fine:.2f}" in why


@pytest.mark.parametrize(("fine", "verdict"), [(1.81, "as declared"), (1.79, "undecided")])
def test_a_high_order_whose_slope_falls_is_not_confirmed(fine: float, verdict: str) -> None:
    errors = [1e-3, 1e-3 / 2.0**4, 1e-3 / 2.0 ** (4 + fine)]
    assert judge_order(2, convergence(SIZES, errors), 1.0)[0] == verdict


def test_two_sizes_decide_nothing() -> None:
    found, why = judge_order(2, convergence(SIZES[:2], [1e-3, 1e-4]), 1.0)
    assert (found, why) == ("undecided", "fewer than three step sizes have errors above round-off")


@pytest.mark.parametrize(("factor", "consistent"), [(1.0, True), (1.01, False), (0.99, False), (-1.0, False)])
def test_a_step_is_consistent_if_its_error_falls_faster_than_h(factor: float, consistent: bool) -> None:
    def euler(y, h, p):
        return tuple(a + factor * h * b for a, b in zip(y, field(y, p), strict=True))

    assert is_consistent(Kowalevski(), Stepper(euler, 6), GENERIC) is consistent


def test_a_step_that_fails_is_not_called_inconsistent() -> None:
    def fails(y, h, p):
        raise ZeroDivisionError

    assert is_consistent(Kowalevski(), Stepper(fails, 6), GENERIC)
    assert is_consistent(Kowalevski(), Stepper(lambda y, h, p: (float("nan"),) * 6, 6), GENERIC)
