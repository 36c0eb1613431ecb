"""Counted operations of a step, against counts by hand."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import pytest

from topcli.arithmetic.fused import fma
from topcli.contracts import Floats, Stepper
from topcli.schemes.registry import find_scheme
from topcli.studies.scheme_page import operations_of

HALF = 0.5


def step(y: Floats, h: float, p: Floats) -> Floats:
    d = HALF * h  # not counted: a constant of the run
    a = y[0] * y[1] + d  # a product, a sum
    b = math.sqrt(fma(a, a, 1.0)) / (1.0 - a)  # a root, a product and a sum, a sum, a division
    c = -abs(math.sin(b)) if b > 0.0 else b  # a call
    return (a, c * d, c - p[0] * d)  # a product, a sum


def of(function: object, name: str = "rk2") -> dict[str, float]:
    found = operations_of(replace(find_scheme(name, "euler"), build=lambda top, options: Stepper(function, 3)))  # type: ignore[arg-type]
    assert found is not None
    return asdict(found)


def test_operations_are_counted_by_kind() -> None:
    assert of(step) == {"sums": 4, "products": 3, "divisions": 1, "roots": 1, "functions": 1}


def test_rk2_by_hand() -> None:
    """Two fields of six products, and two sums y + h k of three products and three sums each."""
    found = operations_of(find_scheme("rk2", "euler"))
    assert found is not None
    assert asdict(found) == {"sums": 6, "products": 18, "divisions": 0, "roots": 0, "functions": 0}
    assert found.text == "6\N{NO-BREAK SPACE}+, 18\N{NO-BREAK SPACE}×"


def test_a_composition_costs_its_stages() -> None:
    base, composed = (operations_of(find_scheme(name, "euler")) for name in ("hk", "hk+suzuki4"))
    assert base is not None
    assert composed is not None
    assert composed.divisions == 5 * base.divisions
    assert 5 * base.products <= composed.products <= 5 * base.products + 60  # h enters each stage by another factor


def test_iterations_count_as_often_as_they_are_carried_out() -> None:
    explicit, implicit = (operations_of(find_scheme(name, "kowalevski")) for name in ("hk", "midpoint"))
    assert explicit is not None
    assert implicit is not None
    assert implicit.products > 3.0 * explicit.products


@pytest.mark.parametrize("name", ["taylor", "exact", "dop853"])
def test_methods_without_plain_steps_have_no_count(name: str) -> None:
    assert operations_of(find_scheme(name, "kowalevski")) is None
