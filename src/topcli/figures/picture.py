"""Pictures as data: panels of lines over the columns of a table, and the function that draws them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from topcli.analysis.attitude import SYMBOLS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from topcli.config.models import Experiment

STYLE = Path(__file__).parent / "print.mplstyle"
IMAGE_FORMATS = ("png", "pdf", "svg")
DEFAULT_FORMATS = ("png", "pdf")

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
    """Experiment of a run that a panel draws; ``as_packaged`` if its motion is that of the packaged scene.

    ``changed`` has the first digits of the digest if overrides of the command line change the experiment.
    """

    experiment: Experiment
    as_packaged: bool
    changed: str = ""


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


def number_text(value: float) -> str:
    """Mathtext, without dollars, of a number to six digits; powers of ten as such."""
    digits, exponent = f"{value:.5e}".split("e")
    power, mantissa = int(exponent), f"{float(digits):g}"
    if -3 < power < 5:
        return f"{value:.6g}"
    ten = f"10^{{{power}}}"
    return {"1": ten, "-1": f"-{ten}"}.get(mantissa, rf"{mantissa}\times {ten}")


def described(text: str, experiment: Experiment) -> str:
    """``text`` with the values of the run in place of ``{scheme}``, ``{h}`` and components of the first state."""
    named = {name: number_text(value) for name, value in zip(experiment.top.components, experiment.y0, strict=True)}
    for key, value in {"scheme": scheme_label(experiment), "h": number_text(experiment.h), **named}.items():
        text = text.replace(f"{{{key}}}", value)
    return text


@dataclass(frozen=True)
class Line:
    """A column drawn against the panel's x column, and its label in the legend (may be mathtext).

    An empty label becomes the symbol of the column in the run's top or scheme. ``dots`` draws open circles at about so
    many points instead of a line: it shows a curve that coincides with another.
    """

    column: str
    label: str = ""
    dots: int = 0


@dataclass(frozen=True)
class Panel:
    """One pair of axes with lines.

    ``ylim`` is the smallest vertical range, ``log`` makes the vertical axis logarithmic. ``title`` is above the axes on
    the left; ``{scheme}``, ``{h}`` and components of the state in it become the run's (``described``). An empty
    ``ylabel`` becomes the labels of the lines. ``deviation`` draws the absolute deviation from the first value,
    relative to it; ``change`` the value minus the first one. With ``whole`` a small pair of axes in the upper left
    corner shows the values themselves over this vertical range. Columns in ``exact`` have another, ``exact:<column>``,
    of the exact motion, which is drawn in grey behind the lines.
    """

    lines: tuple[Line, ...]
    ylabel: str = ""
    xlabel: str = "$t$"
    x: str = "t"
    ylim: tuple[float, float] | None = None
    log: bool = False
    title: str = ""
    deviation: bool = False
    change: bool = False
    whole: tuple[float, float] | None = None
    exact: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return (self.x, *(line.column for line in self.lines), *map(exact_column, self.exact))

    def overlaid(self, known: frozenset[str]) -> Panel:
        """Return the panel with the exact motion behind those of its columns that are ``known``."""
        drawn = tuple(line.column for line in self.lines if line.column in known)
        return self if self.deviation else replace(self, exact=drawn)

    def of_runs(self, runs: Runs) -> Panel:
        """Return the panel with title and labels of the runs that its columns come from."""
        first = runs[self.x].experiment
        lines = tuple(
            replace(line, label=line.label or column_label(runs[line.column].experiment, line.column))
            for line in self.lines
        )
        named = (f"{line.label} − {line.label}$(0)$" if self.change else line.label for line in lines)
        ylabel = self.ylabel or ", ".join(named)
        return replace(self, lines=lines, ylabel=ylabel, title=described(self.title, first))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the lines into ``axes``."""
        x = data[self.x]
        low, high = self.ylim or (np.inf, -np.inf)
        for column in self.exact:
            axes.plot(x, self._shown(data[exact_column(column)]), **styles[REFERENCE])
        for line in self.lines:
            values = self._shown(data[line.column])
            axes.plot(x, values, label=line.label, **self._style(line, len(x), styles))
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
        if self.whole:
            self._inset(axes, data, styles)

    def _shown(self, values: np.ndarray) -> np.ndarray:
        """Values of a column as they are drawn."""
        if self.change:
            return values - values[0]
        if self.deviation:
            values = np.abs(values / values[0] - 1.0)
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


