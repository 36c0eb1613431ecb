"""Splitting and discrete Moser-Veselov: their steps, what is canonical and exact in them, and where they end."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from conftest import GEN, random_states
from split_motions import axes, closed, kicked, moser_veselov, poisson_defect
from stepping import Steps, made, root_mean_square, states_of
from topcli.analysis.reference import reference_states
from topcli.arithmetic.vectors import (
    orthogonal_rodrigues_increment,
    rodrigues_increment,
    rotation_coefficients,
    turned_increment,
)
from topcli.config.load import load_experiment
from topcli.contracts import Outcome, Top
from topcli.engine.loop import Run
from topcli.errors import UsageError
from topcli.studies.comparison import compare_schemes
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

EPS = 2.0**-52
ALL = [TOPS[form].new() for form in TOPS]
TOPS_TRIED: list[Top] = [*ALL, Euler(A=2.0, B=2.0, C=0.7), EulerGamma(A=1.1, B=1.1, C=0.4), Heavy(A=1.3, B=1.3, C=2.0)]
by_top = pytest.mark.parametrize("top", TOPS_TRIED, ids=repr)
SYMMETRIC = [top for top in TOPS_TRIED if len({*top.euler_poisson().moments[:2]}) == 1]
CASES = [("splitting", {}), ("splitting", {"free": "axes"}), ("dmv", {})]
by_case = pytest.mark.parametrize(("name", "options"), CASES, ids=("splitting", "axes", "dmv"))


@by_case
def test_step_is_the_formula(name: str, options: dict) -> None:
    """Also for angles beyond pi/4, where the sine is no polynomial."""
    for top in TOPS_TRIED:
        step = Steps(top, name, **options)
        symmetric = top.euler_poisson().moments[0] == top.euler_poisson().moments[1]
        free = moser_veselov if name == "dmv" else closed if symmetric and not options else axes
        for y in states_of(top, 5, seed=21):
            for h in (0.1, -0.03) if name == "dmv" else (0.1, -0.03, 2.5):
                assert np.abs(step(y, h) - kicked(top, y, h, free)).max() < (2e-14 if h < 1.0 else 1e-12), (top, y, h)


@pytest.mark.parametrize("change", [2.0**-52, -(2.0**-53), 1e-9, 1e-3, -1e-3])
@pytest.mark.parametrize("gravity", [True, False])
def test_the_closed_form_is_taken_for_equal_moments_only(gravity: bool, change: float) -> None:
    """On both sides of A = B by one bit: a closed form for nearly equal moments would move another top."""

    def body(B: float) -> Top:
        return Heavy(A=1.0, B=B, C=0.7) if gravity else Euler(A=1.0, B=B, C=0.7)

    for B, same in ((1.0, "closed"), (1.0 + change, "axes")):
        top = body(B)
        assert top.euler_poisson().moments[1] == B
        by_choice, chosen = Steps(top, "splitting"), Steps(top, "splitting", free=same)
        other = Steps(body(1.0), "splitting", free="axes" if same == "closed" else "closed")
        for y in states_of(top, 5, seed=31):
            assert by_choice(y, 0.4).tolist() == chosen(y, 0.4).tolist()
            assert np.abs(by_choice(y, 0.4) - other(y, 0.4)).max() > 1e-5
    with pytest.raises(UsageError, match="free: closed needs two equal moments"):
        made(body(1.0 + change), "splitting", free="closed")


def test_corrections_complete_the_circle() -> None:
    """S² + (1 - K)² is 1 to far below the last bits with the corrections; without them it misses by 1e-16 chi²."""
    with_them, without = [], []
    for chi in np.geomspace(1e-4, 1.5, 50):
        s, k, s_low, k_low = map(Fraction, rotation_coefficients(float(chi)))
        with_them.append(abs(float((s + s_low) ** 2 + (1 - k - k_low) ** 2 - 1)) / min(1.0, chi**2))
        without.append(abs(float(s * s + (1 - k) ** 2 - 1)) / min(1.0, chi**2))
    assert max(with_them) < 1e-30
    assert 2e-17 < np.median(without) < 2e-16


def test_corrected_rotation_keeps_a_length_over_many_steps() -> None:
    """The same small rotation 1e5 times, the sum carried in rational numbers."""
    s, k, s_low, k_low = rotation_coefficients(0.05)
    x, y = Fraction(0.6), Fraction(0.8)
    square = x * x + y * y
    a, b = turned_increment(s, k, s_low, k_low, 0.6, 0.8)
    assert a == pytest.approx(0.8 * math.sin(0.05) - 0.6 * (1.0 - math.cos(0.05)), rel=1e-14)
    assert b == pytest.approx(-0.6 * math.sin(0.05) - 0.8 * (1.0 - math.cos(0.05)), rel=1e-14)
    growth = (Fraction(s) + Fraction(s_low)) ** 2 + (1 - Fraction(k) - Fraction(k_low)) ** 2
    assert abs(float(square * growth - square)) * 1e5 < 1e-24
    for axis in ((0.03, 0.0, 0.04), (1.1, -0.7, 0.4)):
        v = np.array([0.6, -0.2, 0.8])
        change = np.array(orthogonal_rodrigues_increment(*axis, *v))
        assert np.abs(change - (rotated_about(v, np.array(axis)) - v)).max() < 4e-16


@pytest.mark.slow
def test_rotation_about_an_axis_is_unbiased() -> None:
    """Mean growth of the squared length over a thousand vectors: 1e-18, and 1e-17 without the corrections."""
    means = {}
    for form in (orthogonal_rodrigues_increment, rodrigues_increment):
        vectors, found = np.random.default_rng(29), []
        for axis in np.random.default_rng(30).normal(size=(8, 3)) * 0.2 / math.sqrt(3.0):
            total = Fraction(0)
            for v in vectors.normal(size=(1000, 3)).tolist():
                change = form(*axis.tolist(), *v)
                total += sum(
                    (Fraction(x) + Fraction(d)) ** 2 - Fraction(x) ** 2 for x, d in zip(v, change, strict=True)
                )
            found.append(float(total) / 1000)
        means[form.__name__] = root_mean_square(np.array(found))
    assert means["orthogonal_rodrigues_increment"] < 3e-18
    assert means["rodrigues_increment"] == pytest.approx(1.04e-17, rel=0.3)


def rotated_about(v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Solution at time 1 of v' = v x a by Rodrigues' formula."""
    angle = np.linalg.norm(a)
    n = a / angle
    return v * np.cos(angle) + np.cross(v, n) * np.sin(angle) + n * (n @ v) * (1.0 - np.cos(angle))


