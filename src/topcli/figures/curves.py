"""Panels of curves over a step size or another key, with observed slopes and the plateau of round-off."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.analysis.order import convergence
from topcli.figures.picture import REFERENCE, SharedLegend, Styles

LINEAR, LOG, SYMLOG = "linear", "log", "symlog"
MARKERS = "os^Dv<"
DASHES = ("-", "--", "-.", (0, (6, 1, 1, 1, 1, 1)))
"""Markers of successive curves, and dashes of successive rounds of markers: 24 curves differ without colour."""
NOTHING = "no value"
PLATEAU = "round-off"


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
    ``words`` are the names of the values 0, 1, ... of x if they are not numbers. ``guide`` is the label of one more
    curve, a law, drawn broad and grey behind the others. ``prefix`` distinguishes the columns of several panels. A
    panel that is not ``alone`` leaves its legend to the layout (``SlopeLegend``). Curves in ``flat`` have no slope:
    their x is not what limits the error.
    """

    labels: tuple[str, ...]
    xlabel: str
    ylabel: str
    xlog: bool = False
    yscale: str = LINEAR
    threshold: float = 0.0
    ceiling: float = np.inf
    band: bool = False
    words: tuple[str, ...] = ()
    title: str = ""
    legend: str = ""
    guide: str = ""
    prefix: str = ""
    alone: bool = True
    flat: tuple[str, ...] = ()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        kinds = ("x", "y", *(("low", "high") if self.band else ()))
        curves = [curve_column(label, kind) for label in self.labels for kind in kinds]
        guide = [curve_column(self.guide, kind) for kind in ("x", "y")] if self.guide else []
        return tuple(self.prefix + name for name in (*curves, *guide))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves and, if there is more than one, a legend to their right into ``axes``."""
        import matplotlib as mpl

        cycle = [style["color"] for style in mpl.rcParams["axes.prop_cycle"]]
        data = {name.removeprefix(self.prefix): data[name] for name in self.columns}
        axes.set_xscale(LOG if self.xlog else LINEAR)
        axes.set_yscale(self.yscale, **({"linthresh": self.threshold} if self.yscale == SYMLOG else {}))
        extra: dict[str, Any] = {}
        for i, label in enumerate(self.labels):
            size = 4.6 - 1.8 * i / max(1, len(self.labels) - 1)  # so that markers at one place are seen
            style = {"color": cycle[i % len(cycle)], "marker": MARKERS[i % len(MARKERS)], "markersize": size}
            style["linestyle"] = DASHES[i // len(MARKERS) % len(DASHES)]
            self._curve(axes, data, label, style, extra)
        if self.guide:
            law = [data[curve_column(self.guide, kind)] for kind in ("x", "y")]
            axes.plot(*law, **styles[REFERENCE], label=self.guide)
        if self.yscale == SYMLOG:
            axes.set_yticks(symlog_ticks(self.threshold, *axes.get_ylim()))
        axes.set_xlabel(self.xlabel)
        axes.set_ylabel(self.ylabel)
        axes.set_title(self.title, loc="left")
        if self.words:
            axes.set_xticks(range(len(self.words)), self.words, rotation=0 if len(self.words) < 6 else 90)
        if not self.alone:
            for name, handle in extra.items():
                handle.set_label(name)
                axes.add_line(handle)  # where the layout finds it
            return
        handles, texts = axes.get_legend_handles_labels()
        handles, texts = [*handles, *extra.values()], [*texts, *extra]
        if len(texts) == 1 and self.words:
            return  # the vertical axis says what it is
        rows = 22
        axes.legend(
            handles,
            texts,
            title=self.legend or None,
            loc="upper left",
            bbox_to_anchor=(1.01, 1.02),
            fontsize="small",
            ncols=-(-len(texts) // rows),
        )

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
        shown = plain(label)
        text = shown if found is None or found.order is None else f"{shown}: {found.order:.2f}"
        hollow = drawn & (x <= found.onset) if found and found.onset is not None else np.zeros(len(x), dtype=bool)
        colour = style["color"]
        line = {"linestyle": "none"} if self.words else {}
        axes.plot(x[drawn], y[drawn], label=text, gid=shown, **(style | line))
        if self.band:
            low, high = (data[curve_column(label, kind)][drawn] for kind in ("low", "high"))
            if ylog:
                low, high = np.maximum(low, np.finfo(float).tiny), np.minimum(high, self.ceiling)
            if self.words:
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
class SlopeLegend(SharedLegend):
    """One legend for several panels of curves: each name once, with its slopes in the panels that have any."""

    title: str = ""

    def annotate(self, figure: Any) -> None:
        """Add the legend."""
        handles: dict[str, Any] = {}
        slopes: dict[str, list[str]] = {}
        for axes in figure.axes:
            for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
                name = handle.get_gid() or text
                handles.setdefault(name, handle)
                slopes.setdefault(name, []).append(text.removeprefix(name).removeprefix(": ") or "–")
        texts = [name + (f": {', '.join(found)}" if set(found) != {"–"} else "") for name, found in slopes.items()]
        where: dict[str, Any] = {"loc": "outside lower center", "ncols": self.ncols, "fontsize": "small"}
        figure.legend(handles.values(), texts, title=self.title or None, title_fontsize="small", **where)
