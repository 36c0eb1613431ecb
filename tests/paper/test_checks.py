"""The checks of the ledger: on claims, and on defects other than their controls."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any

import numpy as np
import pytest

import topcli
from topcli.paper import exact_checks, identities, printed, run_checks
from topcli.paper.algebra import Draws, Gauss, exact
from topcli.paper.claim import FAILS, HOLDS, MISPRINT, Measurement
from topcli.paper.ledger import ledger
from topcli.paper.scenes import LedgerScene, exact_maps

CLAIMS = {claim.id: claim for claim in ledger().claims}
CHECKS = {check.name: check for check in ledger().checks}


def measure(name: str) -> tuple[Measurement, str]:
    """Measurement and verdict of a claim."""
    claim = CLAIMS[name]
    measured = claim.check.bind(claim.parameters)()
    return measured, verdict(claim.check.name, measured)


def verdict(check: str, measured: Measurement) -> str:
    """Verdict of a kind of check without words for its reason."""
    bound = CHECKS[check].model_copy(update={"reason": ""}).bound(measured, {})
    return bound.verdict(measured.figure, measured.corrected)


# general statements are tried with random parameters

VARIED = ("conserved exactly", "reversible", "equal maps", "symmetric equation", "elliptic function")
"""Kinds that decide laws and symmetries, which the paper states for all parameters, states and steps."""
GENERAL = [claim for claim in ledger().claims if claim.check.name in VARIED]


@pytest.mark.slow
def test_general_claims_draw_parameters_state_and_step() -> None:
    """Four maps or more for each scene, no two with the same parameters, state or step."""
    for claim in GENERAL:
        assert claim.experiment_text.endswith("with random parameters, states and h")
    for text in {claim.parameters["scene"] for claim in GENERAL}:
        maps = exact_maps(LedgerScene.read(text))
        assert len(maps) >= 4
        distinct = [{tuple(map(str, one.y0)) for one in maps}, {str(one.run.h) for one in maps}]
        if maps[0].experiment.top.form != "lagrange/inertial":  # (L1), (L2) have no parameters
            distinct.append({tuple(map(str, one.run.top.constants())) for one in maps})
        assert [len(one) for one in distinct] == [len(maps)] * len(distinct), text


ROUND = "top.A=1 top.B=1 top.C=1"
EULER = {"A": "A", "B": "B", "C": "C"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("check", "parameters"),
    [
        ("conserved exactly", {"scene": f"euler_hk rational {ROUND} N=3", "invariants": ["m_sq"]}),
        ("reversible", {"scene": f"euler_bs rational {ROUND}"}),
        ("equal maps", {"scene": f"euler_bs rational {ROUND}", "other": "euler_hk rational", "parameters": EULER}),
        ("elliptic function", {"scene": "lagrange_bs rational initial.m=[0,0,1] initial.a=[0,0,1]", "component": 0}),
        (
            "symmetric equation",
            {"scene": "kowalevski_bohlin_a fifty N=1 initial.omega=[0,0,0]", "equation": "still"},
        ),
    ],
)
def test_a_special_top_or_state_does_not_make_a_law(check: str, parameters: dict[str, Any]) -> None:
    """A body without a preferred axis, and an upright top, keep everything; the variants show the defect."""
    if parameters.get("equation") == "still":

        def still(c0: Any, h: Any, old: Any, new: Any, functions: Any) -> Any:
            return old[:3] * exact(1, 1, 1)

        parameters = parameters | {"equation": still}
    measured = CHECKS[check].bind(parameters)()
    assert verdict(check, measured) == FAILS
    if check in ("conserved exactly", "reversible"):
        alone = CHECKS[check].bind(parameters | {"varied": False})()
        assert (alone.figure, verdict(check, alone)) == (0.0, HOLDS)


def test_rounding_of_an_exact_law_may_grow_with_the_steps() -> None:
    """A thousand roundings a step, each of half a unit in the last of the 169 bits that hold 50 digits."""
    for N in (2, 4):
        scene = LedgerScene.read(f"euler_hk scheme=midpoint fifty N={N}")
        measured = exact_checks.conservation(scene, ["m_sq"], varied=False)
        assert measured.limit == pytest.approx(N * 1e3 * 2.0**-169, rel=1e-12)


# identities


def test_readings_of_a_misprint() -> None:
    """As printed it fails and corrected it holds; a formula that holds as printed is none, a wrong one simply fails."""

    def reading(right_as_printed: bool, right_corrected: bool) -> Callable[..., Any]:
        return lambda w, as_printed=False: [0 if (right_as_printed if as_printed else right_corrected) else w[0]]

    for printed_holds, corrected_holds, expected in (
        (False, True, MISPRINT),
        (True, True, HOLDS),
        (True, False, HOLDS),
        (False, False, FAILS),
    ):
        measured = exact_checks.identity(reading(printed_holds, corrected_holds), misprint=True)
        assert verdict("identity", measured) == expected
    for name in ("kowalevski-fourth", "hk-heavy-equation", "hybrid-k-sq-formula", "bohlin-angle"):
        assert measure(name)[1] == MISPRINT


@pytest.mark.slow
def test_every_claimed_law_fails_with_another_term() -> None:
    """Each integral is conserved, but not plus omega_1; a function of the others does not raise the rank."""
    for integrals in (
        identities.top_integrals,
        identities.euler_integrals,
        identities.lagrange_integrals,
        identities.kowalevski_integrals,
    ):

        @wraps(integrals)
        def spoilt(integrals: Callable[..., Any] = integrals, **point: Any) -> Any:
            return integrals(**point) + point["w"][0]

        for law in range(len(integrals(**Draws(1).point(integrals)))):
            assert exact_checks.identity(integrals, law).figure == 0.0
            assert exact_checks.identity(spoilt, law).figure > 1e-3

    def dependent(kowalevski_top: Any, w: Any, c: Any) -> Any:
        return exact(*identities.kowalevski_integrals(kowalevski_top, w, c)[:3], (c @ c) * (c @ c))

    assert exact_checks.independence(dependent, 4).figure == 3.0


def test_implicit_forms_of_the_methods_are_found() -> None:
    """The rate of z at the new z, a rotation about an axis that depends on the new gamma, the root as the unknown."""

    def rate(new: Any, w: Any) -> Any:
        z = Gauss(new[0], new[1])
        return [z - printed.stereographic_rate(Gauss(w[0], w[1]), w[2], z)]

    def axis(new: Any, turn: Any, c: Any) -> Any:
        return new - printed.rotation(new, *turn) @ c

    def root(new: Any, c0: Any, turn: Any, old: Any, e: Any) -> Any:
        return [printed.bohlin(c0, Gauss(*turn), old, exact(*new, 0, *e))]

    for equation, width in ((rate, 2), (axis, 3), (root, 2)):
        assert verdict("explicit", exact_checks.linear(equation, width)) == FAILS
        assert verdict("implicit", exact_checks.linear(equation, width)) == HOLDS
    for name in ("method-b-explicit", "method-c-explicit", "bohlin-explicit"):
        assert measure(name)[0].figure == 0.0


# orders, and the defect of the hybrid


@pytest.mark.slow
def test_residual_of_the_trapezoidal_rule_is_its_leading_term() -> None:
    """|xi| h³/12 |d² omega_3/dt²| with d² omega_3/dt² = -c0 (gamma_3 omega_1 - gamma_1 omega_3), on the same orbit."""
    measured, _ = measure("trapezoidal")
    h = run_checks.LADDER[-1]
    y = topcli.simulate(
        "kowalevski_hk", scheme="exact", h=h, N=2000, initial={"omega": [0.7, -0.4, 1.3], "gamma": [0.6, 0.48, 0.64]}
    ).states.T
    xi = np.abs((y[0] + 1j * y[1]) ** 2 - (y[3] + 1j * y[4]))
    leading = float((xi * np.abs(y[5] * y[0] - y[3] * y[2])).max()) * h**3 / 12.0
    assert float(measured.note.split()[1]) == pytest.approx(leading, rel=0.05)
    assert measured.figure == pytest.approx(2.0, abs=0.01)

    def one_sided(c0: float, h: float, old: Any, new: Any, functions: Any) -> Any:
        """Euler's rule for the angle."""
        return identities.trapezoidal(c0, h, old, np.vstack([new[:2], old[2:3], new[3:]]), functions)

    generic = LedgerScene.read("kowalevski_hk generic")
    assert run_checks.equation_order(generic, one_sided, 2).figure == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_return_defect_of_the_hybrid_is_that_of_plain_doubles() -> None:
    """1.4e-5 at h = 0.1 and of order 4, with 50 digits and by plain doubles here, over the same states."""
    measured, _ = measure("hybrid-reversible")
    assert measured.figure == pytest.approx(1.36e-5, rel=1e-2)
    note = re.fullmatch(r"scales as h\^(\d\.\d\d); (\S+) along the paper's run at h = 0.001", measured.note)
    assert note
    assert float(note[1]) == pytest.approx(4.0, abs=0.1)
    assert float(note[2]) == pytest.approx(2.7e-13, rel=0.05)
    defects = []
    for scheme in exact_maps(LedgerScene.read(CLAIMS["hybrid-reversible"].parameters["scene"])):
        start = scheme.y0.astype(float)
        there, top = start, {"kind": "kowalevski", "c0": float(scheme.run.top.c0)}
        for h in (0.1, -0.1):
            state = {"omega": there[:3].tolist(), "gamma": there[3:].tolist()}
            there = topcli.simulate("kowalevski_hybrid", h=h, N=1, initial=state, top=top).states[-1]
        defects.append(float(np.abs(there - start).max()))
    assert max(defects) == pytest.approx(measured.figure, rel=1e-6)
    assert min(defects) > 1e-9