@pytest.mark.slow
@by_top
@by_case
def test_order_two_from_each_state(top: Top, name: str, options: dict) -> None:
    """The free symmetric top is an exception: in closed form its motion is exact."""
    exact = not options and name == "splitting" and top in SYMMETRIC and not any(top.euler_poisson().gravity)
    step = Steps(top, name, **options)
    worst = []
    for y in states_of(top, 6, seed=22):
        truth = reference_states(top, tuple(y.tolist()), np.array([1.0]))[0]
        errors = [np.linalg.norm(step(y, 1.0 / N, N) - truth) for N in (200, 400)]
        worst.append(max(errors) if exact else abs(math.log2(errors[0] / errors[1]) - 2.0))
    assert max(worst) < (1e-13 if exact else 0.05)


@pytest.mark.slow
@by_top
@by_case
def test_step_is_canonical(top: Top, name: str, options: dict) -> None:
    """J P J^T = P at the image: typically 1e-10, the error of the difference quotients."""
    step = Steps(top, name, **options)
    assert max(poisson_defect(top, step, y, 0.2) for y in states_of(top, 8, seed=24)) < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(("name", "defect"), [("hk", 3.3e-3), ("midpoint", 2.0e-3), ("rk4", 3.3e-5)])
def test_canonical_control(name: str, defect: float) -> None:
    step = Steps(Heavy(), name)
    found = np.median([poisson_defect(Heavy(), step, y, 0.2) for y in states_of(Heavy(), 100, seed=24)])
    assert found == pytest.approx(defect, rel=0.05)


