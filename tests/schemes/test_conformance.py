"""Declared traits of every scheme hold, with every choice of its options and composed; its machine code is its step.

Each measure of ``conformance`` comes with positive controls: methods without the trait, by the value that they miss.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from conformance import (
    Subject,
    choices,
    errors_after,
    exactness,
    ladder,
    order_of,
    reversal_defect,
    states_of,
    subjects,
    working_states,
)
from conftest import GEN
from declared import SCHEMES, TRIALS, by_name, gen
from kick_turn import KICK_TURN
from steppers import EULER, RK2, rk2
from topcli.analysis.order import reversal
from topcli.analysis.tally import invariant_report
from topcli.contracts import Method, Scheme, Stepper, Top
from topcli.engine.loop import Run
from topcli.schemes.compose import COMPOSITIONS, compose, composed_step
from topcli.schemes.kowalevski.hk import hk_kowalevski
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski

HK = find_scheme("hk", "kowalevski")
SPLIT = replace(
    HK, name="kick-turn", conserves=("gamma_sq",), build=lambda top, options: KICK_TURN, doc="A turn between kicks."
)
"""A scheme that is not topcli's own."""
SUBJECTS = [
    subject for scheme in (SPLIT, *SCHEMES) for subject in subjects(scheme, TRIALS[scheme.top][:2], tuple(COMPOSITIONS))
]
DOUBLED = (25, 50, 100, 200, 400, 800, 1600)
WEIGHTS = {name: composition.weights for name, composition in COMPOSITIONS.items()}


def cases(*chosen: Subject) -> Any:
    """Test cases of the subjects; those of compositions are slow."""
    marked = [pytest.param(s, id=str(s), marks=[pytest.mark.slow] if s.stages > 1 else []) for s in chosen]
    return pytest.mark.parametrize("subject", marked)


@by_name
def test_registration_is_complete(scheme: Scheme) -> None:
    assert scheme.name == scheme.name.lower()
    assert scheme.top in TOPS
    assert scheme.title
    assert scheme.doc
    assert scheme.citation
    assert scheme.equations
    known = {invariant.name for invariant in TOPS[scheme.top]().invariants()}
    assert set(scheme.conserves) <= known
    assert all(field.description for field in scheme.options.model_fields.values())


def test_names_are_unique() -> None:
    keys = [(scheme.name, scheme.top) for scheme in SCHEMES]
    assert len(set(keys)) == len(keys)


@cases(*(subject for subject in SUBJECTS if not subject.scheme.adaptive))
def test_declared_order_is_observed(subject: Subject) -> None:
    """That of compositions between 1e-3 and round-off; the adaptive schemes are tried in ``test_baselines``."""
    order = subject.scheme.order_for(subject.options)
    if order is None:
        assert max(errors_after(subject.top, subject.method, 2.0, [1, 7, 300])) < 1e-14
    else:
        assert order_of(subject.top, subject.method, **ladder(subject)) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize(
    ("top", "method", "order", "counts"),
    [
        (Kowalevski(), EULER, 1.0, DOUBLED),
        (Kowalevski(), RK2, 2.0, DOUBLED),
        (Euler(), rk2(Euler()), 2.0, DOUBLED),
        (Kowalevski(), Stepper(composed_step(RK2.step, WEIGHTS["kahan-li8"]), 6), 3.0, [160, 226, 320]),
    ],
    ids=["Euler's rule", "midpoint", "midpoint of three", "composed without self-adjointness"],
)
def test_order_control(top: Top, method: Method, order: float, counts: Any) -> None:
    assert order_of(top, method, 2.0, counts) == pytest.approx(order, abs=0.1)


def test_exact_solution_control() -> None:
    assert min(errors_after(Euler(), rk2(Euler()), 2.0, [1, 7, 300])) == pytest.approx(3.51e-06, rel=0.05)