def exact_column(column: str) -> str:
    """Name of the column of the exact motion that belongs to a column of a run."""
    return f"exact:{column}"


REFERENCE = "reference"
"""Label of the line that others are compared with: broad, grey, and behind them."""


def line_styles(count: int) -> list[dict[str, Any]]:
    """Colours and dashes of ``count`` lines, all different up to the square of the number of colours."""
    import matplotlib as mpl

    cycle = list(mpl.rcParams["axes.prop_cycle"])
    turns = [(i % len(cycle), i // len(cycle)) for i in range(count)]
    return [{**cycle[at], **_dash(cycle[(at + turn) % len(cycle)])} for at, turn in turns]


def _dash(style: Mapping[str, Any]) -> dict[str, Any]:
    return {"linestyle": style.get("linestyle", "-")}


def _styles(labels: Sequence[str]) -> Styles:
    """Line style of each label: the same for equal labels, different for different ones."""
    different = dict.fromkeys(label for label in labels if label != REFERENCE)
    styles = dict(zip(different, line_styles(len(different)), strict=True))
    return {**styles, REFERENCE: {"color": "0.8", "linewidth": 3.5, "linestyle": "-", "zorder": 1.5}}


@dataclass(frozen=True)
class Grid:
    """Layout of panels in ``rows`` of equal axes; ``figsize`` is in inches, ``heading`` a line above all panels."""

    rows: int = 1
    figsize: tuple[float, float] | None = None
    heading: str = ""

    def axes(self, figure: Any, panels: Sequence[Drawable]) -> Sequence[Any]:
        """Axes of the panels in their order."""
        places = figure.subplots(self.rows, -(-len(panels) // self.rows), squeeze=False).ravel()
        for empty in places[len(panels) :]:
            empty.set_axis_off()
        return places[: len(panels)]

    def annotate(self, figure: Any) -> None:
        """Add parts that belong to no panel."""


@dataclass(frozen=True)
class SharedLegend(Grid):
    """Layout with one legend below all panels, in ``ncols`` columns, with an entry for each label.

    Labels in ``first`` come first, in this order.
    """

    ncols: int = 4
    first: tuple[str, ...] = ()

    def annotate(self, figure: Any) -> None:
        """Add the legend."""
        found: dict[str, Any] = {}
        for axes in figure.axes:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                found.setdefault(label, handle)
        ordered = {label: found[label] for label in (*self.first, *found) if label in found}
        where: dict[str, Any] = {"loc": "outside lower center", "ncols": self.ncols, "fontsize": "small"}
        figure.legend(ordered.values(), ordered.keys(), **where)


@contextmanager
def styled(style: Mapping[str, Any] | None = None) -> Iterator[None]:
    """Context with the parameters of the print style, and with those of ``style`` in their place."""
    import matplotlib as mpl

    chosen: Any = dict(style or {})
    with mpl.rc_context(fname=STYLE), mpl.rc_context(chosen):
        yield


def draw(
    panels: Sequence[Drawable],
    data: Mapping[str, np.ndarray],
    layout: Grid | None = None,
    style: Mapping[str, Any] | None = None,
) -> Figure:
    """Draw ``panels`` from the columns of ``data`` (each (m,)) and return the matplotlib figure.

    Legends of lines are above the axes, where they hide no trajectory: one for each panel, or one for the whole figure
    if a panel has more than four lines or a reference; the latter is below if the figure has a heading. Parameters of
    matplotlib in ``style`` replace those for print.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    layout = layout or Grid()
    lines = [panel.lines for panel in panels if isinstance(panel, Panel)]
    labels = [line.label for one in lines for line in one]
    shared = REFERENCE in labels or any(len(one) > 4 for one in lines)
    with styled(style):
        figure = Figure(figsize=(style or {}).get("figure.figsize") or layout.figsize)
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
            place = "outside lower center" if layout.heading else "outside upper center"
            figure.legend(handles.values(), handles.keys(), loc=place, ncols=min(6, len(handles)))
        if layout.heading:
            figure.suptitle(layout.heading, fontsize="medium")
        layout.annotate(figure)
    return figure


def save(figure: Figure, path: Path, style: Mapping[str, Any] | None = None) -> None:
    """Write the picture in the format of the path's suffix, without a date, so that equal data gives equal files."""
    dates = {"pdf": ("CreationDate", "ModDate"), "svg": ("Date",)}.get(path.suffix[1:], ())
    with styled({"svg.hashsalt": "topcli", **(style or {})}):
        figure.savefig(path, metadata=dict.fromkeys(dates))
