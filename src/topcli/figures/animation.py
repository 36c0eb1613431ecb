"""Animations of stored runs: frames of the spinning body, and the video files."""

from __future__ import annotations

import contextlib
import os
import subprocess
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.arithmetic.quaternions import matrices
from topcli.contracts import Array
from topcli.errors import RunError, UsageError, capitalized
from topcli.figures.body import (
    BLUE,
    DOT,
    MARK,
    OLD,
    OLD_FAR,
    PALE,
    TRACE,
    TRACE_FAR,
    Body,
    BodyArtist,
    BodyMotion,
    body_of,
)
from topcli.figures.picture import scheme_label
from topcli.figures.space import SPATIAL
from topcli.figures.style import STYLE
from topcli.store.files import io_failure, require_writable, write_whole

FORMATS = (".gif", ".mp4")
SMOOTH_TURN = 0.12
"""Mean turn of the body between two frames, in radians, up to which more than a nutation is shown by default."""
STEADY = 1e-6
"""Range of the height of the axis below which the motion has no nutation."""
RECENT = 0.12
"""Part of the shown time in which the trace is drawn strongly."""
GIF_TICK = 100.0
"""Units of time of a GIF in a second."""
GIF_FRAMES = 2500
"""Largest number of frames of a GIF, which are all held in memory."""
GIF_PIXELS = 1 << 30
"""Largest number of pixels of all frames of a GIF together, each a byte."""
NAME_LENGTH = 25
"""Letters of a name that fit in a frame."""
INCHES = 7.2
"""Width of a frame in inches, to which the sizes of letters refer."""
FIXED = {"{m}": "angular momentum", "{p}": "vertical"}
"""Direction of the arrow in words, by the letter of its label."""
LARGE, NORMAL = 14.0, 12.0
"""Sizes of letters in points: at a width of 480 pixels the small ones are 11 pixels high."""

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Film:
    """Frames of an animation: ``times`` (k,) in the run, shown at ``fps`` frames per second, ``width`` in pixels."""

    times: Array
    fps: float
    width: int

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, both even."""
        return 2 * (self.width // 2), 2 * round(self.width / 3.0)


def encoder_for(path: Path, fps: float, seconds: float) -> Callable[[Path, Film, Iterator[Array]], None]:
    """Writer of the format of ``path``.

    Raises UsageError if there is none here, or for a GIF of too many frames, in a second or at all.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise UsageError(f"--out {path}: must end in {' or '.join(FORMATS)}")
    if suffix == ".gif":
        if fps > GIF_TICK / 2.0:
            raise UsageError(f"--fps {fps:g}: a GIF has at most {GIF_TICK / 2.0:g} frames per second; write an .mp4")
        if fps * seconds > GIF_FRAMES:
            raise UsageError(
                f"--out {path}: a GIF has at most {GIF_FRAMES} frames, not {fps * seconds:g}; write an .mp4"
            )
        return write_gif
    try:
        import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError, OSError):
        raise UsageError(
            f"--out {path}: MP4 needs an encoder, which is not installed",
            "pip install 'topcli[video]' brings it; a .gif needs nothing more",
        ) from None
    return write_mp4


def planned(
    motion: BodyMotion, fps: float, seconds: float, width: int, start: float | None, stop: float | None
) -> Film:
    """Times of the frames: from ``start`` to ``stop``, by default from the first row.

    Without ``stop`` the film goes on as long as it is smooth, and for at least one nutation. Raises UsageError for
    times outside the run.
    """
    t = motion.t
    low, high = sorted((float(t[0]), float(t[-1])))
    for name, value in (("--start", start), ("--stop", stop)):
        if value is not None and not low <= value <= high:
            raise UsageError(f"{name} {value:g}: the run is from t = {low:g} to {high:g}")
    begin = float(t[0]) if start is None else start
    count = max(2, round(fps * seconds))
    end = float(t[-1]) if stop is None else stop
    if begin == end:
        raise UsageError(f"--start and --stop are both {begin:g}; there is no motion between them")
    if stop is None:
        end = max(_smooth_end(motion, begin, count), _nutation_end(motion, begin), key=lambda end: abs(end - begin))
    return Film(np.linspace(begin, end, count), fps, width)


