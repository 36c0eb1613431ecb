"""Sums whose rounding errors are carried along: against iterates with 40 digits, and what must not change."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import declared
from conformance import ExactStep, Subject
from conftest import GEN, random_states
from declared import TRIALS, gen
from stepping import root_mean_square
from topcli.arithmetic.fused import compensated_sum
from topcli.contracts import Scheme, Stepper, Top
from topcli.engine.loop import loop_of
from topcli.engine.precise_numbers import Floating
from topcli.schemes.compose import COMPOSITIONS, compose
from topcli.schemes.kowalevski.hk import hk_kowalevski_change, hk_kowalevski_compensated
from topcli.schemes.layout import CompensatedOption, stepper
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.kowalevski import Kowalevski

EPS = 2.0**-52
SCHEMES = [one for one in declared.SCHEMES if "compensated" in one.options.model_fields]
by_name = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda one: f"{one.name}/{one.top}")


def built(scheme: Scheme, top: Top, compensated: bool) -> Stepper:
    made = scheme.build(top, scheme.options(compensated=compensated))
    assert isinstance(made, Stepper)
    return made


class Driven:
    """A stepper with its working state, driven step by step through the engine's loop."""

    def __init__(self, made: Stepper, top: Top, y0: Any, h: float = 0.01) -> None:
        self.p = np.array(top.constants())
        self.loop = loop_of(made, len(y0), len(self.p))
        self.work, self.y0 = np.zeros(self.loop.width), np.array(y0, dtype=float)
        self.leave = made.leave or (lambda s, h, p: s)
        self.loop.enter(self.y0, self.work, self.p, h)

    def drive(self, h: float, n: int) -> np.ndarray:
        assert self.loop.drive(self.work, self.work[:0], self.p, h, n, n + 1, n + 1) == n
        return np.array(self.leave(tuple(self.work), h, tuple(self.p)))


def test_every_hk_and_the_hybrids_have_the_option() -> None:
    found = {(one.name, one.top) for one in SCHEMES}
    assert {(one.name, one.top) for one in declared.SCHEMES if one.name in ("hk", "midpoint")} <= found
    assert {("hybrid-xi", "kowalevski"), ("hybrid-sym", "kowalevski"), ("bs", "euler")} <= found
    assert all(issubclass(one.options, CompensatedOption) and one.options().compensated is False for one in SCHEMES)


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


def errors(scheme: Scheme, top: Top, y0: Any, h: float, exact: list[Fraction], n: int) -> tuple[float, float]:
    """Errors of plain and compensated HK after n steps, in units of the last bit of 1."""
    ends = [Driven(built(scheme, top, compensated), top, y0).drive(h, n) for compensated in (False, True)]
    plain, better = (max(abs(float(Fraction(a) - b)) for a, b in zip(end.tolist(), exact, strict=True)) for end in ends)
    return plain / EPS, better / EPS


@pytest.mark.slow
@pytest.mark.parametrize("form", ["kowalevski", "euler", "euler+gamma", "lagrange", "heavy"])
def test_hk_against_forty_digits(form: str) -> None:
    """After 150 steps the plain form is off by many ulp, the compensated one by hardly more than its rounding."""
    scheme, h, n, ratios = find_scheme("hk", form), 0.01, 150, []
    for top in TRIALS[form][:2]:
        precise = ExactStep(Subject(scheme, top, scheme.options()), Floating(133))
        for y0 in [gen(top), tuple(random_states(1, seed=8)[0, : len(top.components)].tolist())]:
            plain, better = errors(scheme, top, y0, h, precise(y0, *[h] * n), n)
            assert better < 3.0, (top, y0)
            ratios.append(plain / better)
    assert np.median(ratios) > 4.0


def test_composed_hk_against_forty_digits() -> None:
    """A compensated base composes: the stages hand on what was lost."""
    hk, top, h, n = find_scheme("hk", "kowalevski"), Kowalevski(), 0.1, 3
    precise = ExactStep(Subject(hk, top, hk.options()), Floating(133))
    exact = precise(GEN, *[weight * h for weight in COMPOSITIONS["kahan-li8"].weights] * n)
    plain, better = errors(compose(hk, "kahan-li8"), top, GEN, h, exact, n)
    assert better < 10.0
    assert plain > 3.0 * better


