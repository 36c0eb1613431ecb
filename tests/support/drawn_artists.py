"""Data and looks of the artists of a drawn figure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from topcli.figures.figure import Loaded
from topcli.figures.picture import draw


def drawn(loaded: Loaded) -> Figure:
    """The figure of what a figure of the catalogue loads."""
    return draw(loaded.panels, loaded.data(), loaded.layout)


def series_of(folder: Path, scene: str) -> dict[str, np.ndarray]:
    """The columns of a run, read without the help of topcli."""
    table = pq.read_table(folder / "r" / scene / "series.parquet")
    return {name: table.column(name).to_numpy() for name in table.column_names}


def data_of(line: Line2D) -> np.ndarray:
    """The points (m, 2) of a line."""
    return np.column_stack([np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)])


def look(line: Line2D) -> tuple[Any, ...]:
    """Features by which a reader identifies a line."""
    return to_rgb(line.get_color()), line.get_linestyle()


def in_sight(axes: Axes, line: Line2D) -> bool:
    """True if no point of the line lies outside the axes' limits."""
    points = data_of(line)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    inside = [(points[:, i] >= limit[0]) & (points[:, i] <= limit[1]) for i, limit in enumerate((low, high))]
    return bool(len(points) and np.all(inside))


def keys_are_true(axes: Axes) -> bool:
    """True if the legend explains each line by a line that looks like it, and no two lines look alike."""
    legend = axes.get_legend()
    assert legend is not None
    shown = {text.get_text(): look(handle) for text, handle in zip(legend.get_texts(), legend.get_lines(), strict=True)}
    assert shown == {str(line.get_label()): look(line) for line in axes.lines}
    return len(set(shown.values())) == len(shown)
