"""Figure of the period of the paper's Figures 1 and 2: order, not time reversal, decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import Grid, Styles
from topcli.paper.swing_period import (
    EPS,
    EXACT,
    PAPER_STEP,
    SCHEMES,
    SHOWN,
    Scheme,
    motion_column,
    period_code,
    period_columns,
    spacing_law,
)

LAW = r"$2\sqrt{2}\,\ln(8\sqrt{7}/\epsilon)$"
MARKERS = "os^Dv"
ROW = 2.6
"""Distance between two rows, in units of gamma_1."""
TITLES = {"hk": "HK", "rk2": "RK2", "rk4": "RK4", "hybrid": "hybrid", "bohlin-a": "Bohlin A"}
ORDINALS = {1: "order 1", 2: "order 2", 4: "order 4"}


def _power(h: float) -> str:
    return rf"$h = 10^{{{round(np.log10(h))}}}$"


def _kind(scheme: Scheme) -> str:
    return f"{ORDINALS[scheme.order]}, {'reversible' if scheme.reversible else 'not reversible'}"


def _row_label(name: str, h: float) -> str:
    """Text at the left of a row."""
    if name == EXACT:
        return "motion\n(closed form)"
    scheme = next(one for one in SCHEMES if one.name == name)
    return f"{TITLES[name]}, {_power(h)}\n{_kind(scheme)}"


def _colours() -> dict[str, str]:
    import matplotlib as mpl

    cycle = [style["color"] for style in mpl.rcParams["axes.prop_cycle"]]
    order = ("hk", "bohlin-a", "rk2", "rk4", "hybrid")
    return {EXACT: "black", **dict(zip(order, cycle, strict=False))}


@dataclass(frozen=True)
class MotionRows:
    """Gamma_1 of the motion and of the schemes, one row each, with vertical lines at the swings of the motion."""

    title: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return ("t", "swings", *(motion_column(name, h) for name, h in SHOWN))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the rows into ``axes``, the first one at the top."""
        colours = _colours()
        heights = [-ROW * i for i in range(len(SHOWN))]
        for swing in data["swings"]:
            axes.axvline(float(swing), color="0.6", linewidth=0.9, linestyle="--", zorder=1.0)
        for height, (name, h) in zip(heights, SHOWN, strict=True):
            axes.plot(data["t"], data[motion_column(name, h)] + height, color=colours[name], linestyle="-")
        axes.set_xlim(0.0, float(data["t"][-1]))
        axes.set_ylim(heights[-1] - 1.4, 1.4)
        axes.set_yticks([height + 0.4 for height in heights], [_row_label(name, h) for name, h in SHOWN], fontsize=8.6)
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False)
        axes.set_xlabel("$t$")
        axes.set_title(self.title, loc="left")


@dataclass(frozen=True)
class SpacingOverStep:
    """Time between swings over h for each scheme, the law, and the distance eps to which each time belongs."""

    title: str

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return tuple(f"{kind}:{scheme.name}" for scheme in SCHEMES for kind in ("h", "spacing"))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the points, the law and the second scale into ``axes``."""
        colours = _colours()
        law = float(spacing_law(np.array(EPS)))
        axes.axhline(law, color="black", linewidth=1.0, linestyle="--", zorder=1.0)
        for scheme, marker in zip(SCHEMES, MARKERS, strict=True):
            h, spacing = data[f"h:{scheme.name}"], data[f"spacing:{scheme.name}"]
            hollow = {} if scheme.reversible else {"markerfacecolor": "white"}
            label = f"{TITLES[scheme.name]}: {_kind(scheme)}"
            axes.plot(h, spacing, "-", marker=marker, markersize=4.0, color=colours[scheme.name], label=label, **hollow)
        axes.axvline(PAPER_STEP, color="0.75", linewidth=0.9, linestyle=":", zorder=1.0)
        axes.text(PAPER_STEP * 1.15, 31.6, "the paper's $h$", fontsize=8, color="0.35", va="center")
        axes.text(1.3e-7, law + 0.35, LAW + r", $\epsilon = 10^{-3}$", fontsize=9, va="bottom")
        axes.annotate(
            "order 1:\n" + r"$\epsilon \propto \sqrt{h}$",
            (1e-5, 21.8),
            (-6, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=9,
            color=colours["bohlin-a"],
        )
        axes.set_xscale("log")
        axes.tick_params(axis="y", right=False)
        axes.set_ylim(8.0, 33.0)
        axes.set_xlabel("$h$")
        axes.set_ylabel("time between swings")
        axes.set_title(self.title, loc="left")
        axes.legend(loc="lower left", fontsize=8, handlelength=2.0)
        powers = (-1, -2, -3)
        scale = axes.secondary_yaxis("right")
        scale.set_yticks(spacing_law(10.0 ** np.array(powers)), [f"$10^{{{k}}}$" for k in powers])
        scale.set_ylabel(r"distance $\epsilon$ of a motion with this time, by the law")


@dataclass(frozen=True)
class PeriodFigure(Figure):
    """Motions of the paper's scene, and the time between swings over h."""

    layout: Grid = field(default_factory=Grid)

    def load(self, request: Request) -> Loaded:
        """Return the panels and the study that makes their columns."""
        panels = (
            MotionRows(r"(a) $\gamma_1$ of the paper's Figures 1 and 2"),
            SpacingOverStep("(b) the same scene, other steps"),
        )
        source = {"study": period_code()}
        return Loaded(panels, lambda: period_columns(request.on_progress), source, self.layout)
