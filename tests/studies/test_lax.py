"""Lax forms: the matrices against closed forms of their spectra, and the study, each with a form or run that fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cases import table_of
from conftest import ROOT, random_states
from declared import random_heavy_tops
from topcli.analysis.lax import (
    LAMBDAS,
    LaxForm,
    block_form,
    commutator_residual,
    discrete_lax_defect,
    hat,
    kowalevski_form,
    lagrange_form,
    lax_forms,
    manakov_form,
    rates,
    spectral_content,
    spectral_drift,
)
from topcli.analysis.reference import reference_states
from topcli.contracts import EulerPoisson, Floats, NoOptions
from topcli.engine.collect import orbit
from topcli.schemes.any_top.midpoint import build
from topcli.schemes.kowalevski.backlund import constants_at, longest_step
from topcli.schemes.registry import find_scheme
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski

EULER = EulerPoisson((2.0, 1.5, 1.0), (0.0, 0.0, 0.0))


LAGRANGE = EulerPoisson((1.6, 1.6, 0.9), (0.0, 0.0, 0.7))


KOWALEVSKI = EulerPoisson((3.0, 3.0, 1.5), (0.8, 0.0, 0.0))


GENERAL = EulerPoisson((2.0, 1.5, 1.0), (1.0, -0.5, 0.8))


STATES = random_states(12, seed=1)


PAIRS = [(EULER, manakov_form), (LAGRANGE, lagrange_form), (KOWALEVSKI, kowalevski_form)]


FORMS = [*((equations, make(equations)) for equations, make in PAIRS), (GENERAL, block_form(GENERAL))]


each_form = pytest.mark.parametrize(("equations", "form"), FORMS, ids=lambda x: getattr(x, "name", ""))


def heavy(equations: EulerPoisson) -> Heavy:
    (A, B, C), (x, y, z) = equations.moments, equations.gravity
    return Heavy(A=A, B=B, C=C, x0=x, y0=y, z0=z)


def test_hat_has_the_papers_sign() -> None:
    u, v = STATES[:, :3], STATES[:, 3:]
    assert hat(u)[0, 0, 1] == u[0, 2]
    assert hat(v) @ hat(u) - hat(u) @ hat(v) == pytest.approx(hat(np.cross(u, v)), abs=1e-14)


def test_rates_are_the_tops_field() -> None:
    for top in (*random_heavy_tops(3, seed=2), Kowalevski(A=3.0, c0=-0.4)):
        for state, slope in zip(STATES, rates(top.euler_poisson(), STATES), strict=True):
            assert top.field(tuple(state), top.constants()) == pytest.approx(slope, rel=1e-13, abs=1e-14)


@pytest.mark.parametrize(
    ("moments", "gravity", "names"),
    table_of("""
