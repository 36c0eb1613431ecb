"""Panels of the growth of round-off: drift against the number of steps, with guide lines for sqrt(N) and N."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.figures.picture import Styles

ULP = 2.0**-52
CROWDED = 8.0
"""If a curve is within this factor above a guide line, the line's label is put below."""
STYLES = {"plain": "-", "compensated": "--"}
MARKERS = "os^Dv<>"
LINE = 11.5
"""Distance of the lines of labels in points."""


@dataclass(frozen=True)
class GrowthPanel:
    """Drifts, columns named ``invariant:form`` with their labels, against the column ``steps``, logarithmically.

    Invariants differ in colour and forms in line style; if there is one invariant only, forms differ in colour. Labels
    are at the right ends of the lines. Grey guide lines, from a common point, grow as sqrt(N) with one ulp per step and
    as N.
    """

    lines: tuple[tuple[str, str], ...]
    title: str = ""
    steps: str = "steps"

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return (self.steps, *(column for column, _ in self.lines))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw curves, guide lines and labels into ``axes``."""
        from matplotlib.ticker import NullFormatter

        n = data[self.steps]
        alone = len({column.partition(":")[0] for column, _ in self.lines}) == 1
        colours: dict[str, str] = {}
        ends = []
        for i, (column, label) in enumerate(self.lines):
            name, _, form = column.partition(":")
            colour = colours.setdefault(column if alone else name, f"C{len(colours)}")
            drift = np.where(data[column] > 0.0, data[column], np.nan)  # a logarithmic axis has no zero
            look = {"linestyle": "-" if alone else STYLES[form], "marker": MARKERS[i % len(MARKERS)], "markersize": 3.0}
            axes.plot(n, drift, color=colour, **look)
            ends.append((float(drift[-1]), label, colour))
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xlim(float(n[0]) / 1.3, float(n[-1]) * 1.3)
        low, high = axes.get_ylim()
        corner = ULP * float(np.sqrt(n[0]))
        low, high = min(low, 0.6 * corner), max(high, 1.6 * ULP * float(np.sqrt(n[-1])))
        axes.set_ylim(low, high)
        self._guide(axes, data, corner, high)
        self._label(axes, ends, float(axes.get_xlim()[1]))
        axes.set_xlabel("number of steps $N$")
        axes.set_ylabel("drift over $N$ steps (rms)")
        axes.set_title(self.title, loc="left")

    def _guide(self, axes: Any, data: Mapping[str, np.ndarray], corner: float, high: float) -> None:
        """Draw the guide lines from ``corner``, labelled below ``high``."""
        from matplotlib.patheffects import withStroke

        n = data[self.steps]
        for power, label in ((0.5, r"$\epsilon\sqrt{N}$"), (1.0, r"$\propto N$")):
            axes.plot(n, corner * (n / n[0]) ** power, color="0.75", linestyle="-", linewidth=0.9, zorder=1.0)
            last = min(float(n[-1]), float(n[0]) * (0.35 * high / corner) ** (1.0 / power))
            at = (last, corner * (last / float(n[0])) ** power)
            near = int(np.argmin(np.abs(np.log(n / last))))
            crowded = any(1.0 < data[column][near] / at[1] < CROWDED for column, _ in self.lines)
            place: dict[str, Any] = {"xytext": (-2, -6), "va": "top"} if crowded else {"xytext": (-2, 3)}
            text = axes.annotate(label, at, textcoords="offset points", ha="right", color="0.5", **place)
            text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])

    def _label(self, axes: Any, ends: list[tuple[float, str, str]], x: float) -> None:
        """Label the lines at the right of the axes, moved apart if labels would overlap."""
        low, high = np.log(axes.get_ylim())
        gap = (high - low) * LINE / (72.0 * 0.72 * axes.figure.get_figheight())
        ends = sorted(ends, key=lambda end: end[0])
        places: list[float] = []
        for drift, _, _ in ends:
            places.append(max(float(np.log(drift)), places[-1] + gap if places else -np.inf))
        limit = float(high)
        for i in range(len(places) - 1, -1, -1):  # back below the upper edge
            places[i] = min(places[i], limit)
            limit = places[i] - gap
        style: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": "small"}
        for (_, label, colour), y in zip(ends, places, strict=True):
            axes.annotate(label, (x, np.exp(y)), xytext=(4, 0), color=colour, **style)
