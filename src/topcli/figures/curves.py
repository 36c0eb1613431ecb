"""Panels of curves or colours over keys, with observed slopes and the plateau of round-off."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.order import convergence
from topcli.contracts import Array
from topcli.figures.picture import caption, label_ends
from topcli.figures.style import Styles, looks
from topcli.schemes.display import display_name

LINEAR, LOG, SYMLOG = "linear", "log", "symlog"
NOTHING = "no value"
PLATEAU = "round-off"
CATEGORY = "0.2"
"""Colour of the only curve over names."""


def curve_column(label: str, kind: str) -> str:
    """Name of a column of a curve: ``kind`` is x, y, low or high."""
    return f"{label}:{kind}"


def plain(text: str) -> str:
    """Text that matplotlib shows as it is, without reading it as mathematics."""
    return text.replace("$", r"\$")


def symlog_ticks(threshold: float, low: float, high: float) -> list[float]:
    """Zero and powers of ten from ``low`` to ``high`` beyond the ``threshold``, at most four on each side."""
    bottom, top = math.floor(math.log10(threshold)) + 1, math.floor(math.log10(max(-low, high)))
    step = max(1, -(-(top - bottom + 1) // 4))
    sizes = [10.0**power for power in range(top, bottom - 1, -step)]
    ticks = [*(-size for size in sizes), 0.0, *reversed(sizes)]
    return [tick for tick in ticks if low <= tick <= high]


@dataclass(frozen=True)
class CurvePanel:
    """Curves with markers, each over its own x.

    The columns of a curve are its label with ``:x`` and ``:y``, and for a ``band`` with ``:low`` and ``:high``. If both
    axes are logarithmic, the legend has the slope at the smallest x above the plateau of round-off; markers on the
    plateau are open, and a dotted line is at its level. A cross at the lower edge marks a point without a value. The
    vertical scale ``symlog`` is linear up to ``threshold`` on both sides of zero and logarithmic beyond. On the scale
    ``log`` a value above ``ceiling``, as of a run that explodes, is an arrowhead at the upper edge.
    ``categories`` are the names of the values 0, 1, ... of x if they are not numbers. Curves in ``flat`` have no slope:
    their x is not what limits the error. With ``at_ends`` the names are at the ends of the curves, and a logarithmic x
    falls to the right.
    """

    labels: tuple[str, ...]
    xlabel: str
    ylabel: str
    xlog: bool = False
    yscale: str = LINEAR
    threshold: float = 0.0
    ceiling: float = np.inf
    band: bool = False
    categories: tuple[str, ...] = ()
    title: str = ""
    legend: str = ""
    flat: tuple[str, ...] = ()
    at_ends: bool = False

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves and, if there is more than one, a legend to their right into ``axes``."""
        axes.set_xscale(LOG if self.xlog else LINEAR)
        axes.set_yscale(self.yscale, **({"linthresh": self.threshold} if self.yscale == SYMLOG else {}))
        extra: dict[str, Any] = {}
        for i, (label, style) in enumerate(looks(self.labels, markers=True).items()):
            size = 4.6 - 1.8 * i / max(1, len(self.labels) - 1)  # so that markers at one place are seen
            self._curve(axes, data, label, {**style, "markersize": size}, extra)
        if self.yscale == SYMLOG:
            axes.set_yticks(symlog_ticks(self.threshold, *axes.get_ylim()))
        explained = f" ({self.legend})" if self.at_ends and self.legend else ""
        caption(axes, self.xlabel, self.ylabel, self.title + explained)
        if self.categories:
            axes.set_xlim(-0.5, len(self.categories) - 0.5)
            axes.set_xticks(
                range(len(self.categories)), self.categories, rotation=0 if len(self.categories) < 6 else 90
            )
        if self.at_ends:
            self._name_ends(axes)
        handles, texts = axes.get_legend_handles_labels()
        handles, texts = [*handles, *extra.values()], [*texts, *extra]
        if not texts or texts == [plain(display_name(self.labels[0]))]:
            return  # the vertical axis says what it is
        if self.at_ends:
            place: dict[str, Any] = {"loc": "outside lower center", "ncols": 4}
            axes.figure.legend(handles, texts, fontsize="small", **place)
            return
        axes.legend(
            handles,
            texts,
            title=self.legend or None,
            loc="upper left",
            bbox_to_anchor=(1.01, 1.02),
            fontsize="small",
        )

    def _name_ends(self, axes: Any) -> None:
        """Move the names of the curves from the legend to their ends; a logarithmic horizontal axis is turned round."""
        if self.xlog:
            axes.invert_xaxis()
        axes.autoscale_view()
        named = [line for line in axes.lines if line.get_label()[0] != "_" and len(line.get_xdata())]
        ends = []
        for line in named:
            last = int((np.argmin if self.xlog else np.argmax)(line.get_xdata()))
            ends.append((line.get_xdata()[last], line.get_ydata()[last], line.get_label(), line.get_color()))
            line.set_label(f"_{line.get_label()}")
        label_ends(axes, ends)

    def _curve(
        self, axes: Any, data: Mapping[str, np.ndarray], label: str, style: dict[str, Any], extra: dict[str, Any]
    ) -> None:
        """Draw one curve in colour and marker of ``style``; new entries of the legend are put into ``extra``."""
        from matplotlib.lines import Line2D

        x, y = data[curve_column(label, "x")], data[curve_column(label, "y")]
        missing = np.isfinite(x) & np.isnan(y)
        ylog = self.yscale == LOG
        drawn = np.isfinite(x) & np.isfinite(y) & (((y > 0.0) & (y <= self.ceiling)) | (not ylog))
        fitted = self.xlog and ylog and label not in self.flat
        found = convergence(x[drawn].tolist(), y[drawn].tolist()) if fitted else None
        shown = plain(display_name(label))
        text = shown if found is None or found.order is None else f"{shown}: {found.order:.2f}".replace(": -", ": −")
        hollow = drawn & (x <= found.onset) if found and found.onset is not None else np.zeros(len(x), dtype=bool)
        colour = style["color"]
        line = {"linestyle": "none"} if self.categories else {}
        if self.categories and len(self.labels) == 1:  # the vertical axis says what it is
            colour, text = CATEGORY, None
            line |= {"color": colour, "markersize": 5.0}
        axes.plot(x[drawn], y[drawn], label=text, gid=shown if text else None, **(style | line))
        if self.band:
            low, high = (data[curve_column(label, kind)][drawn] for kind in ("low", "high"))
            if ylog:
                low, high = np.maximum(low, np.finfo(float).tiny), np.minimum(high, self.ceiling)
            if self.categories:
                at, ends = y[drawn], np.array([y[drawn] - low, high - y[drawn]])
                axes.errorbar(x[drawn], at, ends, color=colour, fmt="none", elinewidth=0.9, capsize=2.0)
            else:
                axes.fill_between(x[drawn], low, high, color=colour, alpha=0.18, linewidth=0.0)
        if found and found.plateau is not None:
            ring = {"linestyle": "none", "markerfacecolor": "white", "zorder": 3}
            axes.plot(x[hollow], y[hollow], **(style | ring))
            span = [x[hollow].min(), x[hollow].max()]
            axes.plot(span, [found.plateau] * 2, linestyle=":", color=colour, linewidth=1.0)
            extra[PLATEAU] = Line2D([], [], linestyle=":", color="0.4", marker="o", mfc="white", markersize=3.5)
        edges = [(missing, 0.025, "x", NOTHING)]
        if ylog:
            edges.append((np.isfinite(x) & (y > self.ceiling), 0.975, "^", f"above {self.ceiling:g}"))
        for points, height, sign, name in edges:
            if points.any():
                at = {"transform": axes.get_xaxis_transform(), "clip_on": False, "zorder": 4}
                axes.plot(x[points], np.full(points.sum(), height), sign, color=colour, markersize=5.0, **at)
                extra[name] = Line2D([], [], linestyle="none", marker=sign, color="0.4", markersize=5.0)


