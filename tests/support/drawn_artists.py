"""Data and looks of the artists of a drawn figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.colors import same_color
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.proj3d import proj_transform

from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Loaded, Request
from topcli.figures.picture import draw

SHOWN = {
    "hk": "HK",
    "hk+kahan-li6": "HK + Kahan-Li 6",
    "hk+kahan-li8": "HK + Kahan-Li 8",
    "bohlin-a": "Bohlin A",
    "bohlin-b": "Bohlin B",
    "bohlin-c": "Bohlin C",
    "rk2": "RK2",
    "rk4": "RK4",
    "taylor": "Taylor",
    "hybrid-sym": "sym. hybrid",
    "dmv": "DMV",
    "dmv:moments=preprocessed,order=10": "DMV (moments=preprocessed, order=10)",
    "backlund": "Bäcklund",
    "backlund:nodes=exact": "Bäcklund, exact nodes",
    "splitting+kahan-li8": "splitting + Kahan-Li 8",
}
"""Names in figures of the schemes that the tests draw."""
NAMED = {shown: name for name, shown in SHOWN.items()}


def drawn(loaded: Loaded) -> Figure:
    """The figure of what a figure of the catalogue loads."""
    return draw(loaded.panels, loaded.data(), loaded.layout)


def drawn_from(name: str, folder: Path) -> Figure:
    """The figure ``name`` of the catalogue, from runs in a folder."""
    return drawn(FIGURES[name].load(Request(folder)))


def series_of(folder: Path, scene: str) -> dict[str, np.ndarray]:
    """The columns of a run, read without the help of topcli."""
    return columns_of(folder / scene / "series.parquet")


def columns_of(path: Path) -> dict[str, np.ndarray]:
    """The columns of a file."""
    table = pq.read_table(path)
    return {name: table.column(name).to_numpy() for name in table.column_names}


def vector(series: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    """The vectors (m, 3) of the rows of a run."""
    return np.column_stack([series[f"{name}{i}"] for i in (1, 2, 3)])


def data_of(line: Line2D) -> np.ndarray:
    """The points (m, 2) of a line."""
    return np.column_stack([np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)])


def labelled(axes: Axes) -> dict[str, Line2D]:
    """The lines of the legend by their labels, without slopes; those of schemes by the names in configs."""
    lines = (line for line in axes.lines if line.get_label()[0] != "_")
    return {name_of(str(line.get_gid() or line.get_label())): line for line in lines}


def name_of(shown: str) -> str:
    """Name in configs of the scheme that is ``shown``; any other label as it is."""
    shown, after, rest = shown.partition(" (after its set-up)")
    return NAMED.get(shown, shown) + after + rest


def explained(figure: Figure) -> dict[str, Line2D]:
    """The lines in all legends of a figure by their texts."""
    legends = [*figure.legends, *(legend for axes in figure.axes if (legend := axes.get_legend()))]
    return {
        text.get_text(): line
        for legend in legends
        for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)
    }


def eye_of(axes: Any) -> np.ndarray:
    """Direction (3,) from the origin towards the viewer of three-dimensional axes."""
    e, a = math.radians(axes.elev), math.radians(axes.azim)
    return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def seen(axes: Any, points: np.ndarray) -> np.ndarray:
    """Places (m, 2) of points (m, 3) on the plane of three-dimensional axes, by their own projection."""
    return np.column_stack(proj_transform(*points.T, axes.get_proj())[:2])


def points_of(line: Any) -> np.ndarray:
    """The points (m, 3) of a line in space."""
    return np.column_stack(line.get_data_3d())


def arrows(axes: Axes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Foot and head of every arrow on the axes."""
    pointing = [text for text in axes.texts if getattr(text, "arrowprops", None) is not None]
    return [(np.asarray(text.xyann), np.asarray(text.xy)) for text in pointing]  # type: ignore[attr-defined]


def in_two_parts(axes: Axes, near: Any, far: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 3) of the curve that is drawn as a near and a far line of these colours, and where it is near."""
    front, back = (
        next(line for line in axes.lines if same_color(line.get_color(), colour) and line.get_linestyle() == "-")
        for colour in (near, far)
    )
    points, others = points_of(front), points_of(back)
    shown = np.isfinite(points).all(axis=1)
    assert (shown ^ np.isfinite(others).all(axis=1)).all()
    assert (front.get_zorder() > back.get_zorder(), front.get_linewidth() > back.get_linewidth()) == (True, True)
    return np.where(shown[:, None], points, others), shown


def texts_of(axes: Axes) -> list[str]:
    """Texts inside of the axes."""
    return [text.get_text() for text in axes.texts if text.get_text()]
