"""Runs in other precisions: numbers, rebuilt steps, declared invariants and equations, at 50 digits and rational."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from cases import table_of
from declared import SCHEMES
from topcli.arithmetic.fused import fma, follow_precision
from topcli.contracts import Outcome, Scheme, Stepper
from topcli.engine.precise import PreciseRun, Rebuilder, longest, obstacle, precise_loop, prepared
from topcli.engine.precise_numbers import (
    FUNCTIONS,
    RATIONAL,
    Floating,
    NotRationalError,
    Rational,
    Rationals,
    StrayDoubleError,
    arithmetic_of,
    decimal_text,
    fraction_from,
    integer_text,
    meaning,
)
from topcli.engine.run import Recorded, Run
from topcli.errors import UsageError
from topcli.runs.report import ORDINARY
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

LIMIT = 1e-12
ROUNDS = 7
ROOTED = 1e-6
follow_precision(__name__, caps=("ROUNDS",), LIMIT=1, ROOTED=0.5)


@pytest.mark.parametrize(
    ("constant", "value"),
    table_of("""
0.1                    1/10
0.16666666666666666    1/6
-0.8                   -4/5
2.220446049250313e-16  1/4503599627370496
1e-16                  1/10000000000000000
0.39216144400731415    0.3921614440073142
0.0                    0
"""),
)
def test_constants_stand_for_what_was_meant(constant: float, value: str) -> None:
    assert meaning(constant) == Fraction(str(value))


def test_short_binary_fractions_mix_and_other_doubles_are_refused() -> None:
    third = Rational(Fraction(1, 3))
    assert (0.5 * third + 2.0).q == Fraction(13, 6)
    with pytest.raises(StrayDoubleError, match=r"0\.1, computed somewhere, has no exact meaning"):
        _ = third * 0.1
    number = Floating(200).number(Fraction(1, 3))
    assert 0.5 * number == number / 2
    with pytest.raises(StrayDoubleError, match=r"0\.1, computed somewhere, has no exact meaning"):
        _ = 0.1 + number


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


VALUES = (0.0, 0.5, -0.5, 1.0, -1.0, 2.0, -8.0, 700.0, -700.0, 1e10, -1e10, math.inf, -math.inf)


@pytest.mark.parametrize("name", sorted({*FUNCTIONS, "sqrt"}))
def test_functions_are_those_of_doubles(name: str, library: str) -> None:
    """At 60 bits, and nan where a double is nan: never a complex number, never an exception."""
    arithmetic = arithmetic_of(17)
    functions = arithmetic.math.__dict__
    known = {"acos": np.arccos, "asin": np.arcsin, "atan": np.arctan, "atan2": np.arctan2}
    expected = known.get(name) or getattr(np, name)
    with arithmetic.active(), np.errstate(all="ignore"):
        for arguments in itertools.product(VALUES, repeat=expected.nin):
            numbers = [
                math.copysign(1, x) * functions["inf"] if math.isinf(x) else arithmetic.number(Fraction(x))
                for x in arguments
            ]
            value, other = float(functions[name](*numbers)), float(expected(*arguments))
            assert value == pytest.approx(other, rel=4e-16, nan_ok=True), arguments


def test_a_precision_lasts_until_its_context_is_left(library: str) -> None:
    """A loop enters the context again, within that of a study."""
    arithmetic = arithmetic_of(50)
    third = Fraction(1, 3)
    for _ in range(3):
        with arithmetic.active():
            with arithmetic.active():
                pass
            found = arithmetic.number(Fraction(1)) / 3
            assert abs(arithmetic.fraction(found) - third) < Fraction(1, 10**50)
    assert found - found == 0


def test_complex_numbers_are_not_finite(library: str) -> None:
    arithmetic = arithmetic_of(50)
    with arithmetic.active():
        assert not arithmetic.finite(arithmetic.number(Fraction(-1)) ** 0.5)
        assert arithmetic.finite(arithmetic.number(Fraction(1)) ** 0.5)


def test_fma_is_rounded_once() -> None:
    arithmetic = Floating(53)
    a, b, c = 1.0 + 2.0**-30, 1.0 - 2.0**-30, -1.0
    numbers = [arithmetic.number(Fraction(x)) for x in (a, b, c)]
    assert float(arithmetic.fma(*numbers)) == -(2.0**-60)
    assert a * b + c == 0.0


def test_rational_roots_of_squares_only() -> None:
    numbers = Rationals()
    assert numbers.root(numbers.number(Fraction(9, 16))) == Rational(Fraction(3, 4))
    with pytest.raises(NotRationalError, match="square root of 2 is not rational"):
        numbers.root(numbers.number(Fraction(2)))


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    table_of("""
-1/8     3  '-1.25e-1'
2/3      5  '6.6667e-1'
99999/10  3  '1.00e+4'
1e25     2  '1.0e+25'
1e-40    1  '1.e-40'
0        4  '0.000e+0'
"""),
)
def test_decimal_texts_are_rounded_correctly(value: str, digits: int, text: str) -> None:
    value = Fraction(str(value))
    assert decimal_text(value, digits) == text
    assert abs(Fraction(text) - value) <= abs(value) * Fraction(1, 2 * 10 ** (digits - 1))


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


H = Fraction(1, 20)
STATE = tuple(map(Fraction, ("3/2", "2/5", "-7/10", "2/7", "3/7", "6/7")))
"""A state in general position; gamma is a rational unit vector."""
BELOW = 1e-45
CAN = [scheme for scheme in SCHEMES if not obstacle(scheme, TOPS[scheme.top].new(), scheme.options())]
CANNOT = [scheme for scheme in SCHEMES if scheme not in CAN]
EXACT = [scheme for scheme in CAN if scheme.conserves or scheme.modified]


def name_of(scheme: Scheme) -> str:
    return f"{scheme.top}-{scheme.name}"


def ready(scheme: Scheme, precision: int | str, max_digits: int = 10_000) -> PreciseRun:
    top = TOPS[scheme.top].new()
    parameters = {name: Fraction(str(value)) for name, value in top.model_dump().items() if isinstance(value, float)}
    numbers = (H, parameters, STATE[: len(top.components)])
    return prepared(scheme, top, scheme.options(), precision, numbers, max_digits)


def carried_out(made: PreciseRun, steps: int) -> Recorded:
    found = Run(made.top, made.loop, made.y0, made.h, steps).collect()
    assert found.ending.outcome is Outcome.COMPLETED
    return found


def in_doubles(scheme: Scheme, steps: int) -> Recorded:
    top = TOPS[scheme.top].new()
    y0 = [float(x) for x in STATE[: len(top.components)]]
    return Run(top, scheme.build(top, scheme.options()), y0, float(H), steps).collect()


def declared_deviations(scheme: Scheme, made: PreciseRun, states: Any) -> dict[str, Any]:
    with made.arithmetic.active():
        modified = scheme.modified(made.top, made.h, scheme.options()) if scheme.modified else ()
        watched = [one for one in made.top.invariants() if one.name in scheme.conserves] + list(modified)
        values = {one.name: one.value(states) for one in watched}
        return {name: max(abs(x - found[0]) for x in found) for name, found in values.items()}


def assert_exact_at_50_digits(scheme: Scheme, steps: int) -> None:
    made = ready(scheme, 50)
    found = carried_out(made, steps)
    deviations = {name: float(x) for name, x in declared_deviations(scheme, made, found.states).items()}
    assert set(deviations) >= set(scheme.conserves)
    assert max(deviations.values()) < BELOW, deviations
    doubles = in_doubles(scheme, steps)
    # the same algorithm: what it counts besides its iterations does not depend on the precision
    events = {name: count for name, count in doubles.ending.counters.items() if name not in ORDINARY}
    assert {name: found.ending.counters[name] for name in events} == events


@pytest.mark.slow
@pytest.mark.parametrize("scheme", EXACT, ids=name_of)
def test_declared_invariants_are_exact_at_50_digits(scheme: Scheme) -> None:
    assert_exact_at_50_digits(scheme, 25)


@pytest.mark.parametrize(("top", "name"), [("euler+gamma", "hk"), ("kowalevski", "hybrid")])
def test_declared_invariants_are_exact_over_a_few_steps(top: str, name: str, library: str) -> None:
    assert_exact_at_50_digits(find_scheme(name, top), 8)


def assert_bits_of_doubles(scheme: Scheme, steps: int) -> None:
    top = TOPS[scheme.top].new()
    method = scheme.build(top, scheme.options())
    assert isinstance(method, Stepper)
    arithmetic = Floating(53)
    step = Rebuilder(arithmetic).function(method.step)
    y0, h, p = tuple(map(float, STATE[: len(top.components)])), float(H), method.parameters(top)
    s = method.enter(y0, h, p) if method.enter else y0
    precise = tuple(arithmetic.number(Fraction(x)) for x in s)
    constants = tuple(arithmetic.number(Fraction(x)) for x in p)
    for n in range(steps):
        s = method.step(s, h, p)
        precise = step(precise, arithmetic.number(Fraction(h)), constants)
        assert [float(x) for x in precise] == list(s), n


@pytest.mark.slow
@pytest.mark.parametrize("scheme", CAN, ids=name_of)
def test_rebuilt_steps_have_the_bits_of_doubles_at_53_bits(scheme: Scheme) -> None:
    assert_bits_of_doubles(scheme, 20)


@pytest.mark.slow
def test_compositions_conserve_at_50_digits() -> None:
    scheme = find_scheme("midpoint+kahan-li6", "lagrange")
    made = ready(scheme, 50)
    found = carried_out(made, 20)
    assert max(map(float, declared_deviations(scheme, made, found.states).values())) < BELOW
    # the stages add up to the step: the state agrees with doubles, which a wrong weight would not allow
    assert found.states[-1].astype(float) == pytest.approx(in_doubles(scheme, 20).states[-1], abs=1e-13)


@pytest.mark.parametrize(
    ("top", "name"),
    table_of("""
