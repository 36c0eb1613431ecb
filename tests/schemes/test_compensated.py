"""Sums whose rounding errors are carried along: against iterates with 40 digits, and what must not change."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from conformance import ExactStep, Subject
from conftest import random_states
from declared import TRIALS, gen
from stepping import made
from topcli.contracts import Top
from topcli.engine.loops import loop_of
from topcli.engine.numbers import decimals
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS

EPS = 2.0**-52
FORMS = ["kowalevski", "euler", "euler+gamma", "lagrange", "heavy"]


def end(top: Top, name: str, y0: Any, h: float, n: int, **options: bool) -> np.ndarray:
    """State after n compiled steps."""
    method = made(top, name, **options)
    p = np.array(top.constants())
    loop = loop_of(method, len(y0), len(p))
    work = np.zeros(loop.width)
    loop.enter(np.array(y0), work, p, h)
    assert loop.take_steps(work, work[:0], p, h, n, n + 1, n + 1) == n
    return np.array((method.leave or (lambda s, h, p: s))(tuple(work), h, tuple(p)))


def errors(name: str, top: Top, y0: Any, h: float, exact: list[Fraction], n: int) -> tuple[float, float]:
    """Errors of the plain and the compensated scheme after n steps, in units of the last bit of 1."""
    ends = [end(top, name, y0, h, n, compensated=compensated) for compensated in (False, True)]
    plain, better = (max(abs(float(Fraction(a) - b)) for a, b in zip(x.tolist(), exact, strict=True)) for x in ends)
    return plain / EPS, better / EPS


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_hk_against_forty_digits(form: str) -> None:
    """After 150 steps the plain form is off by many ulp, the compensated one by hardly more than its rounding."""
    scheme, h, n, ratios = find_scheme("hk", form), 0.01, 150, []
    for top in TRIALS[form][:2]:
        precise = ExactStep(Subject(scheme, top, scheme.options()), decimals(40))
        for y0 in [gen(top), tuple(random_states(1, seed=8)[0, : len(top.components)].tolist())]:
            plain, better = errors("hk", top, y0, h, precise(y0, *[h] * n), n)
            assert better < 3.0, (top, y0)
            ratios.append(plain / better)
    assert np.median(ratios) > 4.0


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["hk", "midpoint"])
def test_every_sum_is_carried_on(name: str, form: str) -> None:
    """A quarter of a last bit lost by one component before a step is in its sum after it; none is dropped."""
    top, h = TOPS[form].new(), 0.01
    method, d = made(top, name, compensated=True), len(top.components)
    assert method.enter is not None
    p = method.parameters(top)
    start = method.step(method.enter(gen(top), h, p), h, p)

    def after(s: tuple[float, ...], i: int) -> Fraction:
        new = method.step(s, h, p)
        return Fraction(new[i]) + Fraction(new[d + i])

    for i in range(d):
        bit = 0.25 * math.ulp(start[i])
        moved = (*start[: d + i], start[d + i] + bit, *start[d + i + 1 :])
        assert float(after(moved, i) - after(start, i)) / bit == pytest.approx(1.0, rel=0.1), i
