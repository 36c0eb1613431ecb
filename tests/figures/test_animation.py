"""Animations: what a frame shows, the files, and what is said before anything is drawn."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from attitude_runs import TURNED, stored
from conftest import Said
from topcli.figures.animation import BodyFigure, BodyMotion, frame_times, stored_body_motion, write_animation
from topcli.figures.style import styled


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the generic Kowalevski top, with its attitude."""
    return stored(tmp_path_factory.mktemp("runs"), "kowalevski_generic_hk", "N=400", TURNED, "name=turned")


@pytest.fixture(scope="module")
def motion(folder: Path) -> BodyMotion:
    return stored_body_motion(folder)


@pytest.mark.slow
def test_frames_show_the_run_at_their_times(motion: BodyMotion) -> None:
    """Time, and the end of the axis on the great circle between two rows."""
    times = frame_times(motion, 20)
    with styled({"figure.constrained_layout.use": False}):
        stage = BodyFigure(motion, times, 300)
        stage.show(12)
    row = int(np.searchsorted(motion.t, times[12], side="right")) - 1
    assert stage.time.get_text() == f"$t = {times[12]:.2f}$"
    (dot,) = (line for line in stage.axes.lines if line.get_marker() == "o")
    tip = np.column_stack(dot.get_data_3d())[0]
    before, after = Rotation.from_quat(motion.attitude[row : row + 2], scalar_first=True).apply(motion.body.axis)
    part = (times[12] - motion.t[row]) / (motion.t[row + 1] - motion.t[row])
    np.testing.assert_allclose(tip, (1.0 - part) * before + part * after, atol=1e-4)
    assert stage.dot.get_ydata()[0] == pytest.approx(tip[2])


def test_backward_runs_are_shown_backwards(tmp_path: Path) -> None:
    backward = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", "N=200", "h=-0.01", TURNED))
    times = frame_times(backward, 10)
    assert times[0] == 0.0
    assert -2.0 <= times[-1] < -0.5


@pytest.mark.slow
def test_the_command_writes_all_frames(folder: Path, cli: Callable[..., Said]) -> None:
    output = cli("animate", str(folder), "--out", "a.gif", "--seconds", "0.2", "--size", "240", "--json")
    content = json.loads(output.out)
    assert (content["run"], content["frames"], content["width"], content["height"]) == ("turned", 5, 240, 160)
    assert 0.0 < content["t_last"] < 4.0
    assert "of 4; more --seconds show more" in output.err
    with Image.open("a.gif") as picture:
        assert (picture.size, picture.n_frames, picture.info["loop"]) == ((240, 160), 5, 0)
        assert picture.info["duration"] == 40
        first = np.asarray(picture.convert("RGB"))
        picture.seek(4)
        assert (np.asarray(picture.convert("RGB")) != first).any()


@pytest.mark.slow
def test_mp4_is_playable(tmp_path: Path, motion: BodyMotion) -> None:
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    write_animation(motion, frame_times(motion, 10), tmp_path / "a.mp4", 241)
    decode = [program, "-i", str(tmp_path / "a.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    output = subprocess.run(decode, check=True, capture_output=True)
    assert len(np.frombuffer(output.stdout, dtype=np.uint8).reshape(-1, 160, 240, 3)) == 10
    assert all(word in output.stderr.decode() for word in ("h264", "25 fps", "yuv420p"))


def test_an_mp4_without_an_encoder_is_refused(
    folder: Path, cli: Callable[..., Said], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("topcli.figures.animation._encoder", lambda: "no-such-program")
    output = cli("animate", str(folder), "--out", "a.mp4")
    assert (output.code, "MP4 needs an encoder, which is not installed" in output.err) == (2, True)