(3.0, 2.0, 1.0)  (0.0, 0.0, 0.0)  manakov block
(2.0, 2.0, 1.5)  (0.0, 0.0, 1.0)  lagrange block
(2.0, 2.0, 1.0)  (1.0, 0.0, 0.0)  kowalevski block
(2.0, 2.0, 1.0)  (0.0, 0.0, 0.0)  manakov lagrange kowalevski block
(2.0, 2.0, 1.5)  (1.0, 0.0, 0.0)  block
(2.0, 2.0, 1.5)  (0.0, 1.0, 0.0)  block
(2.0, 2.0, 1.0)  (1.0, 0.5, 0.0)  block
(2.0, 2.0, 1.0)  (1.0, 0.0, 0.5)  block
(3.0, 2.0, 1.0)  (0.0, 0.0, 1.0)  block
"""),
)
def test_which_forms_a_top_has(moments: Floats, gravity: Floats, names: str) -> None:
    assert [form.name for form in lax_forms(EulerPoisson(moments, gravity))] == names.split()


@each_form
def test_commutator_equation_holds(equations: EulerPoisson, form: LaxForm) -> None:
    slopes = rates(equations, STATES)
    for lam in LAMBDAS:
        assert commutator_residual(form, STATES, slopes, lam) < 1e-15
        assert 5.6e-5 < commutator_residual(form, STATES, slopes * 1.001, lam) < 0.0016  # control


@pytest.mark.parametrize(("equations", "make"), PAIRS, ids=lambda x: getattr(x, "__name__", ""))
def test_pairs_belong_to_their_tops_only(equations: EulerPoisson, make) -> None:
    """Control: with other moments or other gravity the same matrices are not a Lax form."""
    A, B, C = equations.moments
    x, y, z = equations.gravity
    others = [EulerPoisson((A, B, C), (x + 0.3, y + 0.2, z + 0.1))]
    if make is not manakov_form:
        others.append(EulerPoisson((A, 1.1 * B, C), (x, y, z)))
    for other in others:
        assert 0.014 < commutator_residual(make(other), STATES, rates(other, STATES), 1.0) < 0.15


def test_the_block_form_holds_for_any_top() -> None:
    for top in random_heavy_tops(10, seed=3):
        form = block_form(top.euler_poisson())
        assert commutator_residual(form, STATES, rates(top.euler_poisson(), STATES), 1.0) < 1e-15
        assert spectral_content(form, top.invariants(), 6) == (2, ("gamma_sq", "m_gamma"))


def test_the_whole_trace_of_the_block_form_carries_less() -> None:
    """tr L^k of the 6x6 matrix carries gamma² alone; the block traces, twice of which the first is, m.gamma too."""
    top = next(iter(random_heavy_tops(1, seed=5)))
    form = block_form(top.euler_poisson())
    assert spectral_content(replace(form, blocks=1), top.invariants(), 6) == (1, ("gamma_sq",))
    L = form.L(STATES, 1.0)
    assert np.trace(L @ L, axis1=1, axis2=2) == pytest.approx(2.0 * form.invariants(STATES, 1.0)[:, 2], rel=1e-14)


def test_spectra_by_their_closed_forms() -> None:
    """tr L² as worked out by hand for each pair; for the block form gamma² and m.gamma."""
    y = STATES
    for lam in LAMBDAS:
        trace = manakov_form(EULER).invariants(y, lam)[:, 1]
        m = np.array(EULER.moments) * y[:, :3]
        J = 0.5 * sum(EULER.moments) - np.array(EULER.moments)
        assert trace == pytest.approx(-2.0 * (m**2).sum(axis=1) + lam**2 * (J**4).sum(), rel=1e-13)

        trace = lagrange_form(LAGRANGE).invariants(y, lam)[:, 1]
        A = LAGRANGE.moments[0]
        loop = y[:, 3:] + lam * np.array(LAGRANGE.moments) * y[:, :3] + lam**2 * A * np.array(LAGRANGE.gravity)
        assert trace == pytest.approx(-2.0 * (loop**2).sum(axis=1), rel=1e-13)

        top = Kowalevski(A=KOWALEVSKI.moments[0], c0=KOWALEVSKI.gravity[0])
        c = top.c0 / top.C
        gamma_sq, _, energy, _ = (invariant.value(y) for invariant in top.invariants())
        trace = kowalevski_form(KOWALEVSKI).invariants(y, lam)[:, 1]
        want = 16.0 * lam**2 - 8.0 * energy / top.C + 2.0 * c**2 * gamma_sq / lam**2
        assert trace == pytest.approx(want, rel=1e-13, abs=0.0)
    trace = block_form(GENERAL).invariants(y, 1.0)
    gamma_sq, m_gamma, _ = (invariant.value(y) for invariant in heavy(GENERAL).invariants())
    assert trace[:, 2] == pytest.approx(-2.0 * gamma_sq, rel=1e-13, abs=0.0)
    assert trace[:, 3] == pytest.approx(-4.0 * m_gamma, rel=1e-13, abs=0.0)


def test_what_the_spectra_carry() -> None:
    for equations, make, count, carried in (
        (LAGRANGE, lagrange_form, 4, ("gamma_sq", "m_gamma", "energy")),
        (EULER, manakov_form, 2, ("energy",)),
    ):
        assert spectral_content(make(equations), heavy(equations).invariants(), 6) == (count, carried)
    content = spectral_content(kowalevski_form(KOWALEVSKI), Kowalevski(A=3.0, c0=0.8).invariants(), 6)
    assert content == (4, ("gamma_sq", "two_l", "energy", "k_sq"))


@pytest.mark.slow
@each_form
def test_spectrum_along_the_flow(equations: EulerPoisson, form: LaxForm) -> None:
    """Constant along the exact flow; under the midpoint rule all but that of the Kowalevski top."""
    top, y0 = heavy(equations), STATES[0]
    exact = reference_states(top, y0, np.linspace(0.0, 20.0, 101))
    midpoint = orbit(top, build(top, NoOptions()), y0, 0.1, 60).states
    for lam in LAMBDAS:
        assert spectral_drift(form, exact, lam) < 1e-14
        drift = spectral_drift(form, midpoint, lam)
        assert drift < 1e-13 if form.name != "kowalevski" else drift > 1e-8
        assert 2.6e-7 < spectral_drift(form, exact + 1e-6 * np.sin(np.arange(101.0))[:, None], lam) < 3.5e-5


def runs_of(name: str, y0, h: float, top: Kowalevski) -> np.ndarray:
    scheme = find_scheme(name, "kowalevski")
    return orbit(top, scheme.build(top, scheme.options()), y0, h, 60).states


@pytest.mark.slow
@pytest.mark.parametrize("c0", [-3.0, 0.0])
def test_discrete_lax_pair(c0: float) -> None:
    """Round-off along runs of backlund, for real and complex pairs of eigenvalues; of order h³ along HK's."""
    top, pair = Kowalevski(c0=c0, A=3.0), kowalevski_form(Kowalevski(c0=c0, A=3.0).euler_poisson())
    complex_pairs = []
    for y0 in random_states(12, seed=81):
        longest = longest_step(constants_at(tuple(y0), top.constants()[0]))
        for fraction in (0.1, -0.5, 0.99):
            h = fraction * min(2.0, longest)
            states = runs_of("backlund", y0, h, top)
            values = np.linalg.eigvals(pair.L(states[:1], -2.0 / h))[0]
            complex_pairs.append(bool((np.abs(values.imag) > 1e-8).any()))
            for lam in (*LAMBDAS, 2.0 / h):
                assert discrete_lax_defect(pair, states, h, lam) < 1e-12
    assert (True in complex_pairs) == (c0 != 0.0)
    assert False in complex_pairs
    wrong = [discrete_lax_defect(pair, runs_of("hk", STATES[0], h, top)[:2], h, 1.0) for h in (0.04, 0.02)]
    assert np.log2(wrong[0] / wrong[1]) == pytest.approx(3.0, abs=0.1)
    assert wrong[1] > 1e-11


