"""Panels of runs with an attitude: the body with the trace of its axis, and curves of vectors in body and space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from topcli.analysis.attitude import ATTITUDES, QUATERNION
from topcli.arithmetic.quaternions import matrices
from topcli.contracts import Array
from topcli.figures.body import TRACE, TRACE_FAR, Body, BodyArtist, body_of
from topcli.figures.picture import Runs
from topcli.figures.sphere import projection

SHADOW, FRAME, START = "0.80", "0.45", "#D55E00"
LENGTH = 1.18
"""Length of the axes of a frame, relative to the longest vector."""
VECTORS = {"omega": r"\omega", "gamma": r"\gamma"}


def _columns(scene: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of columns of the run of ``scene``; that of the figure itself if it is empty."""
    return tuple(f"{scene}:{name}" if scene else name for name in names)


def _rotations(data: Mapping[str, np.ndarray], columns: tuple[str, ...]) -> Array:
    """Attitudes (m, 3, 3) of the rows that have one; a column may be padded with nan."""
    q = np.column_stack([data[name] for name in columns])
    return matrices(q[np.isfinite(q).all(axis=1)])


@dataclass(frozen=True)
class BodyPanel:
    """Body of the run of ``scene`` after the part ``until`` of its rows, with the trace of its axis until then."""

    title: str
    scene: str = ""
    until: float = 1.0
    elevation: float = 22.0
    azimuth: float | None = None
    body: Body | None = field(default=None, repr=False)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that it draws: the quaternion."""
        return _columns(self.scene, ATTITUDES[QUATERNION])

    def of_runs(self, runs: Runs) -> BodyPanel:
        """Return the panel with the body of the run's top, and the run's name if its motion is not the packaged one."""
        run = runs[self.columns[0]]
        body = body_of(run.experiment.top, run.experiment.y0)
        return replace(self, body=body, title=self.title if run.as_packaged else run.experiment.name)

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        assert self.body is not None
        rotations = _rotations(data, self.columns)
        last = round(self.until * (len(rotations) - 1))
        path = rotations[: last + 1] @ self.body.axis
        artist = BodyArtist(axes, self.body, path, self.elevation, self.azimuth)
        artist.show(last, 0, rotations[last])
        for line in artist.new:
            line.set_linewidth(0.8 * line.get_linewidth() / 1.9)
        axes.set_title(self.title)


@dataclass(frozen=True)
class VectorPanel:
    """Curve of the vector ``vector`` of the run of ``scene``, seen from the body or, ``in_space``, from outside.

    It is drawn in parallel projection with the three axes of its frame and its shadow on the plane below.
    """

    title: str
    vector: str
    scene: str = ""
    in_space: bool = False
    view: tuple[float, float] = (24.0, 32.0)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that it draws: the vector, and the quaternion for a curve in space."""
        names = tuple(f"{self.vector}{i}" for i in (1, 2, 3))
        return _columns(self.scene, (*names, *ATTITUDES[QUATERNION]) if self.in_space else names)

    def of_runs(self, runs: Runs) -> VectorPanel:
        """Return the panel, with the name of the run in its title if the motion is not the packaged one."""
        run = runs[self.columns[0]]
        return self if run.as_packaged else replace(self, title=f"{run.experiment.name}: {self.title}")

    def curve(self, data: Mapping[str, np.ndarray]) -> Array:
        """Points (m, 3) of the curve in its frame."""
        points = np.column_stack([data[name] for name in self.columns[:3]])
        points = points[np.isfinite(points).all(axis=1)]
        return np.einsum("mij,mj->mi", _rotations(data, self.columns[3:]), points) if self.in_space else points

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: object) -> None:
        """Draw into ``axes``; ``styles`` is not used."""
        points = self.curve(data)
        size = float(np.linalg.norm(points, axis=1).max())
        points, camera = points / size, projection(*self.view)
        flat = points @ camera.T
        floor = np.column_stack([points[:, :2], np.full(len(points), min(0.0, points[:, 2].min() - 0.1))])
        floor = floor @ camera.T
        axes.plot(floor[:, 0], floor[:, 1], "-", color=SHADOW, lw=0.6, zorder=1)
        self._frame(axes, camera)
        far = flat[:, 2:] < 0.0
        for colour, mask, width, level in ((TRACE_FAR, ~far, 0.8, 3), (TRACE, far, 1.1, 6)):
            axes.plot(*np.where(mask, np.nan, flat[:, :2]).T, "-", color=colour, lw=width, zorder=level)
        axes.plot([flat[0, 0]], [flat[0, 1]], "o", color=START, ms=4.0, mec="white", mew=0.6, zorder=8)
        shown = np.vstack([flat[:, :2], floor[:, :2], 1.1 * LENGTH * camera[:2].T, np.zeros((1, 2))])
        low, high = shown.min(axis=0) - 0.1, shown.max(axis=0) + 0.1
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set_axis_off()
        axes.set_title(self.title)

    def _frame(self, axes: Any, camera: Array) -> None:
        """Draw the three axes of the frame, labelled by the components of the vector or of space."""
        for i, axis in enumerate(LENGTH * np.eye(3)):
            tip = camera @ axis
            arrow = {"arrowstyle": "-|>", "color": FRAME, "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", tip[:2], (0.0, 0.0), arrowprops=arrow, zorder=2)
            name = rf"${VECTORS[self.vector]}_{i + 1}$" if not self.in_space else ("$x$", "$y$", "$z$")[i]
            axes.text(*(1.1 * tip[:2]), name, ha="center", va="center", color="0.25", zorder=9)
