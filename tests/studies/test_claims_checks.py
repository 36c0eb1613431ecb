"""The checks of the ledger, on defects other than their controls, and its exact arithmetic."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import topcli
from topcli.paper import printed
from topcli.paper.algebra import Draws, dot
from topcli.paper.claim import FAILS, HOLDS, MISPRINT
from topcli.paper.kinds import (
    conservation,
    equation_order,
    exchange,
    first_steps,
    integrability,
    levels,
    maps,
    motion,
    rank,
)
from topcli.paper.ledger import LEDGER, SUBJECTS
from topcli.paper.scenes import Scene, exact_maps, trajectory
from topcli.paper.subjects import equations, hybrid

NAMED = {claim.id: claim for claim in LEDGER}
VARIED_KINDS = ("conserved exactly", "reversible", "equal maps", "symmetric equation", "elliptic function")
"""Kinds that decide laws and symmetries, which the paper states for all parameters, states and steps."""


# general statements are tried with random parameters


@pytest.mark.slow
@pytest.mark.parametrize("name", [claim.id for claim in LEDGER if claim.kind.name in VARIED_KINDS])
def test_general_claim_draws_parameters_state_and_step(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four runs at least, no two with the same parameters, state or step."""
    seen: list[Any] = []
    for module in (conservation, maps, exchange, rank):

        def spied(scene: Scene) -> Any:
            seen.extend(found := exact_maps(scene))
            return found

        monkeypatch.setattr(module, "exact_maps", spied)
    claim = NAMED[name]
    assert claim.decide().verdict == (FAILS if name == "hybrid-reversible" else HOLDS)
    assert claim.experiment.endswith("with random parameters, state and h")
    assert len(seen) >= 4
    forms = {one.experiment.top.form for one in seen}
    distinct = [{tuple(map(str, one.y0)) for one in seen}, {str(one.run.h) for one in seen}]
    if forms != {"lagrange/inertial"}:  # (L1), (L2) have no parameters
        distinct.append({tuple(map(str, one.run.top.constants())) for one in seen})
    assert [len(one) for one in distinct] == [len(seen)] * len(distinct)


