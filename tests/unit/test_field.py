"""Steps generated from random polynomial fields: order, self-adjointness, Kahan's equations, the tangent map."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction

import numpy as np
import pytest

from declared import Heavy
from fields import random_field, random_state, top_of
from steppers import built, physical
from topcli.field.implicit import KahanStep, NewtonStep, generated
from topcli.field.integrals import broken_integral, polynomial_value, rate_of_change
from topcli.field.polynomial import (
    Field,
    NotPolynomialError,
    Polynomial,
    field_of,
    polynomial_field,
)
from topcli.field.straight_line import compiled_function
from topcli.tops import TOPS

EPS = 2.0**-52


def length(field: Field, y: tuple[float, ...]) -> float:
    """A step size at which half the Jacobian is small."""
    return 0.2 / (1.0 + max(sum(abs(rate.derivative(j).value(y)) for j in range(len(y))) for rate in field))


def function(step: KahanStep, constants: Iterable[Fraction]):
    """A step as a function of state and h."""
    code, p = compiled_function(step.graph, "step", step.outputs), tuple(map(float, constants))
    return lambda y, h: code(tuple(y), h, p)


def step_of(field: Field, kind: type[KahanStep] = KahanStep):
    made = generated(kind, field)
    return function(made, made.constants)


def kahans_residual(field: Field, y: tuple[float, ...], new: tuple[float, ...], h: float) -> float:
    """Largest residual of Kahan's equations, in units of round-off of their terms; exact arithmetic."""
    a, b, step = list(map(Fraction, y)), list(map(Fraction, new)), Fraction(h)
    worst = 0.0
    for i, rate in enumerate(field):
        total, size = b[i] - a[i], abs(b[i]) + abs(a[i])
        for monomial, c in rate.terms.items():
            term = {
                0: lambda m: Fraction(1),
                1: lambda m: (a[m[0]] + b[m[0]]) / 2,
                2: lambda m: (a[m[0]] * b[m[1]] + b[m[0]] * a[m[1]]) / 2,
            }[len(monomial)](monomial)
            total -= step * c * term
            size += abs(step * c * term)
        worst = max(worst, abs(float(total)) / (EPS * float(size)))
    return worst


def test_tops_with_other_coefficients_share_their_step() -> None:
    """The function reads them from its constants; the control is a coefficient that needs none."""

    def step(*moments: str):
        made = generated(KahanStep, field_of(Heavy(**dict(zip("ABC", map(float, moments), strict=True)))))
        return compiled_function(made.graph, "step", made.outputs)

    assert step("2.1", "1.5", "1.1") is step("2.3", "1.7", "1.3")
    assert step("2.1", "1.5", "1.1") is not step("2.5", "1.5", "1.0")


def midpoint_residual(field: Field, y: tuple[float, ...], new: tuple[float, ...], h: float) -> float:
    """Largest residual of y' = y + h f((y + y')/2), in units of round-off of its terms; exact arithmetic."""
    a, b, worst = list(map(Fraction, y)), list(map(Fraction, new)), 0.0
    mean = [(x + z) / 2 for x, z in zip(a, b, strict=True)]
    for i, rate in enumerate(field):
        off = b[i] - a[i] - Fraction(h) * rate.value(mean)
        size = abs(a[i]) + abs(b[i]) + abs(Fraction(h)) * rate.magnitudes().value([abs(x) for x in mean])
        worst = max(worst, abs(float(off)) / (EPS * float(size) or 1.0))
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("compensated", [False, True])
@pytest.mark.parametrize("d", [1, 2, 3, 5, 8])
def test_hk_and_midpoint_solve_their_equations_on_fields_of_every_sparsity(d: int, compensated: bool) -> None:
    """From constant, linear and decoupled fields to dense ones; at worst 1.3 units of round-off in 1,000 fields."""
    for density in (0.0, 0.1, 0.2, 0.4, 0.8)[: 5 if d < 8 else 3]:
        for degree in (0, 1, 2, 3):
            field, y = random_field(d, degree, 100 * d + degree, density), random_state(d, d)
            h = length(field, y)
            for name, residual in (("hk", kahans_residual), ("midpoint", midpoint_residual))[degree > 2 :]:
                made = built(name, top_of(field), compensated=compensated)
                p = tuple(map(float, made.constants))
                new = physical(made)(y, h, p)
                assert residual(field, y, new, h) < 20.0
                assert residual(field, y, new, 1.0001 * h) > 20.0 or density < 0.4 or d < 3  # the control: another step
                assert np.abs(np.subtract(physical(made)(new, -h, p), y)).max() < 50.0 * EPS


