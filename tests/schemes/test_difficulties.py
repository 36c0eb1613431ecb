"""Difficulties of schemes: counts and warnings, steps that do not converge, and the states that limits name."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np
import pytest

import topcli
from conftest import GEN, PAPER, Said
from declared import SCHEMES
from steppers import RK2
from topcli.contracts import Ending, Floats, Outcome, Scheme, Stepper, Top
from topcli.engine.loop import plain_loop
from topcli.engine.run import Run
from topcli.errors import RunError
from topcli.runs.report import warning_of
from topcli.schemes.euler.hk import euler_determinant
from topcli.schemes.kowalevski.hk import kowalevski_determinant
from topcli.schemes.layout import AMBIGUOUS, NEAR_SINGULAR
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.stress.cases import TORUS_E4, singular_step
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange


def carried_out(top: Top, name: str, y0: Floats, h: float, N: int) -> tuple[np.ndarray, Ending]:
    scheme = find_scheme(name, top.form)
    _, states, ending = Run(top, scheme.build(top, scheme.options()), y0[: len(top.components)], h, N).collect()
    return states, ending


def counters(top: Top, name: str, y0: Floats, h: float, N: int) -> dict[str, int]:
    return carried_out(top, name, y0, h, N)[1].counters


@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), Lagrange(), Euler(), EulerGamma()], ids=repr)
def test_near_singular_solves_are_counted(top: Top) -> None:
    h = singular_step(top, GEN[: len(top.components)])  # pyright: ignore
    assert counters(top, "hk", GEN, h, 1)[NEAR_SINGULAR] == 1
    assert counters(top, "hk", GEN, 0.05, 1000)[NEAR_SINGULAR] == 0


def test_hybrids_count_singular_solves_of_hk() -> None:
    top = Kowalevski()
    for name in ("hybrid", "hybrid-xi"):
        assert counters(top, name, GEN, singular_step(top, GEN), 1)[NEAR_SINGULAR] == 1  # pyright: ignore


@pytest.mark.parametrize(
    ("determinant", "top"),
    [
        (kowalevski_determinant, Kowalevski()),
        (euler_determinant, Euler()),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_determinants_are_those_of_kahans_matrix(determinant, top: Top) -> None:
    """Up to a factor without a zero they vanish together with det(1 - h/2 f'(y)), and so at the same h."""
    state, p = GEN[: len(top.components)], top.constants()
    root = singular_step(top, state)  # pyright: ignore
    below, above = determinant(state, root * (1.0 - 1e-9), p)[0], determinant(state, root * (1.0 + 1e-9), p)[0]
    assert below * above < 0.0
    value, terms = determinant(state, 1e-3, p)
    assert value == pytest.approx(1.0, rel=0.01)
    assert terms >= abs(value)


def test_ambiguous_roots_are_counted() -> None:
    """At rest on the axis both roots are 0 in every step; on a calm motion it never happens, in a wild one often."""
    top = Kowalevski()
    rest = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for name in ("bohlin-a", "bohlin-b", "bohlin-c"):
        assert counters(top, name, rest, 0.02, 100)[AMBIGUOUS] == 100
        assert counters(top, name, GEN, 0.01, 2000)[AMBIGUOUS] == 0
    assert counters(top, "hybrid", GEN, 0.01, 2000) == {NEAR_SINGULAR: 0, AMBIGUOUS: 0}
    wild = counters(top, "bohlin-a", (3.0, -2.0, 6.0, 0.6, 0.48, 0.64), 1.0, 5000)[AMBIGUOUS]
    assert 1000 < wild <= 5000


def test_dg4_counts_short_corrections() -> None:
    """On a torus that has shrunk to an orbit the Gram matrix is singular; elsewhere it is not."""
    top = Kowalevski()
    assert counters(top, "dg4", GEN, 0.02, 200)["short_corrections"] == 0
    found = counters(top, "dg4", TORUS_E4, 0.02, 200)
    assert found["short_corrections"] + found["midpoint_steps"] >= 190


def test_dg4_counts_steps_that_do_not_restore_the_integrals() -> None:
    """omega = gamma = e3: k = 0, 2l = 1, E = 1/2 = 2 l², where the projected midpoint steps lose k² (1.4e-7)."""
    top, start, h, N = Kowalevski(), (0.0, 0.0, 1.0, 0.0, 0.0, 1.0), 0.05, 400
    states, ending = carried_out(top, "dg4", start, h, N)
    w1, w2, _, g1, g2, _ = states.T
    k_sq = (w1**2 - w2**2 - g1) ** 2 + (2 * w1 * w2 - g2) ** 2
    assert ending.counters["midpoint_steps"] == N
    assert N // 2 < ending.counters["unmet"] <= N
    assert k_sq.max() == pytest.approx(1.4e-7, rel=0.05)
    assert counters(top, "dg4", GEN, 0.02, 200)["unmet"] == 0


def integrals(y: Sequence[float]) -> np.ndarray:
    """gamma², 2l, E and k² of the Kowalevski top with C = c0 = 1."""
    w1, w2, w3, g1, g2, g3 = y
    k_sq = (w1 * w1 - w2 * w2 - g1) ** 2 + (2.0 * w1 * w2 - g2) ** 2
    two_l = 2.0 * (w1 * g1 + w2 * g2) + w3 * g3
    return np.array([g1 * g1 + g2 * g2 + g3 * g3, two_l, w1 * w1 + w2 * w2 + 0.5 * w3 * w3 + g1, k_sq])


RESTORING: list[tuple[str, dict[str, int]]] = [
    ("hk-projected", {}),
    ("hk-symproj", {}),
    ("backlund", {"project": 1}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), RESTORING, ids=[name for name, _ in RESTORING])
def test_unmet_counts_the_steps_that_leave_the_integrals_off(name: str, options: dict[str, int]) -> None:
    """Steps from states moved off their integrals by up to one, h = 0.3: those not counted end within 3e-14 of them.

    Shortened corrections are counted apart: neither kind of step contains the other.
    """
    scheme = find_scheme(name, "kowalevski")
    made = scheme.build(Kowalevski(), scheme.options(**options))
    assert isinstance(made, Stepper)
    assert made.enter is not None
    short, unmet = (made.counters.index(one) - len(made.counters) for one in ("short_corrections", "unmet"))
    random = np.random.default_rng(1)
    off: dict[tuple[float, float], list[float]] = {}
    for _ in range(400):
        begun = made.enter(GEN, 0.3, (1.0,))
        moved = np.array(GEN) + random.normal(size=6) * 10.0 ** random.uniform(-3.0, 0.0)
        new = made.step((*moved.tolist(), *begun[6:]), 0.3, (1.0,))
        off.setdefault((new[short], new[unmet]), []).append(float(np.abs(integrals(new[:6]) - integrals(GEN)).max()))
    assert set(off) <= {(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)}
    met, missed = ([one for key, values in off.items() if key[1] == flag for one in values] for flag in (0.0, 1.0))
    assert max(met) < 1e-13
    assert min(missed) > 5e-15
    assert np.median(missed) > 1e-9  # 5e-7, 8e-8 and 5e-7
    assert max(off[1.0, 0.0]) < 1e-13
    assert max(off[0.0, 1.0]) > 1.0


@pytest.mark.parametrize("top", [Euler(), EulerGamma()], ids=lambda top: top.form)
def test_implicit_euler_top_steps_report_no_convergence(top: Top) -> None:
    for name in ("bs-implicit", "midpoint"):
        _, ending = carried_out(top, name, GEN, singular_step(top, GEN[: len(top.components)]), 50)  # pyright: ignore
        assert ending.outcome is Outcome.NO_CONVERGENCE
        assert carried_out(top, name, GEN, 0.05, 100)[1].outcome is Outcome.COMPLETED
    _, blown = carried_out(top, "rk4", (3.0, -2.0, 6.0, 0.6, 0.48, 0.64), 1.0, 50)
    assert blown.outcome is Outcome.BLEW_UP


def test_a_run_warns_of_what_it_counted() -> None:
    """Iterations are the rule and no reason to warn."""
    report = {"name": "x", "scheme": "dg4", "step": 9, "counters": {"iterations": 40, "midpoint_steps": 0}}
    assert warning_of(report) == ""
    report["counters"] = {"iterations": 40, "midpoint_steps": 3}
    assert warning_of(report) == "3 midpoint steps in 9 steps; topcli show dg4 lists the limits of this scheme"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda one: f"{one.name}/{one.top}")
