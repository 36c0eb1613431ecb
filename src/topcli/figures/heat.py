"""Panels of cells over two keys whose colours are the values of a measure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from topcli.contracts import Array
from topcli.figures.curves import LINEAR, LOG, SYMLOG, symlog_ticks
from topcli.figures.picture import Styles


@dataclass(frozen=True)
class Axis:
    """Key along one side: its label, scale, and the names of the values 0, 1, ... if they are not numbers."""

    label: str
    log: bool = False
    words: tuple[str, ...] = ()


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

    x: Axis
    y: Axis
    colour: str
    scale: str = LINEAR
    threshold: float = 0.0
    title: str = ""

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return ("x", "y", "value")

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
        x, y, value = (data[name] for name in self.columns)
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
            getattr(axes, f"set_{side}label")(axis.label)
            if axis.words:
                turned = {"rotation": 90} if side == "x" and len(axis.words) > 5 else {}
                getattr(axes, f"set_{side}ticks")(range(len(axis.words)), axis.words, **turned)
        axes.set_xlim(edges[0][0], edges[0][-1])
        axes.set_ylim(*(edges[1][[-1, 0]] if self.y.words else edges[1][[0, -1]]))  # names from top to bottom
        axes.set_title(self.title, loc="left")
