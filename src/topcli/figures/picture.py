"""Pictures as data: panels of lines over the columns of a table, and the function that draws them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from topcli.engine.columns import SYMBOLS
from topcli.figures.style import REFERENCE, REFERENCE_LOOK, Styles, looks, styled
from topcli.schemes.display import display_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from topcli.config.models import Experiment

IMAGE_FORMATS = ("png", "pdf", "svg")
DEFAULT_FORMATS = ("png", "pdf")


class Drawable(Protocol):
    """Content of one pair of axes, which is drawn from the columns of a table."""

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw into matplotlib's ``axes``."""
        ...


_GREEK = frozenset("alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi".split())  # noqa: SIM905
_GREEK |= frozenset("pi rho sigma tau upsilon phi chi psi omega".split())  # noqa: SIM905


def component_symbol(name: str) -> str:
    """Mathtext of a component of the state: ``omega1``, ``a3`` or ``theta``; other words are upright."""
    letter = name.rstrip("0123456789")
    number = name[len(letter) :]
    symbol = rf"\{letter}" if letter in _GREEK else letter
    if letter not in _GREEK and len(letter) > 1:
        symbol = r"\mathrm{" + letter.replace("_", r"\_") + "}"
    return f"${symbol}_{{{number}}}$" if len(number) > 1 else f"${symbol}_{number}$" if number else f"${symbol}$"


def column_label(experiment: Experiment, column: str) -> str:
    """Mathtext of a column of the run of ``experiment``: a component or an integral."""
    integrals = {one.name: one.tex for one in (*experiment.top.invariants(), *experiment.modified)}
    if column in experiment.top.components:
        return component_symbol(column)
    if column in experiment.output.attitude_columns:
        return f"${SYMBOLS[column]}$"
    return f"${integrals[column]}$" if column in integrals else column


def scheme_label(experiment: Experiment) -> str:
    """Display name of the scheme, with its options other than the defaults."""
    changed = experiment.options.model_dump(mode="json", exclude_defaults=True)
    options = ", ".join(f"{key}={value}" for key, value in changed.items())
    return display_name(experiment.scheme.name) + (f" ({options})" if options else "")


def number_text(value: float) -> str:
    """Mathtext, without dollars, of a number to six digits; powers of ten as such."""
    digits, exponent = f"{value:.5e}".split("e")
    power, mantissa = int(exponent), f"{float(digits):g}"
    if -3 < power < 5:
        return f"{value:.6g}"
    ten = f"10^{{{power}}}"
    return {"1": ten, "-1": f"-{ten}"}.get(mantissa, rf"{mantissa}\times {ten}")


@dataclass(frozen=True)
class Line:
    """A column drawn against the panel's x column, and its label in the legend (may be mathtext).

    ``dots`` draws open circles at about this number of points instead of a line: it shows a curve that coincides with
    another.
    """

    column: str
    label: str = ""
    dots: int = 0


