"""Formulas of polynomials."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from fields import random_field
from topcli.field.polynomial import Polynomial


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