@pytest.mark.slow
@cases(*(subject for subject in SUBJECTS if not subject.scheme.adaptive and subject.top == TRIALS[subject.top.form][0]))
def test_declared_self_adjointness(subject: Subject) -> None:
    """One step there and back: round-off for a self-adjoint scheme at every h, visibly more for the others."""
    scheme, count = subject.scheme, 12 if subject.stages == 1 else 8
    fine = subject.stages > 1 and scheme.name.startswith(("dmv", "splitting"))
    sizes = (0.05, 0.02, 0.01) if fine else (0.2, 0.1, 0.05)
    defects = [reversal_defect(subject.top, subject.method, h, count) for h in sizes]
    if scheme.self_adjoint:
        # a closed form has the round-off of two states, not of small increments: 1.1e-14 at |omega| = 3 for the
        # Kowalevski top, whose gamma is a difference of terms of the size of |omega|²
        assert max(defects) < (3e-14 if scheme.order is None else 1e-14)
    else:
        assert 3.8e-8 < min(defects) < 0.13
        assert max(defects) < 10.0  # 3.3 at most; a step that fails has an infinite one


@pytest.mark.parametrize(
    ("top", "method", "count", "defect"),
    [
        (Kowalevski(), RK2, 12, 1.04e-3),
        (Euler(), rk2(Euler()), 12, 2.02e-3),
        (Kowalevski(), Stepper(composed_step(RK2.step, WEIGHTS["suzuki4"]), 6), 8, 6.4e-4),
        (Kowalevski(), Stepper(composed_step(hk_kowalevski, tuple(sorted(WEIGHTS["suzuki4"]))), 6), 8, 6.0e-5),
    ],
    ids=["midpoint", "midpoint of three", "composed midpoint", "weights that are no palindrome"],
)
def test_self_adjointness_control(top: Top, method: Method, count: int, defect: float) -> None:
    assert reversal_defect(top, method, 0.1, count) == pytest.approx(defect, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "top"),
    [(scheme, top) for scheme in SCHEMES if scheme.conserves for top in TRIALS[scheme.top]],
    ids=lambda value: f"{value.name}/{value.top}" if isinstance(value, Scheme) else repr(value),
)
def test_declared_invariants_are_exact(scheme: Scheme, top: Top) -> None:
    """Round-off and no more, on several tops, states and step sizes."""
    method = scheme.build(top, scheme.options())
    for y0, h in zip([gen(top), *states_of(top, 3, seed=11)], (0.1, 0.05, 0.01, 0.002), strict=True):
        assert exactness(top, method, y0, h, scheme.conserves) < 1.0


@cases(*(subject for subject in SUBJECTS if subject.stages > 1 and subject.scheme.conserves))
def test_compositions_conserve_what_their_base_does(subject: Subject) -> None:
    """The longest stage is no longer than what the iterations of the implicit bases settle for."""
    scheme, top, split = subject.scheme, subject.top, subject.scheme.name.startswith(SPLIT.name)
    longest = max(map(abs, WEIGHTS[scheme.name.rpartition("+")[2]]))
    for h in (0.5 if split else 0.2 / longest, 0.03):
        given = (top, subject.method, gen(top), h)
        assert exactness(*given, scheme.conserves, 4000, subject.stages) < 1.0
        for other in {one.name for one in top.invariants()} - set(scheme.conserves) if split and h == 0.5 else ():
            assert exactness(*given, [other], 4000, subject.stages) > 100.0


@pytest.mark.parametrize("top", [*TRIALS["kowalevski"], *TRIALS["euler"], *TRIALS["euler+gamma"][:2]], ids=repr)
def test_exactness_control(top: Top) -> None:
    """The explicit midpoint rule, at a small step, fails the same test by far."""
    for name in {"kowalevski": ("gamma_sq", "k_sq")}.get(top.form, [one.name for one in top.invariants()]):
        assert 410000.0 < exactness(top, rk2(top), gen(top), 0.01, (name,)) < 5.9e8


