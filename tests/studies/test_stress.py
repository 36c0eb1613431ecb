"""The hard cases: states are as described, checks distinguish good from bad, and limits match the outcomes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.figure import Figure

from cases import table_of
from declared import Heavy
from topcli.analysis.reference import reference_states
from topcli.contracts import Array, Ending, Floats, Invariant, Outcome, Top
from topcli.engine.drive import Orbit
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.stress import (
    CASES,
    LIMIT,
    OK,
    OUTLIVED,
    TOP,
    UNEXPLAINED,
    Check,
    Finding,
    Trial,
    cases_of,
    forms_with_cases,
    keeps_order,
    report_of,
    returns,
    singular_step,
    stays_bounded,
    stress,
    swing_time,
    swings,
    verdict_of,
)
from topcli.testing import GENERIC
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

EPS = 2.0**-52


def finding(case: str, scheme: str, **traits: Any) -> Finding:
    """Finding of the case for the scheme, of which ``traits`` change the declaration; ``N`` is the number of steps."""
    hard = cases_of("kowalevski")[case]
    experiment = hard.experiment(scheme)
    changes = {"N": traits.pop("N")} if "N" in traits else {}
    trial = Trial(experiment.model_copy(update={**changes, "scheme": replace(experiment.scheme, **traits)}))
    return hard.check(trial)


# the states


@pytest.mark.parametrize(
    ("name", "components", "values"),
    table_of("""
pole          (3, 4, 5)  (0.0, 0.0, -1.0)
branch-point  (0, 1)     (0.0, 0.0)
real-axis     (0, 1)     (-0.8, 0.0)
"""),
)
def test_motions_pass_the_hard_place_on_a_step(name: str, components: tuple[int, ...], values: Floats) -> None:
    experiment = CASES["kowalevski"][name].experiment("hk")
    assert 1.0 / experiment.h == round(1.0 / experiment.h)
    state = reference_states(experiment.top, experiment.y0, np.array([1.0]))[0]
    assert state[list(components)] == pytest.approx(values, abs=4e-15)


@pytest.mark.parametrize("top", [Kowalevski(c0=2.0), Euler(), Heavy(), Lagrange(mu=2.0)], ids=repr)
def test_singular_steps_are_singular(top: Top) -> None:
    """Kahan's matrix 1 - h/2 f'(y), by complex steps from the field itself, has a kernel."""
    state = GENERIC[: len(top.components)]

    def least(h: float) -> float:
        columns = []
        for i in range(len(state)):
            z = [complex(value) for value in state]
            z[i] += 1e-200j
            columns.append([value.imag / 1e-200 for value in map(complex, type(top).field(tuple(z), top.constants()))])  # pyright: ignore
        return float(np.linalg.svd(np.eye(len(state)) - 0.5 * h * np.array(columns).T, compute_uv=False)[-1])

    h = singular_step(top, state)
    assert least(h) < 1e-14
    assert 0.012 < least(0.9 * h) < 0.18


def test_the_theory_of_the_swings() -> None:
    """The reference swings when sqrt 2 ln(8 sqrt 7/eps) says, to the first order in eps."""
    for eps in (1e-3, 1e-6):
        t = swing_time(eps) + np.linspace(-0.01, 0.01, 201)
        y = reference_states(TOP, (2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps), t)
        slope = y[:, 4] * y[:, 2] - y[:, 5] * y[:, 1]  # gamma1'
        assert abs(float(np.interp(0.0, slope, t)) - swing_time(eps)) < 3.0 * eps


# the checks, each on schemes and on motions made up just inside and just outside of each threshold


@pytest.mark.parametrize(
    ("case", "scheme", "changes", "outcome", "step", "why"),
    table_of("""
pole                bohlin-b              {}                                     broke        59      blew up at step
pole                hk                    {"order": 3}                           degraded     None    order is 3
real-axis           bohlin-a:branch=sign  {}                                     broke        50      ""
backwards           rk2                   {"adaptive": True}                     degraded     None    ""
backwards           rk4                   {"conserves": ["gamma_sq"]}            broke        200     γ² is off by
homoclinic-spacing  bohlin-a              {}                                     broke        15297   after t = 15.2967
there-and-back      hybrid                {"self_adjoint": True}                 broke        200000  declared self
"""),
)
def test_checks_distinguish_what_holds_from_what_does_not(
    case: str, scheme: str, changes: dict[str, Any], outcome: str, step: int | None, why: str
) -> None:
    """With other options, another declaration or fewer steps; at 15297 is the first swing of the paper's Figure 2."""
    measured = finding(case, scheme, **changes)
    assert measured.outcome == outcome
    assert step in (None, measured.step)
    assert why in measured.why


