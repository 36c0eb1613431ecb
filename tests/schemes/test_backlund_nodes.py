"""Bäcklund steps with exact nodes: against the reference, over all kinds of motions, refused and watched."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import topcli
from conftest import GEN, PAPER, random_states
from stepping import deviations, ran
from test_backlund import DELONE, HANGING, integrals, limit, simulated, stepper
from topcli.analysis.reference import reference_states
from topcli.config.load import load_experiment
from topcli.contracts import Floats, Outcome, Stepper
from topcli.errors import UsageError
from topcli.schemes.kowalevski import backlund_step
from topcli.schemes.kowalevski.backlund import BacklundOptions
from topcli.schemes.kowalevski.backlund_parameters import frozen_constants, lengths, longest_back, longest_composition
from topcli.schemes.kowalevski.backlund_step import motion, substeps_of
from topcli.schemes.registry import find_scheme
from topcli.studies.roundoff_copies import forms_of
from topcli.tops.kowalevski import Kowalevski

CONFIG = {"top": "kowalevski", "initial": {"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}}
EQUILIBRIUM = (2.0, 0.0, 0.0, 1.0, 0.0, 0.0)
AT_REST = (0.0, 0.0, 0.0, 0.6, 0.48, 0.64)
EXACT = {"name": "backlund", "nodes": "exact"}


def nodes(**options: Any) -> Stepper:
    return stepper(nodes="exact", **options)


def longest(y: Floats, c: float = 1.0, count: int = 4) -> float:
    """The longest step that ``count`` steps forward and one back can make."""
    return longest_composition(frozen_constants(y, (c,))[:4], count)


def forward_steps(y: Floats, h: float, c: float = 1.0) -> float:
    made = nodes()
    assert made.enter is not None
    return made.enter(y, h, (c,))[14]


def reference(y: Floats, t: float, c: float = 1.0) -> np.ndarray:
    return reference_states(Kowalevski(c0=c), y, np.array([t]))[0]


FAMILIES: dict[str, tuple[Floats, float]] = {
    "generic": (GEN, 1.0),
    "paper": (PAPER, 1.0),
    "no gravity": (GEN, 0.0),
    "faint gravity": (GEN, 1e-8),
    "negative gravity": (GEN, -0.7),
    "strong negative gravity": (GEN, -30.0),
    "Delone": (DELONE, 1.0),
    "near Delone": ((DELONE[0] + 1e-7, *DELONE[1:]), 1.0),
    "far from Delone by 1e-12": ((DELONE[0], DELONE[1] + 1e-12, *DELONE[2:]), 1.0),
    "Delone, negative gravity": ((DELONE[1], -DELONE[0], DELONE[2], *DELONE[3:]), -1.0),
    "hanging": (HANGING, 1.0),
    "hanging closely": ((1e-6, -2e-6, 1e-6, -1.0, 1e-6, 0.0), 1.0),
    "hanging, negative gravity": ((1e-3, -2e-3, 1e-3, 1.0, 0.0, 0.0), -2.0),
    "equilibrium": (EQUILIBRIUM, 1.0),
    "from rest": (AT_REST, 1.0),
    "spin about the third axis": ((0.0, 0.0, 2.0, 0.0, 0.0, 1.0), 1.0),
    "pendulum": ((0.0, 1.5, 0.0, 0.8, 0.0, 0.6), 1.0),
    "no vertical": ((0.7, -0.4, 1.3, 0.0, 0.0, 0.0), 1.0),
    "fast": ((7e5, -4e5, 1.3e6, 0.6, 0.48, 0.64), 1.0),
    "long vertical": ((0.7, -0.4, 1.3, 6e5, 4.8e5, 6.4e5), 1.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_one_step_of_every_kind_of_motion(family: str) -> None:
    """Of either sign, up to the longest: within a few ulp of the sizes of omega and gamma."""
    y, c = FAMILIES[family]
    top, made = Kowalevski(c0=c), nodes()
    gamma = max(map(abs, y[3:]))
    sizes = np.repeat([max(map(abs, y[:3])) + math.sqrt(abs(c) * gamma), gamma or 1.0], 3)
    most = min(longest(y, c), 20.0)
    for h in (0.1 * most, -0.6 * most, 0.999 * most):
        states, ending = ran(made, y, h, 1, 1, top)
        assert ending.outcome is Outcome.COMPLETED, ending.message
        assert (np.abs(states[-1] - reference(y, h, c)) / sizes).max() < 1e-14


DECLARED = {"no gravity", "hanging closely", "hanging, negative gravity"}
"""Kinds of motion whose integrals need a projection over many plain steps, as the limits of the scheme say."""


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_long_runs_of_every_kind_of_motion(family: str) -> None:
    """2e3 steps up to the longest, plain, projected and with exact nodes; in sqrt(N) ulp 5, 0.2 and 0.3 are typical."""
    (y, c), N = FAMILIES[family], 2_000
    wider = 8.0 if family == "no vertical" else 1.0  # its gradients are dependent: k² is not restored, 3.3 at worst
    top = Kowalevski(c0=c)
    for made, most, bound in (
        (stepper(), limit(y, c), 30.0),
        (stepper(project=16), limit(y, c), 1.0),
        (nodes(), longest(y, c), 10.0),
    ):
        for fraction in (0.3, 1.0):
            states, ending = ran(made, y, fraction * min(most, 20.0), N, 20, top)
            assert ending.outcome is Outcome.COMPLETED, ending.message
            assert family in DECLARED or max(deviations(states, top).values()) < wider * bound * math.sqrt(N)


@pytest.mark.slow
def test_motion_in_integers() -> None:
    """The series that the first step is compared with, against the reference; both are good to an ulp."""
    for y, c in (*FAMILIES.values(), (GEN, 1e100), (tuple(1e-9 * v for v in GEN), 1e-9)):
        scale = max(*map(abs, y[:3]), math.sqrt(abs(c) * max(map(abs, y[3:]))))
        for h in (3.0 / scale, -1.7 / scale):
            expected = reference(y, h, c)
            sizes = np.repeat([scale, max(map(abs, y[3:])) or 1.0], 3)
            assert (np.abs(np.array(motion(y, h, c)) - expected) / sizes).max() < 2e-15
    assert all(math.isnan(v) for v in motion((math.inf, *GEN[1:]), 1.0, 1.0))
    assert all(math.isnan(v) for v in motion(GEN, 1e6, 1.0))  # too long


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
def test_lengths_up_to_the_longest(count: int) -> None:
    """The step back is shorter than the longest admissible one, and reaches it with the longest composition."""
    for y in map(tuple, random_states(20, seed=84)):
        constants = frozen_constants(y, (1.0,))[:4]
        most = longest(y, count=count)
        for fraction in (0.01, 0.5, 0.98, 0.999999):
            a, b = lengths(fraction * most, count, constants)
            assert 0.0 < a < -b <= longest_back(constants)
            assert lengths(-fraction * most, count, constants) == (-a, -b)
        assert b == pytest.approx(-longest_back(constants), rel=1e-4)
        root = count ** (1.0 / 3.0)
        a, b = lengths(1e-3, count, constants)
        assert (a, b) == (pytest.approx(1e-3 / (count - root), rel=1e-5), pytest.approx(-root * a, rel=1e-5))


def test_three_steps_where_they_suffice() -> None:
    three = longest(GEN, count=3)
    assert forward_steps(GEN, 0.999 * three) == 3.0
    assert forward_steps(GEN, 1.001 * three) == 4.0
    assert forward_steps(GEN, -1.001 * three) == 4.0
    assert three < 0.8 * longest(GEN)


def test_number_of_substeps() -> None:
    assert substeps_of(5.0, 2.5) == 3
    assert substeps_of(-4.9, 2.5) == 2
    assert substeps_of(1.0, 1e-7) == 1  # and then no step is possible
    assert substeps_of(1.0, 0.0) == 1


@pytest.mark.slow
def test_members_of_an_ensemble() -> None:
    """With three and four steps side by side, bit for bit as alone; one whose h is too long ends by itself."""
    states = np.vstack([random_states(5, seed=85), [(4.0, -2.0, 3.0, 0.6, 0.48, 0.64)]])
    h = 1.3
    assert {forward_steps(tuple(y), h) for y in states[:5]} == {3.0, 4.0}
    ensemble = topcli.simulate_ensemble(top="kowalevski", states=states, scheme=EXACT, h=h, N=40)
    for i in range(5):
        initial = {"omega": states[i, :3].tolist(), "gamma": states[i, 3:].tolist()}
        alone = simulated(EXACT, h, 40, initial=initial)
        np.testing.assert_array_equal(ensemble.states[i], alone.states)
    assert (ensemble.endings[5].outcome, ensemble.endings[5].step) == (Outcome.NO_CONVERGENCE, 1)


def refused(monkeypatch: pytest.MonkeyPatch, relative: float) -> topcli.Trajectory:
    """A run whose lengths are wrong by this relative error."""

    def wrong(H: float, count: int, constants: Any) -> tuple[float, float]:
        a, b = lengths(H, count, constants)
        return a * (1.0 + relative), b

    monkeypatch.setattr(backlund_step, "lengths", wrong)
    return simulated(EXACT)


def test_wrong_lengths_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first step differs from the motion by more than 1e-12: no step is recorded, and the message says why."""
    assert refused(monkeypatch, 2e-13).outcome is Outcome.COMPLETED
    run = refused(monkeypatch, 1e-11)
    assert run.outcome is Outcome.NO_CONVERGENCE
    assert run.ending.step == 1
    assert len(run.states) == 1
    found = float(run.ending.message.split("differs from the motion by ")[1].split(",")[0])
    step = nodes(project=0)
    assert step.enter is not None
    monkeypatch.setattr(backlund_step, "ACCURACY", math.inf)
    expected = np.abs(np.array(step.step(step.enter(GEN, 0.5, (1.0,)), 0.5, (1.0,))[:6]) - reference(GEN, 0.5))
    scales = np.repeat([1.3 + math.sqrt(0.64), 0.64], 3)
    assert found == pytest.approx((expected / scales).max(), rel=0.06)


