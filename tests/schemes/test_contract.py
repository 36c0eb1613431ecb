"""Declared traits of every scheme hold: order, self-adjointness, exact invariants.

Every test comes with a positive control: a scheme without the trait that the same measure condemns.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from conftest import GEN, random_states
from declared import SCHEMES, TRIALS, by_name, gen
from steppers import EULER, RK2, rk2
from topcli.analysis.order import observed_order, one_step_back_and_forth, reversal
from topcli.analysis.reference import reference_states
from topcli.analysis.tally import invariant_report
from topcli.contracts import Method, Scheme, Top
from topcli.engine.loop import Run
from topcli.errors import UsageError
from topcli.tops import TOPS
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski


def some_states(top: Top, count: int, seed: int) -> np.ndarray:
    return random_states(count, seed)[:, : len(top.components)]


by_step = pytest.mark.parametrize("scheme", [s for s in SCHEMES if not s.adaptive], ids=lambda s: f"{s.name}/{s.top}")
"""The schemes whose step is h; the adaptive ones are tried in ``test_baselines``."""


def every_option(scheme: Scheme, top: Top) -> list:
    """The default options and, one at a time, every other choice of an enumerated option or a switch.

    A choice that the scheme refuses for this top is left out.
    """
    made = [scheme.options()]
    for name, schema in scheme.options.model_json_schema().get("properties", {}).items():
        choices = [False, True] if schema.get("type") == "boolean" else schema.get("enum", [])
        made += [scheme.options(**{name: v}) for v in choices if v != schema.get("default")]
    return [made[0], *(options for options in made[1:] if not refused(scheme, top, options))]


def refused(scheme: Scheme, top: Top, options: Any) -> bool:
    """True if the scheme cannot be built for this top with these options."""
    try:
        scheme.build(top, options)
    except UsageError:
        return True
    return False


def last_state(top: Top, stepper: Method, y0, h: float, N: int) -> np.ndarray:
    return Run(top, stepper, y0, h, N, N).collect().states[-1]


def observed(top: Top, stepper: Method, duration: float = 2.0) -> float:
    counts = 25 * 2 ** np.arange(7)
    errors = errors_after(top, stepper, duration, counts)
    order = observed_order(list(duration / counts), errors, 1e-12)
    assert order is not None
    return order


def errors_after(top: Top, stepper: Method, duration: float, counts: np.ndarray) -> list[float]:
    exact = reference_states(top, gen(top), np.array([duration]))[0]
    return [float(np.linalg.norm(last_state(top, stepper, gen(top), duration / N, int(N)) - exact)) for N in counts]


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


@by_step
def test_declared_order_is_observed(scheme: Scheme) -> None:
    for top in TRIALS[scheme.top][:2]:
        for options in every_option(scheme, top):
            method = scheme.build(top, options)
            order = scheme.order_for(options)
            if order is None:
                assert max(errors_after(top, method, 2.0, np.array([1, 7, 300]))) < 1e-14, (top, options)
            else:
                assert observed(top, method) == pytest.approx(order, abs=0.1), (top, options)


def test_order_control() -> None:
    """The measure distinguishes orders: Euler's rule is no order-2 scheme, and no rule is exact."""
    assert observed(Kowalevski(), EULER) == pytest.approx(1.0, abs=0.1)
    assert observed(Kowalevski(), RK2) == pytest.approx(2.0, abs=0.1)
    assert observed(Euler(), rk2(Euler())) == pytest.approx(2.0, abs=0.1)
    assert min(errors_after(Euler(), rk2(Euler()), 2.0, np.array([1, 7, 300]))) == pytest.approx(3.51e-06, rel=0.05)


def worst_defect(top: Top, stepper: Method, h: float) -> float:
    return max(one_step_back_and_forth(top, stepper, y, h) for y in some_states(top, 12, seed=3))


