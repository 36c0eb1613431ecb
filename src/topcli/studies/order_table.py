"""Tables of a study of orders: a line for each scheme, and the errors at each step size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from topcli.runs.report import number

HEADER = ("scheme", "order", "observed", "verdict", "fitted over h", "round-off", "from h", "smallest error", "at h")


def order_title(study: Mapping[str, Any]) -> str:
    """Title of the tables: the experiment, the top and the time."""
    return f"{study['name']}: {study['top']}, t from 0 to {study['duration']:g}"


def order_line(row: dict[str, Any]) -> list[str]:
    """Line of one scheme: declared and observed order, verdict, fitted step sizes, plateau, smallest error."""
    best = min((one for one in row["points"] if one["error"] is not None), key=lambda one: one["error"], default=None)
    fitted = f"{number(row['fitted'][0], 2)} to {number(row['fitted'][-1], 2)}" if row["fitted"] else "–"
    return [
        row["scheme"],
        "–" if row["declared_order"] is None else str(row["declared_order"]),
        "–" if row["order"] is None else f"{row['order']:.2f}",
        row["verdict"] or "–",
        fitted,
        number(row["plateau"], 2),
        number(row["onset"], 2),
        number(best and best["error"], 2),
        number(best and best["h"], 2),
    ]


def error_lines(schemes: list[dict[str, Any]]) -> list[list[str]]:
    """Lines of the table of errors: a step size, then a cell for each scheme; a dash where it was not run."""
    each = [{one["h"]: one["error"] for one in row["points"]} for row in schemes]
    lines = []
    for h in sorted({h for points in each for h in points}, reverse=True):
        cells = ["–" if h not in points else "nan" if points[h] is None else number(points[h], 2) for points in each]
        lines.append([f"{h:.4g}", *cells])
    return lines
