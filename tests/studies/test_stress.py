"""The hard cases: the states are as described, checks distinguish good from bad, and limits match the outcomes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpmath import mp, mpc, mpf

import topcli
from cases import table_of
from declared import SCHEMES
from topcli.analysis.reference import reference_states
from topcli.contracts import Floats, Scheme, Stepper, Top
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.stress.cases import (
    CASES,
    DELONE,
    EVENT,
    GENERIC,
    TOP,
    TORUS_E4,
    case_names,
    cases_named,
    degenerate,
    separation,
    singular_step,
    swing_time,
)
from topcli.studies.stress.checks import Case, CaseCache, CaseOutcome, Finding, Trial
from topcli.studies.stress.trials import JudgedTrial, stress, verdict_of
from topcli.tops.euler import Euler
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange

SLOW = ("drift", "there-and-back")


def case_of(name: str, form: str = "kowalevski") -> Case:
    return next(case for case in cases_named(name) if case.form == form)


def finding(
    case: str,
    scheme: str,
    form: str = "kowalevski",
    N: int | None = None,
    options: dict[str, Any] | None = None,
    **traits: Any,
) -> Finding:
    """Finding of the case for the scheme; ``traits`` changes the scheme's declaration or its build."""
    one = case_of(case, form)
    experiment = one.experiment(scheme, options)
    changes: dict[str, Any] = {"scheme": replace(experiment.scheme, **traits)} | ({"N": N} if N else {})
    return one.check(Trial(one, experiment.model_copy(update=changes), CaseCache()))


def bent(step: Callable[[Floats, float, Floats], Floats]) -> Callable[[Top, Any], Stepper]:
    """A ``build`` of the midpoint rule of the Euler top, or of gamma, followed by ``step``."""

    def build(top: Top, options: Any) -> Stepper:
        scheme = find_scheme("midpoint", top.form)
        inner = scheme.build(top, scheme.options())
        assert isinstance(inner, Stepper)
        inner_step = inner.step
        return replace(inner, step=lambda s, h, p: step(inner_step(s, h, p), h, p))

    return build


# the states


def exactly_separated(state: Floats) -> tuple[Any, Any, Any]:
    """S(e4), S(e5), g2³ - 27 g3² with 40 digits, and S made from Kowalevski's R(x) = 0 instead of by its formula."""
    with mp.workdps(40):
        w1, w2, w3, g1, g2, g3 = map(mpf, state)
        l1 = (w1**2 + w2**2 + w3**2 / 2 + g1) / 3
        ell = w1 * g1 + w2 * g2 + w3 * g3 / 2
        k = abs(mpc(w1, w2) ** 2 - mpc(g1, g2))
        # the invariants of the quartic -x^4 + 6 l1 x^2 - 4 l x + 1 - k^2, its coefficients a, 4b, 6c, 4d, e
        a, b, c, d, e = -1, 0, l1, -ell, 1 - k**2
        q2, q3 = a * e - 4 * b * d + 3 * c**2, a * c * e + 2 * b * c * d - c**3 - a * d**2 - b**2 * e
        assert abs(q3 - (l1 * (k**2 - 1 - l1**2) + ell**2)) < mpf(10) ** -30
        cubic = [4 * s**3 - q2 * s - q3 for s in ((l1 + k) / 2, (l1 - k) / 2)]
        return cubic[0], cubic[1], q2**3 - 27 * q3**2


def test_degenerate_tori_are_degenerate() -> None:
    states = (TORUS_E4, degenerate(1, 0.585, 0.59), degenerate(2, 0.62, 0.625))
    for which, state in enumerate(states):
        exact = exactly_separated(state)
        assert abs(exact[which]) < 2e-15
        assert exact == pytest.approx(separation(state), abs=1e-14)
        assert 0.047 < abs(separation(GENERIC)[which]) < 6.7
    assert math.hypot(*TORUS_E4[3:]) == pytest.approx(1.0, abs=1e-15)


def test_delone_is_at_k_zero() -> None:
    w1, w2, _, g1, g2, _ = DELONE
    assert (w1 * w1 - w2 * w2 - g1, 2.0 * w1 * w2 - g2) == pytest.approx((0.0, 0.0), abs=2e-16)