@cases(*(subject for subject in SUBJECTS if isinstance(subject.method, Stepper) and not subject.method.plain))
def test_machine_code_is_the_step(subject: Subject) -> None:
    """The same arithmetic, bit for bit, in all slots of the working state and in the recorded states."""
    method, N = subject.method, 100 if subject.stages == 1 else 30
    assert isinstance(method, Stepper)
    plain, compiled, states = working_states(subject.top, method, 0.02, N)
    assert compiled == plain
    n, recorded, _ = Run(subject.top, method, gen(subject.top), 0.02, N).collect()
    assert n.tolist() == list(range(N + 1))
    assert np.array_equal(recorded, [gen(subject.top), *states])


def test_machine_code_control() -> None:
    """Another order of two sums is seen."""

    def step(s: Any, h: float, p: Any) -> Any:
        return (s[0] * (1.0 + h * s[1]), s[1], s[2], s[3], s[4], s[5])

    def other(s: Any, h: float, p: Any) -> Any:
        return (s[0] + s[0] * (h * s[1]), s[1], s[2], s[3], s[4], s[5])

    assert (
        working_states(Kowalevski(), Stepper(step, 6), 0.02, 100)[0]
        != working_states(Kowalevski(), Stepper(other, 6), 0.02, 100)[1]
    )


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [s for s in SCHEMES if not s.adaptive], ids=lambda s: f"{s.name}/{s.top}")
def test_reversal_order_is_reported(scheme: Scheme) -> None:
    """The study's own measure: no order for a self-adjoint scheme, at least order + 1 for the others."""
    top = TOPS[scheme.top]()
    found = reversal(top, scheme.build(top, scheme.options()), states_of(top, 6, seed=5), 1e-3)
    if scheme.self_adjoint:
        assert found.order is None
        assert found.defect < 1e-14
    else:
        assert found.order is not None
        assert scheme.order is not None
        assert found.order > scheme.order + 0.8


@pytest.mark.parametrize(
    ("h", "sizes"), [(0.05, (0.05, 0.1, 0.2, 0.4)), (-0.05, (0.05, 0.1, 0.2, 0.4)), (0.3, (0.0375, 0.075, 0.15, 0.3))]
)
def test_the_reversal_defect_is_that_of_the_step_itself(h: float, sizes: tuple[float, ...]) -> None:
    """The largest component missed over the states, at h and along the ladder, by the step called here."""
    top, states = Kowalevski(), states_of(Kowalevski(), 5, seed=8)
    p = top.constants()

    def missed(size: float) -> float:
        there = [RK2.step(tuple(y), size, p) for y in states]
        return max(
            np.abs(np.array(RK2.step(y, -size, p)) - start).max() for y, start in zip(there, states, strict=True)
        )

    found = reversal(top, RK2, np.array(states), h)
    assert (found.h, found.sizes) == (abs(h), pytest.approx(sizes))
    assert found.defect == missed(abs(h))
    assert found.defects == tuple(map(missed, found.sizes))
    assert len(set(found.defects)) == 4


def test_verdict_exact_needs_the_declared_invariants_only() -> None:
    """HK's report does not call k² exact; a constant series is."""
    top = Kowalevski()
    n, states, _ = Run(top, HK.build(top, HK.options()), GEN, 0.05, 4000).collect()
    assert {row.verdict for row in invariant_report(top.invariants(), n, 0.05, states)} == {"bounded"}
    still = np.repeat(states[:1], len(n), axis=0)
    assert {row.verdict for row in invariant_report(top.invariants(), n, 0.05, still)} == {"exact"}


def test_choices_leave_out_what_a_top_refuses() -> None:
    dmv = find_scheme("dmv", "heavy")
    assert [options.model_dump(exclude_defaults=True) for options in choices(dmv, TOPS["heavy"].new())] == [
        {},
        {"compensated": True},
    ]
    assert compose(SPLIT, "suzuki4").name == "kick-turn+suzuki4"