def test_newtons_step_converges_quadratically_where_one_component_enters_another_linearly_and_cubed() -> None:
    """x' = y + y^3, y' = x y - x: the number of digits doubles, so the last of five steps changes nothing."""
    one = Fraction(1)
    field = (Polynomial({(1,): one, (1, 1, 1): one}), Polynomial({(0, 1): one, (0,): -one}))
    newton, state, u, changes = step_of(field, NewtonStep), (0.4, 0.9), (0.0, 0.0), []
    for _ in range(5):
        old, u = u, newton((*state, *u), 0.3)[:2]
        changes.append(max(abs(a - b) for a, b in zip(old, u, strict=True)))
    assert changes[-1] < 4.0 * EPS
    assert changes[0] > 0.1


def test_a_field_is_traced_exactly() -> None:
    """Constants are the decimals that are written: 0.1 + 0.2 = 0.3 holds."""

    def field(y, p):
        a, b, c = p
        return (y[0] * (a + b - c) + y[1] ** 2 / 3, +y[0] - 2 * y[1], 0.5)

    zero, quadratic, linear = polynomial_field(field, 3, (0.1, 0.2, 0.3))
    assert zero.terms == {(1, 1): Fraction(1, 3)}
    assert quadratic.terms == {(0,): 1, (1,): -2}
    assert linear.terms == {(): Fraction(1, 2)}


@pytest.mark.parametrize(
    ("rate", "reason"),
    [
        (lambda x: 1.0 / x, "divides by the state"),
        (lambda x: math.sin(x), "calls a function of the state"),
        (lambda x: x**0.5, "takes the power 0.5 of the state"),
        (lambda x: x if x > 0.0 else -x, "'>' not supported"),
        (lambda x: abs(x), "makes a decision that depends on the state"),
        (lambda x: x + "1", "computes with str"),
        (lambda x: x / 0, "divides by zero"),
    ],
)
def test_what_is_no_polynomial_says_why(rate, reason: str) -> None:
    with pytest.raises(NotPolynomialError, match=reason):
        polynomial_field(lambda y, p: (rate(y[0]),), 1, ())


def test_a_field_of_another_length_is_refused() -> None:
    with pytest.raises(NotPolynomialError, match="has 2 components; expected 3"):
        polynomial_field(lambda y, p: y[:2], 3, ())


@pytest.mark.parametrize("form", TOPS)
def test_declared_integrals_have_no_rate_of_change(form: str) -> None:
    """By exact derivatives; the control is a field with one coefficient that is off by a millionth."""
    top = TOPS[form].new()
    field, checked = field_of(top), 0
    wrong = [rate * Fraction(1_000_001, 1_000_000) if i == 0 else rate for i, rate in enumerate(field)]
    for invariant in top.invariants():
        integral = polynomial_value(invariant.value, len(field))
        assert integral.degree > 0
        assert (rate_of_change(field, integral) == {}) is not bool(invariant.on), invariant.name
        checked += bool(rate_of_change(tuple(wrong), integral))
    assert checked > 0
    assert broken_integral(top) == ""


@pytest.mark.parametrize("seed", range(5))
def test_a_polynomial_is_written_as_a_formula_that_is_read_back(seed: int) -> None:
    (polynomial, *_) = random_field(3, 3, seed)
    values = dict(zip("xyz", random_state(3, seed), strict=True))
    text = polynomial.text(tuple(values))
    assert eval(text, {}, values) == pytest.approx(float(polynomial.value([*values.values()])), rel=1e-12)


def test_negative_powers_of_a_constant_are_those_of_its_reciprocal() -> None:
    assert (Polynomial.of(3) ** -2).constant() == Fraction(1, 9)
    with pytest.raises(NotPolynomialError):
        Polynomial.variable(0) ** -2


def test_formulas_are_short() -> None:
    x, y = Polynomial.variable(0), Polynomial.variable(1)
    assert (-x * x * y + y * Fraction(1, 3) - 0.25).text(("a", "b")) == "-a**2*b + (1/3)*b - 0.25"
    assert (Polynomial({}).text(()), Polynomial.of(1).text(())) == ("0", "1")
