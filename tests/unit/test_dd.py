"""Double-double arithmetic against exact fractions."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from topcli.analysis import reference_series as taylor
from topcli.arithmetic import double_double as dd

U = Fraction(1, 2**53)
ordinary = st.floats(-1e40, 1e40).filter(lambda x: x == 0 or abs(x) > 1e-40)


@st.composite
def double_doubles(draw):
    hi = draw(ordinary)
    part = draw(st.floats(-0.5, 0.5).filter(lambda x: x == 0 or abs(x) > 1e-20))
    return dd.quick_two_sum(hi, part * math.ulp(hi) if hi else 0.0)


def exact(pair):
    return Fraction(pair[0]) + Fraction(pair[1])


def assert_close(pair, true, bound):
    assert abs(exact(pair) - true) <= bound * U**2 * abs(true)
    assert pair[0] == pair[0] + pair[1], "not normalised"


@given(ordinary, ordinary)
def test_error_free_transformations_are_exact(a, b):
    assert exact(dd.two_sum(a, b)) == Fraction(a) + Fraction(b)
    assert dd.two_sum(a, b)[0] == a + b
    assert exact(dd.two_prod(a, b)) == Fraction(a) * Fraction(b)
    assert dd.two_prod(a, b)[0] == a * b
    large, small = (a, b) if abs(a) >= abs(b) else (b, a)
    assert exact(dd.quick_two_sum(large, small)) == Fraction(a) + Fraction(b)


@given(double_doubles(), double_doubles(), ordinary)
def test_double_double_operations_meet_their_error_bounds(a, b, c):
    assert_close(dd.dd_add(*a, *b), exact(a) + exact(b), Fraction(301, 100))
    assert_close(dd.dd_mul(*a, *b), exact(a) * exact(b), 7)
    assert_close(dd.dd_scale(*a, c), exact(a) * Fraction(c), 2)
    if c:
        assert_close(dd.dd_div(*a, c), exact(a) / Fraction(c), 3)


@given(double_doubles(), st.floats(-1, 1))
def test_addition_survives_cancellation(a, part):
    b = dd.two_sum(-a[0], part * math.ulp(a[0]) * 1e-3)
    assert_close(dd.dd_add(*a, *b), exact(a) + exact(b), Fraction(301, 100))


def test_cauchy_products_keep_double_double_accuracy():
    rng = np.random.default_rng(1)
    n = 30
    hi = rng.normal(size=(6, n)) * 10.0 ** rng.uniform(-3, 3, size=(6, n))
    lo = hi * 2.0**-54 * rng.uniform(-1, 1, size=(6, n))
    work = np.stack([hi, lo], axis=1).reshape(-1).tolist()
    for j in (0, 1, 7, n - 1):
        terms = [exact((hi[2, k], lo[2, k])) * exact((hi[5, j - k], lo[5, j - k])) for k in range(j + 1)]
        error = abs(exact(taylor.cauchy(work, 2, 5, j, n)) - sum(terms))
        assert error <= (j + 8) ** 2 * U**2 * sum(map(abs, terms))