@pytest.mark.parametrize("section", ["Equations of motion", "Discrete Euler top", "HK scheme of heavy tops"])
def test_identities_of_every_top_draw_its_moments(section: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each printed formula with moments of inertia is tried with 15 triples or more, of which 10 differ in C."""
    seen: dict[str, set[Any]] = {}
    for name in ("euler_poisson", "euler", "euler_top", "laws", "hk_euler", "hk_heavy"):
        formula = getattr(printed, name)

        def spied(moments: Any, *rest: Any, formula: Any = formula, **more: Any) -> Any:
            seen.setdefault(current, set()).add(tuple(moments))
            return formula(moments, *rest, **more)

        monkeypatch.setattr(printed, name, spied)
    (claims,) = (found for title, found in SUBJECTS.items() if title.startswith(section))
    for claim in claims:
        if claim.kind.name == "identity":
            current = claim.id
            claim.decide()
    assert len(seen) >= (1 if section.startswith("HK") else 2)
    for name, moments in seen.items():
        assert len(moments) >= 15, name
        assert len({one[2] for one in moments}) >= 10, name


def test_the_fourth_integral_is_a_misprint_that_no_unit_moment_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """With C = 1 for every draw the printed k² holds: the experiment needs a random C."""
    assert NAMED["kowalevski-fourth"].decide().verdict == MISPRINT
    monkeypatch.setattr(Draws, "positive", lambda self: Fraction(1))
    assert NAMED["kowalevski-fourth"].decide().verdict == HOLDS


def test_rate_of_the_fourth_integral_by_differences() -> None:
    """d/dt |omega² - c gamma|² along the Euler-Poisson equations of random tops A = B = 2C, written out here."""
    draws = np.random.default_rng(3)
    for _ in range(20):
        C, c0 = draws.uniform(1.2, 3.0), draws.uniform(0.5, 2.0)
        w, g = draws.normal(size=3), draws.normal(size=3)
        I = np.array([2.0 * C, 2.0 * C, C])  # noqa: E741
        w_rate = (np.cross(I * w, w) + np.cross(g, [c0, 0.0, 0.0])) / I
        g_rate = np.cross(g, w)

        def rate(c: float, w: Any = w, g: Any = g, w_rate: Any = w_rate, g_rate: Any = g_rate) -> float:
            xi = (w[0] + 1j * w[1]) ** 2 - c * (g[0] + 1j * g[1])
            xi_rate = 2.0 * (w[0] + 1j * w[1]) * (w_rate[0] + 1j * w_rate[1]) - c * (g_rate[0] + 1j * g_rate[1])
            return float(2.0 * (xi.conjugate() * xi_rate).real)

        assert abs(rate(c0 / C)) < 1e-13
        assert abs(rate(c0)) > 1e-4


def test_epsilon_has_to_be_a_grassmann_symbol(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a number for epsilon (Audin) fails by -epsilon² [G, M]; a wrong gravity term or a wrong matrix is found."""
    draws = np.random.default_rng(1)
    I, g, w, c = draws.uniform(1.0, 2.0, 3), *draws.normal(size=(3, 3))  # noqa: E741
    m_rate, c_rate = np.cross(I * w, w) + np.cross(c, g), np.cross(c, w)
    M, G, W, Gamma, M_rate, Gamma_rate = (np.array(printed.hat(tuple(v))) for v in (I * w, g, w, c, m_rate, c_rate))
    for eps in (0.5, 0.1):
        left, L, P = Gamma_rate + eps * M_rate, Gamma + eps * M, W + eps * G
        assert left - (P @ L - L @ P) == pytest.approx(-(eps**2) * (G @ M - M @ G), rel=1e-12, abs=1e-14)
    for name in ("audin", "epsilon"):
        assert NAMED[name].decide().verdict == HOLDS
    right = printed.euler_poisson
    monkeypatch.setattr(printed, "euler_poisson", lambda I, g, w, c: right(I, tuple(-x for x in g), w, c))  # noqa: E741
    monkeypatch.setattr(printed, "EPSILON", ((0, 1), (1, 0)))
    for name in ("audin", "epsilon"):
        assert NAMED[name].decide().verdict == FAILS


def test_kowalevski_integrals_are_four(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rank falls to 3 if k² is replaced by a function of the other three."""
    assert NAMED["kowalevski-integrable"].decide().figure == 4.0
    monkeypatch.setattr(printed, "k_squared", lambda c, w, g: dot(g, g) * dot(g, g))
    assert equations.kowalevski_integrals(Draws(1))
    assert NAMED["kowalevski-integrable"].decide().figure == 3.0


# figures: the order of an equation, levels between swings, growth, singular states, slopes


@pytest.mark.slow
def test_residual_of_the_trapezoidal_rule_is_its_leading_term() -> None:
    """|xi| h³/12 |d² omega_3/dt²| with d² omega_3/dt² = -c0 (gamma_3 omega_1 - gamma_1 omega_3), on the same orbit."""
    finding = NAMED["trapezoidal"].decide()
    h = conservation.LADDER[-1]
    y = topcli.simulate(
        "kowalevski_exact", h=h, N=2000, initial={"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}
    ).states.T
    xi = np.abs((y[0] + 1j * y[1]) ** 2 - (y[3] + 1j * y[4]))
    leading = float((xi * np.abs(y[5] * y[0] - y[3] * y[2])).max()) * h**3 / 12.0
    assert float(finding.note.split()[1]) == pytest.approx(leading, rel=0.05)
    assert finding.figure == pytest.approx(2.0, abs=0.01)

    def one_sided(c0: float, h: float, old: Any, new: Any) -> Any:
        """Euler's rule for the angle."""
        return equation_order.trapezoidal(c0, h, old, np.vstack([new[:2], old[2:3], new[3:]]))

    assert equation_order.equation_order(one_sided, 2).figure == pytest.approx(1.0, abs=0.05)


@dataclass(frozen=True)
class Series:
    """A run of 50 units of time with swings at 13, 27 and 41, and a quantity."""

    value: Callable[[np.ndarray], np.ndarray]
    scheme: str = "made up"

    @property
    def t(self) -> np.ndarray:
        return np.linspace(0.0, 50.0, 5001)

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "gamma1":
            return 1.0 - 2.0 * sum(np.exp(-((self.t - at) ** 2)) for at in (13.0, 27.0, 41.0))
        return self.value(self.t)


def step_up(t: np.ndarray, at: float) -> np.ndarray:
    return 0.5 + 0.5 * np.tanh(4.0 * (t - at))


@pytest.mark.parametrize(
    ("value", "rise", "back"),
    [
        (lambda t: 7.0 + sum(step_up(t, at) for at in (13.0, 27.0, 41.0)), 1.0, 1.0),
        (lambda t: 7.0 + sum(np.exp(-((t - at) ** 2)) for at in (13.0, 27.0, 41.0)), 0.0, 0.0),
        (lambda t: 7.0 + step_up(t, 13.0) - step_up(t, 27.0) + step_up(t, 41.0), -3.0, 1.0),
        (lambda t: 7.0 + step_up(t, 13.0) + 0.55 * step_up(t, 27.0) + step_up(t, 41.0), 0.55 * 3.0 / 2.55, 1.0),
    ],
    ids=["stairs", "bumps", "up and down", "uneven stairs"],
)
def test_levels_between_swings(value: Any, rise: float, back: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "trajectory", lambda scene: Series(value))
    found = levels.rises(Scene("made up"), "x"), levels.returns("x", Scene("made up"))
    assert [one.figure for one in found] == pytest.approx([rise, back], abs=1e-6)
    assert [one.verdict for one in found] == [HOLDS if rise >= 0.5 else FAILS, HOLDS if back <= 0.1 else FAILS]


@pytest.mark.parametrize(
    ("ratio", "stays", "grows"), [(1.0, HOLDS, FAILS), (1.4, HOLDS, FAILS), (1.6, FAILS, FAILS), (5.1, FAILS, HOLDS)]
)
def test_growth_over_a_run(ratio: float, stays: str, grows: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An oscillation of range 2 in the first tenth, and of ``ratio`` times that at the end."""

    def value(t: np.ndarray) -> np.ndarray:
        return np.sin(2.0 * np.pi * t) * np.where(t < 40.0, 1.0, ratio)

    monkeypatch.setattr(levels, "trajectory", lambda scene: Series(value))
    found = levels.stays(Scene("made up"), "x"), levels.grows(Scene("made up"), "x")
    assert [one.figure for one in found] == pytest.approx([ratio, ratio], rel=1e-3)
    assert [one.verdict for one in found] == [stays, grows]


@pytest.mark.slow
def test_energy_of_figure_3_between_swings() -> None:
    """Read off the run at times without motion: 5.00000, 5.00128, 5.00255, 5.00384."""
    run = trajectory(Scene("kowalevski_bohlin_a"))
    wanted = [float(run["energy"][np.searchsorted(run.t, t)]) for t in (3.0, 22.0, 36.0, 50.0)]
    assert wanted == pytest.approx([5.00000, 5.00128, 5.00256, 5.00384], abs=6e-6)
    found, _ = levels.levels_between_swings(Scene("kowalevski_bohlin_a"), "energy")
    assert found == pytest.approx(wanted, abs=4e-6)


def test_singular_states_of_the_methods() -> None:
    finding = NAMED["abc-complete"].decide()
    assert (finding.figure, finding.note) == (2.0, "(B) at γ₃ = -1; (C) at ω = 0")
    w, c = np.array([0.7, -0.4, 1.3]), np.array([0.6, 0.48, 0.64])
    for letter, order in (("A", 3), ("B", 2), ("C", 3)):  # one step of 0.01 against exp(h W) gamma, to the order
        turned = c + first_steps.H * np.cross(c, w) + 0.5 * first_steps.H**2 * np.cross(np.cross(c, w), w)
        found = np.array(first_steps.METHODS[letter](tuple(w), tuple(c)))
        assert np.abs(found - turned).max() < 5.0 * first_steps.H**order, letter
        assert np.dot(found, found) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.slow
def test_the_hybrid_drifts_and_its_reversible_form_does_not() -> None:
    finding = NAMED["reversal-important"].decide()
    assert finding.figure > 1000.0
    assert motion.slopes_differ("hybrid", "hybrid").figure == 1.0
    hybrid_slope, sym_slope = map(float, re.findall(r"(\d\.\de-\d+)", finding.note))
    assert hybrid_slope == pytest.approx(3.6e-5, rel=0.05)
    assert sym_slope < 1e-8


@pytest.mark.slow
def test_neighbours_part_under_maps_that_are_not_integrable() -> None:
    for name in ("hybrid", "bohlin-a", "bohlin-c"):
        assert NAMED[f"{name}-only-approximates"].decide().figure > 9.0
    for h in (0.1, 0.2):
        assert integrability.map_parts_neighbours("backlund", h).figure < 4.0


@pytest.mark.slow
def test_most_orbits_of_b_as_printed_end_at_the_pole() -> None:
    """The reason for which (B) is left out: 27 of 32 orbits end, each with gamma next to the third axis below."""
    draws, ended = np.random.default_rng(1), 0
    for _ in range(32):
        omega, gamma = draws.normal(scale=1.5, size=3), draws.normal(size=3)
        state = {"omega": omega.tolist(), "gamma": (gamma / np.linalg.norm(gamma)).tolist()}
        scheme = {"name": "bohlin-b", "chart": "single"}
        run = topcli.simulate("kowalevski_bohlin_b", scheme=scheme, h=0.4, N=2000, initial=state)
        if len(run) < 2001:
            ended += 1
            finite = run["gamma3"][np.isfinite(run.states).all(axis=1)]
            assert finite[-1] < -0.99
    assert ended == 27


@pytest.mark.slow
def test_reversible_schemes_as_inaccurate_as_figure_3_return() -> None:
    """The control is the size: E deviates by 0.0045 in Figure 3, and as much under the two schemes."""
    finding = NAMED["fig3-cause"].decide()
    sizes = [float(x) for x in re.findall(r"range (\S+),", finding.note)]
    assert len(sizes) == 2
    assert min(sizes) > 0.0044
    coarse = Scene("kowalevski_hk", ("scheme=rk2", "h=0.0625", "N=800"))
    assert levels.returns("energy", coarse).verdict == FAILS


def test_wrong_transcription_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sign in (K1), which every identity about it notices."""

    def wrong(c0: Any, w: Any, c: Any) -> Any:
        return (w[1] * w[2] / 2, -w[2] * w[0] / 2 - c0 / 2 * c[2], -c0 * c[1]), right(c0, w, c)[1]

    right = printed.kowalevski
    names = [
        "kowalevski-equations",
        "kowalevski-complex-omega",
        "kowalevski-xi",
        "kowalevski-energy",
        "kowalevski-k-sq",
    ]
    assert {row.category for row in topcli.claims(names).rows} == {HOLDS}
    monkeypatch.setattr(printed, "kowalevski", wrong)
    assert {row.category for row in topcli.claims(names).rows} == {FAILS}


def test_corrected_equation_is_no_misprint(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the last term corrected as printed, (dEulerPoisson) simply holds; with a wrong correction it fails."""
    original = printed.hk_heavy
    assert topcli.claims("hk-heavy-equation").rows[0].category == MISPRINT
    monkeypatch.setattr(printed, "hk_heavy", lambda *at: original(*at[:-1], True))
    assert topcli.claims("hk-heavy-equation").rows[0].category == HOLDS
    monkeypatch.setattr(printed, "hk_heavy", lambda *at: original(*at[:-1], False))
    assert topcli.claims("hk-heavy-equation").rows[0].category == FAILS


def test_the_misprint_is_one_half_of_a_term() -> None:
    """Both states equal, the printed last line gives (gamma_1 omega_2 - gamma_2 omega_1)/2 instead of twice that."""
    w, c = (Fraction(1), Fraction(2), Fraction(3)), (Fraction(5), Fraction(7), Fraction(11))
    one, zero = (Fraction(1),) * 3, (Fraction(0),) * 3
    for corrected, factor in ((False, Fraction(1, 2)), (True, Fraction(1))):
        left = printed.hk_heavy(one, zero, Fraction(1), (*w, *c), (*w, *c), corrected)
        assert -left[5] == factor * (5 * 2 - 7 * 1)


@pytest.mark.slow
def test_return_defect_of_the_hybrid_is_that_of_plain_doubles() -> None:
    """1.4e-5 at h = 0.1 and of order 4, with 50 digits and by plain doubles here, over the same states."""
    finding = NAMED["hybrid-reversible"].decide()
    assert finding.figure == pytest.approx(1.36e-5, rel=1e-2)
    found = re.fullmatch(r"of order (\d\.\d\d) in h; (\S+) along the paper's run at h = 0.001", finding.note)
    assert found
    assert float(found[1]) == pytest.approx(4.0, abs=0.1)
    assert float(found[2]) == pytest.approx(2.7e-13, rel=0.05)
    defects = []
    for one in exact_maps(hybrid.HYBRID.with_sets("N=1")):
        start = one.y0.astype(float)
        there, top = start, {"kind": "kowalevski", "c0": float(one.run.top.c0)}
        for h in (0.1, -0.1):
            state = {"omega": there[:3].tolist(), "gamma": there[3:].tolist()}
            there = topcli.simulate("kowalevski_hybrid", h=h, N=1, initial=state, top=top).states[-1]
        defects.append(float(np.abs(there - start).max()))
    assert max(defects) == pytest.approx(finding.figure, rel=1e-6)
    assert min(defects) > 1e-9