@dataclass(frozen=True)
class Panel:
    """One pair of axes with lines.

    ``ylim`` is the smallest vertical range, ``log`` makes the vertical axis logarithmic, ``xlog`` the other one.
    ``title`` is above the axes on the left. ``deviation`` draws the largest absolute deviation from the first value so
    far, relative to it; ``change`` the value minus the first one. With ``whole`` a small pair of axes in the upper left
    corner shows the values themselves over this vertical range.
    """

    lines: tuple[Line, ...]
    ylabel: str = ""
    xlabel: str = "time $t$"
    x: str = "t"
    ylim: tuple[float, float] | None = None
    log: bool = False
    xlog: bool = False
    title: str = ""
    deviation: bool = False
    change: bool = False
    whole: tuple[float, float] | None = None

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the lines into ``axes``."""
        x = data[self.x]
        low, high = self.ylim or (np.inf, -np.inf)
        for line in self.lines:
            values = self._shown(data[line.column])
            axes.plot(x, values, label=line.label, **self._style(line, len(x), styles))
            low, high = np.fmin.reduce(values, initial=low), np.fmax.reduce(values, initial=high)
        caption(axes, self.xlabel, self.ylabel, self.title)
        finite = x[np.isfinite(x)]
        axes.set_xlim(float(finite.min()), float(finite.max()))
        if self.log:
            axes.set_yscale("log")
        if self.xlog:
            axes.set_xscale("log")
        if self.ylim:
            axes.set_ylim(float(low), float(high))  # values outside ``ylim`` widen the range
        if self.whole:
            self._inset(axes, data, styles)

    def _shown(self, values: np.ndarray) -> np.ndarray:
        """Values of a column as they are drawn."""
        if self.change:
            return values - values[0]
        if self.deviation:
            values = np.fmax.accumulate(np.abs(values / values[0] - 1.0))  # itself it would return to zero in spikes
            return np.where(values > 0.0, values, np.nan)  # a logarithmic axis has no zero
        return values

    def _style(self, line: Line, points: int, styles: Styles) -> dict[str, Any]:
        """Style of a line with this number of ``points``."""
        if not line.dots:
            return styles[line.label]
        ring = {"marker": "o", "markersize": 3.2, "markerfacecolor": "none", "markeredgewidth": 0.8}
        return {**styles[line.label], "linestyle": "none", "markevery": max(1, points // line.dots), **ring}

    def _inset(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the values themselves into the upper left corner."""
        inset = axes.inset_axes((0.07, 0.52, 0.33, 0.43))
        assert self.whole
        low, high = self.whole
        for line in self.lines:
            values = data[line.column]
            inset.plot(data[self.x], values, **styles[line.label])
            low, high = np.fmin.reduce(values, initial=low), np.fmax.reduce(values, initial=high)
        inset.set(xlim=axes.get_xlim(), ylim=(float(low), float(high)))
        inset.tick_params(labelsize="small")
        inset.set_ylabel(", ".join(line.label for line in self.lines), fontsize="small")


def legend_entries(figure: Any) -> dict[str, Any]:
    """Handle of each different label in the panels of a figure."""
    found: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return found