@dataclass(frozen=True)
class KeyAxis:
    """Key along one side: its label, scale, and the names of the values 0, 1, ... if they are not numbers."""

    label: str
    log: bool = False
    categories: tuple[str, ...] = ()


def cell_edges(centres: Array, log: bool) -> Array:
    """Edges (m + 1,) of cells about the ascending ``centres`` (m,): their means, geometric ones on a log axis."""
    at = np.log(centres) if log else centres
    if len(at) == 1:
        half = 0.5
        edges = np.array([at[0] - half, at[0] + half])
    else:
        inner = 0.5 * (at[1:] + at[:-1])
        edges = np.concatenate([[2.0 * at[0] - inner[0]], inner, [2.0 * at[-1] - inner[-1]]])
    return np.exp(edges) if log else edges


@dataclass(frozen=True)
class HeatPanel:
    """Cells at the columns ``x`` and ``y`` coloured by the column ``value``.

    The colours are ``linear``, ``log``, or ``symlog`` beyond ``threshold``; values of both signs have two hues. A cell
    without a value has a cross; where there is no row, the ground stays white. Names along y run from top to bottom.
    """

    x: KeyAxis
    y: KeyAxis
    colour: str
    scale: str = LINEAR
    threshold: float = 0.0
    title: str = ""

    def _norm(self, cells: Any) -> Any:
        """Map of the values to colours: symmetric for values of both signs."""
        from matplotlib.colors import LogNorm, Normalize, SymLogNorm

        low, high = (float(cells.min()), float(cells.max())) if cells.count() else (0.0, 1.0)
        bound = max(-low, high)
        if self.scale == SYMLOG:
            return SymLogNorm(self.threshold, vmin=-bound, vmax=bound)
        if self.scale == LOG:
            return LogNorm(low, high)
        return Normalize(-bound, bound) if low < 0.0 < high else Normalize(low, high)

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the cells and the scale of colours into ``axes``."""
        x, y, value = (data[name] for name in ("x", "y", "value"))
        across, up = np.unique(x), np.unique(y)
        values = np.full((len(up), len(across)), np.nan)
        values[np.searchsorted(up, y), np.searchsorted(across, x)] = value
        cells = np.ma.masked_where(~(np.isfinite(values) & ((values > 0.0) | (self.scale != LOG))), values)
        norm = self._norm(cells)
        edges = cell_edges(across, self.x.log), cell_edges(up, self.y.log)
        axes.set(xscale="log" if self.x.log else "linear", yscale="log" if self.y.log else "linear")
        axes.grid(False)
        axes.tick_params(which="both", direction="out", top=False, right=False)  # the cells would cover them
        mesh = axes.pcolormesh(
            *edges, cells, norm=norm, cmap="RdBu_r" if norm.vmin == -norm.vmax else "viridis", shading="flat"
        )
        ticks = symlog_ticks(self.threshold, norm.vmin, norm.vmax) if self.scale == SYMLOG else None
        axes.figure.colorbar(mesh, ax=axes, label=self.colour, pad=0.02, ticks=ticks)
        missing = np.isnan(value) & np.isfinite(x)
        if missing.any():
            axes.plot(x[missing], y[missing], "x", color="0.35", markersize=6.0, label="no value")
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        for axis, side in ((self.x, "x"), (self.y, "y")):
            if axis.categories:
                turned = {"rotation": 90} if side == "x" and len(axis.categories) > 5 else {}
                getattr(axes, f"set_{side}ticks")(range(len(axis.categories)), axis.categories, **turned)
        axes.set_xlim(edges[0][0], edges[0][-1])
        axes.set_ylim(*(edges[1][[-1, 0]] if self.y.categories else edges[1][[0, -1]]))  # names from top to bottom
        caption(axes, self.x.label, self.y.label, self.title)