@dataclass
class MadeUp:
    """A trial whose runs are made up: ``moves(n, h)`` gives the states (m, d) at the steps n."""

    moves: Any
    exact: Any = lambda t: np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)
    N: int = 100
    h: float = 0.1
    order: int | None = 2
    claims: tuple[Invariant, ...] = ()
    y0: tuple[float, ...] = (1.0, 0.0, 0.0)
    top: Any = field(default_factory=lambda: SimpleNamespace(components=("a", "b", "c"), swing="a", energy="energy"))
    plain: bool = False
    fault = Trial.fault

    @property
    def scheme(self) -> Any:
        return SimpleNamespace(adaptive=False, self_adjoint=True)

    @property
    def experiment(self) -> Any:
        return SimpleNamespace(h=self.h)

    def run(self, h: float | None = None, N: int | None = None, every: int = 1, y0: Any = None) -> Orbit:
        h, N = h or self.h, N or self.N
        n = np.arange(0, N + 1, every, dtype=np.int64)
        return Orbit(n, self.moves(n, h), Ending(Outcome.COMPLETED, N, N * h))

    def reference(self, h: float, n: Array) -> Array:
        return self.exact(n * h)

    def claimed(self, h: float) -> list[Invariant]:
        return list(self.claims)


def off_by(error: Callable[[float], float], **changes: Any) -> MadeUp:
    """The reference motion with ``error(h)`` in its first component from the first step on."""
    trial = MadeUp(None, **changes)
    trial.moves = lambda n, h: trial.exact(n * h) + np.where(n > 0, error(h), 0.0)[:, None] * [1.0, 0.0, 0.0]
    return trial


def turning(late: float, size: float = 1.0, N: int = 6000) -> MadeUp:
    """Swings of this size, the first of which is due at pi, later by this part."""
    return MadeUp(lambda n, h: size * np.cos(np.outer(n * h / (1.0 + late), [1.0, 0.0, 0.0])), N=N, h=0.001)


def once_as_large(largest: float) -> MadeUp:
    """The motion's size is that of its largest component over ten time scales: 1 here."""
    return MadeUp(lambda n, h: np.where(n == 30, largest, 1.0)[:, None] * np.array([1.0, 0.2, 0.1]))


def not_quite_back(missed: float) -> MadeUp:
    """Missed by this many ulp of the state, which is 2, times sqrt(N) + h N^1.5."""
    N, h, size = 400, 0.1, 2.0
    off = missed * EPS * (math.sqrt(N) + h * N**1.5) * size

    def moves(n: Array, h: float) -> Array:
        return np.tile([size, off if h < 0.0 else 0.0, 0.0], (len(n), 1))

    return MadeUp(moves, N=N, h=h, y0=(size, 0.0, 0.0))


SERIES = Invariant("x", "x", "x", "a series", lambda y: y[:, 0], lambda y: np.full(len(y), 32.0))


def claim_off(units: float) -> MadeUp:
    """A claim that is once off by this many times 50 ulp of its terms times sqrt(N)."""
    off = units * 50.0 * EPS * 32.0 * math.sqrt(100.0)
    return MadeUp(lambda n, h: np.where(n == 64, 1.0 + off, 1.0)[:, None] * np.ones(3), claims=(SERIES,))


def swings_late(due: float, spacing: bool = False) -> Check:
    return lambda trial: swings(trial, due, spacing)


def keeps_claims(trial: Trial) -> Finding:
    return trial.fault(trial.run(), trial.h) or Finding("held", "")