# levels between swings, pictures


@dataclass(frozen=True)
class MadeUp:
    """A run of 50 units of time with swings at 13, 27 and 41, and a quantity; its own scene."""

    value: Callable[[np.ndarray], np.ndarray]
    scheme: str = "made up"

    def trajectory(self) -> MadeUp:
        return self

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
def test_levels_between_swings(value: Any, rise: float, back: float) -> None:
    scene: Any = MadeUp(value)
    rises, returns = run_checks.rises(scene, "x"), run_checks.returns([scene], "x")
    assert [rises.figure, returns.figure] == pytest.approx([rise, back], abs=1e-6)
    assert verdict("rise at each swing", rises) == (HOLDS if rise >= 0.5 else FAILS)
    assert verdict("oscillation", returns) == (HOLDS if back <= 0.1 else FAILS)


@pytest.mark.slow
def test_distance_between_pictures() -> None:
    """Two horizontal lines 0.3 mm apart, and one with a bump of 2 mm."""
    x = np.linspace(0.0, 45.0, 500)
    flat, bump = np.zeros_like(x), 2.0 * np.exp(-((x - 20.0) ** 2))
    lines = [run_checks.resampled(x, y) for y in (flat, flat + 0.3, bump)]
    assert run_checks.curve_distance(lines[0], lines[1]) == pytest.approx(0.3, abs=0.01)
    assert run_checks.curve_distance(lines[0], lines[2]) == pytest.approx(2.0, abs=0.02)
    assert run_checks.curve_distance(lines[2], lines[0]) == run_checks.curve_distance(lines[0], lines[2])


