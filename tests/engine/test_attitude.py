"""The attitude that runs carry along: order, symmetry, the fixed direction, bits independent of what is recorded."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cases import table_of
from conftest import GEN
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Outcome, Stepper, StopAsked, check_stop, stop_asked
from topcli.engine.attitude import Turning, carry, start_attitude, with_attitude
from topcli.engine.collect import orbit
from topcli.engine.loops import loop_of
from topcli.runs.plans import trajectory_of
from topcli.tops import TOPS
from topcli.tops.euler import Euler
from topcli.tops.kowalevski import Kowalevski

INITIAL = {
    form: {name: list(GEN[start:stop]) for name, (start, stop) in cls.vectors.items()} for form, cls in TOPS.items()
}
OUTPUT = {"attitude": "quaternion"}
OMEGA = {
    "volterra": lambda m: np.array([1.0, 1.5, 2.5]) * m + [0.4, 0.0, 0.0],
    "clebsch": lambda y: y[:3],
    "kirchhoff": lambda y: np.array([1.0, 1.0, 1.6]) * y[:3],
    "suslov": lambda w: np.array([w[0], w[1], 0.0]),
}
"""Angular velocities of tops, with their default parameters, that are not the first three components."""


def experiment(top: str, scheme: str, h: float, N: int, **output: Any) -> Experiment:
    made = {"top": top, "initial": INITIAL[top], "scheme": scheme, "h": h, "N": N, "output": {**OUTPUT, **output}}
    return load_experiment({"name": "attitude", **made})


def rows(one: Experiment) -> tuple[np.ndarray, np.ndarray]:
    """States (m, d) and rotation matrices (m, 3, 3) of the recorded rows."""
    states = trajectory_of(one).rows.recorded
    d = len(one.top.components)
    return states[:, :d], Rotation.from_quat(states[:, d:], scalar_first=True).as_matrix()


def reference(one: Experiment, start: np.ndarray) -> np.ndarray:
    """Rotation at the end of the motion, from the nine equations R' = R [omega] or, in space, R' = [m] R."""
    d, p, field = len(one.y0), one.top.constants(), type(one.top).field
    in_space, omega = one.top.form == "lagrange/inertial", OMEGA.get(one.top.kind, lambda y: y[:3])

    def rates(t: float, values: np.ndarray) -> np.ndarray:
        w, R = omega(values[:d]), values[d:].reshape(3, 3)
        cross = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
        return np.concatenate([field(tuple(values[:d]), p), (cross @ R if in_space else R @ cross).ravel()])

    begin = np.concatenate([one.y0, start.ravel()])
    found = solve_ivp(rates, (0.0, one.duration), begin, method="DOP853", rtol=1e-12, atol=1e-13)
    return found.y[d:, -1].reshape(3, 3)


def error(top: str, scheme: str, h: float) -> float:
    one = experiment(top, scheme, h, round(2.0 / h), every=round(2.0 / h))
    matrices = rows(one)[1]
    return float(np.abs(matrices[-1] - reference(one, matrices[0])).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("top", "scheme", "order"),
    table_of("""
