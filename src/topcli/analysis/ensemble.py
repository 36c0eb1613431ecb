"""The result of an ensemble held in memory."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import column_names, columns
from topcli.analysis.many import EnsembleSummary, ManyTally
from topcli.analysis.trajectory import Trajectory
from topcli.contracts import Array, Invariant, Outcome, Top
from topcli.engine.endings import Endings

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Ensemble:
    """Many trajectories of one scheme.

    ``n`` (m,) are the recorded step numbers, ``t = n*h`` exactly, and ``states`` (trajectories, m, d), nan from where
    a trajectory ended early; m is 0 when the rows were not stored. ``initial`` and ``last`` (trajectories, d) are
    there always: ``last`` is the state at step N, or the last recorded one of a trajectory that ended early, at step
    ``last_n``. ``endings`` says how each ended, ``tops`` under which parameters it ran. Seconds are of this machine.
    """

    tops: tuple[Top, ...]
    scheme: str
    h: float
    n: NDArray[np.int64]
    states: Array
    initial: Array
    last: Array
    last_n: NDArray[np.int64]
    endings: Endings
    tallies: tuple[ManyTally, ...]
    table: dict[str, NDArray[Any]]
    modified: tuple[tuple[Invariant, ...], ...]
    """The integrals of the scheme itself, for each trajectory."""
    compile_seconds: float
    run_seconds: float

    @property
    def t(self) -> Array:
        """Times of the recorded states, shape (m,)."""
        return self.n * self.h

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """How many trajectories ended in which way."""
        return self.endings.outcomes

    def __len__(self) -> int:
        return len(self.endings)

    def __repr__(self) -> str:
        told = ", ".join(f"{count} {outcome.value}" for outcome, count in self.outcomes.items())
        return f"<Ensemble of {len(self)} under {self.scheme}: {len(self.n)} rows each, {told}>"

    def _kept(self, index: int) -> int:
        """The rows of trajectory ``index``."""
        return int(np.count_nonzero(self.n <= self.last_n[index]))

    def trajectory(self, index: int) -> Trajectory:
        """Trajectory ``index`` by itself. Raises IndexError, and ValueError when the rows were not stored."""
        if not len(self.n):
            raise ValueError("the rows were not stored; run with store='trajectories'")
        index = range(len(self))[index]
        kept = self._kept(index)
        return Trajectory(
            top=self.tops[index],
            scheme=self.scheme,
            h=self.h,
            n=self.n[:kept],
            states=self.states[index, :kept],
            ending=self.endings[index],
            compile_seconds=self.compile_seconds,
            run_seconds=self.run_seconds / len(self),
            modified=self.modified[index],
        )

    def __getitem__(self, name: str) -> Array:
        """A column by name (trajectories, m): a component, an invariant, or a modified integral of the scheme."""
        made = np.empty(self.states.shape[:2])
        for i, (top, modified) in enumerate(zip(self.tops, self.modified, strict=True)):
            made[i] = columns(top, self.n, self.h, self.states[i], [name], modified)[name]
        return made

    def trajectories(self) -> pd.DataFrame:
        """A row for each trajectory: what varies, initial state, outcome, and the deviations of its invariants."""
        import pandas as pd

        return pd.DataFrame(self.table).set_index("trajectory")

    def invariants(self) -> pd.DataFrame:
        """A row for each invariant: quantiles of its deviations over the trajectories, and how many are exact."""
        import pandas as pd

        summary = EnsembleSummary(io.BytesIO())
        for tally in self.tallies:
            summary.add(tally)
        rows = []
        for row in summary.rows():
            measures = {key: value for key, value in row.items() if isinstance(value, dict)}
            flat = {key: value for key, value in row.items() if key not in measures}
            rows.append(
                flat | {f"{measure}, {name}": x for measure, found in measures.items() for name, x in found.items()}
            )
        return pd.DataFrame(rows).set_index("name")

    def to_pandas(self) -> pd.DataFrame:
        """All recorded rows as a DataFrame: trajectory, n, t, the components, the invariants."""
        import pandas as pd

        frames: Sequence[pd.DataFrame] = [
            pd.DataFrame({"trajectory": i, **{name: one[name] for name in column_names(one.top)}})
            for i, one in enumerate(map(self.trajectory, range(len(self))))
        ]
        return pd.concat(frames, ignore_index=True)