def test_rate_of_change_is_the_norm_of_the_jacobian() -> None:
    """Euler's field at omega = (0, 0, w): a 2x2 block with entries w (B - C)/A and w (C - A)/B."""
    from topcli.tops.euler import Euler

    states = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -3.0]])
    assert run_checks.rate_of_change(Euler(A=3.0, B=2.0, C=1.0), states) == pytest.approx(3.0, rel=1e-12)


# orbits that end


@pytest.mark.slow
def test_most_orbits_of_b_as_printed_end_at_the_pole() -> None:
    """The reason for which (B) is left out: 27 of 32 orbits end, each with gamma next to the third axis below."""
    draws, ended = np.random.default_rng(1), 0
    for _ in range(32):
        omega, gamma = draws.normal(scale=1.5, size=3), draws.normal(size=3)
        state = {"omega": omega.tolist(), "gamma": (gamma / np.linalg.norm(gamma)).tolist()}
        run = topcli.simulate("kowalevski_bohlin_b", h=0.4, N=2000, initial=state)
        if len(run) < 2001:
            ended += 1
            finite = run["gamma3"][np.isfinite(run.states).all(axis=1)]
            assert finite[-1] < -0.99
    assert ended == 27


# roots


def test_angles_modulo_two_pi_miss_one_root() -> None:
    """The other root of w² = z lies at Phi/2 + pi, two radii away."""
    measured, _ = measure("bohlin-angle")
    assert measured.figure == pytest.approx(2.0, rel=1e-12)
    assert measured.corrected is not None
    assert measured.corrected < 1e-15
    for halves, expected in ((1, HOLDS), (4, MISPRINT)):
        assert verdict("angles of the roots", exact_checks.angles(0.5, halves, 1)) == expected


def test_a_wrong_root_at_the_papers_step_by_plain_complex_numbers() -> None:
    """(A), then Bohlin's equation, then the sign: some states, computed here, get the root -omega'."""
    h, wrong = 0.001, 0
    for state in exact_checks.next_to_axis(h)["ensemble"]["states"]:
        w, g = np.array(state["omega"]), np.array(state["gamma"])
        W = 0.5 * h * np.array([[0, w[2], -w[1]], [-w[2], 0, w[0]], [w[1], -w[0], 0]])
        new = np.linalg.solve(np.eye(3) - W, (np.eye(3) + W) @ g)
        omega3 = w[2] - 0.5 * h * (new[1] + g[1])
        xi = complex(w[0], w[1]) ** 2 - complex(g[0], g[1])
        root = (np.exp(-0.5j * h * (w[2] + omega3)) * xi + complex(new[0], new[1])) ** 0.5
        predicted = complex(w[0], w[1]) - 0.5j * h * (w[2] * complex(w[0], w[1]) - g[2])
        chosen = root if (root.imag > 0.0) == (predicted.imag > 0.0) else -root
        wrong += abs(chosen - predicted) > abs(chosen + predicted)
    assert wrong == 6
