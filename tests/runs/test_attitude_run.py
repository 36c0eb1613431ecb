"""The attitude of a run: recorded, refused, and the motion of a stored run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import topcli
from attitude_runs import TURNED, stored, turned_apart
from resuming import HK, small
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.figures.animation import stored_body_motion
from topcli.runs.run import run_experiment
from topcli.store.identity import identity_of
from topcli.store.series import read_series

QUATERNION, ANGLES = "output.attitude=quaternion", "output.attitude=euler-angles"


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_series_holds_the_attitude_behind_the_other_columns(tmp_path: Path, suffix: str) -> None:
    one = small(QUATERNION, f"output.format={suffix}").renamed("one")
    run = run_experiment(one, tmp_path)
    series = read_series(run.stored.series)
    plain = read_series(run_experiment(small(f"output.format={suffix}"), tmp_path).stored.series)
    assert list(series) == [*plain, "q0", "q1", "q2", "q3"]
    assert all(series[name].tobytes() == plain[name].tobytes() for name in plain)
    q = np.column_stack([series[f"q{i}"] for i in range(4)])
    gamma = np.column_stack([series[f"gamma{i}"] for i in (1, 2, 3)])
    up = Rotation.from_quat(q, scalar_first=True).apply(gamma / np.linalg.norm(gamma, axis=1, keepdims=True))
    assert np.abs(up - [0.0, 0.0, 1.0]).max() < 1e-15
    assert q[:, 0].min() >= 0.0


def test_euler_angles_are_those_of_the_quaternion() -> None:
    one = topcli.simulate(HK, N=200, output={"attitude": "quaternion"})
    other = topcli.simulate(HK, N=200, output={"attitude": "euler-angles"})
    assert list(one.to_pandas())[-4:] == ["q0", "q1", "q2", "q3"]
    assert list(other.to_pandas())[-3:] == ["psi", "theta", "phi"]
    assert one.attitude is not None
    assert other.attitude is not None
    assert one.attitude.shape == (201, 4)
    assert one.states.shape == (201, 6)
    assert one.attitude.tobytes() == other.attitude.tobytes()
    angles = np.column_stack([one[name] for name in ("psi", "theta", "phi")])
    expected = Rotation.from_quat(one.attitude, scalar_first=True)
    assert (Rotation.from_euler("ZXZ", angles) * expected.inv()).magnitude().max() < 1e-14
    assert np.abs(np.cos(one["theta"]) - one["gamma3"]).max() < 1e-14
    with pytest.raises(UsageError, match="no column 'q0'"):
        topcli.simulate(HK, N=10)["q0"]


def test_columns_may_place_the_attitude() -> None:
    assert small(ANGLES, "output.columns=[t, theta]").recorded == ["t", "theta", "psi", "phi"]
    assert small(QUATERNION, "output.columns=[t]").recorded == ["t", "q0", "q1", "q2", "q3"]
    assert small("output.columns=[t]").recorded == ["t"]


def test_the_attitude_enters_the_identity_only_if_recorded() -> None:
    plain, turned, angles = small(), small(QUATERNION), small(ANGLES)
    assert "attitude" not in plain.resolved()["output"]
    assert small("output.attitude=null").digest == plain.digest
    assert len({plain.digest, turned.digest, angles.digest}) == 3
    assert load_experiment(turned.resolved()).digest == turned.digest
    codes = {identity_of(one).code for one in (plain, turned)}
    assert len(codes) == 2


@pytest.mark.parametrize("h", [0.001, -0.002])
def test_motion_without_recorded_times_is_over_those_of_its_steps(tmp_path: Path, h: float) -> None:
    columns = "output.columns=[n, omega1, omega2, omega3, gamma1, gamma2, gamma3]"
    rows = ("N=400", "output.every=4", f"h={h}", TURNED, columns)
    motion = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *rows))
    np.testing.assert_allclose(motion.t, np.linspace(0.0, 400 * h, 101), rtol=1e-13)


def test_euler_angles_give_the_same_motion(tmp_path: Path) -> None:
    quaternions, angles = (
        stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", "N=400", *sets)).attitude
        for sets in ((TURNED, "name=turned"), (ANGLES,))
    )
    assert turned_apart(angles, quaternions).max() < 1e-14


def test_a_run_without_attitude_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no attitude is recorded; run it with --set output\.attitude=quaternion"):
        stored_body_motion(stored(tmp_path, "kowalevski_hk", "N=50"))