def _smooth_end(motion: BodyMotion, begin: float, count: int) -> float:
    """Time up to which ``count`` frames from ``begin`` turn the body by SMOOTH_TURN on average; at most the last."""
    turned = np.concatenate([[0.0], np.cumsum(turns(motion.attitude))])
    forwards = 1.0 if motion.t[-1] > motion.t[0] else -1.0
    at = np.interp(forwards * begin, forwards * motion.t, turned)
    return forwards * float(np.interp(at + SMOOTH_TURN * count, turned, forwards * motion.t))


def _nutation_end(motion: BodyMotion, begin: float) -> float:
    """Time of one nutation after ``begin``: from the first to the third extremum of the height of the body's axis.

    ``begin`` if there are fewer extrema; at most the last time.
    """
    heights = (matrices(motion.attitude) @ _body(motion).axis)[:, 2]
    sense = np.sign(np.diff(heights))
    forwards = 1.0 if motion.t[-1] > motion.t[0] else -1.0
    after = forwards * (motion.t[1:-1] - begin) >= 0.0
    extrema = motion.t[1:-1][(sense[1:] * sense[:-1] < 0.0) & after]
    if len(extrema) < 3 or np.ptp(heights) < STEADY:
        return begin
    return forwards * min(forwards * (begin + extrema[2] - extrema[0]), forwards * float(motion.t[-1]))


def _body(motion: BodyMotion) -> Body:
    """Body of the top in motion."""
    return body_of(motion.experiment.top, None if motion.states is None else motion.states[0].tolist())


def turns(q: Array) -> Array:
    """Angles (m - 1,) of the rotations from each attitude (m, 4) to the next."""
    from scipy.spatial.transform import Rotation

    at = Rotation.from_quat(q, scalar_first=True)
    return (at[:-1].inv() * at[1:]).magnitude()


def attitudes_at(motion: BodyMotion, times: Array) -> tuple[Array, NDArray[np.int64]]:
    """Attitudes (k, 4) at ``times`` (k,), on great circles between the rows, and the last row (k,) before each."""
    from scipy.spatial.transform import Rotation, Slerp

    forwards = 1.0 if motion.t[-1] > motion.t[0] else -1.0
    t, at = forwards * motion.t, np.clip(forwards * times, *sorted(forwards * motion.t[[0, -1]]))
    rows = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2).astype(np.int64)
    between = Slerp(t, Rotation.from_quat(motion.attitude, scalar_first=True))
    return between(at).as_quat(scalar_first=True), rows