@pytest.mark.parametrize(
    ("name", "components", "values"),
    table_of("""
pole               (3, 4, 5)  (0.0, 0.0, -1.0)
branch-point       (0, 1)     (0.0, 0.0)
near-branch-point  (0, 1)     (0.0, 1e-3)
real-axis          (0, 1)     (-0.8, 0.0)
"""),
)
def test_motions_pass_the_hard_place_on_a_step(name: str, components: tuple[int, ...], values: Floats) -> None:
    experiment = case_of(name).experiment("hk")
    assert EVENT / experiment.h == round(EVENT / experiment.h)
    state = reference_states(experiment.top, experiment.y0, np.array([EVENT]))[0]
    assert state[list(components)] == pytest.approx(values, abs=4e-15)


@pytest.mark.parametrize(
    "top",
    [Kowalevski(), Kowalevski(c0=2.0), Euler(), Heavy(), Lagrange(), Lagrange(mu=2.0)],
    ids=repr,
)
def test_singular_steps_are_singular(top: Top) -> None:
    """Kahan's matrix 1 - h/2 f'(y), by complex steps from the field itself, has a kernel."""
    state = GENERIC[: len(top.components)]
    h = singular_step(top, state)  # pyright: ignore

    def least(h: float) -> float:
        columns = []
        for i in range(len(state)):
            z = [complex(value) for value in state]
            z[i] += 1e-200j
            columns.append([value.imag / 1e-200 for value in map(complex, type(top).field(tuple(z), top.constants()))])  # pyright: ignore
        return float(np.linalg.svd(np.eye(len(state)) - 0.5 * h * np.array(columns).T, compute_uv=False)[-1])

    assert least(h) < 1e-14
    assert 0.012 < least(0.9 * h) < 0.18


def test_a_top_without_a_singular_step_is_reported() -> None:
    with pytest.raises(ValueError, match="is not singular"):
        singular_step(Euler(A=1.0, B=1.0, C=1.0), (0.7, -0.4, 1.3))  # pyright: ignore


def test_the_theory_of_the_swings() -> None:
    """The reference swings when sqrt 2 ln(8 sqrt 7/eps) says, to the first order in eps."""
    for eps in (1e-3, 1e-5, 1e-6):
        t = swing_time(eps) + np.linspace(-0.01, 0.01, 201)
        y = reference_states(TOP, (2.0, 0.0, 0.0, math.sqrt(1.0 - eps * eps), 0.0, eps), t)
        slope = y[:, 4] * y[:, 2] - y[:, 5] * y[:, 1]  # gamma1'
        assert abs(float(np.interp(0.0, slope, t)) - swing_time(eps)) < 3.0 * eps


# the checks, each on what holds and on what does not


