"""Animations of stored runs: the spinning body, made from its moments of inertia, and video files of its motion."""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.load import load_experiment
from topcli.config.models import Experiment
from topcli.contracts import Array, Outcome, Top
from topcli.engine.columns import quaternions_of
from topcli.errors import RunError, UsageError
from topcli.figures.space import SPATIAL, START, TRACE, axis, curve, draw_globe, set_view, sphere, surface
from topcli.figures.style import halo, labelled, plain_text, scheme_label, styled
from topcli.store.files import io_failure, require_writable, write_whole
from topcli.store.results import intact_result
from topcli.store.series import read_series
from topcli.tops.bodies import checked_equations

FPS = 25
"""Frames in a second."""
SMOOTH_TURN = 0.25
"""Mean turn of the body between two frames, in radians."""
_PARTS = 12
"""Points of the trace from frame to frame."""
INCHES = 7.2
"""Width of a frame in inches, to which the sizes of letters refer."""
GIF_FRAMES = 2500
"""Largest number of frames of a GIF, which are all held in memory."""
LONGITUDES, LATITUDES = 56, 28
PALE, BLUE, MARK = (0.93, 0.90, 0.83), (0.20, 0.47, 0.69), (0.87, 0.42, 0.10)
"""Colours of the sectors; one of them is marked, so that the spin is seen."""
_REACH = 0.66
"""Largest distance of a point of the body from the fixed point; the traces lie on the sphere of radius one."""
UNKNOWN = (3.0, 2.5, 1.5), (0.0, 0.0, 1.0)
"""Moments and centre of gravity of a top that does not declare them."""
SILHOUETTE = ((0.0, 0.86), (0.06, 0.86), (0.28, 0.69), (0.37, 0.57), (0.35, 0.5), (0.06, 0.09), (0.0, 0.0))
"""Distance from the axis and height of a spinning top, convex, from its upper end to its tip."""


@dataclass(frozen=True)
class Body:
    """Convex body of a top: its surface (rows, columns, 3) in the body's frame, around the ``axis`` (3,).

    ``axis`` is traced and ``label`` its name; ``vertical`` names the direction fixed in space.
    """

    surface: Array
    axis: Array
    label: str
    vertical: str


def body_of(top: Top, state: Sequence[float]) -> Body:
    """Body of a top, whose motion starts in ``state``.

    The axis passes through the centre of gravity, or without gravity it is the principal axis that is nearest to the
    angular momentum at the start. A top with a symmetry axis through its centre of gravity looks like a spinning top;
    any other is the homogeneous ellipsoid of its moments, or of ``UNKNOWN`` ones.
    """
    letter = r"\boldsymbol{m}" if len(top.components) == 3 else r"\boldsymbol{p}"
    vertical = letter if type(top).vertical else r"\boldsymbol{e}_z"
    try:
        top.euler_poisson()
        equations = checked_equations(top, "the body")
        moments, gravity = np.array(equations.moments), np.array(equations.gravity)
    except NotImplementedError:
        moments, gravity = map(np.array, UNKNOWN)
    if top.in_space or (moments[0] == moments[1] and gravity[2] and not gravity[:2].any()):
        label = r"$\boldsymbol{a}$" if top.in_space else r"$\boldsymbol{e}_3$"
        return Body(_spinning_top(), np.array([0.0, 0.0, 1.0]), label, vertical)
    momentum = moments * np.array(state[:3], dtype=float)
    axis = gravity / np.linalg.norm(gravity) if gravity.any() else np.eye(3)[int(np.argmax(np.abs(momentum)))]
    along, sign = np.flatnonzero(axis), "-" if axis.min() < 0.0 else ""
    label = rf"${sign}\boldsymbol{{e}}_{along[0] + 1}$" if len(along) == 1 else r"$\boldsymbol{s}$"
    return Body(_ellipsoid(moments, axis), axis, label, vertical)


def _ellipsoid(moments: Array, axis: Array) -> Array:
    """Surface of the homogeneous ellipsoid with the ``moments``, with poles on ``axis``; no semi-axis is too short."""
    sizes = np.sqrt(np.maximum(moments.sum() - 2.0 * moments, 0.0))  # A = (b² + c²)/5 of the mass, and so on
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first = first / np.linalg.norm(first)
    frame = np.stack([first, np.cross(axis, first), axis])
    return (sphere(LATITUDES, LONGITUDES) @ frame) * _REACH * np.maximum(sizes / sizes.max(), 0.12)