@pytest.mark.parametrize("options", [{}, {"project": 0}])
@pytest.mark.parametrize(("slot", "name"), [(0, "omega1"), (4, "gamma2")])
def test_integrals_are_watched(options: dict[str, Any], slot: int, name: str) -> None:
    """A state that leaves the first values of E and k² by more than 1e-11 ends the run; by less, nothing is said."""
    made = nodes(**options)
    first = made.enter
    assert first is not None

    def off(y: Floats, h: float, p: Floats, by: float) -> Floats:
        s = list(first(y, h, p))
        s[slot] += by
        return tuple(s)

    for by, outcome in ((3e-12, Outcome.COMPLETED), (3e-10, Outcome.NO_CONVERGENCE)):
        moved = list(GEN)
        moved[slot] += by
        before, after = integrals(GEN, 1.0), integrals(moved, 1.0)
        size = 2.4**2 + 0.6 + 0.48 + 0.64
        change = max(abs(after[2] - before[2]) / size, abs(after[3] - before[3]) / size**2)
        assert (change > 1e-11) == (outcome is Outcome.NO_CONVERGENCE)
        _, ending = ran(replace(made, enter=lambda y, h, p, by=by: off(y, h, p, by)), GEN, 0.01, 10)
        assert ending.outcome is outcome
        if outcome is Outcome.NO_CONVERGENCE:
            assert ending.step == 1
            assert float(ending.message.split("deviates by ")[1].split(",")[0]) == pytest.approx(change, rel=0.06)


