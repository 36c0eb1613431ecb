"""Times of several forms of a step as ratios against one of them: rows and their print, for all step benchmarks."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any


def quartiles(ratios: Sequence[float]) -> tuple[float, float, float]:
    """The quartiles of some ratios, or of one alone."""
    low, middle, high = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else [*ratios] * 3
    return low, middle, high


def ratio_rows(spent: Mapping[str, Sequence[float]], own: str) -> list[dict[str, Any]]:
    """For each form the median time, and the median and the quartiles of ``own``'s time over it, by repetitions."""
    rows = []
    for name, times in spent.items():
        low, middle, high = quartiles([a / b for a, b in zip(spent[own], times, strict=True)])
        rows.append({"form": name, "ns": statistics.median(times), "ratio": middle, "quartiles": [low, high]})
    return rows


def show_rows(rows: Sequence[dict[str, Any]]) -> None:
    """Print them as a table without its header."""
    for row in rows:
        low, high = row["quartiles"]
        print(f"  {row['form']:<26}{row['ns']:>9.2f}   {row['ratio']:.3f} ({low:.3f} to {high:.3f})")