@dataclass(frozen=True)
class Grid:
    """Layout of panels in ``rows`` of equal axes; ``figsize`` is in inches, ``heading`` a line above all panels.

    With ``ncols`` one legend with this number of columns is below all panels: each label once, those in ``first``
    first. Lines in the legend have the length ``handlelength`` in letters.
    """

    rows: int = 1
    figsize: tuple[float, float] | None = None
    heading: str = ""
    ncols: int = 0
    first: tuple[str, ...] = ()
    fontsize: float | str = "small"
    handlelength: float | None = None

    def axes(self, figure: Any, panels: Sequence[Drawable]) -> Sequence[Any]:
        """Axes of the panels in their order."""
        columns = -(-len(panels) // self.rows)
        return [
            figure.add_subplot(self.rows, columns, i, projection=getattr(panel, "projection", None))
            for i, panel in enumerate(panels, 1)
        ]

    def annotate(self, figure: Any) -> None:
        """Add the legend."""
        if not self.ncols:
            return
        entries = legend_entries(figure)
        ordered = dict.fromkeys(name for name in (*self.first, *entries) if name in entries)
        below_panels(
            figure,
            [entries[name] for name in ordered],
            list(ordered),
            self.ncols,
            fontsize=self.fontsize,
            handlelength=self.handlelength,
        )


DASHED = 2.4
"""Length of a line in a legend, in letters, that shows all of a dash-dot pattern."""


def below_panels(figure: Any, handles: Sequence[Any], texts: Sequence[str], ncols: int, **options: Any) -> None:
    """Add a legend below all panels of a figure."""
    look = {"fontsize": "small", "title_fontsize": "small", **options}
    figure.legend(handles, texts, loc="outside lower center", ncols=ncols, **look)


def caption(axes: Any, x: str, y: str, title: str) -> None:
    """Write names beside the axes, and a title above them on the left."""
    axes.set(xlabel=x, ylabel=y)
    axes.set_title(title, loc="left")


def halo(text: Any, width: float = 2.5) -> None:
    """Surround a text by white, so that it can be read over lines."""
    from matplotlib.patheffects import withStroke

    text.set_path_effects([withStroke(linewidth=width, foreground="white")])


LINE = 10.5
"""Distance of the lines of labels in points."""
AXES_SHARE = 0.72
"""Least part of the height of its row that a pair of axes takes."""
GUTTER = 0.08
"""Room for the leaders between the axes and the labels, relative to the width of the axes."""


def label_ends(axes: Any, ends: Sequence[tuple[float, float, str, Any]]) -> None:
    """Write a label for each curve at the right of the axes, on the height of its end.

    Labels that would overlap are moved apart, by as little as possible; a thin leader joins each to the end.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes with their final scales and limits.
    ends : sequence of (float, float, str, colour)
        Last point of each curve, its label, and its colour.
    """
    from matplotlib.colors import to_rgb
    from scipy.optimize import isotonic_regression

    if not ends:
        return
    heights = np.array([axes.transAxes.inverted().transform(axes.transData.transform(end[:2]))[1] for end in ends])
    order = np.argsort(heights, kind="stable")
    rows = axes.get_gridspec().nrows
    gaps = LINE * rows / (72.0 * AXES_SHARE * axes.figure.get_figheight()) * np.arange(len(ends))
    places = isotonic_regression(heights[order] - gaps).x.clip(0.0, max(0.0, 1.0 - gaps[-1])) + gaps
    leader = {"arrowstyle": "-", "linewidth": 0.5, "shrinkA": 1.0, "shrinkB": 2.0, "relpos": (0.0, 0.5)}
    for at, place in zip(order, places, strict=True):
        x, y, label, colour = ends[at]
        axes.annotate(
            label,
            (x, y),
            (1.0 + GUTTER, place),
            textcoords="axes fraction",
            va="center",
            fontsize="small",
            color=[0.75 * part for part in to_rgb(colour)],  # pale colours are hard to read as text
            arrowprops={**leader, "color": colour},
        )


def draw(panels: Sequence[Drawable], data: Mapping[str, np.ndarray], layout: Grid | None = None) -> Figure:
    """Draw ``panels`` from the columns of ``data`` (each (m,)) and return the matplotlib figure.

    Legends of lines are above the axes, where they hide no trajectory: one for each panel, or one for the whole figure
    if a panel has more than four lines or a reference; the latter is below if the figure has a heading.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    layout = layout or Grid()
    labels = [[line.label for line in panel.lines] if isinstance(panel, Panel) else [] for panel in panels]
    every = list(itertools.chain(*labels))
    shared = REFERENCE in every or any(len(own) > 4 for own in labels)
    with styled():
        figure = Figure(figsize=layout.figsize)
        FigureCanvasAgg(figure)
        for axes, panel, own in zip(layout.axes(figure, panels), panels, labels, strict=True):
            panel.paint(axes, data, {**looks(every if shared else own), REFERENCE: REFERENCE_LOOK})
            if own and not shared:
                axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4, borderaxespad=0.2)
        if shared:
            entries = legend_entries(figure)
            place = "outside lower center" if layout.heading else "outside upper center"
            figure.legend(entries.values(), entries.keys(), loc=place, ncols=min(6, len(entries)))
        if layout.heading:
            figure.suptitle(layout.heading, fontsize="medium")
        layout.annotate(figure)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write the picture in the format of the path's suffix, without a date, so that equal data gives equal files."""
    dates = {"pdf": ("CreationDate", "ModDate"), "svg": ("Date",)}.get(path.suffix[1:], ())
    with styled({"svg.hashsalt": "topcli"}):
        figure.savefig(path, metadata=dict.fromkeys(dates))
