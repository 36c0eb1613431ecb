"""Steps in other numbers: constants, functions, stray doubles, declared invariants at 50 digits and rational."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from cases import table_of
from declared import SCHEMES
from topcli.arithmetic.fused import fma, follow_precision
from topcli.contracts import Outcome, Scheme, Stepper
from topcli.engine.drive import Orbit, orbit
from topcli.engine.machine import Machine
from topcli.engine.numbers import (
    RATIONAL,
    PreciseRun,
    decimals,
    meaning,
    prepared,
)
from topcli.errors import UsageError
from topcli.runs.report import ORDINARY
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.euler import Euler

LIMIT, ROUNDS, ROOTED = 1e-12, 7, 1e-6
TABLE = np.array([0.1, 1.0 / 3.0])
PI = math.pi
follow_precision(__name__, caps=("ROUNDS",), LIMIT=1, ROOTED=0.5)


@pytest.mark.parametrize(
    ("constant", "value"),
    table_of("""
0.1                    1/10
0.16666666666666666    1/6
-0.8                   -4/5
2.220446049250313e-16  1/4503599627370496
1e-16                  1/10000000000000000
0.0                    0
0.39216144400731415    None
1.4142135623730951     None
"""),
)
def test_constants_stand_for_what_was_meant(constant: float, value: str) -> None:
    assert str(meaning(constant)) == str(value)


def kernel(x: float, y: float = 0.1) -> float:
    """Constant, default, global, array, fma and a function of math in one place."""
    return fma(x, y, 1.0 / 6.0) + LIMIT * ROUNDS + math.sqrt(x) + ROOTED + TABLE[1]


def test_rebuilt_function_has_the_accuracy_of_its_numbers() -> None:
    numbers = decimals(60)
    found = numbers.fraction(numbers.rebuilt(kernel)(numbers.number(Fraction(2))))
    scale = 2 ** (numbers.bits - 53)
    root = Fraction(math.isqrt(2 * 10**140), 10**70)
    # tolerances shrink with the rounding error, or its root; a number of iterations grows with the digits
    scaled = Fraction(1, 10**12) / scale * math.ceil(7 * numbers.bits / 53) + Fraction(1, 10**6) / 2 ** round(
        (numbers.bits - 53) / 2
    )
    assert abs(found - (Fraction(2, 10) + Fraction(1, 6) + root + scaled + Fraction(1, 3))) < Fraction(1, 10**59)
    assert kernel(2.0) == pytest.approx(float(Fraction(7, 10)) + math.sqrt(2.0) + 1e-6, rel=1e-11)


class Settings:
    """A constant of an object, which is not rebuilt."""

    rate = 0.1


def computed() -> Callable[..., Any]:
    """Step with a constant that is computed in doubles."""
    c = math.sqrt(0.3)
    return lambda s, h, p: s[0] + h * c


STATE = tuple(map(Fraction, ("3/2", "2/5", "-7/10", "2/7", "3/7", "6/7")))
"""A state in general position; gamma is a rational unit vector."""
STRAY = {
    "a global": lambda s, h, p: s[0] + h * PI,
    "a folded constant": lambda s, h, p: s[0] * 2.0**0.5,
    "a closure": computed(),
    "an attribute": lambda s, h, p: s[0] * Settings.rate,
    "a conversion": lambda s, h, p: h * float(s[0] / 7),
    "a function": lambda s, h, p: math.atan2(s[0], Settings.rate),
    "a state": lambda s, h, p: Settings.rate,
    "numpy": lambda s, h, p: np.sin(s[0]),
}


@pytest.mark.parametrize("value", STRAY.values(), ids=list(STRAY))
@pytest.mark.parametrize("precision", [40, RATIONAL])
def test_doubles_are_refused(value: Any, precision: int | str) -> None:
    """As operands, as arguments, and in the state after a step."""
    step = Stepper(lambda s, h, p: (value(s, h, p), *s[1:]), 6)
    scheme = replace(find_scheme("rk2", "kowalevski"), build=lambda top, options: step)
    with pytest.raises(UsageError, match=r"no exact meaning|math.atan2, which|no step in"):
        carried_out(ready(scheme, precision), 2)


@pytest.mark.parametrize("precision", [40, RATIONAL])
def test_constants_of_a_build_are_computed_exactly(precision: int | str) -> None:
    """Half of a parameter whose double is that of one third."""

    def build(top: Any, options: Any) -> Stepper:
        half = 0.5 * top.c0
        return Stepper(lambda s, h, p: (s[0] + half * s[1], *s[1:]), 6)

    scheme, c0 = replace(find_scheme("rk2", "kowalevski"), build=build), Fraction("0.33333333333333333333")
    run = prepared(scheme, TOPS["kowalevski"].new(), None, precision, (H, {"c0": c0}, STATE))
    first = run.arithmetic.fraction(carried_out(run, 1).states[1, 0])
    assert abs(first - STATE[0] - c0 / 2 * STATE[1]) < Fraction(1, 10**38)


H = Fraction(1, 20)
BELOW = 1e-45
CANNOT = [scheme for scheme in SCHEMES if scheme.name in ("dop853", "exact", "hk-exact", "taylor")]
CAN = [scheme for scheme in SCHEMES if scheme not in CANNOT]


def name_of(scheme: Scheme) -> str:
    return f"{scheme.top}-{scheme.name}"


def ready(scheme: Scheme, precision: int | str, max_digits: int = 10_000, **options: Any) -> PreciseRun:
    top = TOPS[scheme.top].new()
    parameters = {name: Fraction(str(value)) for name, value in top.model_dump().items() if isinstance(value, float)}
    values = (H, parameters, STATE[: len(top.components)])
    return prepared(scheme, top, scheme.options(**options), precision, values, max_digits)


def orbit_of(made: PreciseRun, steps: int) -> Orbit:
    return orbit(
        made.top, Machine(made.top, Stepper(made.loop.take_steps, made.loop.width), made.loop), made.y0, made.h, steps
    )


def carried_out(made: PreciseRun, steps: int) -> Orbit:
    found = orbit_of(made, steps)
    assert found.ending.outcome is Outcome.COMPLETED
    return found


def declared_deviations(scheme: Scheme, made: PreciseRun, states: Any) -> dict[str, Any]:
    modified = scheme.modified(made.top, made.h, scheme.options()) if scheme.modified else ()
    watched = [one for one in made.top.invariants() if one.name in scheme.conserves] + list(modified)
    values = {one.name: one.value(states) for one in watched}
    return {name: max(abs(x - found[0]) for x in found) for name, found in values.items()}


def assert_exact_at_50_digits(scheme: Scheme, steps: int, **options: Any) -> None:
    """Declared invariants to the last digits, and the states and counted events of doubles: the same algorithm."""
    made = ready(scheme, 50, **options)
    found = carried_out(made, steps)
    deviations = {name: float(x) for name, x in declared_deviations(scheme, made, found.states).items()}
    assert set(deviations) >= set(scheme.conserves)
    assert max(deviations.values(), default=0.0) < BELOW, deviations
    top = TOPS[scheme.top].new()
    y0 = [float(x) for x in STATE[: len(top.components)]]
    doubles = orbit(top, scheme.build(top, scheme.options(**options)), y0, float(H), steps)
    assert found.states.astype(float) == pytest.approx(doubles.states, abs=1e-12)
    events = {name: count for name, count in doubles.ending.counters.items() if name not in ORDINARY}
    assert {name: found.ending.counters[name] for name in events} == events


@pytest.mark.slow
@pytest.mark.parametrize("scheme", CAN, ids=name_of)
def test_declared_invariants_are_exact_at_50_digits(scheme: Scheme) -> None:
    assert_exact_at_50_digits(scheme, 25)


@pytest.mark.parametrize(
    ("top", "name", "options"),
    [
        ("heavy", "hk", {"compensated": True}),
        ("heavy", "hk", {"project": 2}),
        ("lagrange", "midpoint+kahan-li6", {}),
    ],
)
def test_wrapped_steps_are_exact_at_50_digits(top: str, name: str, options: dict[str, Any]) -> None:
    assert_exact_at_50_digits(find_scheme(name, top), 5, **options)


@pytest.mark.parametrize(
    ("top", "name"),
    table_of("""
