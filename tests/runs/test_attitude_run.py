"""The attitude of a run: recorded, refused, and the motion of a stored run, reconstructed where it is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import topcli
from resuming import HK, after, small
from topcli.config.load import load_experiment
from topcli.errors import RunError, UsageError
from topcli.figures.animation import BodyMotion, stored_body_motion
from topcli.runs.identity import Identity
from topcli.runs.run import RunOptions, run_experiment
from topcli.store.series import read_series
from turning import TURNED, stored, turned_apart

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
    codes = {Identity.of(one).code for one in (plain, turned)}
    assert len(codes) == 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the generic Kowalevski top, with its attitude."""
    return stored(tmp_path_factory.mktemp("runs"), "kowalevski_generic_hk", "N=400", TURNED, "name=turned")


@pytest.fixture(scope="module")
def motion(folder: Path) -> BodyMotion:
    return stored_body_motion(folder)


def test_motion_is_that_of_the_rows(folder: Path, motion: BodyMotion) -> None:
    series = read_series(folder / "series.parquet")
    np.testing.assert_array_equal(motion.attitude, np.column_stack([series[f"q{i}"] for i in range(4)]))
    np.testing.assert_array_equal(motion.t, series["t"])
    assert motion.notes == ()


@pytest.mark.parametrize("h", [0.001, -0.002])
def test_motion_without_recorded_times_is_over_those_of_its_steps(tmp_path: Path, h: float) -> None:
    columns = "output.columns=[n, omega1, omega2, omega3, gamma1, gamma2, gamma3]"
    rows = ("N=400", "output.every=4", f"h={h}", TURNED, columns)
    found = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *rows))
    np.testing.assert_allclose(found.t, np.linspace(0.0, 400 * h, 101), rtol=1e-13)


def test_euler_angles_give_the_same_motion(tmp_path: Path, motion: BodyMotion) -> None:
    found = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", "N=400", "output.attitude=euler-angles"))
    assert turned_apart(found.attitude, motion.attitude).max() < 1e-14


@pytest.mark.slow
def test_missing_attitude_is_reconstructed_and_said(tmp_path: Path) -> None:
    """To the error of the scheme from rows of HK."""
    rows = ("N=400", "output.every=10", "name=c")
    coarse = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *rows))
    fine = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *rows[:2], TURNED, "name=d"))
    assert coarse.notes == (
        "c: no attitude is recorded; reconstructed from the rows (--set output.attitude=quaternion records the "
        "scheme's own)",
    )
    assert 1e-7 < turned_apart(coarse.attitude, fine.attitude).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["kowalevski_generic_hk", "lagrange_cusps", "euler_hk", "euler_tennis_racket"])
def test_every_form_of_a_top_is_reconstructed(tmp_path: Path, scene: str) -> None:
    """To round-off from rows of the exact motion."""
    sets = ("scheme=exact", "h=0.01", "N=200")
    one = stored_body_motion(stored(tmp_path, scene, *sets, TURNED, "name=a"))
    other = stored_body_motion(stored(tmp_path, scene, *sets, "name=b"))
    assert turned_apart(one.attitude, other.attitude).max() < 1e-11


def test_rows_that_are_too_few_are_refused(tmp_path: Path) -> None:
    folder = stored(tmp_path, "kowalevski_hk", "N=2000", "output.every=1000")
    with pytest.raises(UsageError, match="turns by up to 2 radians from row to row") as caught:
        stored_body_motion(folder)
    assert "--set output.attitude=quaternion, or with rows at least 4." in caught.value.lines[1]
    narrow = stored(tmp_path, "kowalevski_hk", "N=100", "output.columns=[t, gamma1]", "name=narrow")
    with pytest.raises(UsageError, match="records neither the attitude nor all of omega1"):
        stored_body_motion(narrow)


def test_a_damaged_run_is_refused(tmp_path: Path) -> None:
    folder = stored(tmp_path, "kowalevski_hk", "N=50", TURNED)
    with (folder / "series.parquet").open("r+b") as file:
        file.seek(100)
        file.write(b"\x00\x01\x02")
    with pytest.raises(RunError, match=r"series\.parquet: damaged: its SHA-256 differs"):
        stored_body_motion(folder)


def test_an_interrupted_run_is_announced(tmp_path: Path, small_chunks: None) -> None:
    one = load_experiment("kowalevski_hk", ["N=300", TURNED])
    done = run_experiment(one, tmp_path, RunOptions(stop=after(3)))
    found = stored_body_motion(done.stored.folder)
    assert len(found.notes) == 1
    assert found.notes[0].startswith("kowalevski_hk: interrupted at step ")
