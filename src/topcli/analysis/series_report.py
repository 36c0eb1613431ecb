"""Report on rows held in memory: of a series with steps, and of one at uneven times, which has no drift."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.tally import Tally, tally_of
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
    top: Top, invariants: Sequence[Invariant], n: NDArray[np.int64], h: float, states: Array, steps: int | None = None
) -> tuple[list[InvariantRow], int | None]:
    """Report on rows in memory, and the step at which they left their energy surface; None for never.

    ``steps`` of the method lie behind the rows, for the round-off bound, by default the last of ``n``.
    """
    rows, watch = series_rows(top, invariants, n, h, states), EnergyWatch()
    watch.begin(rows.plan)
    watch.add(rows)
    return tally_of(rows).report(steps), None if watch.left[0] < 0 else int(watch.left[0])


def uneven_report(
    top: Top, invariants: Sequence[Invariant], states: Array, steps: int, span: float
) -> tuple[list[InvariantRow], int | None]:
    """Report on rows at uneven times, with ``states`` (m, d): deviations, and no drift.

    ``steps`` of the method lie behind the rows, for the round-off bound, in the time ``span``. The second result is the
    index of the first row that has left the energy surface of the first one; None for none.
    """
    rows = series_rows(top, invariants, np.arange(len(states)), 1.0, states)
    tally, watch = Tally(drifts=False), EnergyWatch()
    for consumer in (tally, watch):
        consumer.begin(rows.plan)
        consumer.add(rows)
    report = [tally.row(i, None, NEEDS_EVEN_TIMES, steps, span) for i in range(len(tally.names))]
    return report, None if watch.left[0] < 0 else int(watch.left[0])
