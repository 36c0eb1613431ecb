"""Fused, double-double and quaternion arithmetic, and the kernels of rotations and roots."""

from __future__ import annotations

import cmath
import itertools
import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conftest import random_states
from topcli.arithmetic import fused as dd
from topcli.arithmetic.fused import fma
from topcli.arithmetic.quaternions import (
    conjugate,
    euler_angles,
    product,
    rotate,
    turn_upright,
    upright,
)
from topcli.arithmetic.vectors import (
    SMALL_ANGLE_SQ,
    add_rotation_increment,
    cayley_increment,
    resolvent,
    rodrigues_increment,
    root_nearest,
    root_sign,
    sinc_cosc,
    solve3,
)
from topcli.engine.native import native
from topcli.engine.numbers import Rational

EPS = 2.0**-52
number = st.floats(-8.0, 8.0, allow_subnormal=False)
rational = st.fractions(-5, 5, max_denominator=60)
vector = st.tuples(rational, rational, rational)


def exactly(function, *arguments) -> list[Fraction]:
    """Values of a kernel of + - * / in rational numbers; tuples among the arguments are taken item by item."""
    made = [
        tuple(Rational(Fraction(x)) for x in a) if isinstance(a, tuple) else Rational(Fraction(a)) for a in arguments
    ]
    return list(function(*made))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


@pytest.mark.slow
@given(vector, vector)
def test_cayley_solves_its_equation_exactly(a, g) -> None:
    d = exactly(cayley_increment, *a, *g)
    assert d == cross([2 * x + y for x, y in zip(g, d, strict=True)], a)
    assert sum((x + y) ** 2 for x, y in zip(g, d, strict=True)) == sum(x * x for x in g)


ANGLES = [0.0, 1e-160, 1e-8, 1e-4, 0.01, 0.1, 0.5, 0.785, math.sqrt(SMALL_ANGLE_SQ), 0.786, 1.0, 3.0, 6.5, 50.0]


@pytest.mark.parametrize("x", ANGLES)
def test_sinc_and_cosc(x: float) -> None:
    with mpmath.workdps(400):
        t = x * x
        root = mpmath.sqrt(mpmath.mpf(t))
        sinc = mpmath.sin(root) / root if t else mpmath.mpf(1)
        cosc = (1 - mpmath.cos(root)) / root**2 if t else mpmath.mpf(1) / 2
        got = sinc_cosc(t)
        assert abs(got[0] - sinc) <= 2 * EPS * max(abs(sinc), mpmath.mpf(0.05))
        assert abs(got[1] - cosc) <= 2 * EPS * max(cosc, mpmath.mpf(0.01))


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-12, 1e-6, 1e-2, 1.0, 7.0])
def test_rodrigues_against_the_increment_in_forty_digits(size: float) -> None:
    """Relative to the angle, also where the paper's matrix loses it among the digits of 1."""
    for y in random_states(20, seed=2):
        a, g = [size * float(x) for x in y[:3]], [float(x) for x in y[3:]]
        with mpmath.workdps(40):
            rows = mpmath.matrix([[0, a[2], -a[1]], [-a[2], 0, a[0]], [a[1], -a[0], 0]])
            exact = mpmath.expm(rows) * mpmath.matrix(g) - mpmath.matrix(g)
            scale = math.hypot(*a)
            error = max(abs(x - e) for x, e in zip(rodrigues_increment(*a, *g), exact, strict=True))
            assert error < 12 * EPS * scale


@given(st.floats(-9.0, 9.0), number, number, number, number)
def test_add_rotation_increment(chi: float, x: float, y: float, a: float, b: float) -> None:
    """Two roundings at the size of the sum, beside the increment's own."""
    with mpmath.workdps(40):
        exact = mpmath.mpc(a, b) + mpmath.expm1(mpmath.mpc(0, -chi)) * mpmath.mpc(x, y)
        got = mpmath.mpc(*add_rotation_increment(chi, x, y, a, b))
        assert abs(got - exact) <= EPS * (6 * min(abs(chi), 2.0) * math.hypot(x, y) + 2 * math.hypot(a, b)) + 1e-300


def squared(w: tuple[float, float]) -> tuple[Fraction, Fraction]:
    a, b = Fraction(w[0]), Fraction(w[1])
    return a * a - b * b, 2 * a * b


@example(-4.0, 0.0, 0.0, 2.0)
@example(-4.0, -0.0, 0.0, 2.0)
@example(-1.0, -1e-14, 0.0, 1.0)
@given(number, number, number, number)
def test_root_squares_back_and_is_the_nearest(x: float, y: float, p1: float, p2: float) -> None:
    assume(math.hypot(x, y) > 1e-140 and not 0.0 < math.hypot(p1, p2) < 1e-140)
    w = root_nearest(0.5 * x, 0.5 * y, p1, p2)
    re, im = squared(w)
    assert math.hypot(float(re - Fraction(x)), float(im - Fraction(y))) <= 4 * EPS * math.hypot(x, y)
    towards = w[0] * p1 + w[1] * p2
    assert towards >= -4 * EPS * math.hypot(*w) * math.hypot(p1, p2)


