"""The result of a run held in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import column_names, columns
from topcli.analysis.drift import invariant_report
from topcli.contracts import Array, Ending, Invariant, Outcome, Top

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Recorded states of one run.

    ``n`` (m,) are the step numbers, ``t = n*h`` exactly, ``states`` (m, d) in the order of
    ``top.components``; the initial state is the first row. Times in seconds are of this machine.
    """

    top: Top
    scheme: str
    h: float
    n: NDArray[np.int64]
    states: Array
    ending: Ending
    compile_seconds: float
    run_seconds: float
    modified: tuple[Invariant, ...] = ()
    """Integrals of the scheme itself, which depend on h."""

    @property
    def t(self) -> Array:
        """Times of the recorded states, shape (m,)."""
        return self.n * self.h

    @property
    def outcome(self) -> Outcome:
        """How the run ended."""
        return self.ending.outcome

    def __repr__(self) -> str:
        return f"<Trajectory of {self.top.kind} under {self.scheme}: {len(self)} rows, {self.ending.message}>"

    def __len__(self) -> int:
        return len(self.n)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column by name: ``n``, ``t``, a component, an invariant, or a modified integral of the scheme."""
        return columns(self.top, self.n, self.h, self.states, [name], self.modified)[name]

    def to_pandas(self) -> pd.DataFrame:
        """All columns as a DataFrame: n, t, the components, the invariants."""
        import pandas as pd

        return pd.DataFrame({name: self[name] for name in column_names(self.top)})

    def invariants(self) -> pd.DataFrame:
        """The report on invariants and modified integrals as a DataFrame, a row each (see ``analysis.drift``)."""
        import pandas as pd

        rows = invariant_report((*self.top.invariants(), *self.modified), self.n, self.h, self.states)
        return pd.DataFrame([row.as_dict() for row in rows]).set_index("name")
