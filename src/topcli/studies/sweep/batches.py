"""Rows put together in batches: equal rows next to each other, each batch about a second of work."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

from topcli.config.sweep.rows import Row
from topcli.studies.sweep.evaluate import Shared

WINDOW = 1 << 14
"""Rows that are looked at together, to find those that can be stepped side by side."""
BATCH_STEPS = 1 << 25
"""Most steps of a batch, unless a single row has more."""
BATCH_ROWS = 1 << 10
PER_WORKER = 4
"""Batches into which a small sweep is divided for each worker."""


def batches(rows: Iterable[Row], workers: int) -> Iterator[list[Row]]:
    """Yield all rows in batches, for ``workers`` that evaluate them at the same time."""
    source = iter(rows)
    while window := list(itertools.islice(source, WINDOW)):
        steps = sum(row.N for row in window)
        limit = min(BATCH_STEPS, steps // (PER_WORKER * workers) + 1)
        groups: dict[Shared, list[Row]] = {}
        for row in window:
            groups.setdefault(Shared.of(row), []).append(row)
        yield from _packed(groups.values(), limit)


def _packed(groups: Iterable[list[Row]], limit: int) -> Iterator[list[Row]]:
    """Yield batches of at most ``limit`` steps, or of one row; a group is divided only if it is larger."""
    batch: list[Row] = []
    steps = 0
    for group in groups:
        size = max(1, min(BATCH_ROWS, limit // group[0].N))
        for start in range(0, len(group), size):
            piece = group[start : start + size]
            more = sum(row.N for row in piece)
            if batch and (steps + more > limit or len(batch) + len(piece) > BATCH_ROWS):
                yield batch
                batch, steps = [], 0
            batch += piece
            steps += more
    if batch:
        yield batch
