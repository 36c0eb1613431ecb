"""The key ``project`` of a scheme."""

from __future__ import annotations

import math
from collections import Counter
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
import pytest

import topcli
from conftest import GEN, random_states
from declared import TRIALS
from stepping import deviations, made, ran
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Outcome, Top
from topcli.engine.numbers import prepared
from topcli.errors import UsageError
from topcli.schemes.registry import find_scheme, schemes_of
from topcli.tops.kowalevski import Kowalevski

SAMPLE = [
    *((name, "kowalevski") for name in ("backlund", "bohlin-a", "hk", "hybrid", "rk2")),
    *(("rk2", form) for form in ("gaudin", "heavy", "lagrange-gyrostat")),
    *(("rk4", form) for form in ("euler+gamma", "so4")),
    *[("dmv", "lagrange/inertial"), ("hk", "clebsch"), ("midpoint", "suslov")],
]
DELONE = (0.9, 0.3, 1.0, 0.72, 0.54, math.sqrt(1.0 - 0.72**2 - 0.54**2))


def state_of(top: Top) -> Floats:
    d = len(top.components)
    return GEN[:d] if d <= 6 else (0.4,) * d


@pytest.mark.slow
@pytest.mark.parametrize(("name", "form"), SAMPLE)
def test_all_integrals_keep_their_first_values(name: str, form: str) -> None:
    """Within 8 ulp of their terms over 2,000 steps (at worst 7, typically 3); without it 1e4 and more."""
    top, h = TRIALS[form][0], 0.03
    plain, projected = made(top, name), made(top, name, project=1)
    states, ending = ran(projected, state_of(top), h, 2_000, 1, top)
    assert ending.outcome is Outcome.COMPLETED, ending.message
    conserved = {invariant.name for invariant in top.invariants() if not invariant.on}
    off = {integral: ulps for integral, ulps in deviations(states, top).items() if integral in conserved}
    assert max(off.values()) < 8.0, off
    before, _ = ran(plain, state_of(top), h, 2_000, 1, top)
    kept = next(scheme.conserves for scheme in schemes_of(form) if scheme.name == name)
    if not conserved <= {*kept}:
        assert max(deviations(before, top)[integral] for integral in conserved) > 1e4


def test_every_k_steps() -> None:
    """Deviations grow for two steps, and are gone after the third; in between the steps are those of the scheme."""
    top, p, h = Kowalevski(), (1.0,), 0.05
    method = made(top, "hk", project=3)
    p = (*p, *map(float, method.constants))
    assert method.enter is not None
    assert method.leave is not None
    s, off = method.enter(GEN, h, p), []
    for _ in range(3):
        s = method.step(s, h, p)
        states = np.array([GEN, method.leave(s, h, p)])
        off.append(max(deviations(states, top).values()))
    assert min(off[:2]) > 1e6
    assert off[2] < 8.0
    plain, _ = ran(made(top, "hk"), GEN, h, 2)
    np.testing.assert_array_equal(ran(method, GEN, h, 2)[0], plain)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "hybrid-sym"])
def test_large_steps_are_never_silently_wrong(name: str) -> None:
    """At steps that cannot converge, of the scheme or the projection: all integrals are kept, or the run says so."""
    outcomes: Counter[Outcome] = Counter()
    for c0 in (1.0, -1.0, 300.0):
        top = Kowalevski(c0=c0)
        for h in (0.2, 0.7, 2.0, 6.0):
            for y in map(tuple, random_states(4, seed=55)):
                states, ending = ran(made(top, name, project=1), y, h / math.sqrt(max(1.0, abs(c0))), 200, 1, top)
                outcomes[ending.outcome] += 1
                states = states[np.isfinite(states).all(axis=1)]
                assert max(deviations(states, top).values()) < 1e4
    assert outcomes[Outcome.NO_CONVERGENCE] > 20
    assert set(outcomes) <= {Outcome.COMPLETED, Outcome.NO_CONVERGENCE}


DEGENERATE = {
    "delone": DELONE,
    "equilibrium": (2.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    "rest": (0.0,) * 6,
    "hanging": (0.0, 0.0, 0.0, 1.0, 0.0, 0.0),
    "pendulum": (0.0, 1.3, 0.0, 0.6, 0.0, 0.8),
    "homoclinic": (2.0, 0.0, 0.0, 1.0, 0.0, 1e-9),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hk", "backlund"])
@pytest.mark.parametrize("y0", DEGENERATE.values(), ids=DEGENERATE)
def test_dependent_gradients(name: str, y0: Floats) -> None:
    """On degenerate tori an integral is left out: no worse than without the projection, or the run ends."""
    top = Kowalevski()
    states, ending = ran(made(top, name, project=1), y0, 0.01, 2000, 5, top)
    plain, _ = ran(made(top, name), y0, 0.01, 2000, 5, top)
    off, before = deviations(states, top), deviations(plain, top)
    assert all(off[integral] <= max(50.0, 0.01 * before[integral]) for integral in off)
    if ending.outcome is not Outcome.COMPLETED:
        assert (name, y0, ending.outcome) == ("hk", DELONE, Outcome.NO_CONVERGENCE)
        return
    exact = reference_states(top, y0, np.array([10.0]))[0]
    assert np.abs(states[200] - exact).max() <= 2.0 * np.abs(plain[200] - exact).max() + 1e-12


def test_many_digits() -> None:
    """With 40 digits the integrals keep 35 digits: targets and constants of the projection follow the precision."""
    scheme, top = find_scheme("hk", "clebsch"), TRIALS["clebsch"][0]
    parameters = {name: Fraction(str(value)) for name, value in top.model_dump().items()}
    state = tuple(map(Fraction, ("0.7", "-0.4", "1.3", "0.6", "0.48", "0.64")))
    run = prepared(scheme, top, scheme.options(project=1), 40, (Fraction("0.05"), parameters, state))
    work, end = np.zeros(run.loop.width, dtype=object), np.zeros(6, dtype=object)
    run.loop.enter(run.y0, work, (), run.h)
    assert run.loop.take_steps(work, end, (), run.h, 3, 3, 3) == 3
    values = [[invariant.value(np.array([y]))[0] for invariant in run.top.invariants()] for y in (run.y0, end)]
    assert max(abs(float(run.arithmetic.fraction(a - b))) for a, b in zip(*values, strict=True)) < 1e-35


def kepler_field(y: Any, p: Any) -> Any:
    r = (y[0] * y[0] + y[1] * y[1]) ** -1.5
    return (y[2], y[3], -y[0] * r, -y[1] * r)


def test_refused_where_an_integral_is_no_polynomial(own_registry: None) -> None:
    @topcli.top
    class Kepler(Top):
        """Motion about a fixed centre."""

        kind = "kepler-plane"
        components = ("x", "y", "u", "v")
        field = staticmethod(kepler_field)
        integrals: ClassVar = {"energy": lambda y, p: (y[2] ** 2 + y[3] ** 2) / 2 - (y[0] ** 2 + y[1] ** 2) ** -0.5}

    with pytest.raises(UsageError, match=r"scheme.project needs polynomial integrals, but 'energy'"):
        made(Kepler.new(), "rk4", project=1)
