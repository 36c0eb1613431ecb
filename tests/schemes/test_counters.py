"""Silent difficulties are counted; the counters change nothing else."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from conftest import GEN, Said
from steppers import physical
from topcli.arithmetic.vectors import root_nearest
from topcli.contracts import Ending, Floats, Outcome, Scheme, Stepper, Top
from topcli.engine.loop import Run
from topcli.runs.report import warning_of
from topcli.schemes.any_top.hk_midpoint import heavy_determinant
from topcli.schemes.euler.hk import euler_determinant, hk_increment
from topcli.schemes.kowalevski.bohlin import bohlin_step, method_c
from topcli.schemes.kowalevski.hk import hk_kowalevski, kowalevski_determinant
from topcli.schemes.kowalevski.hybrid import hybrid_step
from topcli.schemes.lagrange.hk_bs import hk_lagrange, lagrange_determinant
from topcli.schemes.layout import AMBIGUOUS, NEAR_SINGULAR
from topcli.schemes.registry import all_schemes, find_scheme
from topcli.studies.stress.cases import TORUS_E4, singular_step
from topcli.tops import TOPS
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange
from twins_heavy import hk_heavy


def ran(top: Top, name: str, y0: Floats, h: float, N: int) -> tuple[np.ndarray, Ending]:
    scheme = find_scheme(name, top.form)
    _, states, ending = Run(top, scheme.build(top, scheme.options()), y0[: len(top.components)], h, N).collect()
    return states, ending


def plain(top: Top, step, y0: Floats, h: float, N: int) -> np.ndarray:
    return Run(top, Stepper(step, 6), y0, h, N).collect().states


@pytest.mark.parametrize(
    ("top", "name", "step"),
    [
        (Kowalevski(), "hk", hk_kowalevski),
        (Heavy(), "hk", hk_heavy),
        (Lagrange(), "hk", hk_lagrange),
        (Kowalevski(), "hybrid", hybrid_step(root_nearest)),
        (Kowalevski(), "bohlin-c", bohlin_step(method_c, root_nearest)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_counters_change_no_bit(top: Top, name: str, step) -> None:
    """Bit for bit, compiled and in plain Python."""
    states, ending = ran(top, name, GEN, 0.05, 2000)
    assert set(ending.counters.values()) == {0}
    assert np.array_equal(states, plain(top, step, GEN, 0.05, 2000))
    scheme = find_scheme(name, top.form)
    made = physical(scheme.build(top, scheme.options()))
    assert made(GEN, 0.05, top.constants()) == step(GEN, 0.05, top.constants())


@pytest.mark.parametrize("top", [Kowalevski(), Heavy(), Lagrange(), Euler(), EulerGamma()], ids=repr)
def test_near_singular_solves_are_counted(top: Top) -> None:
    h = singular_step(top, GEN[: len(top.components)])  # pyright: ignore
    assert ran(top, "hk", GEN, h, 1)[1].counters[NEAR_SINGULAR] == 1
    assert ran(top, "hk", GEN, 0.05, 1000)[1].counters[NEAR_SINGULAR] == 0


def test_hybrids_count_singular_solves_of_hk() -> None:
    top = Kowalevski()
    for name in ("hybrid", "hybrid-xi"):
        assert ran(top, name, GEN, singular_step(top, GEN), 1)[1].counters[NEAR_SINGULAR] == 1  # pyright: ignore


@pytest.mark.parametrize(
    ("determinant", "top"),
    [
        (kowalevski_determinant, Kowalevski()),
        (heavy_determinant, Heavy()),
        (lagrange_determinant, Lagrange()),
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


def test_the_euler_determinant_is_what_the_step_divides_by() -> None:
    top, h = Euler(), 0.3
    d = 0.5 * h
    c = [d * alpha for alpha in top.constants()[3:]]
    value, _ = euler_determinant(GEN[:3], h, top.constants())
    w1, w2, w3 = GEN[:3]
    u1, u2, u3 = c[0] * w2 * w3, c[1] * w3 * w1, c[2] * w1 * w2
    first = 2.0 * (u1 * (1.0 + c[1] * c[2] * w1 * w1) + c[0] * (w2 * u3 + w3 * u2)) / value
    assert hk_increment(*GEN[:3], *c)[0] == pytest.approx(first, rel=1e-14, abs=0.0)


def test_ambiguous_roots_are_counted() -> None:
    """At rest on the axis both roots are 0 in every step; on a calm motion it never happens, in a wild one often."""
    top = Kowalevski()
    rest = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    for name in ("bohlin-a", "bohlin-b", "bohlin-c"):
        assert ran(top, name, rest, 0.02, 100)[1].counters[AMBIGUOUS] == 100
        assert ran(top, name, GEN, 0.01, 2000)[1].counters[AMBIGUOUS] == 0
    assert ran(top, "hybrid", GEN, 0.01, 2000)[1].counters == {NEAR_SINGULAR: 0, AMBIGUOUS: 0}
    wild = ran(top, "bohlin-a", (3.0, -2.0, 6.0, 0.6, 0.48, 0.64), 1.0, 5000)[1].counters[AMBIGUOUS]
    assert 1000 < wild <= 5000


def test_dg4_counts_short_corrections() -> None:
    """On a torus that has shrunk to an orbit the Gram matrix is singular; elsewhere it is not."""
    top = Kowalevski()
    assert ran(top, "dg4", GEN, 0.02, 200)[1].counters["short_corrections"] == 0
    counters = ran(top, "dg4", TORUS_E4, 0.02, 200)[1].counters
    assert counters["short_corrections"] + counters["midpoint_steps"] >= 190


def test_dg4_counts_steps_that_do_not_restore_the_integrals() -> None:
    """omega = gamma = e3: k = 0, 2l = 1, E = 1/2 = 2 l², where the projected midpoint steps lose k² (1.4e-7)."""
    top, start, h, N = Kowalevski(), (0.0, 0.0, 1.0, 0.0, 0.0, 1.0), 0.05, 400
    states, ending = ran(top, "dg4", start, h, N)
    w1, w2, _, g1, g2, _ = states.T
    k_sq = (w1**2 - w2**2 - g1) ** 2 + (2 * w1 * w2 - g2) ** 2
    assert ending.counters["midpoint_steps"] == N
    assert N // 2 < ending.counters["unmet"] <= N
    assert k_sq.max() == pytest.approx(1.4e-7, rel=0.05)
    assert ran(top, "dg4", GEN, 0.02, 200)[1].counters["unmet"] == 0


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
        _, ending = ran(top, name, GEN, singular_step(top, GEN[: len(top.components)]), 50)  # pyright: ignore
        assert ending.outcome is Outcome.NO_CONVERGENCE
        assert ran(top, name, GEN, 0.05, 100)[1].outcome is Outcome.COMPLETED
    _, blown = ran(top, "rk4", (3.0, -2.0, 6.0, 0.6, 0.48, 0.64), 1.0, 50)
    assert blown.outcome is Outcome.BLEW_UP


def test_the_closed_form_reaches_denormal_omega() -> None:
    y0 = (7e-311, -4e-311, 1.3e-310, 0.6, 0.48, 0.64)
    states, ending = ran(EulerGamma(), "exact", y0, 0.02, 100)
    assert ending.outcome is Outcome.COMPLETED
    assert np.abs(states - np.array(y0)).max() < 1e-15
    assert math.isfinite(states.sum())


def test_a_run_warns_of_what_it_counted() -> None:
    """Iterations are the rule and no reason to warn."""
    report = {"name": "x", "scheme": "dg4", "step": 9, "counters": {"iterations": 40, "midpoint_steps": 0}}
    assert warning_of(report) == ""
    report["counters"] = {"iterations": 40, "midpoint_steps": 3}
    assert warning_of(report) == "3 midpoint steps in 9 steps; topcli show dg4 lists its limits"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", all_schemes(), ids=lambda one: f"{one.name}/{one.top}")
def test_normal_counts_give_no_warning(scheme: Scheme) -> None:
    """On an ordinary run nothing that a scheme counts is a warning; what can be one has a limit that explains it."""
    top = TOPS[scheme.top].new()
    _, ending = ran(top, scheme.name, GEN, 0.02, 200)
    report = {"step": ending.step, "scheme": scheme.name}
    assert warning_of({**report, "counters": ending.counters}) == ""
    warned = [name for name in ending.counters if warning_of({**report, "counters": {name: 1}})]
    assert not warned or scheme.limits


def test_run_of_taylor_prints_only_its_end(cli: Callable[..., Said]) -> None:
    done = cli("run", "euler_taylor")
    assert done.code == 0
    assert "expansions" not in done.err
    assert done.err.startswith("euler_taylor: completed ")
