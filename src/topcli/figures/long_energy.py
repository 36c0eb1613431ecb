"""Figure of the energy of several schemes over a long time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.picture import Grid, Line, Panel, Styles


@dataclass(frozen=True)
class OctavePanel(Panel):
    """Panel with both axes logarithmic."""

    def paint(self, axes: Any, data: Mapping[str, np.ndarray], styles: Styles) -> None:
        """Draw the lines into ``axes``."""
        super().paint(axes, data, styles)
        axes.set_xscale("log")


@dataclass(frozen=True)
class LongEnergyFigure(Figure):
    """Energy errors of the schemes of ``studies.long_energy``, one panel per scene."""

    titles: tuple[tuple[str, str], ...]
    layout: Grid = field(default_factory=Grid)

    def load(self, request: Request) -> Loaded:
        """Return the panels and the study that makes their columns."""
        from topcli.studies.long_energy import SCHEMES, energy_code, energy_columns

        panels = tuple(
            OctavePanel(
                tuple(Line(f"{scene}:{name}", name) for name in SCHEMES[scene]),
                "energy error, relative",
                x=f"t:{scene}",
                log=True,
                title=title,
            )
            for scene, title in self.titles
        )
        return Loaded(panels, energy_columns, {"study": energy_code()}, self.layout)