def _spinning_top() -> Array:
    """Surface of a spinning top with its tip in the fixed point."""
    corners, points = np.arange(len(SILHOUETTE)), sphere(LATITUDES, LONGITUDES)
    at = np.linspace(0.0, corners[-1], LATITUDES + 1)
    radius, height = (np.interp(at, corners, values)[:, None] for values in zip(*SILHOUETTE, strict=True))
    points[..., :2] = points[LATITUDES // 2, :, :2] * radius[..., None]
    points[..., 2] = height
    return points


def draw_space(axes: Any, body: Body, start: Array) -> Array:
    """Draw the unit sphere and the fixed direction; return the camera (3, 3).

    The viewer has the axis of the body on his left at the ``start`` (3,).
    """
    upright = np.hypot(start[0], start[1]) < 0.1
    azimuth = 35.0 if upright else math.degrees(math.atan2(start[1], start[0])) + 70.0
    camera = set_view(axes, 22.0, azimuth, 1.22, 0.15)
    draw_globe(axes, camera)
    axis(axes, np.array([0.0, 0.0, 1.0]), camera, 0.2, body.vertical)
    return camera


def draw_body(axes: Any, camera: Array, body: Body, rotation: Array, path: Array) -> None:
    """Draw the body in the attitude ``rotation`` (3, 3) and the ``path`` (m, 3) of its axis up to it."""
    curve(axes, camera, path, TRACE, 1.3, zorder=20, label="trace of the axis")
    colours = np.array([MARK, BLUE, *[PALE, BLUE] * 3, PALE])[np.arange(LONGITUDES + 1) * 8 // LONGITUDES]
    surface(axes, body.surface @ rotation.T, np.broadcast_to(colours, body.surface.shape), camera, zorder=10)

    # the axis from the surface to the sphere, its end and its name
    tip = rotation @ body.axis
    right, up, ahead = camera @ tip
    reach, level = (np.max(body.surface @ body.axis), 21) if ahead >= 0.0 else (0.0, 3)
    axes.plot(*np.column_stack([reach * tip, tip]), "-", color="0.1", lw=1.6, solid_capstyle="round", zorder=level)
    dot = {"color": START, "ms": 5.5, "mec": "white", "mew": 0.8, "zorder": level + 1, "label": "end of the axis"}
    axes.plot(*tip[:, None], "o", **dot)
    beside = 0.14 * np.array([right, up]) / max(math.hypot(right, up), 0.15)
    halo(axes.text(*(tip + beside @ camera[:2]), body.label, ha="center", va="center", zorder=30), 2.2)


@dataclass(frozen=True)
class BodyMotion:
    """Rows of a run: times (m,) and attitudes as unit quaternions (m, 4), with the body and a message on its end."""

    experiment: Experiment
    t: Array
    attitude: Array
    body: Body
    note: str


def stored_body_motion(folder: Path) -> BodyMotion:
    """Motion of the finished or interrupted run in ``folder``.

    Raises UsageError if there is no run, or if its rows have no attitude, and RunError if it is damaged.
    """
    run = intact_result(folder)
    if "ensemble" in run.manifest["config"]:
        raise UsageError(f"{run.folder}: is an ensemble; run a single one of its trajectories")
    experiment = load_experiment(run.manifest["config"], any_precision=True)
    series = read_series(run.series)
    attitude = quaternions_of(series)
    if attitude is None:
        raise UsageError(f"{folder}: no attitude is recorded; run it with --set output.attitude=quaternion")
    finite: Any = np.isfinite(attitude).all(axis=1)
    rows = len(finite) if finite.all() else int(np.argmin(finite))
    if rows < 2:
        raise UsageError(f"{folder}: no motion to show: the attitude is not finite or has only one row")
    t = series["t"] if "t" in series else np.arange(len(finite)) * experiment.output.every * experiment.h
    note = "" if run.outcome is Outcome.COMPLETED else f"{experiment.name}: {run.manifest['message']}"
    return BodyMotion(experiment, t[:rows], attitude[:rows], body_of(experiment.top, experiment.y0), note)


def frame_times(motion: BodyMotion, count: int) -> Array:
    """Times (count,) of the frames, from the first row as long as the motion is smooth."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(motion.attitude, scalar_first=True)
    turned = np.cumsum((turns[1:] * turns[:-1].inv()).magnitude())
    last = min(int(np.searchsorted(turned, SMOOTH_TURN * count)) + 1, len(motion.t) - 1)
    return np.linspace(motion.t[0], motion.t[last], count)


class BodyFigure:
    """A figure that shows the motion at any time: the body on the left, the time and the height of its axis beside."""

    def __init__(self, motion: BodyMotion, times: Array, width: int) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Canvas
        from scipy.spatial.transform import Rotation, Slerp

        # attitudes on great circles between the rows, with further points of the trace between two frames
        self.times, self.body, experiment = times, motion.body, motion.experiment
        forwards = 1.0 if motion.t[-1] > motion.t[0] else -1.0
        t = forwards * motion.t
        dense = np.linspace(times[0], times[-1], _PARTS * (len(times) - 1) + 1)
        turns = Slerp(t, Rotation.from_quat(motion.attitude, scalar_first=True))((forwards * dense).clip(t[0], t[-1]))
        self.rotations, self.path = turns[::_PARTS].as_matrix(), turns.apply(self.body.axis)

        # the globe, words, and the height of the axis over the shown time
        self.canvas = Canvas(figsize=(INCHES, INCHES / 1.5), dpi=2 * (width // 2) / INCHES)
        FigureCanvasAgg(self.canvas)
        self.axes = self.canvas.add_axes((0.0, 0.0, 0.62, 1.0), projection=SPATIAL)
        self.camera = draw_space(self.axes, self.body, self.path[0])
        self.fixed = set(self.axes.get_children())
        self.canvas.text(0.62, 0.965, plain_text(experiment.name[:25]), fontsize=14, va="top")
        scheme = f"{scheme_label(experiment)[:24]}, $h = {experiment.h:g}$"
        self.canvas.text(0.62, 0.895, scheme, fontsize=12, color="0.35", va="top")
        self.time = self.canvas.text(0.62, 0.785, "", fontsize=14, va="top")
        heights = self.canvas.add_axes((0.67, 0.145, 0.31, 0.42))
        heights.plot(dense, self.path[:, 2], "-", color=TRACE, lw=0.9)
        label = f"height of {self.body.label}"
        labelled(heights, "time $t$", "", label, xlim=sorted(times[[0, -1]]), ylim=(-1.08, 1.08))
        self.dot = heights.plot([], [], "o", color=START, ms=5.5)[0]
        self.show(0)
        self.canvas.legend(*self.axes.get_legend_handles_labels(), loc="upper left", fontsize=12, frameon=False)

    def show(self, index: int) -> None:
        """Draw frame ``index``."""
        for artist in set(self.axes.get_children()) - self.fixed:
            artist.remove()
        path = self.path[: _PARTS * index + 1]
        draw_body(self.axes, self.camera, self.body, self.rotations[index], path)
        self.time.set_text(f"$t = {self.times[index]:.2f}$")
        self.dot.set_data([self.times[index]], [path[-1, 2]])


def require_format(path: Path, seconds: float) -> None:
    """Raise UsageError for a format that cannot be written here, and for a GIF of too many frames."""
    from matplotlib.animation import FFMpegWriter

    form = path.suffix.lower()
    if form not in (".gif", ".mp4"):
        raise UsageError(f"--out {path}: must end in .gif or .mp4")
    if form == ".gif" and FPS * seconds > GIF_FRAMES:
        raise UsageError(f"--out {path}: a GIF has at most {GIF_FRAMES} frames; write an .mp4")
    with styled({"animation.ffmpeg_path": _encoder()}):
        if form == ".mp4" and not FFMpegWriter.isAvailable():
            advice = "pip install 'topcli[video]' brings it; a .gif needs nothing more"
            raise UsageError(f"--out {path}: MP4 needs an encoder, which is not installed", advice)


def _encoder() -> str:
    """Path of ffmpeg: that of the package imageio_ffmpeg, or a program of this name."""
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg") or "ffmpeg"


def write_animation(
    motion: BodyMotion,
    times: Array,
    path: Path,
    width: int,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> None:
    """Draw a frame at each of the ``times`` and write them to ``path``, which appears complete or not at all.

    Raises RunError if the file cannot be written.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    require_writable(path.parent)
    with styled({"animation.ffmpeg_path": _encoder(), "figure.constrained_layout.use": False}):
        stage = BodyFigure(motion, times, width)
        h264 = ["-pix_fmt", "yuv420p", "-crf", "18"]
        writer: Any = PillowWriter(FPS) if path.suffix.lower() == ".gif" else FFMpegWriter(FPS, extra_args=h264)

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