@pytest.mark.parametrize(
    ("options", "others", "reason"),
    [
        ({"constants": "recomputed"}, {}, "nodes: exact needs constants: frozen"),
        ({"compensated": True}, {}, "nodes: exact has no compensated form"),
        ({"compose": "suzuki4"}, {}, "cannot be composed with these options"),
        ({}, {"precision": 40}, "computes its lengths in doubles; use nodes: plain"),
    ],
)
def test_options_that_do_not_go_together(options: dict[str, Any], others: dict[str, Any], reason: str) -> None:
    with pytest.raises(UsageError, match=reason):
        simulated({**EXACT, **options}, **others)


def test_declared_order_depends_on_the_nodes() -> None:
    scheme = find_scheme("backlund", "kowalevski")
    assert scheme.order_for(scheme.options(nodes="exact")) is None
    assert scheme.order_for(scheme.options()) == 2


def test_growth_of_round_off_without_a_compensated_form() -> None:
    """The study has one form for exact nodes, and two for plain ones."""
    for scheme, forms in ((EXACT, ["plain"]), ({"name": "backlund"}, ["plain", "compensated"])):
        experiment = load_experiment({**CONFIG, "scheme": scheme, "h": 0.5, "N": 3})
        assert list(forms_of(experiment)) == forms


def test_projection_every_sixteen_steps() -> None:
    """By default, if the nodes are exact; other steps are not projected."""
    assert BacklundOptions().period == 0
    for given, period in ((None, 16), (0, 0), (5, 5)):
        assert BacklundOptions(nodes="exact", project=given).period == period
