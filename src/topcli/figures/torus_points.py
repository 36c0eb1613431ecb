"""Figure of the points of two maps with a long step, beside the torus of the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import Grid, Styles

SPANS = {"x": (-1.2, 1.45), "y": (-1.6, 1.6), "z": (-1.1, 1.15)}
"""Parts of the axes omega1, omega2, gamma3 that are seen; each is shown with the same length."""
LABELS = {"x": r"$\omega_1$", "y": r"$\omega_2$", "z": r"$\gamma_3$"}
ELEVATION, AZIMUTH = 52.0, 18.0
FRAME = 1.35
"""Half the width of the picture; an axis has the length 2."""
CORNER, ARROW = (-1.05, -0.98), 0.28
COLOURS = "viridis"


def seen(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, up and towards the viewer (m,) of directions (m, 3), turned about the third axis and tilted."""
    e, a = np.radians(ELEVATION), np.radians(AZIMUTH)
    x, y, z = points.T
    ahead, right = np.cos(a) * x + np.sin(a) * y, -np.sin(a) * x + np.cos(a) * y
    return right, np.cos(e) * z - np.sin(e) * ahead, np.sin(e) * z + np.cos(e) * ahead


@dataclass(frozen=True)
class TorusView:
    """Points of a map, of which nearer ones hide farther ones and are lighter.

    A map with fewer than ``whole`` points has left the energy surface after them.
    """

    scheme: str
    title: str
    whole: int

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return tuple(f"{self.scheme}:{axis}" for axis in SPANS)

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the points, and arrows along the axes, into ``axes``."""
        from matplotlib.patheffects import withStroke

        points = np.column_stack([data[name] for name in self.columns]).astype(float)
        points = points[np.isfinite(points).all(axis=1)]
        low, high = np.array(list(SPANS.values())).T
        right, up, depth = seen((2.0 * points - (low + high)) / (high - low))
        inside = np.maximum(np.abs(right), np.abs(up)) <= FRAME
        order = np.argsort(depth[inside], kind="stable")
        right, up, depth = (one[inside][order] for one in (right, up, depth))
        size = 0.35 if len(right) > 100_000 else 0.8
        axes.scatter(right, up, c=depth, s=size, lw=0.0, cmap=COLOURS, vmin=-1.2, vmax=1.2, rasterized=True)
        for label, direction in zip(LABELS.values(), np.eye(3), strict=True):
            x, y, _ = (float(one[0]) for one in seen(direction[None, :]))
            head = (CORNER[0] + ARROW * x, CORNER[1] + ARROW * y)
            axes.annotate("", head, CORNER, arrowprops={"arrowstyle": "->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0})
            at = (CORNER[0] + 1.45 * ARROW * x, CORNER[1] + 1.45 * ARROW * y)
            text = axes.text(*at, label, ha="center", va="center", fontsize=9)
            text.set_path_effects([withStroke(linewidth=2.5, foreground="white")])
        axes.set(xlim=(-FRAME, FRAME), ylim=(-FRAME, FRAME), xticks=[], yticks=[], aspect="equal")
        end = "" if len(points) >= self.whole else ", then lost"
        axes.set_title(f"{self.title}, {len(points):,} points{end}", loc="left")


@dataclass(frozen=True)
class TorusSection:
    """Points of a map near omega1 = 0 over the section of the torus of the motion."""

    scheme: str
    title: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return tuple(f"{name}:{axis}" for name in ("flow", self.scheme) for axis in "uv")

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the section of the torus in grey and the points into ``axes``."""
        u, v, x, y = (data[name] for name in self.columns)
        axes.plot(u, v, "s", color="0.75", ms=3.4, mew=0.0, rasterized=True, label="motion")
        size = 1.8 if np.isfinite(x).sum() > 1000 else 3.0
        axes.plot(x, y, ".", color="#0072B2", ms=size, mew=0.0, rasterized=True, label=self.scheme)
        axes.set(xlim=(-2.1, 2.1), ylim=(-1.7, 1.7), xlabel=r"$\omega_2$", ylabel=r"$\gamma_2$")
        axes.set_title(self.title, loc="left")


class TorusPointsFigure(Figure):
    """The study ``torus_points``."""

    rank: ClassVar[int] = 1

    def load(self, request: Request) -> Loaded:
        """Return panels and the study that makes their columns."""
        from topcli.studies.torus_points import POINTS, SCHEMES, THICKNESS, torus_code, torus_columns

        ours, other = SCHEMES
        near = rf"$|\omega_1| < {THICKNESS:g}$"
        panels = (
            TorusView(ours, f"(a) {ours}, $h = 1$", POINTS),
            TorusView(other, f"(b) {other}, $h = 1$", POINTS),
            TorusSection(ours, f"(c) {ours}, {near}; grey: the motion"),
            TorusSection(other, f"(d) {other}, {near}"),
        )
        return Loaded(panels, torus_columns, {"study": torus_code()}, Grid(2, (7.0, 6.4)))