def test_command_reports_each_form(cli) -> None:
    """Sizes, carried integrals and drifts of the spectrum; typical defects are 3e-17 to 9e-15 for what is exact."""
    report = cli("lax", "kowalevski", "midpoint", "backlund", "--set", "N=200", "--json").json()
    kowalevski, block = report["forms"]
    assert (kowalevski["form"], kowalevski["size"], kowalevski["lax_pair"]) == ("kowalevski", 5, True)
    assert (block["form"], block["size"], block["lax_pair"]) == ("block", 6, False)
    assert kowalevski["carries"] == ["gamma_sq", "two_l", "energy", "k_sq"]
    assert block["carries"] == ["gamma_sq", "two_l"]
    for form in (kowalevski, block):
        assert form["independent_integrals"] == len(form["carries"])
        assert form["residual"] < 1e-15
    exact, midpoint, backlund = report["runs"]
    assert [run["scheme"] for run in report["runs"]] == ["exact flow", "midpoint", "backlund"]
    for run in (exact, backlund):
        assert max(form["drift"] for form in run["forms"]) < 1e-14
    assert midpoint["forms"][0]["drift"] > 1e-8 > 1e-13 > midpoint["forms"][1]["drift"]
    assert midpoint["discrete_lax_defect"] > 1e-9 > 1e-11 > backlund["discrete_lax_defect"]
    assert exact["discrete_lax_defect"] is None
    assert cli("lax", "euler", "hk", "--set", "N=100").out.startswith("manakov is a Lax pair; block is no Lax pair")


def test_a_config_of_another_top_is_refused(cli) -> None:
    message = cli("lax", "heavy", "--config", str(ROOT / "configs" / "kowalevski_hk.yaml"))
    assert (message.code, message.out) == (2, "")
    assert "of the top 'kowalevski', not 'heavy'" in message.err


@pytest.mark.slow
def test_a_run_that_fails_is_reported(cli) -> None:
    report = cli("lax", "heavy", "rk2", "midpoint", "--set", "h=60.0", "--set", "N=20", "--set", "top.x0=50")
    assert report.code == 1
    assert "error: rk2: blew up" in report.err
