"""Animations: what a frame shows, the files, and what is said before anything is drawn."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.signal import argrelmax, argrelmin
from scipy.spatial.transform import Rotation

from cases import table_of
from conftest import Said
from drawn_artists import points_of
from topcli.errors import RunError
from topcli.figures.animation import Stage, animate, attitudes_at, planned, turns
from topcli.figures.body import BodyMotion, stored_body_motion
from turning import TURNED, stored, turned_apart


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run of the generic Kowalevski top, with its attitude."""
    return stored(tmp_path_factory.mktemp("runs"), "kowalevski_generic_hk", "N=400", TURNED, "name=turned")


@pytest.fixture(scope="module")
def motion(folder: Path) -> BodyMotion:
    return stored_body_motion(folder)


@pytest.mark.slow
def test_frames_show_the_run_at_their_times(motion: BodyMotion) -> None:
    film = planned(motion, 10.0, 2.0, 300, None, None)
    stage = Stage(motion, film)
    picture = stage.frame(12)
    assert picture.shape == (200, 300, 3)
    assert picture.dtype == np.uint8
    time = film.times[12]
    row = int(np.searchsorted(motion.t, time, side="right")) - 1
    assert stage.time.get_text() == f"{time:.2f}"
    shown = [tuple(text.get_text() for text in pair) for pair in stage.values]
    for (value, change), values in zip(shown, motion.invariants.values(), strict=True):
        assert float(value) == pytest.approx(values[row], rel=1e-5)
        assert float(change.replace("\N{MINUS SIGN}", "-")) == pytest.approx(
            values[row] - values[0], rel=0.06, abs=1e-16
        )
    rotation = Rotation.from_quat(attitudes_at(motion, film.times)[0][12], scalar_first=True)
    np.testing.assert_allclose(points_of(stage.artist.dot)[0], rotation.apply([1.0, 0.0, 0.0]), atol=1e-12)
    heights = stage.cursor[1].get_data()
    assert (heights[0][0], heights[1][0]) == pytest.approx((time, rotation.apply([1.0, 0.0, 0.0])[2]))
    assert (stage.frame(13) != picture).any()
    np.testing.assert_array_equal(stage.frame(12), picture)


def test_attitudes_between_rows_are_on_great_circles(motion: BodyMotion) -> None:
    times = np.array([motion.t[10], 0.25 * motion.t[10] + 0.75 * motion.t[11], motion.t[-1]])
    found, rows = attitudes_at(motion, times)
    assert rows.tolist() == [10, 10, 399]
    assert turned_apart(found[[0, 2]], motion.attitude[[10, -1]]).max() < 1e-14
    whole = turned_apart(motion.attitude[10:11], motion.attitude[11:12])[0]
    assert turned_apart(motion.attitude[10:11], found[1:2])[0] == pytest.approx(0.75 * whole, rel=1e-9)
    assert turns(motion.attitude)[10] == pytest.approx(whole, rel=1e-9)
    assert turns(-motion.attitude[10:12] * np.array([[1.0], [-1.0]]))[0] == pytest.approx(whole, rel=1e-9)


def nutation_of(motion: BodyMotion) -> float:
    """Time from the first to the third extremum of the height of the traced axis, here the first one."""
    heights = Rotation.from_quat(motion.attitude, scalar_first=True).apply([1.0, 0.0, 0.0])[:, 2]
    extrema = np.sort(np.concatenate([argrelmax(heights)[0], argrelmin(heights)[0]]))
    return float(motion.t[extrema[2]] - motion.t[extrema[0]])


@pytest.mark.slow
def test_backward_runs_are_shown_backwards(tmp_path: Path) -> None:
    found = stored_body_motion(stored(tmp_path, "kowalevski_generic_hk", "N=200", "h=-0.01", TURNED))
    film = planned(found, 10.0, 1.0, 240, None, None)
    assert film.times[0] == 0.0
    assert -2.0 <= film.times[-1] < -0.5
    q, _ = attitudes_at(found, np.array([-0.5]))
    assert turned_apart(q, found.attitude[50:51])[0] < 1e-9
    Stage(found, film).frame(5)


@pytest.mark.slow
def test_gif_holds_all_frames_at_the_wanted_speed(tmp_path: Path, motion: BodyMotion) -> None:
    film = planned(motion, 30.0, 0.5, 240, None, None)
    seen: list[tuple[int, int]] = []
    path = tmp_path / "new" / "a.gif"
    animate(motion, film, path, lambda done, total: seen.append((done, total)))
    with Image.open(path) as picture:
        assert picture.size == (240, 160)
        assert picture.n_frames == 15
        assert picture.info["loop"] == 0
        lengths = []
        for index in range(picture.n_frames):
            picture.seek(index)
            lengths.append(picture.info["duration"])
        assert sum(lengths) == 500
        assert set(lengths) == {30, 40}
        picture.seek(9)
        shown = np.asarray(picture.convert("RGB"), dtype=float)
    expected = Stage(motion, film).frame(9).astype(float)
    assert np.abs(shown - expected).mean() < 4.0  # of 256; the palette
    assert seen[0] == (0, 15)
    assert seen[-1] == (15, 15)
    assert list(path.parent.iterdir()) == [path]