class Stage:
    """A figure that shows the motion at any time: the body on the left, time and invariants on the right."""

    def __init__(self, motion: BodyMotion, film: Film) -> None:
        import matplotlib as mpl
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.motion, self.film = motion, film
        width, height = film.size
        one = motion.experiment
        body = _body(motion)
        self.attitudes, self.rows = attitudes_at(motion, film.times)
        self.path = matrices(motion.attitude) @ body.axis
        self.first = int(self.rows[0])
        self.elapsed = np.abs(motion.t[self.first :] - film.times[0])
        with mpl.rc_context(fname=STYLE):
            mpl.rcParams.update({"figure.constrained_layout.use": False, "font.size": NORMAL})
            self.figure = Figure(figsize=(INCHES, INCHES * height / width), dpi=width / INCHES)
            self.canvas = FigureCanvasAgg(self.figure)
            words = next((words for letter, words in FIXED.items() if letter in body.vertical), "")
            axes = self.figure.add_axes((0.0, 0.0, 0.62, 1.0), projection=SPATIAL)
            labelled = replace(body, vertical=f"{words} {body.vertical}".strip())
            self.artist = BodyArtist(axes, labelled, self.path[self.first :])
            name = one.name if len(one.name) <= NAME_LENGTH else f"{one.name[: NAME_LENGTH - 1]}\N{HORIZONTAL ELLIPSIS}"
            self.figure.text(0.62, 0.965, name.replace("$", r"\$"), fontsize=LARGE, va="top")
            title = one.top.title.partition(" (")[0]
            about = (capitalized(title), f"{scheme_label(one)}, h = {one.h:g}")
            lines = [line for text in about for line in textwrap.wrap(text, 34)[:1]]
            self.figure.text(0.62, 0.905, "\n".join(lines), fontsize=NORMAL, color="0.35", va="top")
            self.figure.text(0.62, 0.785, "$t =$", fontsize=LARGE, va="top")
            self.time = self.figure.text(0.67, 0.785, "", fontsize=LARGE, va="top")
            self._legend(body)
            self.values = self._table()
            self.cursor = self._heights(body.label)
            for one in self._moving():
                one.set_animated(True)
            self.letters: dict[Any, Any] = {
                key: mpl.rcParams[key] for key in mpl.rcParams if key.startswith(("font.", "mathtext."))
            }
            self.canvas.draw()
            self.still = self.canvas.copy_from_bbox(self.figure.bbox)

    def _moving(self) -> list[Any]:
        """Artists that differ from frame to frame, in the order in which they are drawn."""
        return [*self.artist.moving, self.time, *(text for pair in self.values for text in pair), *self.cursor]

    def _table(self) -> list[tuple[Any, ...]]:
        """Names of the invariants, and pairs of texts for their values and changes."""
        known = {one.name: one for one in self.motion.experiment.top.invariants()}
        texts: list[tuple[Any, ...]] = []
        if known:
            self.figure.text(0.98, 0.725, "change", fontsize=NORMAL, color="0.35", va="top", ha="right")
        for line, name in enumerate(self.motion.invariants):
            y = 0.67 - 0.062 * line
            self.figure.text(0.62, y, f"${known[name].tex}$", fontsize=NORMAL, va="top")
            texts.append(tuple(self.figure.text(x, y, "", fontsize=NORMAL, va="top", ha="right") for x in (0.83, 0.98)))
        return texts

    def _heights(self, label: str) -> tuple[Any, Any]:
        """Height of the axis over the shown time, and the marks that move along it."""
        lines = 0.67 - 0.062 * max(len(self.values), 1)
        axes = self.figure.add_axes((0.67, 0.145, 0.31, max(0.12, min(0.24, lines - 0.22))))
        low, high = sorted((float(self.film.times[0]), float(self.film.times[-1])))
        heights = (matrices(self.attitudes) @ self.artist.body.axis)[:, 2]
        axes.plot(self.film.times, heights, "-", color=TRACE, lw=0.9)
        axes.set(xlim=(low, high), ylim=(-1.08, 1.08), yticks=(-1, 0, 1))
        axes.tick_params(labelsize=NORMAL)
        axes.set_xlabel("time $t$", fontsize=NORMAL, labelpad=1.0)
        axes.set_title(f"height of {label}", loc="left", fontsize=NORMAL)
        return axes.axvline(low, color="0.4", lw=0.7, ls="-"), axes.plot([], [], "o", color=DOT, ms=4.5)[0]

    def _legend(self, body: Body) -> None:
        """Say what the marks are."""
        from matplotlib.lines import Line2D

        handles = [
            Line2D([], [], color=DOT, marker="o", ls="none", label=f"end of the axis {body.label}"),
            Line2D([], [], color=TRACE, lw=1.9, ls="-", label="its path, recent"),
            Line2D([], [], color=OLD, lw=0.9, ls="-", label="earlier, or behind"),
        ]
        self.figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(0.0, 1.0),
            fontsize=NORMAL,
            handlelength=1.0,
            frameon=False,
        )

    def frame(self, index: int) -> Array:
        """Picture (height, width, 3) of frame ``index``, 8 bits per colour."""
        import matplotlib as mpl

        time, row = float(self.film.times[index]), int(self.rows[index])
        rotation = matrices(self.attitudes[index : index + 1])[0]
        recent = RECENT * abs(float(self.film.times[-1] - self.film.times[0]))
        since = int(np.searchsorted(self.elapsed, abs(time - self.film.times[0]) - recent))
        self.artist.show(row - self.first, min(since, row - self.first), rotation)
        self.time.set_text(f"{time:.2f}".replace("-", "\N{MINUS SIGN}"))
        for (value, off), values in zip(self.values, self.motion.invariants.values(), strict=True):
            change = float(values[row] - values[0])
            value.set_text(f"{float(values[row]):.6g}")
            off.set_text(f"{change:+.1e}".replace("-", "\N{MINUS SIGN}") if change else "0")
        line, dot = self.cursor
        line.set_xdata([time, time])
        dot.set_data([time], [(rotation @ self.artist.body.axis)[2]])
        with mpl.rc_context(self.letters):
            self.canvas.restore_region(self.still)
            self.artist.faces.do_3d_projection()
            for one in self._moving():
                self.figure.draw_artist(one)
        return np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()


