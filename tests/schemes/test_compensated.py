"""Sums whose rounding errors are carried along: against iterates with 40 digits, and what must not change."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from conformance import ExactStep, Subject
from conftest import GEN, random_states
from declared import TRIALS, gen
from stepping import made, ran
from topcli.arithmetic.fused import compensated_sum
from topcli.contracts import Outcome, Top
from topcli.engine.loops import loop_of
from topcli.engine.numbers import floating
from topcli.schemes.compose import COMPOSITIONS
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski

EPS = 2.0**-52
FORMS = ["kowalevski", "euler", "euler+gamma", "lagrange", "heavy"]


def end(top: Top, name: str, y0: Any, h: float, n: int, **options: bool) -> np.ndarray:
    """State after n compiled steps."""
    method = made(top, name, **options)
    p = np.array(top.constants())
    loop = loop_of(method, len(y0), len(p))
    work = np.zeros(loop.width)
    loop.enter(np.array(y0), work, p, h)
    assert loop.drive(work, work[:0], p, h, n, n + 1, n + 1) == n
    return np.array((method.leave or (lambda s, h, p: s))(tuple(work), h, tuple(p)))


def test_every_hk_and_midpoint_rule_has_the_option() -> None:
    compensated = {
        (scheme.name, scheme.top) for scheme in all_schemes() if "compensated" in scheme.options.model_fields
    }
    assert compensated == {(scheme.name, scheme.top) for scheme in all_schemes() if scheme.name in ("hk", "midpoint")}


def test_carried_sum_returns_the_lost_part() -> None:
    """Exactly, where the change is the smaller one; else up to the last bit of the change."""
    random = np.random.default_rng(5)
    for y, d, e in zip(*random.normal(size=(3, 2000)), strict=True):
        for size in (1.0, 1e-3, 1e-9):
            t = d * size + e * 1e-17
            s, r = compensated_sum(y, e * 1e-17, d * size)
            assert s == y + t
            lost = Fraction(y) + Fraction(t) - Fraction(s)
            if abs(t) <= abs(y):
                assert Fraction(r) == lost
            else:
                assert abs(Fraction(r) - lost) <= math.ulp(t)


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
        precise = ExactStep(Subject(scheme, top, scheme.options()), floating(133))
        for y0 in [gen(top), tuple(random_states(1, seed=8)[0, : len(top.components)].tolist())]:
            plain, better = errors("hk", top, y0, h, precise(y0, *[h] * n), n)
            assert better < 3.0, (top, y0)
            ratios.append(plain / better)
    assert np.median(ratios) > 4.0


def test_composed_hk_against_forty_digits() -> None:
    """A compensated base composes: the stages hand on what was lost."""
    hk, top, h, n = find_scheme("hk", "kowalevski"), Kowalevski(), 0.1, 3
    precise = ExactStep(Subject(hk, top, hk.options()), floating(133))
    exact = precise(GEN, *[weight * h for weight in COMPOSITIONS["kahan-li8"].weights] * n)
    plain, better = errors("hk+kahan-li8", top, GEN, h, exact, n)
    assert better < 10.0
    assert plain > 3.0 * better


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


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["hk", "midpoint"])
def test_the_first_step_is_that_of_the_plain_scheme(name: str, form: str) -> None:
    """Up to a rounding: a plain step of HK fuses its last product with the sum. Later steps differ."""
    top = TRIALS[form][-1]
    first, later = ([end(top, name, gen(top), 0.05, n, compensated=c) for c in (False, True)] for n in (1, 200))
    assert np.abs(first[0] - first[1]).max() <= EPS
    assert later[0].tolist() != later[1].tolist()


def test_a_step_that_does_not_converge_is_seen() -> None:
    """Compensated or not: the midpoint rule has no solution at such a step."""
    y0, h = (9.0, -8.0, 7.0, 0.6, 0.48, 0.64), 11.0
    top = TOPS["heavy"].model_validate({"A": 3.0, "B": 2.0, "C": 1.2, "x0": 40.0, "y0": -30.0, "z0": 60.0})
    endings = [ran(made(top, "midpoint", compensated=c), y0, h, 1000, 1, top)[1] for c in (False, True)]
    assert {(ending.outcome, ending.step) for ending in endings} == {(Outcome.NO_CONVERGENCE, endings[0].step)}
