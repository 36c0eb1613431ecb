"""A picture as data: panels of lines over the columns of a table, and the one function that draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.figures.sphere import Sphere, draw_sphere

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = Path(__file__).parent / "print.mplstyle"
IMAGE_FORMATS = ("png", "pdf")


@dataclass(frozen=True)
class Line:
    """One line: the column drawn over the panel's x column, and its label in the legend (may be mathtext)."""

    column: str
    label: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes. ``ylim`` fixes the vertical range; ``log`` makes the vertical axis logarithmic."""

    lines: tuple[Line, ...]
    ylabel: str
    xlabel: str = "$t$"
    x: str = "t"
    ylim: tuple[float, float] | None = None
    log: bool = False


def _draw_panel(axes: Any, panel: Panel, data: Mapping[str, np.ndarray]) -> None:
    x = data[panel.x]
    for line in panel.lines:
        axes.plot(x, data[line.column], label=line.label)
    axes.set_xlabel(panel.xlabel)
    axes.set_ylabel(panel.ylabel)
    finite = x[np.isfinite(x)]
    axes.set_xlim(float(finite.min()), float(finite.max()))
    if panel.log:
        axes.set_yscale("log")
    if panel.ylim:
        axes.set_ylim(*panel.ylim)
    # above the axes: no trajectory can run through it
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=min(4, len(panel.lines)), borderaxespad=0.2)


def draw(panels: Sequence[Panel | Sphere], data: Mapping[str, np.ndarray]) -> Figure:
    """A matplotlib figure with ``panels`` side by side, drawn from the columns of ``data`` (each (m,))."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(fname=STYLE):
        figure = Figure()
        FigureCanvasAgg(figure)
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            if isinstance(panel, Sphere):
                draw_sphere(axes, panel, data)
            else:
                _draw_panel(axes, panel, data)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the picture in the format of the path's suffix, without a date: the same data gives the same file."""
    import matplotlib as mpl

    dated = {"pdf": {"CreationDate": None, "ModDate": None}}.get(path.suffix[1:], {})
    with mpl.rc_context(fname=STYLE):
        figure.savefig(path, metadata=dated)
