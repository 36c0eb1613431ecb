"""Declared exact invariants, decided without round-off: every scheme that can, at 50 digits and in rational numbers."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from topcli.contracts import Outcome, Scheme, Stepper, Top
from topcli.engine.loop import Recorded, Run
from topcli.engine.precise.arithmetic import Floating
from topcli.engine.precise.loop import PreciseRun, Rebuilder, obstacle, prepared
from topcli.engine.precise.numbers import RATIONAL
from topcli.errors import UsageError
from topcli.runs.report import ORDINARY
from topcli.schemes.registry import all_schemes, composed, find_scheme
from topcli.tops import TOPS

H = Fraction(1, 20)
STATE = tuple(map(Fraction, ("3/2", "2/5", "-7/10", "2/7", "3/7", "6/7")))
"""A state in general position; gamma is a rational unit vector."""
BELOW = 1e-45
CAN = [scheme for scheme in all_schemes() if not obstacle(scheme, TOPS[scheme.top].new(), scheme.options())]
CANNOT = [scheme for scheme in all_schemes() if scheme not in CAN]
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
    assert_exact_at_50_digits(scheme, 1000)


@pytest.mark.parametrize(("top", "name"), [("euler+gamma", "hk"), ("kowalevski", "hybrid")])
def test_declared_invariants_are_exact_over_a_few_steps(top: str, name: str) -> None:
    assert_exact_at_50_digits(find_scheme(name, top), 8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("top", "name", "invariant"),
    [
        ("kowalevski", "hk", "k_sq"),
        ("kowalevski", "hybrid", "energy"),
        ("euler", "hk", "m_sq"),
        ("heavy", "rk4", "energy"),
    ],
)
def test_invariants_that_are_not_conserved_deviate_as_in_doubles(top: str, name: str, invariant: str) -> None:
    def largest(of: Top, states: Any) -> float:
        values = next(one for one in of.invariants() if one.name == invariant).value(states)
        return max(abs(float(x - values[0])) for x in values)

    scheme = find_scheme(name, top)
    made = ready(scheme, 50)
    found = largest(made.top, carried_out(made, 100).states)
    assert found == pytest.approx(largest(TOPS[top].new(), in_doubles(scheme, 100).states), rel=1e-7)
    assert found > 1e-7


def assert_bits_of_doubles(scheme: Scheme, steps: int) -> None:
    top = TOPS[scheme.top].new()
    method = scheme.build(top, scheme.options())
    assert isinstance(method, Stepper)
    arithmetic = Floating(53)
    step = Rebuilder(arithmetic).function(method.step)
    y0, h, p = tuple(map(float, STATE[: len(top.components)])), float(H), top.constants()
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
    assert_bits_of_doubles(scheme, 60)


def test_rebuilt_step_of_bohlin_has_the_bits_of_doubles() -> None:
    assert_bits_of_doubles(find_scheme("bohlin-c", "kowalevski"), 10)


@pytest.mark.slow
def test_compositions_conserve_at_50_digits() -> None:
    scheme = composed(find_scheme("midpoint", "lagrange"), "kahan-li6")
    made = ready(scheme, 50)
    found = carried_out(made, 20)
    assert max(map(float, declared_deviations(scheme, made, found.states).values())) < BELOW
    # the stages add up to the step: the state agrees with doubles, which a wrong weight would not allow
    assert found.states[-1].astype(float) == pytest.approx(in_doubles(scheme, 20).states[-1], abs=1e-13)


@pytest.mark.parametrize(("top", "name"), [("euler", "hk"), ("lagrange/inertial", "bs"), ("euler+gamma", "hk")])
def test_rational_orbits_keep_declared_invariants_equal(top: str, name: str) -> None:
    scheme = find_scheme(name, top)
    made = ready(scheme, RATIONAL)
    found = carried_out(made, 8)
    assert set(declared_deviations(scheme, made, found.states).values()) == {0}
    first = made.top.invariants()[0 if name == "hk" else 3]  # the control: conserved only in its modified form
    assert first.name not in scheme.conserves
    values = first.value(found.states)
    assert max(abs(float(x - values[0])) for x in values) > 1e-4


@pytest.mark.slow
def test_rational_orbit_of_lagrange_keeps_its_modified_integrals_equal() -> None:
    scheme = find_scheme("hk", "lagrange")
    made = ready(scheme, RATIONAL)
    assert set(declared_deviations(scheme, made, carried_out(made, 6).states).values()) == {0}


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