def test_gammas_change_is_more_than_a_double() -> None:
    """One Kowalevski step from y + e: gamma is off by h times what carried sums alone, the control, leave."""
    h, p, random, hk = 0.01, (1.0,), np.random.default_rng(4), find_scheme("hk", "kowalevski")
    exactly = ExactStep(Subject(hk, Kowalevski(), hk.options()))
    steps = (hk_kowalevski_compensated, stepper(hk_kowalevski_change, 6, lost=range(6)).step)
    misses: list[list[float]] = [[], []]
    for y0 in random_states(40, seed=9).tolist():
        e0 = (1e-17 * random.normal(size=6)).tolist()
        exact = exactly([Fraction(y) + Fraction(e) for y, e in zip(y0, e0, strict=True)], h)
        for step, found in zip(steps, misses, strict=True):
            s = step((*y0, *e0), h, p)
            found += [float(Fraction(s[i]) + Fraction(s[i + 6]) - exact[i]) for i in (3, 4, 5)]
    refined, plain = map(root_mean_square, map(np.array, misses))
    assert 0.5 * h * EPS < plain < 2.0 * h * EPS
    assert refined < 2.0 * h * plain


CARRIED = {
    **{f"{name}/euler": (range(3), range(3, 6)) for name in ("hk", "bs", "bs-implicit", "midpoint")},
    **{f"{name}/euler+gamma": (range(6), range(6, 12)) for name in ("hk", "bs", "bs-implicit", "midpoint")},
    **{f"hk/{top}": (range(6), range(6, 12)) for top in ("kowalevski", "heavy")},
    "hk/lagrange": ((0, 1, 3, 4, 5), range(6, 11)),
    **{f"midpoint/{top}": (range(6), range(6, 12)) for top in ("kowalevski", "heavy")},
    "midpoint/lagrange": ((0, 1, 3, 4, 5), (6, 7, 9, 10, 11)),
    **{f"splitting/{top}": (range(6), range(12, 18)) for top in ("kowalevski", "heavy")},
    "hybrid-xi/kowalevski": (range(2, 8), range(10, 16)),
    "hybrid-sym/kowalevski": (range(2, 8), range(10, 16)),
    "backlund/kowalevski": (range(6), range(7, 13)),
}
"""Slots of the working state that are sums, and those of what they have lost."""


@pytest.mark.parametrize("name", CARRIED)
def test_every_sum_is_carried_on(name: str) -> None:
    """A quarter of a last bit lost by one component before a step is in its sum after it; none is dropped."""
    scheme, top = find_scheme(*name.split("/")), TOPS[name.split("/")[1]].new()
    made = built(scheme, top, True)
    assert made.enter is not None
    p, h = made.parameters(top), 0.01
    start = made.step(made.enter(gen(top), h, p), h, p)
    sums, lost = CARRIED[name]

    def after(s: tuple[float, ...], i: int, j: int) -> Fraction:
        new = made.step(s, h, p)
        return Fraction(new[i]) + Fraction(new[j])

    further = made.step(start, h, p)
    for i, j in zip(sums, lost, strict=True):
        assert further[j] != start[j], i
        bit = 0.25 * math.ulp(start[i])
        moved = (*start[:j], start[j] + bit, *start[j + 1 :])
        assert float(after(moved, i, j) - after(start, i, j)) / bit == pytest.approx(1.0, rel=0.1), i


@pytest.mark.slow
@by_name
def test_plain_is_old_plus_change(scheme: Scheme) -> None:
    """From a fresh start the first step is the same with and without compensation, bit for bit; later ones differ.

    hybrid-xi takes a mean as 2 omega + change instead of omega + omega', which is better by a rounding; the plain step
    of backlund fuses the last product of the change with the sum.
    """
    top = TRIALS[scheme.top][-1]
    plain, better = (Driven(built(scheme, top, compensated), top, gen(top), 0.05) for compensated in (False, True))
    close = {"hybrid-xi", "backlund"}
    same = (lambda a, b: np.abs(a - b).max() <= EPS) if scheme.name in close else np.array_equal
    assert same(plain.drive(0.05, 1), better.drive(0.05, 1))
    assert plain.drive(0.05, 200).tolist() != better.drive(0.05, 200).tolist()
