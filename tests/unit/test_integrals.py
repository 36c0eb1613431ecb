"""Polynomial integrals that are found, symmetry and divergence of fields, and formulas of polynomials."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest

from fields import random_field
from topcli.field.integrals import (
    divergence,
    further_integrals,
    polynomial_integrals,
    polynomial_value,
    rate_of_change,
    reversal,
)
from topcli.field.polynomial import Polynomial, field_of
from topcli.tops import TOPS

DECLARED = ["kowalevski", "heavy", "euler+gamma", "lagrange/inertial", "clebsch"]


def declared(form: str) -> list[Polynomial]:
    top = TOPS[form].new()
    return [polynomial_value(one.value, len(top.components)) for one in top.invariants() if not one.on]


@pytest.mark.parametrize("form", DECLARED)
def test_declared_integrals_are_found_and_nothing_else(form: str) -> None:
    """Without one of them, it is found again: up to others, a constant factor and products."""
    field, known = field_of(TOPS[form].new()), declared(form)
    assert further_integrals(field, known) == (4, [])
    for left_out in known:
        rest = [one for one in known if one is not left_out]
        _, further = further_integrals(field, rest)
        assert [rate_of_change(field, one) for one in further] == [{}] * len(further)
        assert min(one.degree for one in further) == left_out.degree


def test_the_space_of_integrals_has_its_dimension() -> None:
    """Of the Euler top: polynomials in m^2 and m.omega, so 2 of degree two, 3 of degree four, none in between."""
    field = field_of(TOPS["euler"].new())
    assert [len(polynomial_integrals(field, k)) for k in range(1, 6)] == [0, 2, 2, 5, 5]


@pytest.mark.parametrize("seed", range(4))
def test_a_random_field_has_no_integral(seed: int) -> None:
    assert polynomial_integrals(random_field(3, 2, seed, 0.9), 4) == []


def test_of_many_components_fewer_degrees_are_tried() -> None:
    twelve = random_field(12, 2, 1, 0.02)
    degree, _ = further_integrals(twelve, [])
    assert degree == 3


def test_divergence_is_the_trace_of_the_jacobian() -> None:
    field = random_field(3, 3, 2)
    y = (Fraction(1, 3), Fraction(-2, 7), Fraction(5, 11))
    trace = sum(rate.derivative(i).value(y) for i, rate in enumerate(field))
    assert divergence(field).value(y) == trace != 0


@pytest.mark.parametrize("form", [form for form in TOPS if form != "custom"])
def test_reversed_signs_reverse_the_motion(form: str) -> None:
    """f(R y) = -R f(y), with as few minus signs as there can be."""
    field = field_of(TOPS[form].new())
    signs, d = reversal(field), len(field)
    assert signs is not None
    y = [Fraction(k + 2, 2 * k + 3) for k in range(d)]
    values = [rate.value(y) for rate in field]

    def reverses(signs: tuple[int, ...]) -> bool:
        turned = [rate.value([s * x for s, x in zip(signs, y, strict=True)]) for rate in field]
        return all(turned[i] == -signs[i] * values[i] for i in range(d))

    assert reverses(signs)
    for minus in itertools.combinations(range(d), signs.count(-1) - 1):
        assert not reverses(tuple(-1 if i in minus else 1 for i in range(d)))


def test_a_field_without_a_reversal_says_so() -> None:
    damped = (Polynomial({(0,): Fraction(-1), (0, 0): Fraction(1)}),)
    assert reversal(damped) is None


@pytest.mark.parametrize("seed", range(5))
def test_a_polynomial_is_written_as_a_formula_that_is_read_back(seed: int) -> None:
    (polynomial, *_) = random_field(3, 3, seed)
    text = polynomial.text(("x", "y", "z"))
    values = dict(zip("xyz", np.random.default_rng(seed).uniform(-1, 1, 3).tolist(), strict=True))
    assert eval(text, {}, values) == pytest.approx(float(polynomial.value(list(values.values()))), rel=1e-12)


def test_formulas_are_short() -> None:
    x, y = Polynomial.variable(0), Polynomial.variable(1)
    assert (-x * x * y + y * Fraction(1, 3) - 0.25).text(("a", "b")) == "-a**2*b + (1/3)*b - 0.25"
    assert Polynomial({}).text(()) == "0"
    assert Polynomial.of(1).text(()) == "1"
