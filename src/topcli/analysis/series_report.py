"""Report on rows held in memory: of a series with steps, and of one at uneven times, which has no drift."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.tally import Tally
from topcli.analysis.verdict import NEEDS_EVEN_TIMES, InvariantRow
from topcli.contracts import Array, Invariant, Top
from topcli.engine.consumers import EnergyWatch
from topcli.engine.rows import Plan, Rows


def series_rows(top: Top, invariants: Sequence[Invariant], n: NDArray[np.int64], h: float, states: Array) -> Rows:
    """Rows (1, m, d) of one trajectory in memory, after ``n`` (m,) steps of ``h`` in a row, with ``invariants``."""
    every = int(n[1] - n[0]) if len(n) > 1 else 1
    plan = Plan(top, None, states[:1], h, int(n[-1]) if len(n) else 0, every, invariants=tuple(invariants))
    return Rows(plan, n, states[None])


def invariant_report(
    top: Top,
    invariants: Sequence[Invariant],
    n: NDArray[np.int64],
    h: float,
    states: Array,
    steps: int | None = None,
    uneven_span: float | None = None,
) -> tuple[list[InvariantRow], int | None]:
    """Report on rows in memory, and the one of ``n`` at which they left their energy surface; None for never.

    ``steps`` of the method lie behind the rows, for the round-off bound, by default the last of ``n``. Rows at uneven
    times, which take the time ``uneven_span``, have no drift.
    """
    rows, even = series_rows(top, invariants, n, h, states), uneven_span is None
    tally, watch = Tally(drifts=even, judged=even), EnergyWatch()
    for consumer in (tally, watch):
        consumer.begin(rows.plan)
        consumer.add(rows)
    left, last = int(watch.left[0]), int(n[-1]) if steps is None else steps
    if uneven_span is None:
        report = tally.report(last)
    else:
        report = [tally.row(i, None, NEEDS_EVEN_TIMES, last, uneven_span) for i in range(len(tally.names))]
    return report, None if left < 0 else left
