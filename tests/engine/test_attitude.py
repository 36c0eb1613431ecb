"""The attitude that runs carry along: order, symmetry, the fixed direction, bits independent of what is recorded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cases import table_of
from conftest import GEN
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.engine.attitude import Turning, carry, start_attitude
from topcli.engine.drive import orbit
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
lagrange/inertial  taylor        4
heavy              midpoint      2
lagrange/inertial  bs            1
euler              hk            2
euler              exact         4
volterra           rk4           4
clebsch            hk            2
kirchhoff          rk4           4
"""),
)
def test_order_is_that_of_the_scheme_up_to_four(top: str, scheme: str, order: int) -> None:
    coarse, fine = error(top, scheme, 0.05), error(top, scheme, 0.025)
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize(
    ("top", "scheme"),
    table_of("""
kowalevski         hk
kowalevski         bohlin-a
kowalevski         dop853
heavy              taylor
lagrange/inertial  bs
euler              hk
euler+gamma        exact
"""),
)
def test_the_fixed_direction_stays_upright(top: str, scheme: str) -> None:
    """gamma, the axis's vertical or the angular momentum, at every row, also of schemes that do not keep its length.

    The states have the bits of a run without attitude, over several blocks of steps.
    """
    one = experiment(top, scheme, 0.1, 2500, every=9)
    states, matrices = rows(one)
    assert np.array_equal(states, orbit(one.top, one.method(), one.y0, one.h, one.N, 9).states)
    if top == "lagrange/inertial":  # the axis is the third one of the body
        seen, expected = matrices[:, :, 2], states[:, 3:]
    else:
        seen, expected = np.tile([0.0, 0.0, 1.0], (len(states), 1)), states[:, 3:]
        if top == "euler":
            expected = states * np.array([3.0, 2.0, 1.0])
        expected = np.einsum("mij,mj->mi", matrices, expected)
    expected = expected / np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(seen - expected).max() < 2e-15


@pytest.mark.slow
@pytest.mark.parametrize(
    ("top", "scheme", "h", "every"), [("kowalevski", "taylor", 0.02, 9), ("kowalevski", "rk4", 2.0, 1)]
)
def test_states_have_the_bits_of_a_run_without_attitude(top: str, scheme: str, h: float, every: int) -> None:
    """The second one blows up."""
    one = experiment("kowalevski", scheme, h, 5000, every=every)
    plain = orbit(one.top, one.method(), one.y0, one.h, one.N, every)
    found = trajectory_of(one)
    assert found.n.tobytes() == plain.n.tobytes()
    assert np.ascontiguousarray(found.states).tobytes() == plain.states.tobytes()
    assert replace(found.ending, left=None, left_t=None) == plain.ending


@pytest.mark.parametrize("order", [2, 4])
def test_turns_are_symmetric_and_code_agrees_with_python(order: int) -> None:
    top, h, steps = Kowalevski(), 0.3, 20
    states = orbit(top, load_experiment("kowalevski_hk").method(), GEN, h, steps).states
    turning, found = Turning(top, order), []
    assert turning.turns(states[::-1], -h)[::-1] == pytest.approx(-turning.turns(states, h), abs=1e-15)
    for code in (turning.code, carry):
        turning.code = code
        found.append(turning.along(np.array(start_attitude(top, GEN)), states, h))
    assert np.abs(found[0] - found[1]).max() < 1e-15


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