@pytest.mark.slow
@by_top
@by_case
def test_returns_and_keeps_lengths(top: Top, name: str, options: dict) -> None:
    """2e4 steps and back; typically 1e-13, and the invariants 3 ulp sqrt(N)/10."""
    step = Steps(top, name, **options)
    names = {"gamma_sq", "m_gamma", "two_l", "a_sq", "m_a", "m_sq"} - (
        {"m_sq"} if any(top.euler_poisson().gravity) else set()
    )
    kept = [one for one in top.invariants() if one.name in names]
    assert kept
    N, h = 20_000, 5e-4
    for y in states_of(top, 4, seed=25):
        there = step(y, h, N)
        assert np.abs(step(there, -h, N) - y).max() < 1e-10
        both = np.array([y, there])
        for one in kept:
            bound = 10.0 * EPS * math.sqrt(N) * float(one.scale(both).max())
            assert abs(float(np.diff(one.value(both))[0])) < bound, one.name


def test_splitting_does_not_keep_the_energy() -> None:
    """The control: its energy oscillates by h², its m² does not."""
    top = Euler()
    deviations = []
    for h in (0.1, 0.05):
        states = Run(top, made(top, "splitting"), GEN[:3], h, 20_000, 1).collect().states
        m_sq = np.square(states * (3.0, 2.0, 1.0)).sum(axis=1)
        energy = 0.5 * (np.square(states) * (3.0, 2.0, 1.0)).sum(axis=1)
        assert np.abs(m_sq - m_sq[0]).max() < 50.0 * EPS * math.sqrt(20_000) * m_sq[0]
        deviations.append(float(np.abs(energy - energy[0]).max()))
    assert deviations[0] == pytest.approx(2.69e-3, rel=0.02)
    assert deviations[0] / deviations[1] == pytest.approx(4.0, abs=0.1)


def test_free_symmetric_top_is_exact() -> None:
    """Round-off after a thousand steps, also with steps of several radians."""
    for top in (Euler(A=2.0, B=2.0, C=0.7), EulerGamma(A=1.1, B=1.1, C=0.4), Kowalevski(c0=0.0), Lagrange(mu=0.0)):
        y = GEN[: len(top.components)]
        for h, N in ((0.01, 1000), (2.0, 50)):
            truth = reference_states(top, y, np.array([h * N]))[0]
            assert np.abs(Steps(top, "splitting")(y, h, N) - truth).max() < 2e-13


def test_moser_veselov_keeps_a_small_momentum_along_an_axis_of_symmetry() -> None:
    """Bit for bit, also if it is far below the round-off of the other components."""
    y = (1.0, -0.7, 1e-18, 0.6, 0.0, 0.8)
    assert Steps(Lagrange(), "dmv")(y, 0.05, 1000)[2] == 1e-18
    assert Steps(EulerGamma(A=1.0, B=2.0, C=2.0), "dmv")((1e-18, 1.0, -0.7, 0.6, 0.0, 0.8), 0.05, 1000)[0] == 1e-18


def test_error_of_closed_splitting_follows_the_torque() -> None:
    """A top of ten times the spin and the same step errs less; rotations about axes and dmv err by far more."""
    found = {}
    for spin in (4.0, 40.0):
        y = (0.1, -0.2, spin, 0.6, 0.0, 0.8)
        truth = reference_states(Lagrange(), y, np.array([1.0]))[0]
        for name, options in CASES:
            miss = Steps(Lagrange(), name, **options)(y, 0.005, 200) - truth
            found[name, bool(options), spin] = float(np.linalg.norm(miss[3:]))
    assert found["splitting", False, 40.0] < 0.5 * found["splitting", False, 4.0]
    assert found["splitting", True, 40.0] > 30.0 * found["splitting", False, 40.0]
    assert found["dmv", False, 40.0] > 1e5 * found["splitting", False, 40.0]


@by_top
def test_too_long_a_step_names_the_longest(top: Top) -> None:
    """The hint is right to its digits: a little less works, a little more does not."""
    method = made(top, "dmv")
    failed = Run(top, method, GEN[: len(top.components)], 3.0, 10)
    failed.collect()
    assert failed.ending is not None
    assert failed.ending.outcome is Outcome.NO_CONVERGENCE
    assert failed.ending.step == 1
    assert "the largest h that works from there is about" in failed.ending.message
    if not any(top.euler_poisson().gravity):  # otherwise the kick depends on h
        longest = float(failed.ending.message.split()[-1])
        for factor, outcome in ((0.99, Outcome.COMPLETED), (1.01, Outcome.NO_CONVERGENCE)):
            run = Run(top, method, GEN[: len(top.components)], factor * longest, 1)
            run.collect()
            assert run.ending is not None
            assert run.ending.outcome is outcome, (factor, longest)


