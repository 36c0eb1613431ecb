"""Tops declared by their field and integrals alone: the defaults, and integrals that only some motions conserve."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from custom_tops import Volterra
from topcli.arithmetic.sized import Sized
from topcli.contracts import Top
from topcli.field.integrals import broken_integral, measured_change
from topcli.tops import TOPS

STATES = np.random.default_rng(3).uniform(-1.0, 1.0, (50, 6))


def test_what_a_top_does_not_declare() -> None:
    top = Volterra(k=0.7)
    assert (top.form, top.title, top.swing) == ("volterra-in-python", "The same top declared in Python", "w1")
    assert top.vectors == {"w1": (0, 1), "w2": (1, 2), "w3": (2, 3)}
    assert (top.constants(), top.step_constants) == ((3.0, 2.0, 1.0, 0.7), ("A", "B", "C", "k"))
    assert next((i.name, i.symbol, i.meaning) for i in top.invariants()) == ("energy", "energy", "energy")


def test_an_integral_is_its_formula_and_its_scale_the_size_of_its_terms() -> None:
    energy, momentum = Volterra(k=-0.7).invariants()
    w = STATES[:, :3]
    assert energy.value(w) == pytest.approx((1.5 * w[:, 0] ** 2 + w[:, 1] ** 2 + 0.5 * w[:, 2] ** 2), rel=1e-15)
    expected = 9.0 * w[:, 0] ** 2 + 4.0 * w[:, 1] ** 2 + (w[:, 2] - 0.7) ** 2
    assert momentum.value(w) == pytest.approx(expected, rel=1e-14)
    sizes = 9.0 * w[:, 0] ** 2 + 4.0 * w[:, 1] ** 2 + (abs(w[:, 2]) + 0.7) ** 2
    assert momentum.scale(w) == pytest.approx(sizes, rel=1e-14)


def test_sizes_of_terms_are_added() -> None:
    x, y = Sized(np.array([3.0])), Sized(np.array([-2.0]))
    for formula, value, size in [
        (x + y, 1.0, 5.0),
        (1.0 - x * y, 7.0, 7.0),
        ((x + y) ** 2 - 1, 0.0, 26.0),
        ((x + y) / (y + 1.0), -1.0, 5.0),
        (np.array([2.0]) * (x + y), 2.0, 10.0),
        (abs(-x) - +y, 5.0, 5.0),
        (6.0 / x, 2.0, 2.0),
        (np.exp(x + y), np.e, np.e),
    ]:
        assert (formula.value, formula.size) == (pytest.approx(value), pytest.approx(size))


def heavy(y, p):
    A, B, C, x, z = p
    w1, w2, w3, g1, g2, g3 = y
    return (
        ((B - C) * w2 * w3 + g2 * z) / A,
        ((C - A) * w3 * w1 + (g3 * x - g1 * z)) / B,
        ((A - B) * w1 * w2 - g2 * x) / C,
        g2 * w3 - g3 * w2,
        g3 * w1 - g1 * w3,
        g1 * w2 - g2 * w1,
    )


def m_gamma(y, p):
    return p[0] * y[0] * y[3] + p[1] * y[1] * y[4] + p[2] * y[2] * y[5]


def chaplygin(y, p):
    """Integral of Goryachev and Chaplygin, for A = B = 4C."""
    return y[2] * (y[0] ** 2 + y[1] ** 2) - p[3] * y[0] * y[5]


def hess(y, p):
    """Invariant relation of Hess."""
    A, _, C, x, z = p
    return A * y[0] * x + C * y[2] * z


class HeavyOnItsPlane(Top):
    """Heavy top with its centre of gravity in the plane of two axes."""

    kind = "declared-heavy"
    components = ("w1", "w2", "w3", "g1", "g2", "g3")
    A: float = 4.0
    B: float = 4.0
    C: float = 1.0
    x: float = 1.0
    z: float = 0.0
    field = staticmethod(heavy)


def declared(integrals, where) -> type[Top]:
    class Declared(HeavyOnItsPlane):
        """With these integrals."""

    Declared.integrals, Declared.holds_on = integrals, where
    return Declared


G = {"m_gamma": m_gamma, "chaplygin": chaplygin}


def test_an_integral_may_hold_on_a_level_of_another() -> None:
    assert "'chaplygin' is not an integral of the field" in broken_integral(declared(G, {})())
    on = declared(G, {"chaplygin": {"m_gamma": 0.0}})
    assert broken_integral(on()) == ""
    assert on().invariants()[1].on == {"m_gamma": 0.0}
    assert "'chaplygin' is not an integral" in broken_integral(declared(G, {"chaplygin": {"m_gamma": 0.1}})())
    assert "'chaplygin' is not an integral" in broken_integral(on(A=4.1, B=4.1))
    assert "'m_omega', which is not an integral" in broken_integral(declared(G, {"chaplygin": {"m_omega": 0.0}})())


def test_an_invariant_relation_holds_on_its_own_zero() -> None:
    """Hess' condition A (B - C) x^2 = C (A - B) z^2, here with 2.4 on both sides."""
    on = declared({"hess": hess}, {"hess": {"hess": 0.0}})
    assert broken_integral(on(A=4.0, B=1.6, C=1.0, x=1.0, z=1.0)) == ""
    assert "'hess' is not an integral" in broken_integral(on(A=4.0, B=1.6, C=1.0, x=1.0, z=1.01))


@pytest.mark.parametrize("form", TOPS)
def test_integrals_are_told_from_other_functions_by_differences_too(form: str) -> None:
    """What is judged exactly elsewhere; the control adds a thousandth of the square of a component."""
    top = TOPS[form].new()
    for invariant in top.invariants():
        if invariant.on:
            continue
        assert measured_change(top, invariant) == ""

        def wrong(y, value=invariant.value, scale=invariant.scale):
            return value(y) + 1e-3 * scale(y[:1])[0] * y[:, 0] ** 2

        assert "its rate of change is" in measured_change(top, replace(invariant, value=wrong)), invariant.name


class Pendulum(Top):
    """Pendulum by its angle and momentum."""

    kind = "pendulum-declared"
    components = ("q", "p")
    sign: float = 1.0

    @staticmethod
    def field(y, p):
        return (y[1], -math.sin(y[0]))

    integrals: ClassVar = {"energy": lambda y, p: y[1] ** 2 / 2 - p[0] * np.cos(y[0])}


def test_an_integral_that_is_no_polynomial_is_judged_by_its_changes() -> None:
    assert broken_integral(Pendulum()) == ""
    q, p = np.random.default_rng(0).normal(size=2)
    wrong = broken_integral(Pendulum(sign=-1.0))
    assert wrong.startswith("'energy' is not an integral of the field: its rate of change is ")
    rate, place = re.fullmatch(r".*rate of change is (\S+) at \((.*)\)", wrong).groups()
    assert [*map(float, place.split(", "))] == pytest.approx([q, p], rel=1e-2)
    assert float(rate) == pytest.approx(-2.0 * p * math.sin(q), rel=2e-2)