FIRST, SECOND = swings_late(math.pi), swings_late(2.0 * math.pi, spacing=True)
THRESHOLDS: dict[str, tuple[Check, Callable[[float], MadeUp], float, str, str]] = {
    "error of half the size": (keeps_order, lambda x: off_by(lambda h: x * (h / 0.1) ** 2), 0.5, "held", "broke"),
    "order short by 0.35": (keeps_order, lambda x: off_by(lambda h: 1e-3 * h ** (2.0 - x)), 0.35, "held", "degraded"),
    "error of a closed form": (keeps_order, lambda x: off_by(lambda h: x, order=None), 1e-10, "held", "degraded"),
    "swing a hundredth late": (FIRST, turning, 0.01, "held", "degraded"),
    "swing a tenth late": (FIRST, turning, 0.1, "degraded", "broke"),
    "swing of half a unit": (FIRST, lambda x: turning(0.0, 0.5 * x), 0.5, "broke", "held"),
    "twice the size": (stays_bounded, once_as_large, 2.0, "held", "degraded"),
    "a hundred times the size": (stays_bounded, once_as_large, 100.0, "degraded", "broke"),
    "return missed": (returns, not_quite_back, 4.0, "held", "broke"),
    "spacing a hundredth long": (SECOND, lambda x: turning(x, N=16_000), 0.01, "held", "degraded"),
    "claim that is lost": (keeps_claims, claim_off, 1.0, "held", "broke"),
}
"""A check, the motion of a size, the size of the threshold, and the outcomes 2 % below and above it."""


@pytest.mark.parametrize("name", THRESHOLDS)
def test_outcomes_change_at_their_thresholds(name: str) -> None:
    check, motion, size, below, above = THRESHOLDS[name]
    assert [check(cast(Trial, motion(factor * size))).outcome for factor in (0.98, 1.02)] == [below, above]


# limits


@pytest.mark.slow
def test_what_breaks_is_declared_and_what_is_declared_breaks() -> None:
    """All schemes of the tops with cases of their own, in all cases."""
    report = stress()
    assert report.errors == []
    assert report.code == 0
    rows = report.tables[0].rows
    assert sum(row["verdict"] == LIMIT for row in rows) > 80
    tried = {(row["scheme"], row["top"], row["case"]) for row in rows}
    forms = forms_with_cases()
    schemes = [scheme for scheme in all_schemes() if scheme.top in forms]
    assert tried == {(scheme.name, scheme.top, case) for scheme in schemes for case in cases_of(scheme.top)}
    assert {row["outcome"] for row in report.tables[1].rows} == {"degraded", "broke", "not tried"}


def test_verdicts_compare_outcomes_with_limits() -> None:
    hk = find_scheme("hk", "kowalevski")
    assert verdict_of(hk, "huge", "broke") == UNEXPLAINED
    assert verdict_of(hk, "resonance", "broke") == LIMIT
    assert verdict_of(hk, "resonance", "degraded") == OUTLIVED
    assert verdict_of(hk, "huge", "degraded") == OK
    assert verdict_of(replace(hk, name="hk+suzuki4"), "resonance", "held") == OK


# the study


def test_the_picture_marks_what_did_not_hold() -> None:
    outcomes = {"rk2": ("held", "broke", "held"), "hk": ("held", "degraded", "not tried"), "rk4": ("held",) * 3}
    row = {"top": "kowalevski", "step": None, "verdict": OK, "why": ""}
    rows = [
        {**row, "scheme": s, "case": c, "outcome": o}
        for s, of in outcomes.items()
        for c, o in zip("abc", of, strict=True)
    ]
    lines = report_of(rows).plot(Figure().add_subplot()).get_lines()
    assert [(line.get_label(), line.get_marker(), line.get_color(), line.get_xydata().tolist()) for line in lines] == [
        ("held", ".", "0.6", [[1.0, 0.0]]),
        ("not tried", "_", "0.6", [[1.0, 1.0]]),
        ("degraded", "o", "C1", [[0.0, 1.0]]),
        ("broke", "X", "C3", [[0.0, 0.0]]),
    ]


def test_trials_are_counted_and_options_are_set(cli: Any) -> None:
    cases = ("--case", "huge", "--case", "pole")
    document = cli("stress", "hk", "Hybrid-Sym", "--top", "kowalevski", *cases, "--json").json()
    assert document["answer"] == (
        "4 trials: 3 held, 1 broke; 1 at declared limits; none contradicts what the schemes declare"
    )
    signed = cli("stress", "bohlin-a:branch=sign", "--case", "real-axis")
    assert signed.code == 4
    assert "error: bohlin-a:branch=sign (kowalevski), case real-axis: breaks without a declared limit" in signed.err
