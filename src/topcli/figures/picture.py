"""Pictures as data: panels of lines over the columns of a table, and the function that draws them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from topcli.analysis.attitude import SYMBOLS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from topcli.config.models import Experiment

STYLE = Path(__file__).parent / "print.mplstyle"
IMAGE_FORMATS = ("png", "pdf")


Styles = Mapping[str, dict[str, Any]]
"""Line style of each label of a figure."""


class Drawable(Protocol):
    """Content of one pair of axes, drawn from the columns of a table."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that it draws."""
        ...

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw into matplotlib's ``axes``."""
        ...


@dataclass(frozen=True)
class DrawnRun:
    """Experiment of a run that a panel draws; ``as_packaged`` if its motion is that of the packaged scene."""

    experiment: Experiment
    as_packaged: bool


Runs = Mapping[str, DrawnRun]
"""Run that each column of a figure comes from."""


def component_symbol(name: str) -> str:
    """Mathtext of a component of the state: ``omega1`` or ``a3``."""
    letter, number = name[:-1], name[-1]
    return rf"$\{letter}_{number}$" if len(letter) > 1 else f"${letter}_{number}$"


def column_label(experiment: Experiment, column: str) -> str:
    """Mathtext of a column of the run of ``experiment``: a component or an integral."""
    integrals = {one.name: one.tex for one in (*experiment.top.invariants(), *experiment.modified)}
    if column in experiment.top.components:
        return component_symbol(column)
    if column in experiment.output.attitude_columns:
        return f"${SYMBOLS[column]}$"
    return f"${integrals[column]}$" if column in integrals else column


def scheme_label(experiment: Experiment) -> str:
    """Name of the scheme, with its options other than the defaults."""
    changed = experiment.options.model_dump(mode="json", exclude_defaults=True)
    options = ", ".join(f"{key}={value}" for key, value in changed.items())
    return experiment.scheme.name + (f" ({options})" if options else "")


@dataclass(frozen=True)
class Line:
    """A column drawn against the panel's x column, and its label in the legend (may be mathtext).

    An empty label becomes the symbol of the column in the run's top or scheme.
    """

    column: str
    label: str = ""


@dataclass(frozen=True)
class Panel:
    """One pair of axes with lines.

    ``ylim`` is the smallest vertical range, ``log`` makes the vertical axis logarithmic. ``title`` is above the axes on
    the left; ``{scheme}`` in it becomes the name of the run's scheme. An empty ``ylabel`` becomes the labels of the
    lines. ``deviation`` draws the absolute deviation from the first value, relative to it.
    """

    lines: tuple[Line, ...]
    ylabel: str = ""
    xlabel: str = "$t$"
    x: str = "t"
    ylim: tuple[float, float] | None = None
    log: bool = False
    title: str = ""
    deviation: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return (self.x, *(line.column for line in self.lines))

    def of_runs(self, runs: Runs) -> Panel:
        """Return the panel with title and labels of the runs that its columns come from."""
        first = runs[self.x].experiment
        lines = tuple(
            replace(line, label=line.label or column_label(runs[line.column].experiment, line.column))
            for line in self.lines
        )
        ylabel = self.ylabel or ", ".join(line.label for line in lines)
        return replace(self, lines=lines, ylabel=ylabel, title=self.title.replace("{scheme}", scheme_label(first)))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the lines into ``axes``."""
        x = data[self.x]
        low, high = self.ylim or (np.inf, -np.inf)
        for line in self.lines:
            values = data[line.column]
            if self.deviation:
                values = np.abs(values / values[0] - 1.0)
                values = np.where(values > 0.0, values, np.nan)  # a logarithmic axis has no zero
            axes.plot(x, values, label=line.label, **styles[line.label])
            low, high = np.fmin.reduce(values, initial=low), np.fmax.reduce(values, initial=high)
        axes.set_xlabel(self.xlabel)
        axes.set_ylabel(self.ylabel)
        axes.set_title(self.title, loc="left")
        finite = x[np.isfinite(x)]
        axes.set_xlim(float(finite.min()), float(finite.max()))
        if self.log:
            axes.set_yscale("log")
        if self.ylim:
            axes.set_ylim(float(low), float(high))  # values outside ``ylim`` widen the range


REFERENCE = "reference"
"""Label of the line that others are compared with: broad, grey, and behind them."""


def _styles(labels: Sequence[str]) -> Styles:
    """Line style of each label: the same for equal labels, different for different ones."""
    import matplotlib as mpl

    different = dict.fromkeys(label for label in labels if label != REFERENCE)
    styles = dict(zip(different, itertools.cycle(mpl.rcParams["axes.prop_cycle"]), strict=False))
    return {**styles, REFERENCE: {"color": "0.75", "linewidth": 3.5, "linestyle": "-", "zorder": 1.5}}


@dataclass(frozen=True)
class Grid:
    """Layout of panels in ``rows`` of equal axes; ``figsize`` is in inches."""

    rows: int = 1
    figsize: tuple[float, float] | None = None

    def axes(self, figure: Any, panels: Sequence[Drawable]) -> Sequence[Any]:
        """Axes of the panels in their order."""
        places = figure.subplots(self.rows, -(-len(panels) // self.rows), squeeze=False).ravel()
        for empty in places[len(panels) :]:
            empty.set_axis_off()
        return places[: len(panels)]

    def annotate(self, figure: Any) -> None:
        """Add parts that belong to no panel."""


def draw(panels: Sequence[Drawable], data: Mapping[str, np.ndarray], layout: Grid | None = None) -> Figure:
    """Draw ``panels`` from the columns of ``data`` (each (m,)) and return the matplotlib figure.

    Legends of lines are above the axes, where they hide no trajectory: one for each panel, or one for the whole figure
    if a panel has more than four lines or a reference.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    layout = layout or Grid()
    lines = [panel.lines for panel in panels if isinstance(panel, Panel)]
    labels = [line.label for one in lines for line in one]
    shared = REFERENCE in labels or any(len(one) > 4 for one in lines)
    with mpl.rc_context(fname=STYLE):
        figure = Figure(figsize=layout.figsize)
        FigureCanvasAgg(figure)
        handles: dict[str, Any] = {}
        for axes, panel in zip(layout.axes(figure, panels), panels, strict=True):
            own = [line.label for line in panel.lines] if isinstance(panel, Panel) else []
            panel.paint(axes, data, _styles(labels if shared else own))
            if own:
                for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                    handles.setdefault(label, handle)
                if not shared:
                    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2)
        if shared:
            figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=min(6, len(handles)))
        layout.annotate(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the picture in the format of the path's suffix, without a date, so that equal data gives equal files."""
    import matplotlib as mpl

    dated = {"pdf": {"CreationDate": None, "ModDate": None}}.get(path.suffix[1:], {})
    with mpl.rc_context(fname=STYLE):
        figure.savefig(path, metadata=dated)
