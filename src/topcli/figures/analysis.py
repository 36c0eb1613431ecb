"""Figure of ``topcli analyse``: error, swings and deviations of the invariants of a series."""

from __future__ import annotations

import numpy as np

from topcli.config.load import experiment_from
from topcli.errors import UsageError
from topcli.figures.contract import Loaded
from topcli.figures.picture import REFERENCE, Line, Panel, component_symbol
from topcli.studies.study import Result

SERIES = "series"
"""Label of the analysed series."""


def _data(analysis: Result) -> dict[str, np.ndarray]:
    """Columns of the figure; zeros of logarithmic panels become nan."""
    linear = ("t", "swing", "swing:reference")
    return {
        name: values if name in linear else np.where(values > 0.0, values, np.nan)
        for name, values in analysis.arrays.items()
    }


def loaded_analysis(analysis: Result) -> Loaded:
    """The figure of ``topcli analyse``, without lines that are zero throughout or need a missing reference.

    Raises UsageError for a stored result without its series.
    """
    if not analysis.arrays:
        raise UsageError("the series is not in this file")
    data, report = _data(analysis), analysis.data
    top = experiment_from(report["config"]).top
    swings = [Line("swing", SERIES)]
    panels = []
    if "error" in data:
        swings.insert(0, Line("swing:reference", REFERENCE))
        if np.isfinite(data["error"]).any():
            panels.append(Panel((Line("error", SERIES),), "error of the state", log=True))
    panels.append(Panel(tuple(swings), component_symbol(top.swing)))
    moving = [one for one in top.invariants() if np.isfinite(data[f"deviation:{one.name}"]).any()]
    if moving:
        lines = tuple(Line(f"deviation:{one.name}", f"${one.tex}$") for one in moving)
        panels.append(Panel(lines, "deviation of the invariants", log=True))
    return Loaded(tuple(panels), lambda: data, {key: report[key] for key in ("config", "file", "sha256")})