euler              hk
lagrange/inertial  bs
euler+gamma        hk
lagrange           hk
"""),
)
def test_rational_orbits_keep_declared_invariants_equal(top: str, name: str, library: str) -> None:
    scheme = find_scheme(name, top)
    made = ready(scheme, RATIONAL)
    found = carried_out(made, 8)
    assert set(declared_deviations(scheme, made, found.states).values()) == {0}
    first = made.top.invariants()[0 if name == "hk" else 3]  # the control: conserved only in its modified form
    assert first.name not in scheme.conserves
    values = first.value(found.states)
    assert max(abs(float(x - values[0])) for x in values) > 1e-4


@pytest.mark.parametrize("scheme", CANNOT, ids=name_of)
def test_schemes_without_steps_of_arithmetic_say_so(scheme: Scheme) -> None:
    assert scheme.name in ("dop853", "exact", "hk-exact", "taylor")
    with pytest.raises(UsageError, match=f"scheme '{scheme.name}' cannot compute with 50 digits: it "):
        ready(scheme, 50)


@pytest.mark.parametrize(
    ("top", "name", "reason"),
    [("kowalevski", "hybrid", r"uses math\.sin"), ("heavy", "midpoint", "solves its equations by iteration")],
)
def test_schemes_that_are_not_rational_say_so(top: str, name: str, reason: str) -> None:
    with pytest.raises(UsageError, match=f"scheme '{name}' cannot compute with rational: it {reason}"):
        ready(find_scheme(name, top), RATIONAL)


def test_rational_run_stops_at_the_number_of_digits() -> None:
    made = ready(find_scheme("hk", "heavy"), RATIONAL, max_digits=300)
    found = Run(made.top, made.loop, made.y0, made.h, 50).collect()
    assert found.ending.outcome is Outcome.DIGIT_LIMIT
    assert found.ending.step == len(found.n)
    longest = max(len(str(x.q.numerator)) for x in found.states[-1])
    assert 30 < longest <= 300
