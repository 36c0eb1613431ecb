"""Figures of packaged scenes, and panels of bodies and traces of vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from topcli.analysis.columns import ATTITUDES, QUATERNION
from topcli.arithmetic.quaternions import matrices
from topcli.config.load import load_experiment
from topcli.contracts import Array, Outcome
from topcli.errors import RunError
from topcli.figures.body import TRACE, TRACE_FAR, BodyArtist, body_of
from topcli.figures.figure import Figure, Loaded, Request
from topcli.figures.picture import Drawable, Grid
from topcli.figures.scene3d import arrow, pair_of_lines, projection
from topcli.store.manifest import StoredRun


def scene_figure(
    name: str,
    title: str,
    scene: str,
    panels: Sequence[Drawable],
    layout: Grid,
    others: Sequence[str] = (),
    overrides: Sequence[str] = (),
) -> Figure:
    """A figure of columns of the run of ``scene``; ``other:name`` is a column of the run of a scene in ``others``.

    The texts ``key=value`` in ``overrides`` change the config of ``scene``.
    """
    runs = {"": (scene, overrides), scene: (scene, overrides)} | {other: (other, ()) for other in others}
    return Figure(name, title, scene, partial(_load, name, runs, tuple(panels), layout))


def _load(
    name: str,
    configs: Mapping[str, tuple[str, Sequence[str]]],
    panels: Sequence[Drawable],
    layout: Grid,
    request: Request,
) -> Loaded:
    """Load panels and columns of the runs, which are carried out if missing. Raises UsageError and RunError."""
    found = {config: _run(name, *config, request) for config in dict.fromkeys(configs.values())}
    runs = {scene: found[config] for scene, config in configs.items()}
    source = {"runs": [[run.manifest[key] for key in ("digest", "code")] for run in found.values()]}
    return Loaded(panels, lambda: _Columns(runs), source, layout)


def _run(name: str, scene: str, overrides: Sequence[str], request: Request) -> StoredRun:
    """Completed run of ``scene``. Raises UsageError and RunError."""
    from topcli.runs.decision import RunOptions
    from topcli.runs.run import run_experiment

    options = RunOptions(force=request.force, on_progress=request.on_progress)
    run = run_experiment(load_experiment(scene, overrides), request.results, options)
    if run.set_aside:
        request.on_message(run.set_aside_message)
    if run.outcome is not Outcome.COMPLETED:
        raise RunError(f"{name}: the run {run.stored.folder} {run.report['message']}")
    return run.stored


class _Columns(dict[str, Any]):
    """Columns of the runs by scene, read when they are drawn."""

    def __init__(self, runs: Mapping[str, StoredRun]) -> None:
        super().__init__()
        self.runs = runs

    def __missing__(self, name: str) -> np.ndarray:
        """Column of this name."""
        from topcli.store.series import read_series

        scene, _, column = name.rpartition(":")
        self[name] = read_series(self.runs[scene].series, [column])[column]
        return self[name]


SHADOW, FRAME, START = "0.87", "0.45", "#D55E00"
LENGTH = 1.18
"""Length of the axes of a frame, relative to the longest vector."""
BACK = "its rear part"
VECTORS = {"omega": r"\omega", "gamma": r"\gamma"}


def _finite(data: Mapping[str, np.ndarray], scene: str, names: Sequence[str]) -> Array:
    """Columns (m, k) of the run of ``scene``; rows padded with nan are left out."""
    values = np.column_stack([data[f"{scene}:{name}"] for name in names])
    return values[np.isfinite(values).all(axis=1)]


def _rotations(data: Mapping[str, np.ndarray], scene: str) -> Array:
    """Attitudes (m, 3, 3) of the rows of a run."""
    return matrices(_finite(data, scene, ATTITUDES[QUATERNION]))


@dataclass(frozen=True)
class BodyPanel:
    """Body of the run of ``scene`` after the part ``until`` of its rows, with the trace of its axis until then."""

    title: str
    scene: str
    until: float

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        experiment = load_experiment(self.scene)
        body, rotations = body_of(experiment.top, experiment.y0), _rotations(data, self.scene)
        last = round(self.until * (len(rotations) - 1))
        artist = BodyArtist(axes, body, rotations[: last + 1] @ body.axis)
        artist.show(last, 0, rotations[last])
        for line in artist.new:
            line.set_linewidth(0.8 * line.get_linewidth() / 1.9)
        labels = "trace of the axis", "on the far side", "the axis at the end"
        for line, label in zip((*artist.new, artist.dot), labels, strict=True):
            line.set_label(label)
        axes.set_title(self.title)


@dataclass(frozen=True)
class VectorPanel:
    """Curve of the vector ``vector`` of the run of ``scene``, seen from the body or, ``in_space``, from outside.

    It is drawn in parallel projection with the three axes of its frame, a tick on each, and its shadow on the plane
    below. The part behind the plane through the origin and across the line of sight is paler. The legend is up to the
    layout.
    """

    title: str
    vector: str
    scene: str
    in_space: bool = False
    view: tuple[float, float] = (24.0, 32.0)

    def curve(self, data: Mapping[str, np.ndarray]) -> Array:
        """Points (m, 3) of the curve in its frame."""
        points = _finite(data, self.scene, [f"{self.vector}{i}" for i in (1, 2, 3)])
        return np.einsum("mij,mj->mi", _rotations(data, self.scene), points) if self.in_space else points

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        points = self.curve(data)
        size = float(np.linalg.norm(points, axis=1).max())
        points, camera = points / size, projection(*self.view)
        flat = points @ camera.T
        floor = np.column_stack([points[:, :2], np.full(len(points), min(0.0, points[:, 2].min() - 0.1))])
        floor = floor @ camera.T
        axes.plot(floor[:, 0], floor[:, 1], "-", color=SHADOW, lw=2.8, zorder=1, label="shadow below")
        self._frame(axes, camera, size)
        name = rf"$\boldsymbol{{{VECTORS[self.vector]}}}$"
        near = {"color": TRACE, "lw": 1.1, "zorder": 6, "label": name}
        pair_of_lines(
            axes, flat, flat[:, 2] >= 0.0, (near, {"color": TRACE_FAR, "lw": 0.8, "zorder": 3, "label": BACK})
        )
        look = {"ms": 4.0, "mec": "white", "mew": 0.6, "zorder": 8, "label": "start"}
        axes.plot([flat[0, 0]], [flat[0, 1]], "D", color=START, **look)
        shown = np.vstack([flat[:, :2], floor[:, :2], 1.1 * LENGTH * camera[:2].T, np.zeros((1, 2))])
        low, high = shown.min(axis=0) - 0.1, shown.max(axis=0) + 0.1
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        axes.set_title(self.title)

    def _frame(self, axes: Any, camera: Array, size: float) -> None:
        """Draw the three axes of the frame, labelled by the components of the vector or of space.

        Each has a tick at the same value, where the longest vector has the length ``size``.
        """
        value = tick_value(size)
        for i, axis in enumerate(LENGTH * np.eye(3)):
            tip = camera @ axis
            arrow(axes, (0.0, 0.0), tip[:2], FRAME, 0.7, zorder=2)
            name = rf"${VECTORS[self.vector]}_{i + 1}$" if not self.in_space else ("$x$", "$y$", "$z$")[i]
            axes.text(*(1.1 * tip[:2]), name, ha="center", va="center", color="0.25", zorder=9)
            at, across = value / size / LENGTH * tip[:2], np.array([-tip[1], tip[0]]) / math.hypot(*tip[:2])
            axes.plot(*np.array([at - 0.02 * across, at + 0.02 * across]).T, "-", color=FRAME, lw=0.7, zorder=2)
            side = 0.08 * across * (-1.0 if across[1] > 0.0 or i == 2 else 1.0)
            axes.text(*(at + side), f"{value:g}", ha="center", va="center", color="0.25", fontsize=8, zorder=9)


def tick_value(size: float) -> float:
    """Largest of the numbers 1, 2 and 5 times a power of ten that is at most ``size``."""
    power = 10.0 ** math.floor(math.log10(size))
    return power * next(digit for digit in (5, 2, 1) if digit * power <= size * (1.0 + 1e-12))
