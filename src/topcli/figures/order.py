"""Figures of errors over h: of the catalogue, and of ``topcli order``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from topcli.engine.fingerprint import fingerprint
from topcli.figures.contract import Figure, Loaded, Request
from topcli.figures.curves import LOG, CurvePanel, curve_column, plain
from topcli.figures.picture import Grid
from topcli.store.study import write_study
from topcli.studies.study import Result

CEILING = 1e3
"""Errors above this one, of step sizes at which a scheme explodes, are drawn at the upper edge."""


def order_data(study: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Columns of a study: step sizes and errors of each scheme; an error that is not finite is nan."""
    data = {}
    for row in study["schemes"]:
        for kind, key in (("x", "h"), ("y", "error")):
            values = [np.nan if one[key] is None else one[key] for one in row["points"]]
            data[curve_column(row["scheme"], kind)] = np.array(values, dtype=float)
    return data


def loaded_order(result: Result) -> Loaded:
    """The figure of a study of orders."""
    study = result.data
    labels = tuple(row["scheme"] for row in study["schemes"] if row["points"])
    span = rf"largest error, $0 \leq t \leq {study['duration']:g}$"
    panel = CurvePanel(
        labels, "$h$", span, True, LOG, ceiling=CEILING, title=plain(study["name"]), legend="scheme: order"
    )
    code = fingerprint(order_data, compiled=False)
    return Loaded(
        (panel,), lambda: order_data(study), {"study": result.source(), "code": code}, Grid(figsize=(6.4, 3.8))
    )


class OrderFigure(Figure):
    """The default study of ``topcli order``, run if it is missing, out of date or forced."""

    def load(self, request: Request) -> Loaded:
        """Return panel and data of the stored study. Raises UsageError and RunError."""
        from topcli.studies.order import FILE, ladders, order_source, order_study, stored_order

        what = ladders(())
        source = order_source(what)
        study = stored_order(request.results)
        if study is None or study.get("source") != source or request.force:
            study = order_study(what, request.on_progress)
            write_study(request.results / FILE, study, source)
        return loaded_order(Result(study, source=lambda: source))
