"""Result of a run held in memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import ATTITUDES, attitude_columns, column_names, columns
from topcli.analysis.leaving import step_of_leaving
from topcli.analysis.tally import InvariantRow, invariant_report
from topcli.contracts import Array, Ending, Invariant, Outcome, Top
from topcli.engine.loop import Run

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Recorded states of one run, as ``topcli.simulate`` returns them.

    ``trajectory[name]`` is a column of shape (m,) by name: ``n``, ``t``, a component of the state, an invariant of the
    top, a modified integral of the scheme, or of the attitude. ``len(trajectory)`` is the number of rows m.

    Attributes
    ----------
    top : Top
        Top with its parameters.
    scheme : str
        Name of the scheme.
    h : float
        Step size, in units of time.
    n : ndarray of int64, shape (m,)
        Step numbers of the rows; the first row is the initial state.
    states : ndarray, shape (m, d)
        States in the order of ``top.components``.
    ending : Ending
        Outcome of the run, its last or failing step, and the counts of its events.
    compile_seconds, run_seconds, setup_seconds : float
        Wall time of compiling or loading the machine code, of the steps, and of the set-up of a closed form.
    modified : tuple of Invariant
        Integrals of the scheme itself, which depend on h.
    rows : tuple of InvariantRow or None
        Report on the invariants of a run in another precision than double, computed in that precision; ``states`` are
        rounded to doubles.
    attitude : ndarray, shape (m, 4), or None
        Unit quaternions, scalar part first, of the rotation from the body's frame to space; None unless
        ``output.attitude`` asks for them.
    attitude_form : str
        ``output.attitude``, empty without it. It decides on the columns of ``to_pandas``; ``trajectory[name]`` gives
        those of both forms.

    Examples
    --------
    >>> import topcli
    >>> trajectory = topcli.simulate("kowalevski_hk", h=0.01, N=1000)
    >>> trajectory
    <Trajectory of kowalevski under hk: 1001 rows, completed 1000 steps (t = 10)>
    >>> trajectory.states.shape, float(trajectory.t[-1]), trajectory["gamma1"].shape
    ((1001, 6), 10.0, (1001,))
    >>> trajectory.invariants().loc["energy", "verdict"]
    'bounded'
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
    rows: tuple[InvariantRow, ...] | None = None
    setup_seconds: float = 0.0
    attitude: Array | None = None
    attitude_form: str = ""

    @classmethod
    def of_run(cls, run: Run, scheme: str, modified: tuple[Invariant, ...] = (), attitude: str = "") -> Trajectory:
        """Carry out ``run`` and return its trajectory, with the step at which it left its energy surface.

        ``attitude`` is the form of the attitude, whose quaternions then follow the states of the run.
        """
        n, states, ending = run.collect()
        made: dict[str, Any] = {}
        if attitude:
            states, q = map(np.ascontiguousarray, np.split(states, [len(run.top.components)], axis=1))
            made = {"attitude": q, "attitude_form": attitude}
        ending = ending.with_left(step_of_leaving(run.top, n, states), run.h)
        seconds = run.compile_seconds, run.run_seconds
        ready = run.setup.seconds if run.setup else 0.0
        return cls(run.top, scheme, run.h, n, states, ending, *seconds, modified, setup_seconds=ready, **made)

    @property
    def t(self) -> Array:
        """Times ``n * h`` of the recorded states, shape (m,)."""
        return self.n * self.h

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return self.ending.outcome

    def __repr__(self) -> str:
        return f"<Trajectory of {self.top.kind} under {self.scheme}: {len(self)} rows, {self.ending.message}>"

    def __len__(self) -> int:
        return len(self.n)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Column by name, shape (m,). Raises UsageError for an unknown name."""
        attitude: dict[str, Array] = {}
        if self.attitude is not None:
            for form, names in ATTITUDES.items():
                attitude |= attitude_columns(form, self.attitude) if name in names else {}
        return columns(self.top, self.n, self.h, self.states, [name], self.modified, attitude)[name]

    def to_pandas(self) -> pd.DataFrame:
        """Return all columns as a DataFrame: n, t, the components, the invariants, the attitude."""
        import pandas as pd

        names = [*column_names(self.top), *ATTITUDES.get(self.attitude_form, ())]
        return pd.DataFrame({name: self[name] for name in names})

    def invariants(self) -> pd.DataFrame:
        """Return the report on invariants and modified integrals, one row each (see ``analysis.tally``)."""
        import pandas as pd

        return pd.DataFrame([row.as_dict() for row in self.invariant_rows()]).set_index("name")

    def invariant_rows(self) -> Sequence[InvariantRow]:
        """Return the report on invariants and modified integrals as rows, in the order of the columns."""
        if self.rows is not None:
            return self.rows
        return invariant_report((*self.top.invariants(), *self.modified), self.n, self.h, self.states)
