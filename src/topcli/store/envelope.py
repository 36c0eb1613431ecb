"""Rows of a long series that suffice to draw it: the smallest and largest values in each stretch of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array
from topcli.store.series import series_length, series_pieces

STRETCHES = 500
"""Stretches into which a long series is divided: more than a small picture has pixels across."""


def envelope(path: Path, names: Sequence[str], stretches: int = STRETCHES) -> dict[str, Array]:
    """Columns ``names`` at the rows that a picture needs, in order; all rows of a short series.

    Minima and maxima of every stretch and both ends are kept. Memory does not grow with the number of rows. Raises
    RunError if the series is damaged.
    """
    size = _stretch(series_length(path), len(names), stretches)
    kept: list[Mapping[str, Array]] = []
    rest: Mapping[str, Array] = {name: np.empty(0) for name in names}
    for piece in series_pieces(path, names):
        rows = {name: np.append(rest[name], piece[name]) for name in names}
        whole = len(rows[names[0]]) // size * size
        kept.append(_extremes({name: values[:whole] for name, values in rows.items()}, size))
        rest = {name: values[whole:] for name, values in rows.items()}
    kept.append(_extremes(rest, size))
    return {name: np.concatenate([piece[name] for piece in kept]) for name in names}


def _stretch(rows: int, columns: int, stretches: int) -> int:
    """Rows of a stretch; 1 if its extremes would be about as many as its rows."""
    size = -(-rows // stretches)
    return size if size > 2 * columns + 2 else 1


def _extremes(columns: Mapping[str, Array], size: int) -> Mapping[str, Array]:
    """Rows with the smallest or largest number of a column in each stretch of ``size`` rows, and the ends of these.

    The number of rows is a multiple of ``size``, or smaller than it.
    """
    rows = len(next(iter(columns.values())))
    if size == 1 or not rows:
        return columns
    size = min(size, rows)
    starts = np.arange(0, rows, size)
    needed: list[NDArray[np.int64]] = [starts, starts + size - 1]
    for values in columns.values():
        stretches = values.reshape(-1, size)
        missing = np.isnan(stretches)
        needed.append(starts + np.where(missing, np.inf, stretches).argmin(axis=1))
        needed.append(starts + np.where(missing, -np.inf, stretches).argmax(axis=1))
    kept = np.unique(np.concatenate(needed))
    return {name: values[kept] for name, values in columns.items()}