kowalevski         hk            2
kowalevski         bohlin-a      1
kowalevski         rk4           4
kowalevski         hk+yoshida4   4
kowalevski         hk+kahan-li6  4
kowalevski         taylor        4
lagrange           exact         4
lagrange/inertial  taylor        4
heavy              midpoint      2
lagrange           hk            2
lagrange/inertial  bs            1
euler              hk            2
euler              exact         4
euler+gamma        hk            2
euler              hk-exact      2
volterra           rk4           4
lagrange-gyrostat  hk            2
hess-appelrot      hk            2
clebsch            hk            2
kirchhoff          rk4           4
suslov             rk4           4
"""),
)
def test_order_is_that_of_the_scheme_up_to_four(top: str, scheme: str, order: int) -> None:
    coarse, fine = error(top, scheme, 0.05), error(top, scheme, 0.025)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


def test_a_top_of_formulas_turns_by_its_angular_velocity() -> None:
    """One that is not a polynomial, without a vertical: to the order of the scheme from the identity on."""
    field = {"u": "sin(2*v)", "v": "-u*cos(u)"}
    top = {"kind": "custom", "components": ["u", "v"], "field": field, "angular_velocity": ["u*v", "exp(-v)", "k"]}
    made = {"name": "t", "top": top | {"parameters": {"k": 0.7}}, "initial": {"u": 0.8, "v": -0.3}, "output": OUTPUT}

    def turned(scheme: str, h: float) -> np.ndarray:
        one = load_experiment(made | {"scheme": scheme, "h": h, "N": round(2.0 / h)})
        assert rows(one)[1][0].tolist() == np.eye(3).tolist()
        return rows(one)[1][-1]

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        u, v, *q = y
        turn = Rotation.from_quat([u * v, np.exp(-v), 0.7, 0.0])  # as a quaternion, not as a rotation: scaled below
        size = np.sqrt((u * v) ** 2 + np.exp(-2.0 * v) + 0.49)
        rate = (Rotation.from_quat(q) * turn).as_quat(canonical=False) * size * np.linalg.norm(q) / 2.0
        return np.array([np.sin(2.0 * v), -u * np.cos(u), *rate])

    begin = [0.8, -0.3, 0.0, 0.0, 0.0, 1.0]
    found = solve_ivp(rates, (0.0, 2.0), begin, method="DOP853", rtol=1e-12, atol=1e-13)
    expected = Rotation.from_quat(found.y[2:, -1]).as_matrix()
    for scheme, order in (("rk2", 2), ("rk4", 4)):
        coarse, fine = (np.abs(turned(scheme, h) - expected).max() for h in (0.05, 0.025))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.2)
    assert np.abs(turned("dop853", 0.01) - expected).max() < 1e-8


@pytest.mark.parametrize(
    ("top", "scheme"),
    table_of("""
kowalevski         hk
kowalevski         bohlin-a
kowalevski         rk2
kowalevski         exact
heavy              taylor
lagrange           exact
lagrange/inertial  bs
euler              hk
euler+gamma        exact
"""),
)
def test_the_fixed_direction_stays_upright(top: str, scheme: str) -> None:
    """gamma, the axis's vertical or the angular momentum, at every row, also of schemes that do not keep its length."""
    one = experiment(top, scheme, 0.1, 300)
    states, matrices = rows(one)
    if top == "lagrange/inertial":  # the axis is the third one of the body
        seen, expected = matrices[:, :, 2], states[:, 3:]
    else:
        seen, expected = np.tile([0.0, 0.0, 1.0], (len(states), 1)), states[:, 3:]
        if top == "euler":
            expected = states * np.array([3.0, 2.0, 1.0])
        expected = np.einsum("mij,mj->mi", matrices, expected)
    expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(seen - expected).max() < 2e-15


@pytest.mark.parametrize(
    ("top", "scheme"),
    table_of("""
kowalevski  hk
kowalevski  taylor
euler       exact
kowalevski  dop853
"""),
)
@pytest.mark.slow
def test_states_have_the_bits_of_a_run_without_attitude(top: str, scheme: str) -> None:
    one = experiment(top, scheme, 0.02, 5000, every=9)
    plain = orbit(one.top, one.method(), one.y0, one.h, one.N, 9)
    found = trajectory_of(one)
    assert found.n.tobytes() == plain.n.tobytes()
    assert np.ascontiguousarray(found.states).tobytes() == plain.states.tobytes()
    assert found.ending == plain.ending


def test_a_run_that_blows_up_keeps_the_attitude_until_then() -> None:
    one = experiment("kowalevski", "rk4", 3.0, 5000)
    plain = orbit(one.top, one.method(), one.y0, one.h, one.N, invariants=one.top.invariants())
    found = trajectory_of(one)
    assert plain.ending.outcome is Outcome.BLEW_UP
    assert found.ending == plain.ending
    assert found.states[:, :6].tolist() == plain.states.tolist()
    assert found.rows.recorded.shape == (plain.ending.step, 10)


