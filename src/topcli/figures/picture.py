"""A picture as data: panels of lines over the columns of a table, and the one function that draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = Path(__file__).parent / "print.mplstyle"
IMAGE_FORMATS = ("png", "pdf")


class Drawable(Protocol):
    """What fills one pair of axes from the columns of a table; a ``figsize`` of its own is heeded."""

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that it needs."""
        ...

    def paint(self, axes: Any, data: Mapping[str, np.ndarray]) -> None:
        """Draw into matplotlib's ``axes``."""
        ...


@dataclass(frozen=True)
class Line:
    """One line: the column drawn over the panel's x column, and its label in the legend (may be mathtext)."""

    column: str
    label: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes. ``ylim`` fixes the vertical range; ``log`` makes the vertical axis logarithmic.

    ``deviation`` draws by how much a column differs from its first value, relative to it and without the sign.
    """

    lines: tuple[Line, ...]
    ylabel: str
    xlabel: str = "$t$"
    x: str = "t"
    ylim: tuple[float, float] | None = None
    log: bool = False
    deviation: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that the panel draws."""
        return (self.x, *(line.column for line in self.lines))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray]) -> None:
        """Draw the lines into ``axes``."""
        _draw_panel(axes, self, data)


def _draw_panel(axes: Any, panel: Panel, data: Mapping[str, np.ndarray]) -> None:
    x = data[panel.x]
    for line in panel.lines:
        values = data[line.column]
        if panel.deviation:
            values = np.abs(values / values[0] - 1.0)
            values = np.where(values > 0.0, values, np.nan)  # a logarithmic axis has no zero
        axes.plot(x, values, label=line.label)
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


def draw(panels: Sequence[Drawable], data: Mapping[str, np.ndarray]) -> Figure:
    """A matplotlib figure with ``panels`` side by side, drawn from the columns of ``data`` (each (m,))."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(fname=STYLE):
        figure = Figure(figsize=getattr(panels[0], "figsize", None))
        FigureCanvasAgg(figure)
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            panel.paint(axes, data)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the picture in the format of the path's suffix, without a date: the same data gives the same file."""
    import matplotlib as mpl

    dated = {"pdf": {"CreationDate": None, "ModDate": None}}.get(path.suffix[1:], {})
    with mpl.rc_context(fname=STYLE):
        figure.savefig(path, metadata=dated)