@pytest.mark.parametrize(
    ("case", "scheme", "form", "changes", "outcome", "step", "why"),
    table_of("""
pole                bohlin-a  kowalevski  {}                                 held      None   ""
pole                bohlin-b  kowalevski  {}                                 broke     59     blew up at step 59
pole                hk        kowalevski  {"order": 3}                       degraded  None   ""
branch-point        hk        kowalevski  {}                                 held      None   ""
branch-point        hybrid    kowalevski  {}                                 degraded  None   ""
real-axis           bohlin-a  kowalevski  {}                                 held      None   ""
real-axis           bohlin-a  kowalevski  {"options": {"branch": "sign"}}    broke     50     ""
rest-on-axis        bohlin-a  kowalevski  {}                                 broke     None   left the exact motion
backwards           dop853    kowalevski  {}                                 held      None   ""
backwards           rk2       kowalevski  {"adaptive": True}                 degraded  None   ""
backwards           exact     euler       {}                                 held      None   ""
backwards           midpoint  euler       {"order": None}                    degraded  None   ""
backwards           rk4       kowalevski  {}                                 held      None   ""
backwards           rk4       kowalevski  {"conserves": ("gamma_sq",)}       broke     None   γ² changes
homoclinic-1e-9     hk        kowalevski  {}                                 held      None   ""
homoclinic-1e-9     hk        kowalevski  {"N": 1000}                        broke     None   no swing
homoclinic-spacing  bohlin-a  kowalevski  {}                                 broke     15297  ""
resonance           midpoint  kowalevski  {}                                 held      None   ""
resonance           rk4       kowalevski  {}                                 broke     None   ""
singular-step       hk        kowalevski  {}                                 broke     1      ""
singular-step       bohlin-a  kowalevski  {}                                 degraded  None   ""
there-and-back      hybrid    kowalevski  {}                                 degraded  None   ""
there-and-back      hybrid    kowalevski  {"self_adjoint": True}             broke     None   ""
drift               hk        kowalevski  {"N": 10000, "conserves": ("energy",)}  broke  None  E changes
drift               hk        kowalevski  {"N": 100}                         "not tried"  None   ""
"""),
)
def test_checks_distinguish_what_holds_from_what_does_not(
    case: str, scheme: str, form: str, changes: dict[str, Any], outcome: str, step: int | None, why: str
) -> None:
    """With other options, another declaration or fewer steps; at 15297 is the first swing of the paper's Figure 2."""
    found = finding(case, scheme, form, **changes)
    assert found.result.value == outcome
    assert step in (None, found.step)
    assert why in found.why


def test_timing_of_flips_is_judged() -> None:
    for offset in ("1e-3", "1e-12"):
        held = finding(f"racket-{offset}", "midpoint", "euler")
        assert held.result is CaseOutcome.HELD
        assert held.figures["relative_error"] < 1e-3
    kicked = finding(
        "racket-1e-12", "midpoint", "euler", conserves=(), build=bent(lambda s, h, p: (s[0] + 1e-9, *s[1:]))
    )
    assert kicked.result is CaseOutcome.BROKE
    assert kicked.figures["time"] < 0.75 * kicked.figures["exact"]
    still = finding(
        "racket-1e-3", "midpoint", "euler", conserves=(), build=bent(lambda s, h, p: (1e-3, 1.0, 0.0, *s[3:]))
    )
    assert (still.result, "no flip" in still.why) == (CaseOutcome.BROKE, True)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scheme", [s for s in SCHEMES if s.self_adjoint and not s.adaptive], ids=lambda s: f"{s.name}/{s.top}"
)
def test_self_adjoint_schemes_return(scheme: Scheme) -> None:
    """1e5 steps forward and 1e5 back: nothing but round-off's growth is left."""
    assert finding("there-and-back", scheme.name, scheme.top).result is CaseOutcome.HELD


@pytest.mark.slow
def test_claimed_invariants_do_not_drift() -> None:
    """A step that restores its integrals stays within 2 ulp; round-off of backlund and midpoint walks 107 and 134."""
    integrals = ("gamma_sq", "two_l", "energy", "k_sq")
    for scheme, traits, bound in (
        ("hybrid-sym", {}, 5.0),
        ("hk", {"options": {"project": 1}, "conserves": integrals}, 5.0),
        ("backlund", {}, math.sqrt(200_000)),
        ("midpoint", {}, math.sqrt(200_000)),
    ):
        held = finding("drift", scheme, N=200_000, **traits)
        assert held.result is CaseOutcome.HELD
        assert max(value for key, value in held.figures.items() if key.endswith(":ulp")) < bound

    def biased(s: Floats, h: float, p: Floats) -> Floats:
        a = 1.0 + 2.0**-52
        return (a * s[0], a * s[1], a * s[2], *s[3:])

    slanted = finding("drift", "midpoint", "euler", N=100_000, build=bent(biased))
    assert slanted.result is not CaseOutcome.HELD


# limits


@pytest.fixture(scope="module")
def fast() -> list[JudgedTrial]:
    """All schemes of the registry but those of the interpreter, in all cases but the slowest."""
    plain = {scheme.name for scheme in all_schemes() if scheme.adaptive}
    names = sorted({scheme.name for scheme in all_schemes()} - plain)
    return stress(names, [name for name in case_names() if name not in SLOW])