def test_a_missing_encoder_is_said_first(
    folder: Path, monkeypatch: pytest.MonkeyPatch, cli: Callable[..., Said]
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    said = cli("animate", str(folder / "nowhere"), "--out", "a.mp4")
    assert said.code == 2
    assert said.err.splitlines() == [
        "error: --out a.mp4: MP4 needs an encoder, which is not installed",
        "pip install 'topcli[video]' brings it; a .gif needs nothing more",
    ]


FAKE = """#!{python}
import sys
arguments = sys.argv[1:]
frames = sys.stdin.buffer.read()
if {fails}:
    sys.exit("first line\\nno such codec")
open(arguments[-1], "wb").write("\\n".join(arguments).encode() + b"\\n\\n" + frames)
"""


def fake_encoder(folder: Path, monkeypatch: pytest.MonkeyPatch, fails: bool = False) -> None:
    """Install an encoder that writes its arguments and all that it is sent."""
    program = folder / "encoder"
    program.write_text(FAKE.format(python=sys.executable, fails=fails))
    program.chmod(0o755)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", SimpleNamespace(get_ffmpeg_exe=lambda: str(program)))


@pytest.mark.slow
def test_frames_reach_the_encoder(tmp_path: Path, motion: BodyMotion, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_encoder(tmp_path, monkeypatch)
    film = planned(motion, 10.0, 0.5, 241, None, None)
    path = tmp_path / "out" / "a.mp4"
    animate(motion, film, path)
    said, _, sent = path.read_bytes().partition(b"\n\n")
    words = said.decode().splitlines()
    assert words[words.index("-s") + 1] == "240x160"
    assert float(words[words.index("-r") + 1]) == 10.0
    assert words.index("rgb24") < words.index("-i") < words.index("yuv420p")
    frames = np.frombuffer(sent, dtype=np.uint8).reshape(-1, 160, 240, 3)
    assert len(frames) == 5
    np.testing.assert_array_equal(frames[3], Stage(motion, film).frame(3))
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "message"),
    [("mp4", "the encoder failed: no such codec"), ("gif", "no space left on the device; no animation was written")],
)
def test_a_failed_animation_keeps_the_earlier_file(
    tmp_path: Path, motion: BodyMotion, monkeypatch: pytest.MonkeyPatch, suffix: str, message: str
) -> None:
    def full(self: Stage, index: int) -> Any:
        raise OSError(28, "No space left on device")

    fake_encoder(tmp_path, monkeypatch, fails=True)
    if suffix == "gif":
        monkeypatch.setattr(Stage, "frame", full)
    (tmp_path / "out").mkdir()
    path = tmp_path / "out" / f"a.{suffix}"
    path.write_bytes(b"earlier")
    with pytest.raises(RunError, match=message):
        animate(motion, planned(motion, 10.0, 0.3, 240, None, None), path)
    assert path.read_bytes() == b"earlier"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.slow
def test_mp4_is_playable(tmp_path: Path, motion: BodyMotion) -> None:
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    film = planned(motion, 20.0, 1.0, 240, None, None)
    animate(motion, film, tmp_path / "a.mp4")
    decode = [program, "-i", str(tmp_path / "a.mp4"), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    made = subprocess.run(decode, check=True, capture_output=True)
    frames = np.frombuffer(made.stdout, dtype=np.uint8).reshape(-1, 160, 240, 3)
    about = made.stderr.decode()
    assert "h264" in about
    assert "20 fps" in about
    assert "yuv420p" in about
    assert len(frames) == 20
    assert np.abs(frames[7].astype(float) - Stage(motion, film).frame(7)).mean() < 4.0


@pytest.mark.parametrize(
    ("arguments", "expected"),
    table_of("""
--out a.webm                           --out a.webm: must end in .gif or .mp4
--out a.gif --fps 60                   --fps 60: a GIF has at most 50 frames per second; write an .mp4
--out a.gif --seconds 200              a GIF has at most 2500 frames, not 5000; write an .mp4
--out a.gif --seconds 4.4 --size 3840  1081344000 pixels in all frames of a GIF
--out a.gif --stop 9                   --stop 9: the run is from t = 0 to 4
--out a.gif --start -1                 --start -1: the run is from t = 0 to 4
--out a.gif --start 2 --stop 2         are both 2
--out a.gif --size 10                  --size
--out a.gif --size -1                  --size
--out a.gif --size 1000000000          --size
--out a.gif --size x                   --size
--out a.gif --fps nan                  --fps
--out a.gif --fps inf                  --fps
--out a.gif --fps 0                    --fps
--out a.gif --seconds nan              --seconds
--out a.gif --seconds 1e300            --seconds
--out a.gif --start nan                --start nan
--out a.gif --stop inf                 --stop inf
--out a                                --out a: must end in .gif or .mp4
"""),
)
def test_wrong_options_are_refused(folder: Path, cli: Callable[..., Said], arguments: str, expected: str) -> None:
    said = cli("animate", str(folder), *arguments.split())
    assert said.code == 2
    assert expected in said.err
    assert not Path("a.gif").exists()


@pytest.mark.slow
def test_the_command_reports_what_it_wrote(folder: Path, cli: Callable[..., Said]) -> None:
    said = cli("animate", str(folder), "--out", "a.gif", "--seconds", "0.2", "--size", "240", "--stop", "4")
    assert said.code == 0
    assert said.out == "turned: 5 frames, 240 x 160 -> a.gif\n"
    shown = cli("animate", str(folder), "--out", "a.gif", "--seconds", "0.2", "--size", "240", "--json", "--force")
    assert json.loads(shown.out) == {
        "schema_version": 1,
        "command": "animate",
        "run": "turned",
        "file": "a.gif",
        "frames": 5,
        "fps": 25.0,
        "width": 240,
        "height": 160,
        "t_first": 0.0,
        "t_last": pytest.approx(nutation_of(stored_body_motion(folder)), abs=1e-9),
    }
    assert "turned: shows t = 0 to 3.18 " in shown.err
    assert "of 4; --stop 4 shows the whole run faster" in shown.err