def test_normal_counts_give_no_warning(scheme: Scheme) -> None:
    """On an ordinary run nothing that a scheme counts is a warning; what can be one has a limit that explains it."""
    top = TOPS[scheme.top].new()
    _, ending = carried_out(top, scheme.name, GEN, 0.02, 200)
    report = {"step": ending.step, "scheme": scheme.name}
    assert warning_of({**report, "counters": ending.counters}) == ""
    warned = [name for name in ending.counters if warning_of({**report, "counters": {name: 1}})]
    assert not warned or scheme.limits


def test_run_of_taylor_prints_only_its_end(cli: Callable[..., Said]) -> None:
    done = cli("run", "euler_hk", "--set", "scheme=taylor", "--set", "name=series")
    assert done.code == 0
    assert "expansions" not in done.err
    assert done.err.startswith("series: completed ")


# steps that end a run


@pytest.mark.parametrize("y", [(0.0,) * 6, (0.0, 0.0, 0.0, 0.6, 0.0, 0.8), (0.0, 0.0, 2.0, 0.6, 0.0, 0.8), PAPER])
@pytest.mark.parametrize("h", [1e-9, 0.1])
def test_equilibria_and_special_states_settle(y: Floats, h: float) -> None:
    for A, C, x, z in ((1.0, 1.0, 0.6, 0.8), (2.0, 1.0, 0.0, 0.0), (2.0, 1.0, 1.0, 0.0)):
        top = Heavy(A=A, B=A, C=C, x0=x, y0=0.0, z0=z)
        assert carried_out(top, "midpoint", y, h, 3)[1].outcome is Outcome.COMPLETED