@pytest.mark.slow
def test_what_breaks_is_declared_and_what_is_declared_breaks(fast: list[JudgedTrial]) -> None:
    wrong = [
        (one.scheme.name, one.scheme.top, one.case.name, one.verdict)
        for one in fast
        if one.verdict in ("unexplained", "outlived limit")
    ]
    assert wrong == []
    assert sum(one.verdict == "limit" for one in fast) > 30


@pytest.mark.slow
def test_every_form_has_its_cases(fast: list[JudgedTrial]) -> None:
    for scheme in {one.scheme.name: one.scheme for one in fast}.values():
        asked = {case.name for case in CASES if case.form == scheme.top}
        assert {one.case.name for one in fast if one.scheme == scheme} == asked - set(SLOW)


def test_limits_named_like_cases_are_cases_of_the_scheme() -> None:
    for scheme in all_schemes():
        for key, text in scheme.limits.items():
            assert key not in case_names() or any(case.form == scheme.top for case in cases_named(key))
            assert text.endswith(".")


def test_verdicts_compare_outcomes_with_limits() -> None:
    hk = find_scheme("hk", "kowalevski")
    assert verdict_of(hk, "huge", CaseOutcome.BROKE) == "unexplained"
    assert verdict_of(hk, "resonance", CaseOutcome.BROKE) == "limit"
    assert verdict_of(hk, "resonance", CaseOutcome.DEGRADED) == "outlived limit"
    assert verdict_of(hk, "huge", CaseOutcome.DEGRADED) == "ok"
    assert verdict_of(replace(hk, name="hk+suzuki4"), "resonance", CaseOutcome.HELD) == "ok"


def test_a_scheme_that_fails_in_the_interpreter_is_a_finding() -> None:
    (one,) = stress(["hk-exact"], ["singular-step"])
    assert one.finding.result is CaseOutcome.BROKE
    assert "use |h| <" in one.finding.why


@pytest.mark.slow
@pytest.mark.usefixtures("own_registry")
def test_a_hard_case_is_one_entry(cli: Callable[..., Any]) -> None:
    """From outside: a config, a question and a check; it is listed, completed, tried, judged and can be a limit."""

    def upright(trial: Trial) -> Finding:
        lowest = float(trial.run(N=10).states[:, 5].min())
        return Finding(
            CaseOutcome.HELD if lowest > 0.999 else CaseOutcome.BROKE, f"gamma3 = {lowest:.6f}", 10, {"lowest": lowest}
        )

    def config() -> dict[str, Any]:
        return {"top": "heavy", "initial": {"omega": [0, 0, 1], "gamma": [0, 0, 1]}, "h": 0.01, "N": 20}

    def never(trial: Trial) -> Finding:
        return Finding(CaseOutcome.BROKE, "never", 3)

    for name, check in (("my-case", upright), ("my-other", never)):
        topcli.case(name, top="heavy", question="does it stay upright?", check=check)(config)
    with pytest.raises(ValueError, match="case 'my-case' for top 'heavy' is already registered"):
        topcli.case("my-case", top="heavy", question="again?")(config)
    listed = cli("list", "cases", "--top", "heavy", "--json").json()["cases"]
    assert listed[-2] == {"name": "my-case", "top": "heavy", "question": "does it stay upright?", "origin": __file__}
    assert {"my-case", "my-other"} <= set(case_names())
    tried = cli("stress", "rk4", "--case", "my-case", "--json")
    (trial,) = tried.json()["trials"]
    assert (tried.code, trial["scheme"], trial["top"], trial["outcome"], trial["verdict"]) == (
        0, "rk4", "heavy", "held", "ok",
    )  # fmt: skip
    assert 0.999 < trial["figures"]["lowest"] <= 1.0
    broken = cli("stress", "rk4", "--case", "my-other", "--json")
    assert (broken.code, broken.json()["trials"][0]["verdict"]) == (4, "unexplained")
    declared = replace(find_scheme("rk4", "heavy"), limits={"my-other": "a limit of its own"})
    assert verdict_of(declared, "my-other", CaseOutcome.BROKE) == "limit"