def test_an_interrupted_call_counts_no_step() -> None:
    """A plain step that gives up leaves the working state of the whole call, attitude included."""

    def step(s: Any, h: float, p: Any) -> Any:
        if s[0] > 4.0:  # in the second block
            check_stop()
        return (s[0] + h, s[1], s[2])

    top = Euler()
    loop = with_attitude(loop_of(Stepper(step, 3, plain=True), 3, 6), top, 2)
    work, out = np.zeros(loop.width), np.empty(70000)
    loop.enter(np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), work, np.array(top.constants()), 2.0**-10)
    begun = work.copy()
    token = stop_asked.set(lambda: True)
    try:
        with pytest.raises(StopAsked):
            loop.drive(work, out, np.array(top.constants()), 2.0**-10, 8000, 1, 1)
    finally:
        stop_asked.reset(token)
    assert work.tobytes() == begun.tobytes()


@pytest.mark.parametrize("order", [2, 4])
def test_turns_are_symmetric_and_code_agrees_with_python(order: int) -> None:
    top, h, steps = Kowalevski(), 0.3, 20
    states = orbit(top, load_experiment("kowalevski_hk").method(), GEN, h, steps).states
    turning, found = Turning(top, order), []
    assert turning.turns(states[::-1], -h)[::-1] == pytest.approx(-turning.turns(states, h), abs=1e-15)
    for code in (turning.code, carry):
        turning.code, out = code, np.zeros(10 * steps)
        assert turning.along(turning.begin(start_attitude(top, GEN)), states, out, h, 1, 1) == steps
        found.append(out.reshape(steps, 10))
    assert np.abs(found[0] - found[1]).max() < 1e-15


@pytest.mark.slow
def test_unit_length_does_not_drift() -> None:
    """Many steps: the length stays within rounding of one, at the end as at the beginning."""
    one = experiment("kowalevski", "hk", 0.05, 400_000, every=20)
    q = trajectory_of(one).rows.recorded[:, 6:]
    defects = np.abs((q * q).sum(axis=1) - 1.0)
    assert defects[-1000:].max() < 1e-15
    assert defects.max() < 1e-15


def test_the_attitude_at_the_start_is_the_shortest_rotation() -> None:
    top = Kowalevski()
    assert start_attitude(top, (1.0, 2.0, 3.0, 0.0, 0.0, 1.0)) == (1.0, 0.0, 0.0, 0.0)
    assert start_attitude(top, (1.0, 2.0, 3.0, 0.0, 0.0, -1.0)) == (0.0, 1.0, 0.0, 0.0)
    found = Rotation.from_quat(start_attitude(top, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0)), scalar_first=True)
    assert found.apply([1.0, 0.0, 0.0]) == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert found.as_rotvec() == pytest.approx([0.0, -np.pi / 2.0, 0.0], abs=1e-15)
    assert start_attitude(Euler(), (0.0, 0.0, 0.0)) == (1.0, 0.0, 0.0, 0.0)


def test_a_step_too_long_for_its_turn_has_no_attitude() -> None:
    """The run goes on; its attitude is nan, not silently wrong. A fast steady rotation is no long step."""
    one = experiment("kowalevski", "taylor", 1.0, 3)
    states = trajectory_of(one).rows.recorded
    assert np.isfinite(states[:, :6]).all()
    assert np.isnan(states[1:, 6:]).all()
    spinning = experiment("euler", "taylor", 1.0, 5).model_copy(update={"y0": (0.0, 0.0, 2.5)})
    turn = Rotation.from_quat(trajectory_of(spinning).rows.recorded[1, 3:], scalar_first=True)
    assert turn.magnitude() == pytest.approx(2.5, abs=1e-12)