def test_spherical_top_steps_up_to_one_radian() -> None:
    """sin(angle) = h |omega| has no solution beyond h |omega| = 1."""
    top, y = EulerGamma(A=1.0, B=1.0, C=1.0), (0.0, 0.6, 0.8, 1.0, 0.0, 0.0)
    for h, outcome in ((0.999, Outcome.COMPLETED), (1.001, Outcome.NO_CONVERGENCE)):
        run = Run(top, made(top, "dmv"), y, h, 1)
        run.collect()
        assert run.ending is not None
        assert run.ending.outcome is outcome


@pytest.mark.slow
def test_ensemble_has_the_bits_of_single_runs_where_the_iteration_goes_on() -> None:
    """The vectorised loop leaves the longer iteration, and steps without a solution, to the loop of single runs."""
    from topcli.engine.ensemble import EnsembleRun

    top, method, y0, h = EulerGamma(), made(EulerGamma(), "dmv"), random_states(40, 28), 0.45
    ensemble = EnsembleRun(top, method, y0, h, 50, 50, made=lambda piece: None)
    for _ in ensemble:
        pass
    outcomes = set()
    for i, y in enumerate(y0):
        single = Run(top, method, y, h, 50, 50)
        states = single.collect().states
        found = ensemble.endings[i]
        assert single.ending is not None
        assert (found.outcome, found.step, found.counters) == (
            single.ending.outcome,
            single.ending.step,
            single.ending.counters,
        )
        if found.outcome is Outcome.COMPLETED:
            assert (ensemble.last[i] == states[-1]).all()
        outcomes.add(found.outcome)
    assert outcomes == {Outcome.COMPLETED, Outcome.NO_CONVERGENCE}


@pytest.mark.slow
def test_comparison_finds_exact_and_bounded_integrals() -> None:
    """On a scene of each top: what a scheme declares is exact, the energy of splitting is bounded, and so is HK's."""
    scenes = {
        "kowalevski_generic_hk": {"gamma_sq", "two_l"},
        "lagrange_hk": {"gamma_sq", "m_gamma", "m_axis"},
        "heavy_hk": {"gamma_sq", "m_gamma"},
        "euler_gamma": {"m_sq", "gamma_sq", "m_gamma"},
    }
    for scene, exact in scenes.items():
        experiment = load_experiment(scene, ["h=0.05", "N=4000"])
        figures = compare_schemes(experiment, ("hk", "splitting", "dmv", "midpoint")).data
        verdicts = {
            one["scheme"]: {row["name"]: row["verdict"] for row in one["invariants"]} for one in figures["schemes"]
        }
        energy = experiment.top.energy
        free = scene == "euler_gamma"
        assert {name for name, verdict in verdicts["splitting"].items() if verdict == "exact"} == exact
        assert {name for name, verdict in verdicts["dmv"].items() if verdict == "exact"} == exact | (
            {energy} & {"m_omega"}
        )
        assert (verdicts["splitting"][energy], verdicts["hk"][energy]) == ("bounded", "bounded")
        assert verdicts["dmv"][energy] == ("exact" if free else "bounded")


def test_iterations_are_counted() -> None:
    """Three corrections a step where h |omega| is small; more where it is not."""
    counts = []
    for h in (0.01, 0.1, 0.6):
        run = Run(EulerGamma(), made(EulerGamma(), "dmv"), GEN, h, 100)
        run.collect()
        assert run.ending is not None
        counts.append(run.ending.counters["iterations"])
    assert counts[:2] == [300, 300]
    assert 600 < counts[2] < 1200


def test_refused_options_say_why() -> None:
    with pytest.raises(UsageError, match=r"free: closed needs two equal moments, A = B, not A = 2.0 and B = 1.5"):
        made(Heavy(), "splitting", free="closed")
    assert made(Heavy(B=2.0), "splitting", free="closed").step is not made(Heavy(), "splitting").step
