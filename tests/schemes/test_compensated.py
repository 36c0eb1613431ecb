"""Sums whose rounding errors are carried along: against iterates with 40 digits, and what must not change."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpf

from conftest import GEN, PAPER, random_states
from declared import TRIALS, gen
from topcli.arithmetic.fused import compensated_sum
from topcli.config.load import load_experiment
from topcli.contracts import Outcome, Scheme, Stepper, Top
from topcli.engine.driver import loop_of, plain_loop
from topcli.engine.loop import Run
from topcli.errors import ConfigError
from topcli.schemes.compose import COMPOSITIONS, compose
from topcli.schemes.kowalevski.hk import hk_kowalevski_change, hk_kowalevski_compensated
from topcli.schemes.layout import CompensatedOption, stepper
from topcli.schemes.registry import all_schemes, composable_names, find_scheme
from topcli.tops import TOPS
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from twins import solve

EPS = 2.0**-52
SCHEMES = [one for one in all_schemes() if "compensated" in one.options.model_fields]
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
    assert {(one.name, one.top) for one in all_schemes() if one.name in ("hk", "midpoint")} <= found
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


def kahan(field: Callable[..., Any], y: list[Any], h: Any, p: Any) -> list[Any]:
    """Kahan's method for any quadratic field: (I - h/2 f'(y)) (y' - y) = h f(y), the derivative by differences."""
    d = len(y)
    columns = []
    for i in range(d):
        up, down = ([v + s * (i == j) for j, v in enumerate(y)] for s in (1, -1))
        columns.append([(a - b) / 2 for a, b in zip(field(up, p), field(down, p), strict=True)])
    matrix = [[(i == j) - h / 2 * columns[j][i] for j in range(d)] for i in range(d)]
    return [a + b for a, b in zip(y, solve(matrix, [h * f for f in field(y, p)]), strict=True)]


def errors(scheme: Scheme, top: Top, y0: Any, h: float, exact: list[Any], n: int) -> tuple[float, float]:
    """Errors of plain and compensated HK after n steps, in units of the last bit of 1."""
    ends = [Driven(built(scheme, top, compensated), top, y0).drive(h, n) for compensated in (False, True)]
    plain, better = (max(abs(float(mpf(float(a)) - b)) for a, b in zip(end, exact, strict=True)) / EPS for end in ends)
    return plain, better


@pytest.mark.slow
@pytest.mark.parametrize("form", ["kowalevski", "euler", "euler+gamma", "lagrange", "heavy"])
def test_hk_against_forty_digits(form: str) -> None:
    """After 150 steps the plain form is off by many ulp, the compensated one by hardly more than its rounding."""
    found = find_scheme("hk", form)
    h, n = 0.01, 150
    ratios = []
    for top in TRIALS[form][:2]:
        for y0 in [gen(top), tuple(random_states(1, seed=8)[0, : len(top.components)])]:
            with mp.workdps(40):
                p, exact = tuple(map(mpf, top.constants())), [mpf(float(v)) for v in y0]
                for _ in range(n):
                    exact = kahan(type(top).field, exact, mpf(h), p)
                plain, better = errors(found, top, y0, h, exact, n)
            assert better < 3.0, (top, y0)
            ratios.append(plain / better)
    assert np.median(ratios) > 4.0


def test_composed_hk_against_forty_digits() -> None:
    """A compensated base composes: the stages hand on what was lost."""
    top, h, n = Kowalevski(), 0.1, 3
    composed = compose(find_scheme("hk", "kowalevski"), "kahan-li8")
    with mp.workdps(40):
        p, exact = (mpf(1),), [mpf(v) for v in GEN]
        for _ in range(n):
            for weight in COMPOSITIONS["kahan-li8"].weights:
                exact = kahan(Kowalevski.field, exact, mpf(weight * h), p)
        plain, better = errors(composed, top, GEN, h, exact, n)
    assert better < 10.0
    assert plain > 3.0 * better


def test_gammas_change_is_more_than_a_double() -> None:
    """One Kowalevski step from y + e: gamma is off by h times what carried sums alone, the control, leave."""
    h, p, random = 0.01, (1.0,), np.random.default_rng(4)
    carried, misses = stepper(hk_kowalevski_change, 6, lost=range(6)).step, {True: [], False: []}
    for y0 in random_states(40, seed=9):
        e0 = 1e-17 * random.normal(size=6)
        with mp.workdps(40):
            exact = kahan(Kowalevski.field, [mpf(y) + mpf(e) for y, e in zip(y0, e0, strict=True)], mpf(h), (mpf(1),))
            for refined, step in ((True, hk_kowalevski_compensated), (False, carried)):
                s = step((*y0.tolist(), *e0.tolist()), h, p)
                misses[refined].append([float(mpf(s[i]) + mpf(s[i + 6]) - exact[i]) for i in (3, 4, 5)])
    refined, plain = (np.sqrt(np.mean(np.square(misses[kind]))) for kind in (True, False))
    assert 0.5 * h * EPS < plain < 2.0 * h * EPS
    assert refined < 2.0 * h * plain


CARRIED = {
    **{f"{name}/euler": (range(3), range(3, 6)) for name in ("hk", "bs", "bs-implicit", "midpoint")},
    **{f"{name}/euler+gamma": (range(6), range(6, 12)) for name in ("hk", "bs", "bs-implicit", "midpoint")},
    **{f"hk/{top}": (range(6), range(6, 12)) for top in ("kowalevski", "heavy")},
    "hk/lagrange": ((0, 1, 3, 4, 5), range(6, 11)),
    **{f"midpoint/{top}": (range(6), range(12, 18)) for top in ("kowalevski", "heavy")},
    "midpoint/lagrange": ((0, 1, 3, 4, 5), (12, 13, 15, 16, 17)),
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
    p, h = top.constants(), 0.01
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
def test_compensated_schemes_can_be_composed(scheme: Scheme) -> None:
    """The option changes nothing about whether a scheme can be composed, and the composed one runs."""
    if scheme.name not in composable_names(scheme.top):
        return
    top = TOPS[scheme.top].new()
    ends = []
    for compensated in (True, False):
        made, p = built(compose(scheme, "suzuki4"), top, compensated), top.constants()
        work = [0.0] * made.width
        enter, drive = plain_loop(made, len(gen(top)), len(p))
        enter(gen(top), work, p, 0.05)
        assert drive(work, [], p, 0.05, 50, 51, 51) == 50
        ends.append(np.array((made.leave or (lambda s, h, p: s))(tuple(work), 0.05, p)))
    assert 0.0 < np.abs(ends[0] - ends[1]).max() < 1e-13


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


@pytest.mark.slow
@by_name
def test_a_run_goes_on_from_its_working_state(scheme: Scheme) -> None:
    top = TRIALS[scheme.top][0]
    made = built(scheme, top, True)
    whole, parts, copied = (Driven(made, top, gen(top), 0.03) for _ in range(3))
    end = whole.drive(0.03, 700)
    parts.drive(0.03, 300)
    copied.work[:] = parts.work
    assert parts.drive(0.03, 400).tolist() == end.tolist()
    assert copied.drive(0.03, 400).tolist() == end.tolist()
    records = {every: list(Run(top, made, gen(top), 0.03, 700, every))[-1].states[-1].tolist() for every in (1, 7, 700)}
    assert all(last == end.tolist() for last in records.values())


@pytest.mark.parametrize(("name", "top"), [("hk", Kowalevski()), ("hybrid-sym", Kowalevski()), ("midpoint", Heavy())])
def test_reversal_comes_closer(name: str, top: Top) -> None:
    """Two thousand steps there and back, with what was lost handed on; the start of a chaotic top lies far back."""
    scheme, misses = find_scheme(name, top.form), {True: [], False: []}
    for y0 in map(tuple, random_states(6, seed=12)):
        for compensated, found in misses.items():
            driven = Driven(built(scheme, top, compensated), top, y0)
            driven.drive(0.01, 2000)
            found.append(np.abs(driven.drive(-0.01, 2000) - np.array(y0)).max())
    assert np.median(misses[True]) < 0.3 * np.median(misses[False])


def deviation(scheme: Scheme, top: Top, y0: Any, compensated: bool, h: float = 0.01, n: int = 1_000_000) -> float:
    """The largest deviation of a claimed invariant over a million steps, in ulp of its terms."""
    run = Run(top, built(scheme, top, compensated), y0, h, n, 500)
    states = run.collect().states
    assert run.ending is not None
    assert run.ending.outcome is Outcome.COMPLETED
    modified = scheme.modified(top, h, scheme.options()) if scheme.modified else ()
    claimed = [one for one in top.invariants() if one.name in scheme.conserves]
    found = [
        np.abs(one.value(states) - one.value(states[:1])).max() / (EPS * one.scale(states).max())
        for one in (*claimed, *modified)
    ]
    return float(max(found))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "form"), [("hk", "lagrange"), ("hk", "euler"), ("bs", "euler+gamma"), ("midpoint", "heavy")]
)
def test_exact_invariants_over_a_million_steps(name: str, form: str) -> None:
    """Within 60 ulp of the terms, where the plain sums, the control, are off by five times as much."""
    scheme, top = find_scheme(name, form), TRIALS[form][1]
    compensated = deviation(scheme, top, gen(top), True)
    assert compensated < 60.0
    assert deviation(scheme, top, gen(top), False) > 5.0 * compensated