euler              hk
lagrange/inertial  bs
euler+gamma        hk
lagrange           hk
"""),
)
def test_rational_orbits_keep_declared_invariants_equal(top: str, name: str) -> None:
    scheme = find_scheme(name, top)
    made = ready(scheme, RATIONAL)
    found = carried_out(made, 8)
    assert set(declared_deviations(scheme, made, found.states).values()) == {0}
    first = made.top.invariants()[0 if name == "hk" else 3]  # the control: conserved only in its modified form
    assert first.name not in scheme.conserves
    values = first.value(found.states)
    assert max(abs(float(x - values[0])) for x in values) > 1e-4


REFUSED = [(scheme, 50, "numbers of 50 digits: it ") for scheme in CANNOT] + [
    (find_scheme("hybrid", "kowalevski"), RATIONAL, r"rational numbers: it uses math\.s"),
    (find_scheme("midpoint", "heavy"), RATIONAL, "rational numbers: it solves its equations by iteration"),
]


@pytest.mark.parametrize(("scheme", "precision", "reason"), REFUSED)
def test_schemes_without_steps_in_these_numbers_say_so(scheme: Scheme, precision: int | str, reason: str) -> None:
    with pytest.raises(UsageError, match=f"scheme '{scheme.name}' cannot compute with {reason}"):
        ready(scheme, precision)


def test_generated_code_with_a_constant_of_doubles_is_refused() -> None:
    """The polynomials of the field read the decimals of 2/7, and the copy of the field reads 2/7."""

    class Turned(Euler):
        """Rotation with an own field."""

        field = staticmethod(lambda y, p: (y[1] * y[2] * (2.0 / 7.0), -y[0] * y[2], y[0]))

    scheme = find_scheme("hk", "euler")
    values = (H, {name: Fraction(str(x)) for name, x in Turned().model_dump().items()}, STATE[:3])
    with pytest.raises(UsageError, match="'hk' cannot compute with numbers of 40 digits: it has constants that are"):
        prepared(scheme, Turned(), scheme.options(), 40, values)


def test_rational_run_stops_at_the_number_of_digits() -> None:
    made = ready(find_scheme("hk", "heavy"), RATIONAL, max_digits=300)
    found = orbit_of(made, 50)
    assert found.ending.outcome is Outcome.DIGIT_LIMIT
    assert found.ending.step == len(found.n)
    assert 30 < max(len(str(x.numerator)) for x in found.states[-1]) <= 300
