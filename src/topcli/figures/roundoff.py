"""The picture of ``topcli roundoff``: how the round-off of a scheme's invariants grows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from topcli.figures.growth import GrowthPanel
from topcli.figures.make import write_figure


def growth_data(study: Mapping[str, Any]) -> tuple[dict[str, np.ndarray], tuple[tuple[str, str], ...]]:
    """The columns of a study, and its lines with their labels; what has not changed by the end has no line."""
    forms = study["forms"]
    steps = np.array(forms[0]["invariants"][0]["steps"], dtype=float)
    data, lines = {"steps": steps}, []
    for i, first in enumerate(forms[0]["invariants"]):
        for form in forms:
            column = f"{first['name']}:{form['form']}"
            data[column] = np.array(form["invariants"][i]["rms"])
            lines.append((column, f"{first['symbol']}, {form['form']}" if len(forms) > 1 else first["symbol"]))
    return data, tuple(line for line in lines if data[line[0]][-1] > 0.0)


def draw_roundoff(study: Mapping[str, Any], name: str, out: Path) -> tuple[Path, ...]:
    """Write ``<name>.png``, ``.pdf`` and ``.parquet`` into ``out``; the paths. Raises RunError when it cannot."""
    data, lines = growth_data(study)
    title = f"{study['forms'][0]['scheme']}, $h = {study['h']:g}$"
    return write_figure(name, (GrowthPanel(lines, title),), data, out)