@pytest.mark.slow
@by_step
def test_declared_self_adjointness(scheme: Scheme) -> None:
    """One step there and back: round-off for a self-adjoint scheme at every h, visibly more for the others."""
    top = TOPS[scheme.top]()
    for options in every_option(scheme, top):
        stepper = scheme.build(top, options)
        defects = [worst_defect(top, stepper, h) for h in (0.2, 0.1, 0.05)]
        if scheme.self_adjoint:
            # a closed form has the round-off of two states, not of small increments: 1.1e-14 at |omega| = 3 for the
            # Kowalevski top, whose gamma is a difference of terms of the size of |omega|²
            assert max(defects) < (3e-14 if scheme.order is None else 1e-14)
        else:
            assert 3.8e-8 < min(defects) < 0.13
            assert max(defects) < 10.0  # 3.3 at most; a step that fails has an infinite one


def test_self_adjointness_control() -> None:
    assert worst_defect(Kowalevski(), RK2, 0.1) == pytest.approx(1.04e-3, rel=0.02)
    assert worst_defect(Euler(), rk2(Euler()), 0.1) == pytest.approx(2.02e-3, rel=0.02)


def deviation_over_bound(top: Top, stepper: Method, y0, h: float, names: tuple[str, ...]) -> float:
    """Largest deviation of the invariants ``names`` in units of 50 ulp times sqrt(N), over 2e4 steps."""
    states = Run(top, stepper, y0, h, 20_000, 10).collect().states
    worst = 0.0
    for invariant in top.invariants():
        if invariant.name in names:
            values = invariant.value(states)
            bound = 50.0 * np.finfo(float).eps * np.sqrt(20_000) * invariant.scale(states).max()
            worst = max(worst, float(np.abs(values - values[0]).max()) / bound)
    return worst


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "top"),
    [(scheme, top) for scheme in SCHEMES if scheme.conserves for top in TRIALS[scheme.top]],
    ids=lambda value: f"{value.name}/{value.top}" if isinstance(value, Scheme) else repr(value),
)
def test_declared_invariants_are_exact(scheme: Scheme, top: Top) -> None:
    """Round-off and no more, on several tops, states and step sizes."""
    stepper = scheme.build(top, scheme.options())
    for y0, h in zip([gen(top), *some_states(top, 3, seed=11)], (0.1, 0.05, 0.01, 0.002), strict=True):
        assert deviation_over_bound(top, stepper, y0, h, scheme.conserves) < 1.0


@pytest.mark.parametrize("top", [*TRIALS["kowalevski"], *TRIALS["euler"], *TRIALS["euler+gamma"][:2]], ids=repr)
def test_exactness_control(top: Top) -> None:
    """The explicit midpoint rule, at a small step, fails the same test by far."""
    for name in {"kowalevski": ("gamma_sq", "k_sq")}.get(top.form, [one.name for one in top.invariants()]):
        assert 410000.0 < deviation_over_bound(top, rk2(top), gen(top), 0.01, (name,)) < 5.9e8


@pytest.mark.slow
@by_step
def test_reversal_order_is_reported(scheme: Scheme) -> None:
    """The study's own measure: no order for a self-adjoint scheme, at least order + 1 for the others."""
    top = TOPS[scheme.top]()
    found = reversal(top, scheme.build(top, scheme.options()), some_states(top, 6, seed=5), 1e-3)
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
    top, states = Kowalevski(), some_states(Kowalevski(), 5, seed=8)
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
    hk = next(scheme for scheme in SCHEMES if (scheme.name, scheme.top) == ("hk", "kowalevski"))
    n, states, _ = Run(top, hk.build(top, hk.options()), GEN, 0.05, 4000).collect()
    assert {row.verdict for row in invariant_report(top.invariants(), n, 0.05, states)} == {"bounded"}
    still = np.repeat(states[:1], len(n), axis=0)
    assert {row.verdict for row in invariant_report(top.invariants(), n, 0.05, still)} == {"exact"}
