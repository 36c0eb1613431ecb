"""Figure of errors over the step size and over time: the integrable map of the Kowalevski top among other schemes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import Grid, Styles

LARGEST = 3.0
"""Largest error that is drawn: the size of the state."""
FAMILY_COLOUR = "#0072B2"
LOOKS: dict[str, tuple[str, str, str]] = {
    "hybrid": ("#CC79A7", "v", ":"),
    "hk": ("#D55E00", "s", "--"),
    "midpoint4": ("#009E73", "D", "-."),
    "splitting": ("#E69F00", "^", (0, (5, 1))),  # type: ignore[dict-item]
    "backlund": (FAMILY_COLOUR, "o", "-"),
    "backlund+suzuki4": (FAMILY_COLOUR, "P", "-"),
    "backlund+kahan-li6": (FAMILY_COLOUR, "X", "-"),
    "backlund+kahan-li8": (FAMILY_COLOUR, "*", "-"),
    "backlund:nodes=exact": ("black", "o", "none"),
}
"""Colour, marker and line of each scheme; the integrable map and its compositions share a colour."""
NAMES = {
    "backlund": "backlund, order 2",
    "backlund+suzuki4": "backlund, order 4",
    "backlund+kahan-li6": "backlund, order 6",
    "backlund+kahan-li8": "backlund, order 8",
    "backlund:nodes=exact": "backlund, exact nodes",
}
ABSCISSAE = {"h": "step $h$", "time": "CPU time per unit of time, µs"}


def column_name(scheme: str, kind: str) -> str:
    """Name of a column: ``kind`` is ``h``, ``error``, or ``time`` in microseconds per unit of simulated time."""
    return f"{scheme}:{kind}"


@dataclass(frozen=True)
class ErrorPanel:
    """Errors of the ``schemes`` over the columns of a kind, both logarithmic; with ``keys`` the legend is beside."""

    schemes: tuple[str, ...]
    kind: str
    title: str
    keys: bool = False

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns that the panel draws."""
        return tuple(column_name(scheme, kind) for scheme in self.schemes for kind in (self.kind, "error"))

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the curves into ``axes``."""
        axes.set(xscale="log", yscale="log")
        for scheme in self.schemes:
            x, y = data[column_name(scheme, self.kind)], data[column_name(scheme, "error")]
            shown = np.isfinite(x) & (y > 0.0) & (y <= LARGEST)
            colour, marker, line = LOOKS[scheme]
            style: dict[str, Any] = {
                "color": colour,
                "marker": marker,
                "linestyle": line,
                "markersize": 5.0 if line == "none" else 3.5,
            }
            axes.plot(x[shown], y[shown], label=NAMES.get(scheme, scheme), lw=1.0, mew=0.4, **style)
        axes.set_ylim(top=2.0 * LARGEST)
        axes.set_xlabel(ABSCISSAE[self.kind])
        axes.set_ylabel("largest error")
        axes.set_title(self.title, loc="left")
        if self.keys:
            axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.02), fontsize=8.5, borderaxespad=0.0)


class ErrorAndCostFigure(Figure):
    """The study of errors and times, measured if it is missing, out of date or forced."""

    rank: ClassVar[int] = 1

    def load(self, request: Request) -> Loaded:
        """Return panels and data of the stored study. Raises RunError."""
        from topcli.studies.error_and_cost import current_study

        study, source = current_study(request.results, request.force, request.on_progress)
        return loaded_study(study, source)


def loaded_study(study: Mapping[str, Any], source: str) -> Loaded:
    """The figure of a study."""
    data = {}
    for row in study["schemes"]:
        for kind, key, factor in (("h", "h", 1.0), ("time", "seconds", 1e6), ("error", "error", 1.0)):
            values = [np.nan if one[key] is None else factor * one[key] for one in row["points"]]
            data[column_name(row["scheme"], kind)] = np.array(values, dtype=float)
    schemes = tuple(row["scheme"] for row in study["schemes"] if row["points"])
    span = rf"$0 \leq t \leq {study['duration']:g}$"
    panels = (
        ErrorPanel(schemes, "h", f"(a) over the step, {span}"),
        ErrorPanel(schemes, "time", f"(b) over the time it takes, {span}", keys=True),
    )
    measured = [[row["scheme"], [one["seconds"] for one in row["points"]]] for row in study["schemes"]]
    return Loaded(panels, lambda: data, {"study": source, "measured": measured}, Grid(figsize=(7.0, 3.1)))
