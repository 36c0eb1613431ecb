"""Figures of the growth of round-off: of the catalogue, and of ``topcli roundoff``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.growth import GrowthPanel
from topcli.figures.picture import Grid
from topcli.studies.study import Result


@dataclass(frozen=True)
class GrowthFigure(Figure):
    """The growth of round-off under several ways to write a step, measured by ``studies.growth``."""

    panels: tuple[GrowthPanel, ...]
    layout: Grid = field(default_factory=Grid)

    def load(self, request: Request) -> Loaded:
        """Return the panels and the study that makes their columns."""
        from topcli.studies.growth import growth_code, growth_columns

        return Loaded(self.panels, growth_columns, {"study": growth_code()}, self.layout)


def growth_data(study: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], tuple[tuple[str, str], ...]]:
    """Columns of a study, and its lines with their labels; an invariant without drift at the end has no line."""
    forms = study["forms"]
    steps = np.array(forms[0]["invariants"][0]["steps"], dtype=float)
    data, lines = {"steps": steps}, []
    for i, first in enumerate(forms[0]["invariants"]):
        for form in forms:
            column = f"{first['name']}:{form['form']}"
            data[column] = np.array(form["invariants"][i]["rms"])
            lines.append((column, f"{first['symbol']}, {form['form']}" if len(forms) > 1 else first["symbol"]))
    return data, tuple(line for line in lines if data[line[0]][-1] > 0.0)


def loaded_roundoff(result: Result) -> Loaded:
    """The figure of ``topcli roundoff``; nothing is drawn if a run failed."""
    study = result.data
    data, lines = growth_data(study)
    panel = GrowthPanel(lines, f"{study['forms'][0]['scheme']}, $h = {study['h']:g}$")
    source = {key: study[key] for key in ("config", "steps", "copies")}
    completed = all(form["outcome"] == "completed" for form in study["forms"])
    return Loaded((panel,) if completed else (), lambda: data, source, Grid(figsize=(5.4, 3.2)))
