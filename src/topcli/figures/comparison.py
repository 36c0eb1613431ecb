"""The picture of a comparison: errors and swings of the schemes over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from topcli.figures.make import write_figure
from topcli.figures.picture import REFERENCE, Line, Panel, component_symbol
from topcli.studies.compare import Comparison


def draw_comparison(comparison: Comparison, name: str, out: Path) -> tuple[Path, ...]:
    """Write ``<name>.png``, ``.pdf`` and ``.parquet`` into ``out``: errors (left) and the swinging component (right).

    Raises RunError when they cannot be written.
    """
    schemes = [scheme["scheme"] for scheme in comparison.figures["schemes"]]
    component = comparison.figures["reference"]["swing"]
    data = dict(comparison.series)
    for scheme in schemes:
        error = data[f"error:{scheme}"]
        data[f"error:{scheme}"] = np.where(error > 0.0, error, np.nan)  # a logarithmic axis has no zero
    panels = (
        Panel(tuple(Line(f"error:{scheme}", scheme) for scheme in schemes), "error of the state", log=True),
        Panel(tuple(Line(f"swing:{scheme}", scheme) for scheme in (REFERENCE, *schemes)), component_symbol(component)),
    )
    return write_figure(name, panels, data, out)
