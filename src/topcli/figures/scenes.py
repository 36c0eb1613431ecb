"""Figures of packaged scenes, and panels of bodies and traces of vectors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from topcli.analysis.columns import ATTITUDES, QUATERNION
from topcli.arithmetic.quaternions import matrices
from topcli.config.load import load_experiment, load_named
from topcli.contracts import Array, Outcome
from topcli.errors import RunError, UsageError
from topcli.figures.body import TRACE, TRACE_FAR, Body, BodyArtist, body_of
from topcli.figures.figure import Figure, Loaded, Request
from topcli.figures.picture import Drawable, DrawnRun, Grid, Runs, described, overlay_column
from topcli.figures.scene3d import arrow, pair_of_lines, projection


class RunPanel(Protocol):
    """A panel that takes titles, labels or parameters from the runs that it draws.

    If it can show the exact motion behind them, the columns that have one are in ``overlaid``.
    """

    def of_runs(self, runs: Runs) -> Drawable:
        """Return the panel as the runs complete it."""
        ...


def scene_config(scene: str, configs: Path) -> Path | str:
    """Config of ``scene`` in the folder ``configs``, or the packaged scene's name if there is none."""
    for suffix in (".yaml", ".yml", ".toml"):
        path = configs / f"{scene}{suffix}"
        if path.is_file():
            return path
    return scene


def scene_figure(
    name: str,
    title: str,
    scene: str,
    panels: Sequence[RunPanel],
    layout: Grid,
    others: Sequence[str] = (),
    rank: int = 2,
    sets: Sequence[str] = (),
) -> Figure:
    """A figure of columns of the run of ``scene``; ``other:name`` is a column of the run of a scene in ``others``.

    ``sets`` are overrides of ``scene``.
    """
    return Figure(
        name,
        title,
        scene,
        partial(_load, name, {"": scene} | {other: other for other in others}, sets, tuple(panels), layout),
        needs=(scene, *others),
        rank=rank,
        takes_overrides=True,
        takes_overlay=any(hasattr(panel, "overlaid") for panel in panels),
    )


def _load(
    name: str,
    scenes: Mapping[str, str],
    sets: Sequence[str],
    panels: Sequence[RunPanel],
    layout: Grid,
    request: Request,
) -> Loaded:
    """Load panels and columns of the runs, which are carried out if missing. Raises UsageError and RunError."""
    drawn: dict[str, DrawnRun] = {}
    for key, scene in scenes.items():
        drawn[key] = drawn[scene] = _run(name, scene, () if key else sets, request)
    runs = Runs(drawn, request.overlay)
    completed = tuple(panel.of_runs(runs) for panel in panels)
    heading = described(layout.heading, drawn[""].experiment)
    if request.overlay:
        if not any(getattr(panel, "overlaid", ()) for panel in completed):
            raise UsageError(f"{name}: --overlay exact: no panel shows components or integrals themselves")
        heading = "; ".join([*([heading] if heading else []), "exact motion in grey"])
    return Loaded(
        completed,
        lambda: _Columns(name, scenes, drawn),
        {"runs": [[drawn[scene].manifest[key] for key in ("digest", "code")] for scene in scenes]},
        replace(layout, heading=heading),
        variant=next((run.changed for run in drawn.values() if run.changed), ""),
    )


def _run(name: str, scene: str, sets: Sequence[str], request: Request) -> DrawnRun:
    """Completed run of ``scene`` with the overrides ``sets``. Raises UsageError and RunError."""
    from topcli.runs.decision import RunOptions
    from topcli.runs.run import run_experiment

    config = scene_config(scene, request.configs)
    overrides = [*sets, *request.overrides]
    experiment = load_experiment(config, overrides).renamed(load_named(config, overrides).name)
    changed = experiment.digest != load_experiment(config, sets).digest
    run = run_experiment(experiment, request.results, RunOptions(force=request.force, on_progress=request.on_progress))
    if run.set_aside:
        request.on_message(run.set_aside_message)
    if run.outcome is not Outcome.COMPLETED:
        raise RunError(f"{name}: the run {run.stored.folder} {run.report['message']}")
    packaged = load_experiment(scene, sets)
    as_packaged = (experiment.top, experiment.y0) == (packaged.top, packaged.y0)
    return DrawnRun(
        experiment, as_packaged, experiment.digest[:6] if changed else "", run.stored.manifest, run.stored.series
    )


class _Columns(dict[str, Any]):
    """Columns of the runs, read when they are drawn; ``exact:<column>`` is that of the exact motion."""

    def __init__(self, name: str, scenes: Mapping[str, str], drawn: Mapping[str, DrawnRun]) -> None:
        super().__init__()
        self.name, self.scenes, self.drawn = name, scenes, drawn
        self.motions: dict[str, Mapping[str, np.ndarray]] = {}

    def __missing__(self, name: str) -> np.ndarray:
        """Column of this name. Raises UsageError if its run does not record it."""
        from topcli.runs.references import overlay_columns
        from topcli.store.series import read_series

        plain = name.removeprefix(overlay_column(""))
        key, _, column = plain.rpartition(":")
        run = self.drawn[key]
        if plain != name:
            if key not in self.motions:
                self.motions[key] = overlay_columns(run.experiment)
            self[name] = self.motions[key][column]
        elif column in run.experiment.recorded:
            self[name] = read_series(run.series, [column])[column]
        else:
            raise UsageError(f"{self.name}: the config of {self.scenes.get(key, key)} does not record {column}")
        return self[name]


SHADOW, FRAME, START = "0.87", "0.45", "#D55E00"
LENGTH = 1.18
"""Length of the axes of a frame, relative to the longest vector."""
BACK = "its rear part"
VECTORS = {"omega": r"\omega", "gamma": r"\gamma"}


def _finite(data: Mapping[str, np.ndarray], scene: str, names: Sequence[str]) -> Array:
    """Columns (m, k) of the run of ``scene``, of the figure's own if it is empty; rows padded with nan are left out."""
    values = np.column_stack([data[f"{scene}:{name}" if scene else name] for name in names])
    return values[np.isfinite(values).all(axis=1)]


def _rotations(data: Mapping[str, np.ndarray], scene: str) -> Array:
    """Attitudes (m, 3, 3) of the rows of a run."""
    return matrices(_finite(data, scene, ATTITUDES[QUATERNION]))


@dataclass(frozen=True)
class BodyPanel:
    """Body of the run of ``scene`` after the part ``until`` of its rows, with the trace of its axis until then."""

    title: str
    scene: str = ""
    until: float = 1.0
    elevation: float = 22.0
    azimuth: float | None = None
    body: Body | None = field(default=None, repr=False)

    def of_runs(self, runs: Runs) -> BodyPanel:
        """Return the panel with the body of the run's top, and the run's name if its motion is not the packaged one."""
        run = runs.by_scene[self.scene]
        body = body_of(run.experiment.top, run.experiment.y0)
        return replace(self, body=body, title=self.title if run.as_packaged else run.experiment.name)

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        assert self.body is not None
        rotations = _rotations(data, self.scene)
        last = round(self.until * (len(rotations) - 1))
        path = rotations[: last + 1] @ self.body.axis
        artist = BodyArtist(axes, self.body, path, self.elevation, self.azimuth)
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
    scene: str = ""
    in_space: bool = False
    view: tuple[float, float] = (24.0, 32.0)

    def of_runs(self, runs: Runs) -> VectorPanel:
        """Return the panel, with the name of the run in its title if the motion is not the packaged one."""
        run = runs.by_scene[self.scene]
        return self if run.as_packaged else replace(self, title=f"{run.experiment.name}: {self.title}")

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
