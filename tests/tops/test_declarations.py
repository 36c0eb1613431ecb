"""Tops declared by their field and integrals alone: the defaults, and integrals that only some motions conserve."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from custom_tops import Volterra
from topcli.contracts import Top
from topcli.field.integrals import broken_integral, measured_change
from topcli.tops import TOPS


def test_what_a_top_does_not_declare() -> None:
    top = Volterra(k=0.7)
    assert (top.form, top.title, top.swing) == ("volterra-in-python", "The same top declared in Python", "w1")
    assert top.vectors == {"w1": (0, 1), "w2": (1, 2), "w3": (2, 3)}
    assert (top.constants(), top.step_constants) == ((3.0, 2.0, 1.0, 0.7), ("A", "B", "C", "k"))
    assert next((i.name, i.symbol, i.meaning) for i in top.invariants()) == ("energy", "energy", "energy")


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
