"""The motion of a stored run: recorded, reconstructed, or refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from conftest import Said
from resuming import after, killed, small
from topcli.config.load import load_experiment
from topcli.errors import RunError, UsageError
from topcli.figures.body_motion import BodyMotion, stored_body_motion
from topcli.runs.decision import RunOptions
from topcli.runs.run import run_experiment
from topcli.store.series import read_series
from turning import TURNED, stored, turned_apart


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
    assert list(motion.invariants) == ["gamma_sq", "two_l", "energy", "k_sq"]
    for name, values in motion.invariants.items():
        np.testing.assert_array_equal(values, series[name])
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
    """To round-off from rows of the exact motion, to the error of the scheme from those of HK."""
    exact = ("scheme=exact", "h=0.05", "N=100")
    with_it = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *exact, TURNED, "name=a"))
    without = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *exact, "name=b"))
    assert turned_apart(with_it.attitude, without.attitude).max() < 1e-11
    assert without.notes == (
        "b: no attitude is recorded; reconstructed from the rows (--set output.attitude=quaternion records the "
        "scheme's own)",
    )
    rows = ("N=400", "output.every=10", "name=c")
    coarse = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *rows))
    fine = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", *rows[:2], TURNED, "name=d"))
    assert 1e-7 < turned_apart(coarse.attitude, fine.attitude).max() < 1e-3


@pytest.mark.parametrize("scene", ["lagrange_cusps", "euler_hk", "euler_tennis_racket"])
def test_every_form_of_a_top_is_reconstructed(tmp_path: Path, scene: str) -> None:
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


@pytest.mark.slow
def test_what_is_no_finished_run_is_refused(folder: Path, small_chunks: None, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"no run is stored here .* did you mean 'turned'"):
        stored_body_motion(folder.parent / "tuned")
    with pytest.raises(UsageError, match="give the folder of a run, such as results/NAME"):
        stored_body_motion(Path("kowalevski_hk"))
    half = killed(tmp_path, small(), 3)
    for place in (half, tmp_path / "kowalevski_hk"):
        with pytest.raises(UsageError, match="the run is unfinished; topcli run --resume continues it"):
            stored_body_motion(place)


@pytest.mark.slow
def test_an_ensemble_is_refused(cli: Callable[..., Said]) -> None:
    small_one = ("--set", "ensemble.random.count=2", "--set", "N=10", "--name", "many")
    assert cli("run", "kowalevski_ensemble", *small_one).code == 0
    said = cli("animate", "results/many", "--out", "a.gif")
    assert said.code == 2
    assert "results/many: an ensemble of many trajectories; run a single one of them" in said.err


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
