"""Equations of implicit and projected schemes at 50 digits, in their own words, evaluated with mpmath."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import mpmath
import pytest
from mpmath import mp, mpf

from test_precise_schemes import STATE
from topcli.engine.loop import Run
from topcli.engine.precise.loop import prepared
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

Vector = Sequence[Any]


def one_step(name: str, h: Fraction) -> tuple[Any, Any]:
    """State before and after a step with 50 digits, as columns."""
    scheme, top = find_scheme(name, "kowalevski"), TOPS["kowalevski"].new()
    made = prepared(scheme, top, scheme.options(), 50, (h, {"A": Fraction(2), "c0": Fraction(1)}, STATE), 10_000)
    states = Run(made.top, made.loop, made.y0, made.h, 1).collect().states
    before, after = (mpmath.matrix([mpf(str(v)) for v in row]) for row in (states[0], states[-1]))
    return before, after


def gradients(y: Any) -> Any:
    """Gradients of gamma², 2l, E and k² by omega and gamma, as the columns of a matrix."""
    w1, w2, w3, g1, g2, g3 = y
    a, b = w1 * w1 - w2 * w2 - g1, 2 * w1 * w2 - g2
    return mpmath.matrix(
        [
            [0, 2 * g1, 2 * w1, 4 * (a * w1 + b * w2)],
            [0, 2 * g2, 2 * w2, 4 * (b * w1 - a * w2)],
            [0, g3, w3, 0],
            [2 * g1, 2 * w1, 1, -2 * a],
            [2 * g2, 2 * w2, 0, -2 * b],
            [2 * g3, w3, 0, 0],
        ]
    )


def outside(D: Any, v: Any) -> Any:
    """Distance of ``v`` from the span of the columns of ``D``."""
    return mpmath.norm(v - D * mpmath.lu_solve(D.T * D, D.T * v))


def tensor(m: Vector, g: Vector) -> Any:
    """Poisson tensor of e(3): a function of m and g with the gradient (a, b) has the field (m x a + g x b, g x a)."""

    def hat(v: Vector) -> list[list[Any]]:
        return [[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]]

    return mpmath.matrix([p + q for p, q in zip(hat(m), hat(g), strict=True)] + [p + [0] * 3 for p in hat(g)])


def scaled(v: Any, factors: Vector) -> Any:
    return mpmath.matrix([p * q for p, q in zip(v, factors, strict=True)])


@pytest.mark.slow
def test_midpoint4_solves_its_equation_in_m_and_gamma() -> None:
    """The residual is round-off for m and gamma; read for omega and gamma, the equation does not hold."""
    h = Fraction(1, 20)
    with mp.workdps(50):
        y, new = one_step("midpoint4", h)
        z = (y + new) / 2
        momenta = (2, 2, 1, 1, 1, 1)

        def residual(factors: Vector) -> Any:
            """Part of y' - y - h f outside of the correction's direction, for the coordinates ``factors`` y."""
            place = scaled(z, factors)
            J = tensor(place[:3], place[3:])
            D = gradients(z)
            E, K = (scaled(D[:, i], [1 / mpf(factor) for factor in factors]) for i in (2, 3))
            F, X = J * E, J * K
            FX, FF = (F.T * X)[0], (F.T * F)[0]
            field = scaled(tensor([2 * z[0], 2 * z[1], z[2]], z[3:]) * mpmath.matrix([*z[:3], 1, 0, 0]), (1,) * 6)
            rate = scaled(field, [factor / mpf(two) for factor, two in zip(factors, momenta, strict=True)])
            return outside(J * (FF * X - FX * F), scaled(new - y, factors) - mpf(h.numerator) / h.denominator * rate)

        assert residual(momenta) < mpf(10) ** -45
        assert residual((1,) * 6) > mpf(10) ** -8


@pytest.mark.slow
def test_hk_projected_solves_its_equation_up_to_the_fourth_order_of_the_correction() -> None:
    """Renewed gradients lead out of the span of D(z) by x⁴: with x of order h³, by h¹²."""
    with mp.workdps(50):
        off = []
        for h in (Fraction(1, 20), Fraction(1, 40)):
            _, hk = one_step("hk", h)
            _, new = one_step("hk-projected", h)
            correction = new - hk
            off.append(outside(gradients(hk), correction))
            assert off[-1] < mpf(10) ** -14 * mpmath.norm(correction)
        assert abs(mpmath.log(off[0] / off[1], 2) - 12) < 1
        assert off[1] > mpf(10) ** -30