@given(number, number, number, number)
def test_root_by_sign_is_the_papers_rule(x: float, y: float, p1: float, p2: float) -> None:
    assume(abs(y) > 1e-6)
    root = cmath.sqrt(complex(x, y))
    if (cmath.phase(root) >= 0.0) != (cmath.phase(complex(p1, p2)) >= 0.0):
        root = -root
    assert root_sign(0.5 * x, 0.5 * y, p1, p2) == pytest.approx((root.real, root.imag), rel=1e-9, abs=1e-12)


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


SPECIAL = (0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324, -5e-324, 1e308, -1e308, 1.0)


def each(a, b, c, out, n):
    for i in range(n):
        out[i] = fma(a[i], b[i], c[i])
    return 0


def naive(a, b, c, out, n):
    for i in range(n):
        out[i] = a[i] * b[i] + c[i]
    return 0


def operands() -> list[np.ndarray]:
    """Any bit patterns, sums that cancel, and every triple of special values."""
    rng = np.random.default_rng(1)
    a, b, c = rng.integers(0, 2**64, (3, 4000), dtype=np.uint64).view(float)
    x, y = rng.normal(size=(2, 2000))
    special = np.array(list(itertools.product(SPECIAL, repeat=3))).T
    return [np.concatenate(pieces) for pieces in zip((a, b, c), (x, y, -x * y), special, strict=True)]


def test_the_instruction_is_the_exact_operation_rounded_once() -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        a, b, c = operands()
    fused, unfused = np.zeros_like(a), np.zeros_like(a)
    native(each, "ppppq")(a, b, c, fused, len(a))
    native(naive, "ppppq")(a, b, c, unfused, len(a))
    exact = np.array([fma(*values) for values in zip(a.tolist(), b.tolist(), c.tolist(), strict=True)])
    bits, wanted = fused.view(np.uint64), exact.view(np.uint64)
    assert np.all((bits == wanted) | (np.isnan(fused) & np.isnan(exact)))
    assert np.sum(unfused[4000:6000] == 0.0) == 2000  # the compiler fuses nothing by itself
    assert np.sum(fused[4000:6000] != 0.0) > 1900


RANDOM = Rotation.random(200, rng=np.random.default_rng(1))
Q = RANDOM.as_quat(scalar_first=True)


def close(found: object, expected: object) -> None:
    assert np.abs(np.asarray(found) - np.asarray(expected)).max() < 2e-15


def test_product_and_rotation() -> None:
    p, q = tuple(Q[0].tolist()), tuple(Q[1].tolist())
    expected = (RANDOM[0] * RANDOM[1]).as_quat(scalar_first=True)
    found = np.array(product(p, q))
    close(found * np.sign(found @ expected), expected)
    close(rotate(p, (1.0, -2.0, 0.5)), RANDOM[0].apply([1.0, -2.0, 0.5]))
    close(rotate(conjugate(p), rotate(p, (1.0, -2.0, 0.5))), (1.0, -2.0, 0.5))


def test_upright_is_the_shortest_rotation() -> None:
    for v in np.random.default_rng(2).normal(size=(50, 3)):
        found = Rotation.from_quat(upright(tuple(v.tolist())), scalar_first=True)
        u = v / np.linalg.norm(v)
        close(found.apply(u), [0.0, 0.0, 1.0])
        assert found.magnitude() == pytest.approx(math.acos(u[2]), abs=1e-14)
    assert turn_upright((0.0, 0.0, -1.0)) == (-1.0, 1.0, 0.0, 0.0)


def test_euler_angles_are_those_of_the_sequence_zxz() -> None:
    psi, theta, phi = euler_angles(Q)
    close(Rotation.from_euler("ZXZ", np.column_stack([psi, theta, phi])).as_matrix(), RANDOM.as_matrix())
    assert theta.min() >= 0.0
    assert theta.max() <= math.pi
    assert np.abs([psi, phi]).max() <= math.pi
    close(np.cos(theta), RANDOM.as_matrix()[:, 2, 2])  # the height of the third axis
    for q, angles in (
        ((0.8, 0.0, 0.0, 0.6), (2.0 * math.atan2(0.6, 0.8), 0.0, 0.0)),
        ((0.0, 1.0, 0.0, 0.0), (0.0, math.pi, 0.0)),
    ):
        assert [float(one[0]) for one in euler_angles(np.array([q]))] == pytest.approx(angles, abs=1e-15)


@pytest.mark.slow
@given(st.tuples(*[rational] * 3), st.tuples(*[rational] * 3))
def test_resolvent_solves_its_equation(a, b) -> None:
    z = exactly(resolvent, *a, *b)
    assert [u - v for u, v in zip(z, cross(z, a), strict=True)] == list(b)


@pytest.mark.slow
@given(st.tuples(*[rational] * 9), st.tuples(*[rational] * 3))
def test_solve3_solves(m, r) -> None:
    try:
        x = exactly(solve3, m, *r)
    except ZeroDivisionError:
        assert np.linalg.matrix_rank(np.array(m, dtype=float).reshape(3, 3)) < 3
        return
    assert [sum(m[3 * i + j] * x[j] for j in range(3)) for i in range(3)] == list(r)