def test_hanging_top_stays_at_rest() -> None:
    """Gamma along g at rest is an equilibrium; the step leaves it where it is, to the last bit."""
    y = (0.0, 0.0, 0.0, 0.0, 0.0, -1.0)
    states, _ = carried_out(Heavy(A=2.0, B=1.5, C=1.0, x0=0.0, y0=0.0, z0=3.0), "midpoint", y, 0.1, 1)
    assert (states == y).all()


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_slow_and_fast_tops_settle_to_the_last_bits(scale: float) -> None:
    """Omega is far smaller or larger than gamma: the equations hold for both, each to its own size."""
    top, h = Heavy(x0=scale**2, y0=0.5 * scale**2, z0=0.8 * scale**2), 0.2 / scale
    y = tuple(np.array(GEN) * [scale, scale, scale, 1.0, 1.0, 1.0])
    start, end = np.longdouble(carried_out(top, "midpoint", y, h, 1)[0])
    rates = np.array(top.field(tuple((start + end) / 2), tuple(map(np.longdouble, top.constants()))))
    residual = np.abs(end - start - h * rates) / (scale, scale, scale, 1.0, 1.0, 1.0)
    assert residual.max() < 4e-16


def test_a_step_that_does_not_converge_ends_the_run_as_such() -> None:
    """An h with no hope: the outcome, the step, the rows before it, compiled and interpreted alike."""
    top, y0, h = Heavy(A=3.0, B=2.0, C=1.2, x0=40.0, y0=-30.0, z0=60.0), (9.0, -8.0, 7.0, 0.6, 0.48, 0.64), 11.0
    method = find_scheme("midpoint", "heavy").build(top, find_scheme("midpoint", "heavy").options())
    assert isinstance(method, Stepper)
    states, ending = carried_out(top, "midpoint", y0, h, 1000)
    assert (ending.outcome, ending.step, len(states)) == (Outcome.NO_CONVERGENCE, 4, 4)
    assert np.isfinite(states).all()
    assert ending.counters["iterations"] == 108  # 58 in three steps, and twice 25 in the fourth
    assert ending.message.startswith("did not converge at step 4")
    p = np.array(method.parameters(top))
    enter, drive = plain_loop(method, 6, len(p))
    work, out = np.zeros(method.width), np.zeros(6000)
    enter(np.array(y0), work, p, h)
    assert drive(work, out, p, h, 1000, 1, 1) == -4
    assert math.isnan(work[method.width - 2])


def test_blow_up_is_not_reported_as_no_convergence() -> None:
    run = Run(Kowalevski(), RK2, (1e200, 1e200, 0.0, 0.6, 0.48, 0.64), 1.0, 10)
    assert run.collect().ending.outcome is Outcome.BLEW_UP


# states that the texts of limits name

NUMBERS = r"\(([-\d., ]+)\)"
EXAMPLE = re.compile(rf"omega = {NUMBERS},?(?: with| and)? gamma = {NUMBERS}(?:(?: with|,) c0 = ([-\d.]+))?")


def examples() -> list[tuple[Scheme, str, list[float], list[float], float]]:
    """Scheme, name of the limit, omega, gamma and c0 of every state in a text."""
    return [
        (scheme, name, vector(omega), vector(gamma), float(c0 or 1.0))
        for scheme in all_schemes()
        for name, text in scheme.limits.items()
        for omega, gamma, c0 in EXAMPLE.findall(text)
    ]


def vector(numbers: str) -> list[float]:
    return [float(v) for v in numbers.split(",")]


def simulate(scheme: str, omega: list[float], gamma: list[float], c0: float) -> topcli.Trajectory:
    top = {"kind": "kowalevski", "c0": c0}
    return topcli.simulate(
        {"top": top, "initial": {"omega": omega, "gamma": gamma}, "scheme": scheme, "h": 0.01, "N": 10}
    )


def test_every_state_in_a_limit_is_found() -> None:
    """No text names a vector that the examples leave out."""
    vectors = sum(len(re.findall(r"= " + NUMBERS, text)) for one in all_schemes() for text in one.limits.values())
    assert vectors == 2 * len(examples()) > 0


@pytest.mark.slow
@pytest.mark.parametrize(("scheme", "name", "omega", "gamma", "c0"), examples(), ids=lambda one: str(one)[:20])
def test_states_in_limits_can_be_run(
    scheme: Scheme, name: str, omega: list[float], gamma: list[float], c0: float
) -> None:
    """Legal for every other scheme; those of limits that say "refused" are refused."""
    assert simulate("hk", omega, gamma, c0).outcome is Outcome.COMPLETED
    if "refused" in scheme.limits[name]:
        with pytest.raises(RunError):
            simulate(scheme.name, omega, gamma, c0)
        assert simulate(scheme.name, [omega[0] + 1e-3, *omega[1:]], gamma, c0).outcome is Outcome.COMPLETED