def animate(motion: BodyMotion, film: Film, path: Path, on_progress: Progress = lambda done, total: None) -> None:
    """Draw all frames and write them to ``path``, which appears complete or not at all.

    Raises UsageError if the format cannot be written here, and RunError if the file cannot be.
    """
    write = encoder_for(path, film.fps, len(film.times) / film.fps)
    pixels = len(film.times) * film.size[0] * film.size[1]
    if write is write_gif and pixels > GIF_PIXELS:
        raise UsageError(
            f"--out {path}: {pixels} pixels in all frames of a GIF, at most {GIF_PIXELS}; take fewer frames, "
            "a smaller --size, or an .mp4"
        )
    require_writable(path.parent)
    stage, count = Stage(motion, film), len(film.times)

    def frames() -> Iterator[Array]:
        for index in range(count):
            on_progress(index, count)
            yield stage.frame(index)
        on_progress(count, count)

    try:
        write_whole(path, lambda temporary: write(temporary, film, frames()))
    except OSError as error:
        raise io_failure(error, path, "no animation was written") from error


def gif_durations(count: int, fps: float) -> list[int]:
    """Milliseconds of each of ``count`` frames: multiples of 10, as a GIF has, with the mean of ``fps``."""
    ends = np.round(np.arange(1, count + 1) * GIF_TICK / fps).astype(int)
    return (np.diff(ends, prepend=0) * round(1000.0 / GIF_TICK)).tolist()


def palette() -> NDArray[np.uint8]:
    """Colours (k, 3), at most 256, that all frames of a GIF share: lit and dark sectors, lines on paper, greys."""
    from matplotlib.colors import to_rgb

    found = [np.linspace(0.0, 1.0, 40)[:, None] * np.ones(3)]
    found += [np.array(colour) * np.linspace(0.5, 1.04, 44)[:, None] for colour in (PALE, BLUE, MARK)]
    paper = np.linspace(0.0, 0.9, 10)[:, None]
    for name in (TRACE, TRACE_FAR, OLD, OLD_FAR, DOT):
        found.append(paper * 0.975 + (1.0 - paper) * np.array(to_rgb(name)))
    return np.unique(np.round(255.0 * np.clip(np.vstack(found), 0.0, 1.0)).astype(np.uint8), axis=0)


def write_gif(path: Path, film: Film, frames: Iterator[Array]) -> None:
    """Write an endless GIF."""
    from PIL import Image

    colours = Image.new("P", (1, 1))
    colours.putpalette(palette().ravel().tolist())
    pictures = [Image.fromarray(one).quantize(palette=colours, dither=Image.Dither.NONE) for one in frames]
    durations = gif_durations(len(pictures), film.fps)
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=False, disposal=1
    )


def write_mp4(path: Path, film: Film, frames: Iterator[Array]) -> None:
    """Write an MP4 (H.264) that browsers and slides play. Raises RunError if the encoder fails."""
    import imageio_ffmpeg  # pyright: ignore[reportMissingImports]

    width, height = film.size
    raw = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", repr(film.fps), "-i", "-")
    coded = ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "18", "-preset", "medium", "-movflags", "+faststart")
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *raw, *coded, os.fspath(path.absolute())]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as encoder:
        assert encoder.stdin is not None
        assert encoder.stderr is not None
        try:
            with contextlib.suppress(BrokenPipeError), encoder.stdin:  # then it has said why on stderr
                for frame in frames:
                    encoder.stdin.write(frame.tobytes())
            said = encoder.stderr.read().decode(errors="replace").strip().splitlines()
        except BaseException:
            encoder.kill()
            raise
    if encoder.returncode:
        raise RunError(f"the encoder failed: {said[-1] if said else f'exit code {encoder.returncode}'}")
