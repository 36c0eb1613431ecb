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
    compositions_of,
    errors_after,
    ladder,
    named,
    order_of,
    subjects,
)
from conftest import GEN
from declared import SCHEMES, TRIALS, by_name, gen
from kick_turn import SPLIT
from steppers import EULER, RK2, rk2
from stepping import states_of
from topcli.analysis.conformance import exactness, reversal_defect, working_states
from topcli.analysis.order import reversal
from topcli.contracts import Invariant, Method, Scheme, Stepper, Top
from topcli.engine.collect import orbit
from topcli.schemes.compose import COMPOSITIONS, composed_step
from topcli.schemes.limits import polynomial_invariants
from topcli.schemes.registry import find_scheme
from topcli.tops import TOPS
from topcli.tops.declared import custom_class
from topcli.tops.euler import Euler
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski

HK = find_scheme("hk", "kowalevski")
SUBJECTS = [
    subject
    for scheme in (SPLIT, *SCHEMES)
    for subject in subjects(scheme, TRIALS[scheme.top][:2], compositions_of(scheme))
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
    """That of compositions between 1e-3 and round-off; the adaptive schemes are tried in ``test_adaptive``."""
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
        (Kowalevski(), Stepper(composed_step(RK2.step, WEIGHTS["kahan-li8"], 6), 6), 3.0, [160, 226, 320]),
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
    defects = [reversal_defect(subject.top, subject.method, h, states_of(subject.top, count, seed=3)) for h in sizes]
    if scheme.self_adjoint:
        # a closed form has the round-off of two states, not of small increments: 1.1e-14 at |omega| = 3 for the
        # Kowalevski top, whose gamma is a difference of terms of the size of |omega|²
        assert max(defects) < (3e-14 if scheme.order is None else 1e-14)
    else:
        assert 3.8e-8 < min(defects) < 0.13
        assert max(defects) < 10.0  # 3.3 at most; a step that fails has an infinite one


def uneven_hk() -> Stepper:
    """HK in stages whose lengths are no palindrome."""
    hk = HK.build(Kowalevski(), HK.options())
    assert isinstance(hk, Stepper)
    return replace(hk, step=composed_step(hk.step, tuple(sorted(WEIGHTS["suzuki4"])), hk.width))


@pytest.mark.parametrize(
    ("top", "method", "count", "defect"),
    [
        (Kowalevski(), RK2, 12, 1.04e-3),
        (Euler(), rk2(Euler()), 12, 2.02e-3),
        (Kowalevski(), Stepper(composed_step(RK2.step, WEIGHTS["suzuki4"], 6), 6), 8, 6.4e-4),
        (Kowalevski(), uneven_hk(), 8, 6.0e-5),
    ],
    ids=["midpoint", "midpoint of three", "composed midpoint", "weights that are no palindrome"],
)
def test_self_adjointness_control(top: Top, method: Method, count: int, defect: float) -> None:
    assert reversal_defect(top, method, 0.1, states_of(top, count, seed=3)) == pytest.approx(defect, rel=0.02)


CONSERVING = [
    Subject(scheme, top, options)
    for scheme in SCHEMES
    if scheme.conserves or scheme.modified
    for top in TRIALS[scheme.top]
    for options in (choices(scheme, top) if top is TRIALS[scheme.top][0] else [scheme.options()])
]


@pytest.mark.slow
@pytest.mark.parametrize("subject", CONSERVING, ids=str)
def test_declared_invariants_are_exact(subject: Subject) -> None:
    """Round-off and no more, the modified ones of the scheme too, on several tops, states and step sizes."""
    scheme, top, method = subject.scheme, subject.top, subject.method
    N = 500 if isinstance(method, Stepper) and method.plain else 20_000
    sizes = (0.1, 0.5 if scheme.modified else 0.05, 0.01, 0.002)
    for y0, h in zip([gen(top), *states_of(top, 3, seed=11)], sizes, strict=True):
        assert exactness(top, method, y0, h, watched(subject, h), N) < 1.0


def watched(subject: Subject, h: float) -> list[Invariant]:
    """Invariants that the scheme declares to be exact."""
    modified = subject.scheme.modified(subject.top, h, subject.options) if subject.scheme.modified else ()
    return [*named(subject.top, *subject.scheme.conserves), *modified]


@pytest.mark.parametrize("scheme", [scheme for scheme in SCHEMES if scheme.modified], ids=lambda s: f"{s.name}/{s.top}")
def test_modified_integrals_tend_to_those_of_the_motion(scheme: Scheme) -> None:
    """Their difference falls with h to the order of the scheme."""
    assert scheme.modified is not None
    for top in TRIALS[scheme.top][:2]:
        y, plain = np.array([gen(top)]), {one.name: one for one in top.invariants()}
        gaps = []
        for h in (0.02, 0.01):
            modified = {one.name.removeprefix("modified_"): one for one in scheme.modified(top, h, scheme.options())}
            gaps.append(
                {
                    name: abs(float(modified[name].value(y)[0] - plain[name].value(y)[0]))
                    for name in modified.keys() & plain
                }
            )
        assert gaps[0]
        for name, gap in gaps[0].items():
            assert gap < 0.01
            assert gap < 1e-14 or gap / gaps[1][name] == pytest.approx(2.0**scheme.order, rel=0.02), name


@cases(*(subject for subject in SUBJECTS if subject.stages > 1 and subject.scheme.conserves))
def test_compositions_conserve_what_their_base_does(subject: Subject) -> None:
    """The longest stage is no longer than what the iterations of the implicit bases settle for."""
    scheme, top, split = subject.scheme, subject.top, subject.scheme.name.startswith(SPLIT.name)
    longest = max(map(abs, WEIGHTS[scheme.name.rpartition("+")[2]]))
    for h in (0.5 if split else 0.2 / longest, 0.03):
        given = (top, subject.method, gen(top), h)
        assert exactness(*given, named(top, *scheme.conserves), 4000, subject.stages) < 1.0
        for other in {one.name for one in top.invariants()} - set(scheme.conserves) if split and h == 0.5 else ():
            assert exactness(*given, named(top, other), 4000, subject.stages) > 100.0


@pytest.mark.parametrize("top", [*TRIALS["kowalevski"], *TRIALS["euler"], *TRIALS["euler+gamma"][:2]], ids=repr)
def test_exactness_control(top: Top) -> None:
    """The explicit midpoint rule, at a small step, fails the same test by far."""
    for name in {"kowalevski": ("gamma_sq", "k_sq")}.get(top.form, [one.name for one in top.invariants()]):
        assert 410000.0 < exactness(top, rk2(top), gen(top), 0.01, named(top, name)) < 5.9e8


@pytest.mark.slow
@cases(*(subject for subject in SUBJECTS if isinstance(subject.method, Stepper) and not subject.method.plain))
def test_machine_code_is_the_step(subject: Subject) -> None:
    """The same arithmetic, bit for bit, in all slots of the working state and in the recorded states."""
    method, N = subject.method, 40 if subject.stages == 1 else 12
    assert isinstance(method, Stepper)
    plain, compiled, states = working_states(subject.top, method, gen(subject.top), 0.02, N)
    assert compiled == plain
    n, recorded, _ = orbit(subject.top, method, gen(subject.top), 0.02, N)
    assert n.tolist() == list(range(N + 1))
    assert np.array_equal(recorded, [gen(subject.top), *states])


def test_machine_code_control() -> None:
    """Another order of two sums is seen."""

    def step(s: Any, h: float, p: Any) -> Any:
        return (s[0] * (1.0 + h * s[1]), s[1], s[2], s[3], s[4], s[5])

    def other(s: Any, h: float, p: Any) -> Any:
        return (s[0] + s[0] * (h * s[1]), s[1], s[2], s[3], s[4], s[5])

    assert (
        working_states(Kowalevski(), Stepper(step, 6), GEN, 0.02, 100)[0]
        != working_states(Kowalevski(), Stepper(other, 6), GEN, 0.02, 100)[1]
    )


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


def test_choices_leave_out_what_a_top_refuses() -> None:
    dmv = find_scheme("dmv", "heavy")
    assert [options.model_dump(exclude_defaults=True) for options in choices(dmv, TOPS["heavy"].new())] == [
        {},
    ]


def test_which_invariants_are_quadratic() -> None:
    for top in (Kowalevski(), Kowalevski(c0=-3.0, A=0.1)):
        assert polynomial_invariants(top, 1) == ()
        assert polynomial_invariants(top, 2) == polynomial_invariants(top, 3) == ("gamma_sq", "two_l", "energy")
        assert polynomial_invariants(top, 4) == ("gamma_sq", "two_l", "energy", "k_sq")
    assert polynomial_invariants(Heavy(), 2) == ("gamma_sq", "m_gamma", "energy")


@pytest.mark.filterwarnings("error")
def test_a_formula_without_a_value_is_no_polynomial() -> None:
    invariants = {"log": "log(-1 - x**2)", "line": "2*x"}
    top = custom_class({"components": ["x"], "field": {"x": "0"}, "invariants": invariants}).new()
    assert polynomial_invariants(top, 2) == ("line",)
