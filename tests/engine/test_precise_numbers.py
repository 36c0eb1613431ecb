"""Numbers other than doubles: constants mean what they say, and a stray double is refused."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from topcli.arithmetic.fused import fma
from topcli.arithmetic.tolerances import follow_precision
from topcli.contracts import Outcome, Stepper
from topcli.engine.precise.arithmetic import Exact, Floating, Rationals, arithmetic_of
from topcli.engine.precise.loop import Rebuilder, longest, precise_loop
from topcli.engine.precise.numbers import (
    NotRationalError,
    StrayDoubleError,
    decimal_text,
    exact_text,
    fraction_from,
    from_exact_text,
    integer_text,
    meaning,
)

LIMIT = 1e-12
ROUNDS = 7
ROOTED = 1e-6
follow_precision(__name__, caps=("ROUNDS",), LIMIT=1, ROOTED=0.5)


@pytest.mark.parametrize(
    ("constant", "value"),
    [
        (0.1, Fraction(1, 10)),
        (1.0 / 6.0, Fraction(1, 6)),
        (-0.8, Fraction(-4, 5)),
        (2.0**-52, Fraction(1, 2**52)),
        (1e-16, Fraction(1, 10**16)),
        (0.39216144400731415, Fraction("0.3921614440073142")),
        (0.0, Fraction(0)),
    ],
)
def test_constants_stand_for_what_was_meant(constant: float, value: Fraction) -> None:
    assert meaning(constant) == value


def test_short_binary_fractions_mix_and_other_doubles_are_refused() -> None:
    third = Exact(Fraction(1, 3))
    assert (0.5 * third + 2.0).q == Fraction(13, 6)
    with pytest.raises(StrayDoubleError, match=r"0\.1, computed somewhere, has no exact meaning"):
        _ = third * 0.1
    number = Floating(200).number(Fraction(1, 3))
    assert 0.5 * number == number / 2
    with pytest.raises(StrayDoubleError, match=r"0\.1, computed somewhere, has no exact meaning"):
        _ = 0.1 + number


def test_rational_numbers_work_in_arrays() -> None:
    states = np.array([[Exact(Fraction(1, 3)), Exact(Fraction(2, 3))]], dtype=np.object_)
    assert ((states**2).sum(axis=1) * Exact(Fraction(9)))[0] == 5
    assert (np.abs(-states) @ np.ones(2))[0] == 1
    assert np.abs(Exact(Fraction(-1, 2)) * states)[0, 1] == Exact(Fraction(1, 3))


def kernel(x: float, y: float = 0.1) -> float:
    """Constant, default, global, fma and a function of math in one place."""
    return fma(x, y, 1.0 / 6.0) + LIMIT * ROUNDS + math.sqrt(x) + ROOTED


def test_rebuilt_function_has_the_accuracy_of_its_arithmetic() -> None:
    arithmetic = Floating(206)
    found = arithmetic.fraction(Rebuilder(arithmetic).function(kernel)(arithmetic.number(Fraction(2))))
    root = Fraction(math.isqrt(2 * 10**140), 10**70)
    # tolerances shrink with the rounding error, by 2^-153, or its root; a number of iterations grows with the digits
    scaled = Fraction(1, 10**12) / 2**153 * 28 + Fraction(1, 10**6) / 2**76
    assert abs(found - (Fraction(2, 10) + Fraction(1, 6) + root + scaled)) < Fraction(1, 2**203)
    assert kernel(2.0) == pytest.approx(float(Fraction(11, 30)) + math.sqrt(2.0) + 1e-6, rel=1e-11)


def test_fma_is_rounded_once() -> None:
    arithmetic = Floating(53)
    a, b, c = 1.0 + 2.0**-30, 1.0 - 2.0**-30, -1.0
    numbers = [arithmetic.number(Fraction(x)) for x in (a, b, c)]
    assert float(arithmetic.fma(*numbers)) == -(2.0**-60)
    assert a * b + c == 0.0


def test_rational_roots_of_squares_only() -> None:
    numbers = Rationals()
    assert numbers.root(numbers.number(Fraction(9, 16))) == Exact(Fraction(3, 4))
    with pytest.raises(NotRationalError, match="square root of 2 is not rational"):
        numbers.root(numbers.number(Fraction(2)))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (Fraction(-1, 8), 3, "-1.25e-1"),
        (Fraction(2, 3), 5, "6.6667e-1"),
        (Fraction(99999, 10), 3, "1.00e+4"),
        (Fraction(10**25), 2, "1.0e+25"),
        (Fraction(1, 10**40), 1, "1.e-40"),
        (Fraction(0), 4, "0.000e+0"),
    ],
)
def test_decimal_texts_are_rounded_correctly(value: Fraction, digits: int, text: str) -> None:
    assert decimal_text(value, digits) == text
    assert abs(Fraction(text) - value) <= abs(value) * Fraction(1, 2 * 10 ** (digits - 1))


def test_exact_texts_read_back() -> None:
    value = Fraction(-(3**500), 7**400)
    assert from_exact_text(exact_text(value)) == value


def test_numbers_within_a_step_are_bounded() -> None:
    """A step that squares its number twelve times, as a composition does, ends when the number is too long."""
    longest_seen = [0]

    def step(s: Any, h: Any, p: Any) -> Any:
        x = s[0]
        for _ in range(12):
            x = x * x
            longest_seen[0] = max(longest_seen[0], longest((x,)))
        return (x / x,)

    arithmetic = arithmetic_of("rational")
    for digits, outcome in ((30, Outcome.DIGIT_LIMIT), (10_000, None)):
        longest_seen[0] = 0
        loop = precise_loop(Stepper(step, 1), 1, (), arithmetic, digits)
        work = np.array([arithmetic.number(Fraction(3))], dtype=object)
        taken = loop.drive(work, np.empty(1, dtype=object), None, None, 1, 1, 1)
        assert taken == (1 if outcome is None else -1)
        assert outcome is None or loop.failure(work) is outcome
        limit = int(digits * math.log2(10.0))
        assert longest_seen[0] <= 4 * limit
        assert longest_seen[0] > (limit if outcome else 6000)  # 3^4096 has 6493 binary digits


def test_texts_of_long_integers_are_exact() -> None:
    """Python itself refuses to convert more than 4300 digits."""
    text = "7" + "0123456789" * 600
    number = fraction_from(text)
    assert number.denominator == 1
    assert number.numerator % 10**10 == 123456789
    assert number.numerator // 10**5990 == 70123456789
    assert integer_text(number.numerator) == text
    assert fraction_from(f"1/{text}") == Fraction(1, number.numerator)
    assert fraction_from(f"0.{text}") * 10 ** len(text) == number
