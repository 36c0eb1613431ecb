"""Endings of the trajectories of a batch: arrays of a few bytes each; an ``Ending`` is made on access."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Ending, Outcome

OUTCOMES = tuple(Outcome)
"""Outcomes in the order of their codes."""
CODES = {outcome: code for code, outcome in enumerate(OUTCOMES)}
ARRAYS = ("outcome", "step", "counts", "left")


@dataclass
class Endings:
    """Endings of B trajectories with steps of ``h``; before they end they count as interrupted at step 0.

    Attributes
    ----------
    counters : tuple of str
        Names of the events that the scheme counts.
    outcome : ndarray of int8, shape (B,)
        Codes of the outcomes, the places in ``OUTCOMES``.
    step : ndarray of int64, shape (B,)
        Last step taken, or the failed one.
    counts : ndarray of int64, shape (B, counters)
        Events counted.
    left : ndarray of int64, shape (B,)
        First recorded step that is far off the energy surface; -1 for never.
    """

    h: float
    counters: tuple[str, ...]
    outcome: NDArray[np.int8]
    step: NDArray[np.int64]
    counts: NDArray[np.int64]
    left: NDArray[np.int64]

    @classmethod
    def of_none(cls, count: int, h: float, counters: Sequence[str] = ()) -> Endings:
        """Endings of ``count`` trajectories that have not begun."""
        zeros = np.zeros(count, dtype=np.int64)
        outcome = np.full(count, CODES[Outcome.INTERRUPTED], dtype=np.int8)
        return cls(h, tuple(counters), outcome, zeros, np.zeros((count, len(counters)), dtype=np.int64), zeros - 1)

    @classmethod
    def joined(cls, parts: Sequence[Endings]) -> Endings:
        """Endings of several batches in a row; all have the same step and counters."""
        arrays = [np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS]
        return cls(parts[0].h, parts[0].counters, *arrays)

    def put(self, which: Any, outcome: Outcome, step: Any, counts: Any) -> None:
        """Store the ending of the trajectories ``which``, an index or several."""
        self.outcome[which], self.step[which], self.counts[which] = CODES[outcome], step, counts

    def mark_left(self, left: NDArray[np.int64]) -> None:
        """Store the steps ``left`` (B,); a completed trajectory that left its motion ends as ``left_motion``."""
        self.left[:] = left
        self.outcome[self.is_(Outcome.COMPLETED) & (left >= 0)] = CODES[Outcome.LEFT_MOTION]

    def is_(self, *outcomes: Outcome) -> NDArray[np.bool_]:
        """True (B,) for the trajectories with one of these outcomes."""
        return np.isin(self.outcome, [CODES[outcome] for outcome in outcomes])

    @property
    def failed(self) -> NDArray[np.int64]:
        """Numbers of the trajectories that ended neither completed nor interrupted."""
        return np.flatnonzero(~self.is_(Outcome.COMPLETED, Outcome.INTERRUPTED))

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """Number of trajectories by outcome, for the outcomes that occur."""
        counts = np.bincount(self.outcome, minlength=len(OUTCOMES)).tolist()
        return {outcome: count for outcome, count in zip(OUTCOMES, counts, strict=True) if count}

    @property
    def totals(self) -> dict[str, int]:
        """Events counted over all trajectories."""
        return dict(zip(self.counters, self.counts.sum(axis=0).tolist(), strict=True))

    def of(self, which: Any) -> Endings:
        """Endings of several trajectories, a slice or an array of numbers."""
        return replace(self, **{name: getattr(self, name)[which] for name in ARRAYS})

    def __len__(self) -> int:
        return len(self.outcome)

    def __iter__(self) -> Iterator[Ending]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, index: int) -> Ending:
        i = range(len(self))[index]
        step, left, h = int(self.step[i]), int(self.left[i]), self.h
        counters = dict(zip(self.counters, self.counts[i].tolist(), strict=True))
        where = (None, None) if left < 0 else (left, left * h)
        return Ending(OUTCOMES[self.outcome[i]], step, step * h, counters, *where)
