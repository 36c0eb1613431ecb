"""Animations of stored runs: the motion of the body, and its video files by matplotlib's writers."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from topcli.arithmetic.quaternions import matrices
from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome
from topcli.engine.attitude import attitude_of_rows, velocities
from topcli.engine.columns import quaternions_of
from topcli.errors import RunError, UsageError, capitalized
from topcli.figures.body import DOT, TRACE, Body, body_of, draw_body, draw_globe
from topcli.figures.labels import labelled, plain, scheme_label
from topcli.figures.space import SPATIAL
from topcli.figures.style import styled
from topcli.store.files import io_failure, require_writable, write_whole
from topcli.store.results import intact_result
from topcli.store.series import read_series

ASK = "--set output.attitude=quaternion"
LARGEST_TURN = 0.5
"""Largest turn between two rows, in radians, from which an attitude is reconstructed."""
SMOOTH_TURN = 0.25
"""Mean turn of the body between two frames, in radians, of an animation without a given end."""
RECENT = 0.12
"""Part of the shown time in which the trace is drawn strongly."""
PARTS = 12
"""Points of the trace from frame to frame."""
INCHES = 7.2
"""Width of a frame in inches, to which the sizes of letters refer."""
GIF_FRAMES = 2500
"""Largest number of frames of a GIF, which are all held in memory."""
FIXED = {"{m}": "angular momentum", "{p}": "vertical"}
"""Direction of the arrow in words, by the letter of its label."""


@dataclass(frozen=True)
class BodyMotion:
    """Rows of a run: times (m,) and attitudes as unit quaternions (m, 4), with the body and messages about the rows."""

    experiment: Experiment
    t: Array
    attitude: Array
    body: Body
    notes: tuple[str, ...]


def stored_body_motion(folder: Path) -> BodyMotion:
    """Motion of the finished or interrupted run in ``folder``.

    Raises UsageError if there is no run, or if its rows do not determine the attitude, and RunError if it is damaged.
    """
    run = intact_result(folder)
    if "ensemble" in run.manifest["config"]:
        raise UsageError(f"{run.folder}: is an ensemble; run a single one of its trajectories")
    experiment = load_experiment(run.manifest["config"], any_precision=True)
    series, name, notes = read_series(run.series), experiment.name, []
    if run.outcome is not Outcome.COMPLETED:
        notes.append(f"{name}: {run.manifest['message']}")
    attitude = quaternions_of(series)
    if attitude is None:
        attitude = _reconstructed(experiment, series, folder)
        notes.append(f"{name}: no attitude is recorded; reconstructed from the rows ({ASK} records the scheme's own)")
    finite: Any = np.isfinite(attitude).all(axis=1)
    rows = len(finite) if finite.all() else int(np.argmin(finite))
    if rows < 2:
        raise UsageError(f"{folder}: no motion to show: the attitude is not finite or has only one row")
    if rows < len(finite):
        notes.append(f"{name}: the attitude is not finite after row {rows}")
    t = series["t"] if "t" in series else np.arange(len(finite)) * experiment.output.every * experiment.h
    body = body_of(experiment.top, experiment.y0)
    return BodyMotion(experiment, t[:rows], attitude[:rows], body, tuple(notes))


def _reconstructed(experiment: Experiment, series: dict[str, Any], folder: Path) -> Array:
    """Attitudes (m, 4) from the states of the rows. Raises UsageError if there are too few columns or rows."""
    top, span = experiment.top, experiment.h * experiment.output.every
    if not set(top.components) <= set(series):
        columns = ", ".join(top.components)
        raise UsageError(f"{folder}: records neither the attitude nor all of {columns}", f"run it with {ASK}")
    states = np.column_stack([series[component] for component in top.components])
    turn = float(np.nanmax(np.linalg.norm(velocities(top, states), axis=1))) * abs(span)
    if not turn <= LARGEST_TURN:
        raise UsageError(
            f"{folder}: the body turns by up to {turn:.2g} radians from row to row, and no attitude is recorded",
            f"run it with {ASK}, or with rows at least {turn / LARGEST_TURN:.1f} times as dense (output.every)",
        )
    return attitude_of_rows(top, states, span)


def frame_times(motion: BodyMotion, count: int, start: float | None = None, stop: float | None = None) -> Array:
    """Times (count,) of the frames from ``start`` to ``stop``, by default from the first row as long as it is smooth.

    Raises UsageError for times outside the run.
    """
    low, high = sorted((float(motion.t[0]), float(motion.t[-1])))
    for name, value in (("--start", start), ("--stop", stop)):
        if value is not None and not low <= value <= high:
            raise UsageError(f"{name} {value:g}: the run is from t = {low:g} to {high:g}")
    begin = float(motion.t[0]) if start is None else start
    if begin == (float(motion.t[-1]) if stop is None else stop):
        raise UsageError(f"--start and --stop are both {begin:g}; there is no motion between them")
    if stop is None:
        first = int(np.argmin(np.abs(motion.t - begin)))
        rotations = matrices(motion.attitude[first:])
        traces = np.einsum("nij,nij->n", rotations[1:], rotations[:-1])
        turned = np.cumsum(np.arccos(np.clip(0.5 * (traces - 1.0), -1.0, 1.0)))
        rows = int(np.searchsorted(turned, SMOOTH_TURN * count))
        stop = float(motion.t[min(first + rows + 1, len(motion.t) - 1)])
    return np.linspace(begin, stop, count)


class Stage:
    """A figure that shows the motion at any time: the body on the left, the time and the height of its axis beside."""

    def __init__(self, motion: BodyMotion, times: Array, width: int) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Canvas
        from scipy.spatial.transform import Rotation, Slerp

        # attitudes on great circles between the rows, with further points of the trace between two frames
        self.times, self.body, experiment = times, motion.body, motion.experiment
        forwards = 1.0 if motion.t[-1] > motion.t[0] else -1.0
        t = forwards * motion.t
        dense = forwards * np.linspace(times[0], times[-1], PARTS * (len(times) - 1) + 1)
        turns = Slerp(t, Rotation.from_quat(motion.attitude, scalar_first=True))(dense.clip(t[0], t[-1]))
        self.rotations = turns[::PARTS].as_matrix()
        self.path = turns.apply(self.body.axis)
        self.recent = int(RECENT * len(dense))

        # the globe, words, and the height of the axis over the shown time
        self.canvas = Canvas(figsize=(INCHES, INCHES / 1.5), dpi=2 * (width // 2) / INCHES)
        FigureCanvasAgg(self.canvas)
        self.axes = self.canvas.add_axes((0.0, 0.0, 0.62, 1.0), projection=SPATIAL)
        words = next((words for letter, words in FIXED.items() if letter in self.body.vertical), "")
        named = replace(self.body, vertical=f"{words} {self.body.vertical}".strip())
        self.camera = draw_globe(self.axes, named, self.path[0])
        self.fixed = set(self.axes.get_children())
        title = capitalized(experiment.top.title.partition(" (")[0])
        about = f"{title[:34]}\n{scheme_label(experiment)[:20]}, h = {experiment.h:g}"
        self.canvas.text(0.62, 0.965, plain(experiment.name[:25]), fontsize=14, va="top")
        self.canvas.text(0.62, 0.905, about, fontsize=12, color="0.35", va="top")
        self.time = self.canvas.text(0.62, 0.785, "", fontsize=14, va="top")
        heights = self.canvas.add_axes((0.67, 0.145, 0.31, 0.42))
        heights.plot(np.linspace(times[0], times[-1], len(dense)), self.path[:, 2], "-", color=TRACE, lw=0.9)
        label = f"height of {self.body.label}"
        labelled(heights, "time $t$", "", label, xlim=sorted(times[[0, -1]]), ylim=(-1.08, 1.08))
        self.dot = heights.plot([], [], "o", color=DOT, ms=5.5)[0]
        self.show(0)
        self.canvas.legend(*self.axes.get_legend_handles_labels(), loc="upper left", fontsize=12, frameon=False)

    def show(self, index: int) -> None:
        """Draw frame ``index``."""
        for artist in set(self.axes.get_children()) - self.fixed:
            artist.remove()
        path = self.path[: PARTS * index + 1]
        recent = max(0, len(path) - self.recent)
        draw_body(self.axes, self.camera, self.body, self.rotations[index], path, recent, 1.9)
        self.time.set_text(f"$t = {self.times[index]:.2f}$")
        self.dot.set_data([self.times[index]], [path[-1, 2]])


def require_format(path: Path, fps: float, seconds: float) -> None:
    """Raise UsageError for a format that cannot be written here, and for a GIF of too many frames."""
    from matplotlib.animation import FFMpegWriter

    if path.suffix.lower() not in (".gif", ".mp4"):
        raise UsageError(f"--out {path}: must end in .gif or .mp4")
    if path.suffix.lower() == ".gif":
        if fps > 50.0 or fps * seconds > GIF_FRAMES:
            raise UsageError(f"--out {path}: a GIF has at most 50 frames per second and {GIF_FRAMES}; write an .mp4")
        return
    with styled({"animation.ffmpeg_path": _encoder()}):
        if not FFMpegWriter.isAvailable():
            raise UsageError(
                f"--out {path}: MP4 needs an encoder, which is not installed",
                "pip install 'topcli[video]' brings it; a .gif needs nothing more",
            )


def _encoder() -> str:
    """Path of ffmpeg: that of the package imageio_ffmpeg, or a program of this name."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg") or "ffmpeg"


def animate(
    motion: BodyMotion,
    times: Array,
    path: Path,
    fps: float,
    width: int,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Draw a frame at each of the ``times`` and write them to ``path``, which appears complete or not at all.

    Raises UsageError if the format cannot be written here, and RunError if the file cannot be.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    require_format(path, fps, len(times) / fps)
    require_writable(path.parent)
    with styled({"animation.ffmpeg_path": _encoder(), "figure.constrained_layout.use": False}):
        stage = Stage(motion, times, width)
        h264, speed = ["-pix_fmt", "yuv420p", "-crf", "18"], cast("int", fps)
        writer: Any = PillowWriter(speed) if path.suffix.lower() == ".gif" else FFMpegWriter(speed, extra_args=h264)

        def write(temporary: Path) -> None:
            writer.setup(stage.canvas, str(temporary))
            for index in range(len(times)):
                on_progress(index, len(times))
                stage.show(index)
                writer.grab_frame()
            writer.finish()

        try:
            write_whole(path, write)
        except OSError as error:
            raise io_failure(error, path, "no animation was written") from error
        except subprocess.CalledProcessError as error:
            raise RunError(f"{path}: the encoder failed (exit code {error.returncode})") from None
    on_progress(len(times), len(times))
