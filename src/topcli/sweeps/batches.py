"""Rows put together in batches: equal rows next to each other, each batch about a second of work."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

from topcli.config.rows import Row
from topcli.sweeps.evaluate import Shared

WINDOW = 1 << 14
"""Rows that are looked at together, to find those that can be stepped side by side."""
BATCH_STEPS = 1 << 25
"""Most steps of a batch, unless a single row has more."""
BATCH_ROWS = 1 << 10
PER_WORKER = 4
"""Batches into which a small sweep is divided for each worker."""


def batches(rows: Iterable[Row], workers: int, scale: int = 1) -> Iterator[list[Row]]:
    """Yield all rows in batches of ``scale`` times the usual size, for ``workers`` that evaluate them side by side."""
    source = iter(rows)
    while window := list(itertools.islice(source, WINDOW)):
        steps = sum(row.N for row in window)
        limit = min(scale * BATCH_STEPS, steps // (PER_WORKER * workers) + 1)
        groups: dict[Shared, list[Row]] = {}
        for row in window:
            groups.setdefault(Shared.of(row), []).append(row)
        yield from _packed(groups.values(), limit, scale * BATCH_ROWS)


def _packed(groups: Iterable[list[Row]], limit: int, most: int) -> Iterator[list[Row]]:
    """Yield batches of at most ``limit`` steps and ``most`` rows, or of one row; only larger groups are divided."""
    batch: list[Row] = []
    steps = 0
    for group in groups:
        size = max(1, min(most, limit // group[0].N))
        for start in range(0, len(group), size):
            piece = group[start : start + size]
            more = sum(row.N for row in piece)
            if batch and (steps + more > limit or len(batch) + len(piece) > most):
                yield batch
                batch, steps = [], 0
            batch += piece
            steps += more
    if batch:
        yield batch
