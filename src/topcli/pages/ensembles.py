"""Blocks of an ensemble: quantiles of the deviations, failures, and the distribution over the trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.figures.curves import LINEAR, LOG, CurvePanel, curve_column, plain
from topcli.pages.contents import Cells, Chapter, Notes, Picture, Pictures
from topcli.pages.series_pictures import positive
from topcli.pages.svg import svg_of
from topcli.runs.ensemble_report import ensemble_table
from topcli.store.series import read_series

MOST_POINTS = 60
"""Points of a curve of quantiles."""


def ensemble_blocks(chapter: Chapter, folder: Path, report: dict[str, Any], name: str | None) -> None:
    """Add the blocks of an ensemble, whose tables are in ``folder``; without a ``name`` no pictures."""
    chapter.attempt("invariants", lambda: _table(report))
    chapter.attempt("outcomes", lambda: _outcomes(report))
    if name:
        chapter.attempt("distribution", lambda: _distribution(folder, report, name))


def _table(report: dict[str, Any]) -> Cells:
    header, *lines = ensemble_table(report)
    return Cells("Conservation laws", header, lines, "Quantiles over the trajectories.")


def _outcomes(report: Mapping[str, Any]) -> Notes:
    counted = [
        f"{count} of {report['trajectories']} trajectories: {name}" for name, count in report["outcomes"].items()
    ]
    failed = [f"trajectory {one['trajectory']}: {one['outcome']} at step {one['step']}" for one in report["failures"]]
    counters = [f"counter {key.replace('_', ' ')}: {count}" for key, count in report["counters"].items()]
    return Notes("Outcomes", [*counted, *failed, *counters])


def quantile_curves(deviations: Mapping[str, Sequence[float]]) -> tuple[CurvePanel, dict[str, np.ndarray]]:
    """Panel and columns of the sorted deviations of each invariant over the fraction of trajectories below them."""
    data: dict[str, np.ndarray] = {}
    for label, values in deviations.items():
        known = np.sort(np.asarray(values, dtype=float))
        known = known[np.isfinite(known)]
        at = np.unique(np.linspace(0, len(known) - 1, min(MOST_POINTS, len(known))).astype(int))
        data[curve_column(label, "x")] = (at + 0.5) / max(len(known), 1)
        data[curve_column(label, "y")] = positive(known[at])
    panel = CurvePanel(tuple(deviations), "fraction of the trajectories", "max deviation", False, LOG)
    drawn = any(np.isfinite(values).any() for name, values in data.items() if name.endswith(":y"))
    return (panel if drawn else CurvePanel(tuple(deviations), panel.xlabel, panel.ylabel, False, LINEAR)), data


def stored_quantiles(folder: Path, report: Mapping[str, Any]) -> tuple[CurvePanel, dict[str, np.ndarray]]:
    """``quantile_curves`` of the ensemble in ``folder``. Raises RunError if its table is damaged."""
    path = next(iter(sorted(folder.glob("trajectories.*"))), folder / "trajectories.parquet")
    columns = {plain(str(row["symbol"])): f"{row['name']}_max_deviation" for row in report["invariants"]}
    table = read_series(path, list(columns.values()))
    return quantile_curves({symbol: table[column].tolist() for symbol, column in columns.items()})


def _distribution(folder: Path, report: Mapping[str, Any], name: str) -> Pictures:
    panel, data = stored_quantiles(folder, report)
    caption = "largest deviation of each invariant: the value that a given fraction of the trajectories stays below"
    return Pictures("Pictures", [Picture(svg_of(panel, data, f"{name}-quantiles", caption), caption)])
