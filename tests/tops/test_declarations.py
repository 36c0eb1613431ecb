"""Tops declared by their field and integrals alone: the defaults, and integrals that only some motions conserve."""

from __future__ import annotations

from dataclasses import replace

import pytest

from custom_tops import Volterra
from topcli.field.integrals import measured_change
from topcli.tops import TOPS


def test_what_a_top_does_not_declare() -> None:
    top = Volterra(k=0.7)
    assert (top.form, top.title, top.swing) == ("volterra-in-python", "The same top declared in Python", "w1")
    assert top.vectors == {"w1": (0, 1), "w2": (1, 2), "w3": (2, 3)}
    assert (top.constants(), top.step_constants) == ((3.0, 2.0, 1.0, 0.7), ("A", "B", "C", "k"))
    assert next((i.name, i.symbol, i.meaning) for i in top.invariants()) == ("energy", "energy", "energy")


@pytest.mark.parametrize("form", TOPS)
def test_integrals_are_told_from_other_functions_by_differences_too(form: str) -> None:
    """Other tests judge the same exactly; the control adds a thousandth of the square of a component."""
    top = TOPS[form].new()
    for invariant in top.invariants():
        if invariant.on:
            continue
        assert measured_change(top, invariant) == ""

        def wrong(y, value=invariant.value, scale=invariant.scale):
            return value(y) + 1e-3 * scale(y[:1])[0] * y[:, 0] ** 2

        assert "its rate of change is" in measured_change(top, replace(invariant, value=wrong)), invariant.name
