"""Figure of ``topcli order``: errors against the step size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from topcli.figures.curves import LOG, CurvePanel, curve_column, plain
from topcli.figures.figure import Loaded, study_digest
from topcli.figures.picture import Grid
from topcli.studies.study import Result

CEILING = 1e3
"""Errors above this one, of step sizes at which a scheme explodes, are drawn at the upper edge."""


def order_data(study: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Columns of a study: step sizes and errors of each scheme; an error that is not finite is nan."""
    data = {}
    for row in study["schemes"]:
        for kind, key in (("x", "h"), ("y", "error")):
            data[curve_column(row["scheme"], kind)] = np.array([point[key] for point in row["points"]], dtype=float)
    return data


def loaded_order(result: Result) -> Loaded:
    """The figure of a study of orders."""
    study = result.data
    labels = tuple(row["scheme"] for row in study["schemes"] if row["points"])
    span = rf"largest error, $0 \leq t \leq {study['duration']:g}$"
    panel = CurvePanel(
        labels,
        "step size $h$",
        span,
        True,
        LOG,
        ceiling=CEILING,
        title=plain(f"{study['top'].partition(' (')[0]} ({study['name']})"),
        legend="scheme: order",
    )
    source = {"study": study_digest(study)}
    return Loaded((panel,), lambda: order_data(study), source, Grid(figsize=(6.4, 3.8)))
