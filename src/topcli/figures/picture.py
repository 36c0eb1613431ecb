"""A picture as data: panels of lines over the columns of a table, and the one function that draws them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

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
    """One pair of axes. ``ylim`` fixes the vertical range; ``log`` makes the vertical axis logarithmic.

    ``title`` stands above the axes on the left.
    """

    lines: tuple[Line, ...]
    ylabel: str
    xlabel: str = "$t$"
    x: str = "t"
    ylim: tuple[float, float] | None = None
    log: bool = False
    title: str = ""


REFERENCE = "reference"
"""The label of a line that others are compared with: drawn broad and grey, behind them."""


def _styles(panels: Sequence[Panel]) -> dict[str, dict[str, Any]]:
    """A line style for each label: the same label looks the same in every panel, another label never does."""
    import matplotlib as mpl

    labels = dict.fromkeys(line.label for panel in panels for line in panel.lines if line.label != REFERENCE)
    styles = dict(zip(labels, itertools.cycle(mpl.rcParams["axes.prop_cycle"]), strict=False))
    return {**styles, REFERENCE: {"color": "0.75", "linewidth": 3.5, "linestyle": "-", "zorder": 1.5}}


def _draw_panel(axes: Any, panel: Panel, data: Mapping[str, np.ndarray], styles: Mapping[str, dict[str, Any]]) -> None:
    x = data[panel.x]
    for line in panel.lines:
        axes.plot(x, data[line.column], label=line.label, **styles[line.label])
    axes.set_xlabel(panel.xlabel)
    axes.set_ylabel(panel.ylabel)
    axes.set_title(panel.title, loc="left")
    finite = x[np.isfinite(x)]
    axes.set_xlim(float(finite.min()), float(finite.max()))
    if panel.log:
        axes.set_yscale("log")
    if panel.ylim:
        axes.set_ylim(*panel.ylim)


def draw(panels: Sequence[Panel], data: Mapping[str, np.ndarray]) -> Figure:
    """A matplotlib figure with ``panels`` side by side, drawn from the columns of ``data`` (each (m,)).

    Legends stand above the axes, where no trajectory can run through them: one for each panel, or one for all
    where there are many lines or a reference.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    labels = [line.label for panel in panels for line in panel.lines]
    shared = REFERENCE in labels or any(len(panel.lines) > 4 for panel in panels)
    with mpl.rc_context(fname=STYLE):
        figure = Figure()
        FigureCanvasAgg(figure)
        styles = _styles(panels)
        every_axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, panel in zip(every_axes, panels, strict=True):
            _draw_panel(axes, panel, data, styles)
            if not shared:
                axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, borderaxespad=0.2)
        if shared:
            handles = {
                label: handle
                for axes in every_axes
                for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
            }
            figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=min(6, len(set(labels))))
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the picture in the format of the path's suffix, without a date: the same data gives the same file."""
    import matplotlib as mpl

    dated = {"pdf": {"CreationDate": None, "ModDate": None}}.get(path.suffix[1:], {})
    with mpl.rc_context(fname=STYLE):
        figure.savefig(path, metadata=dated)