@pytest.mark.parametrize("name", ["hybrid-xi", "hybrid-sym"])
@pytest.mark.parametrize("y0", [GEN, PAPER])
def test_hybrids_keep_their_lengths(name: str, y0: Any) -> None:
    """Compensated lengths are also restored: nothing grows."""
    assert deviation(find_scheme(name, "kowalevski"), Kowalevski(), y0, True, n=300_000) < 12.0


@pytest.mark.parametrize("compensated", [True, False])
def test_blow_up_is_found_at_the_same_step(compensated: bool) -> None:
    run = Run(Kowalevski(), built(find_scheme("hk", "kowalevski"), Kowalevski(), compensated), (1e160,) * 6, 0.1, 50)
    assert sum(len(chunk.n) for chunk in run) == 1
    assert run.ending is not None
    assert (run.ending.outcome, run.ending.step) == (Outcome.BLEW_UP, 1)


def test_option_is_accepted_in_a_config() -> None:
    base = {
        "top": "kowalevski",
        "initial": {"omega": [2, 0, 0], "gamma": ["auto", 0, 1e-3]},
        "h": 0.01,
        "N": 10,
    }
    made = load_experiment(base | {"scheme": {"name": "hk", "compensated": True}})
    assert isinstance(made.options, CompensatedOption)
    assert made.options.compensated
    assert made.digest != load_experiment(base | {"scheme": "hk"}).digest
    assert load_experiment(made.resolved()) == made
    assert load_experiment(base | {"scheme": {"name": "hk+kahan-li8", "compensated": True}}).scheme.order == 8
    with pytest.raises(ConfigError, match=r"scheme\.compensated: must be true or false"):
        load_experiment(base | {"scheme": {"name": "hk", "compensated": "yes"}})
    with pytest.raises(ConfigError, match=r"scheme\.compensated: unknown key"):
        load_experiment(base | {"scheme": {"name": "rk4", "compensated": True}})
