"""Rows of a long series that suffice to draw it: the smallest and largest values in each stretch of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from topcli.contracts import Array
from topcli.store.series import read_series, series_pieces

STRETCHES = 500
"""Stretches into which a long series is divided: more than a small picture has pixels across."""
PIECE = 1 << 17
"""Rows that are read together, about."""


def envelope(path: Path, names: Sequence[str], stretches: int = STRETCHES) -> dict[str, Array]:
    """Columns ``names`` at the rows that a picture needs, in order; all rows of a short series.

    Minima and maxima of every stretch and both ends are included. Raises RunError if the series is damaged.
    """
    size = -(-len(read_series(path, names[:1])[names[0]]) // stretches)
    if size <= 2 * len(names) + 2:  # the extremes would be about as many as the rows
        return read_series(path, names)
    pieces = [_extremes(piece, size) for piece in series_pieces(path, names, size * max(1, PIECE // size))]
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in names}


def _extremes(columns: Mapping[str, Array], size: int) -> dict[str, Array]:
    """Rows with the smallest or largest number of a column in each stretch of ``size`` rows, and the ends of these."""
    rows = len(next(iter(columns.values())))
    starts = np.arange(0, rows, size)
    needed = [starts, np.minimum(starts + size, rows) - 1]
    for values in columns.values():
        for filling, extreme in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            numbers = np.where(np.isnan(values), filling, values)
            padded = np.pad(numbers, (0, -rows % size), constant_values=filling)
            needed.append(np.minimum(starts + extreme(padded.reshape(-1, size), axis=1), rows - 1))
    chosen = np.unique(np.concatenate(needed))
    return {name: values[chosen] for name, values in columns.items()}
