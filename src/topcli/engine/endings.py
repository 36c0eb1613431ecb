"""Endings of many trajectories as arrays of a few bytes each; an ``Ending`` is made on access."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Ending, Outcome

OUTCOMES = tuple(Outcome)
"""Outcomes in the order of their codes in ``Endings.outcome``."""
CODES = {outcome: code for code, outcome in enumerate(OUTCOMES)}
ARRAYS = ("outcome", "step", "counts", "begun", "left")
"""Arrays of ``Endings`` with a row for each trajectory."""
NO_FAILURE = (Outcome.COMPLETED, Outcome.INTERRUPTED)


class Endings(Sequence[Ending]):
    """Endings of ``count`` trajectories of step ``h``, each interrupted at step 0 until ``put`` replaces it.

    ``outcome`` (m,) holds codes, ``step`` (m,) step numbers, ``counts`` (m, counters) the events named in
    ``counters``; a trajectory that is not ``begun`` (m,) counted none. ``left`` (m,) are the first recorded steps at
    which the states were far off their energy surface, -1 for never.
    """

    def __init__(self, count: int, h: float, counters: Sequence[str] = ()) -> None:
        self.h, self.counters = h, tuple(counters)
        self.outcome: NDArray[np.int8] = np.full(count, CODES[Outcome.INTERRUPTED], dtype=np.int8)
        self.step: NDArray[np.int64] = np.zeros(count, dtype=np.int64)
        self.counts: NDArray[np.int64] = np.zeros((count, len(self.counters)), dtype=np.int64)
        self.begun: NDArray[np.bool_] = np.zeros(count, dtype=bool)
        self.left: NDArray[np.int64] = np.full(count, -1, dtype=np.int64)

    @classmethod
    def joined(cls, parts: Sequence[Endings]) -> Endings:
        """Endings of ``parts`` in their order; all have the same step and counters."""
        made = cls(0, parts[0].h, parts[0].counters)
        for name in ARRAYS:
            setattr(made, name, np.concatenate([getattr(part, name) for part in parts]))
        return made

    def put(self, where: Any, outcome: Outcome, step: int, counts: Any) -> None:
        """Store the ending of the trajectories at ``where`` (an index or several), with ``counts`` (m, counters)."""
        self.outcome[where], self.step[where] = CODES[outcome], step
        self.counts[where], self.begun[where] = counts, True

    def mark_left(self, left: NDArray[np.int64]) -> None:
        """Store ``left`` (m,); completed trajectories that left their motion get the outcome ``left_motion``."""
        self.left[:] = left
        completed = self.outcome == CODES[Outcome.COMPLETED]
        self.outcome[completed & (left >= 0)] = CODES[Outcome.LEFT_MOTION]

    def of(self, which: NDArray[np.int64]) -> Endings:
        """Endings of the trajectories numbered ``which`` (k,) alone."""
        made = Endings(0, self.h, self.counters)
        for name in ARRAYS:
            setattr(made, name, getattr(self, name)[which])
        return made

    @property
    def failed(self) -> NDArray[np.int64]:
        """Numbers of the trajectories that ended neither completed nor interrupted."""
        return np.flatnonzero(~np.isin(self.outcome, [CODES[outcome] for outcome in NO_FAILURE]))

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """Number of trajectories by outcome, for the outcomes that occur."""
        counts = np.bincount(self.outcome, minlength=len(OUTCOMES)).tolist()
        return {outcome: count for outcome, count in zip(OUTCOMES, counts, strict=True) if count}

    @property
    def totals(self) -> dict[str, int]:
        """Events counted over all trajectories; empty if none was begun."""
        if not self.begun.any():
            return {}
        return dict(zip(self.counters, self.counts.sum(axis=0).tolist(), strict=True))

    def __len__(self) -> int:
        return len(self.outcome)

    @overload
    def __getitem__(self, index: int) -> Ending: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Ending, ...]: ...

    def __getitem__(self, index: int | slice) -> Ending | tuple[Ending, ...]:
        if isinstance(index, slice):
            return tuple(self[i] for i in range(*index.indices(len(self))))
        step = int(self.step[index])
        counted = self.counts[index].tolist() if self.begun[index] else []
        counters = dict(zip(self.counters, counted, strict=False))
        ending = Ending(OUTCOMES[self.outcome[index]], step, step * self.h, counters)
        left = int(self.left[index])
        return ending if left < 0 else replace(ending, left=left, left_t=left * self.h)
