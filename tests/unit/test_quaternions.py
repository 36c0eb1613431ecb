"""Quaternions against SciPy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from topcli.analysis.attitude import attitude_columns, quaternions_of
from topcli.arithmetic.quaternions import (
    canonical,
    canonical_rows,
    conjugate,
    euler_angles,
    matrices,
    product,
    products,
    quaternions,
    rotate,
    turn_of,
    turn_upright,
    unit_turn,
    upright,
)

RANDOM = Rotation.random(200, rng=np.random.default_rng(1))
Q = RANDOM.as_quat(scalar_first=True)
HALF_TURNS = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.6, 0.0, 0.8], [1.0, 0.0, 0.0, 0.0]])


def close(found: object, expected: object) -> None:
    assert np.abs(np.asarray(found) - np.asarray(expected)).max() < 2e-15


def test_product_and_rotation() -> None:
    p, q = tuple(Q[0].tolist()), tuple(Q[1].tolist())
    expected = (RANDOM[0] * RANDOM[1]).as_quat(scalar_first=True)
    found = np.array(product(p, q))
    close(found * np.sign(found @ expected), expected)
    close(rotate(p, (1.0, -2.0, 0.5)), RANDOM[0].apply([1.0, -2.0, 0.5]))
    close(rotate(conjugate(p), rotate(p, (1.0, -2.0, 0.5))), (1.0, -2.0, 0.5))
    close(products(Q[0], Q[1:])[0], found)


def test_turns_are_quaternions_minus_one() -> None:
    w, x, y, z = unit_turn(0.1, -0.2, 0.3)
    angle = 2.0 * math.atan(math.sqrt(0.14))
    expected = Rotation.from_rotvec(angle * np.array([0.1, -0.2, 0.3]) / math.sqrt(0.14)).as_quat(scalar_first=True)
    close((1.0 + w, x, y, z), expected)
    assert unit_turn(1e-9, 0.0, 0.0)[0] == pytest.approx(-0.5e-18, rel=1e-15)  # all digits
    small = (1.0, 1e-9, 0.0, 0.0)
    assert turn_of(small)[0] == pytest.approx(-0.5e-18, rel=1e-15)
    assert turn_of((-0.6, 0.8, 0.0, 0.0)) == (-1.6, 0.8, 0.0, 0.0)


def test_upright_is_the_shortest_rotation() -> None:
    for v in np.random.default_rng(2).normal(size=(50, 3)):
        found = Rotation.from_quat(upright(tuple(v.tolist())), scalar_first=True)
        u = v / np.linalg.norm(v)
        close(found.apply(u), [0.0, 0.0, 1.0])
        assert found.magnitude() == pytest.approx(math.acos(u[2]), abs=1e-14)
    assert turn_upright((0.0, 0.0, -1.0)) == (-1.0, 1.0, 0.0, 0.0)


def test_canonical_is_one_of_each_pair() -> None:
    assert canonical((-0.6, 0.8, 0.0, 0.0)) == (0.6, -0.8, 0.0, 0.0)
    assert canonical((0.0, -1.0, 0.0, 0.0)) == (0.0, 1.0, 0.0, 0.0)
    assert [math.copysign(1.0, one) for one in canonical((-1.0, 0.0, 0.0, -0.0))] == [1.0] * 4
    rows = np.vstack([Q, -Q, HALF_TURNS, -HALF_TURNS])
    close(canonical_rows(2.0 * rows), [canonical(tuple(row)) for row in rows.tolist()])


def test_matrices_and_back() -> None:
    rows = np.vstack([Q, HALF_TURNS])
    expected = Rotation.from_quat(rows, scalar_first=True).as_matrix()
    close(matrices(rows), expected)
    close(canonical_rows(quaternions(expected)), canonical_rows(rows))


def test_euler_angles_are_those_of_the_sequence_zxz() -> None:
    psi, theta, phi = euler_angles(Q)
    close(Rotation.from_euler("ZXZ", np.column_stack([psi, theta, phi])).as_matrix(), RANDOM.as_matrix())
    assert theta.min() >= 0.0
    assert theta.max() <= math.pi
    assert np.abs([psi, phi]).max() <= math.pi
    close(np.cos(theta), RANDOM.as_matrix()[:, 2, 2])  # the height of the third axis
    for q, angles in (
        ((0.8, 0.0, 0.0, 0.6), (2.0 * math.atan2(0.6, 0.8), 0.0, 0.0)),
        ((0.0, 1.0, 0.0, 0.0), (0.0, math.pi, 0.0)),
    ):
        assert [float(one[0]) for one in euler_angles(np.array([q]))] == pytest.approx(angles, abs=1e-15)


@pytest.mark.parametrize("form", ["quaternion", "euler-angles"])
def test_recorded_columns_give_the_attitude_back(form: str) -> None:
    found = quaternions_of(attitude_columns(form, Q))
    assert found is not None
    close(np.abs((found * Q).sum(axis=1)), 1.0)
    assert quaternions_of({"t": Q[:, 0]}) is None
