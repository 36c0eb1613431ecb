"""Results in memory: the trajectories of an experiment, of one or of many initial states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.tally import Tally, invariant_report, summary, tally_of, trajectory_columns
from topcli.analysis.verdict import InvariantRow
from topcli.contracts import Array, Ending, Outcome, Top
from topcli.engine.columns import ATTITUDES, column_names
from topcli.engine.endings import Endings
from topcli.engine.rows import Rows
from topcli.errors import UsageError, counted

if TYPE_CHECKING:
    import pandas as pd


class Trajectory:
    """Recorded states of B trajectories of one scheme, as returned by ``topcli.simulate``.

    ``trajectory[name]`` is the column called ``name``, shape (B, m). The name is ``n``, ``t``, a component of the
    state, an invariant of the top, a modified integral of the scheme, a quantity of ``output.quantities``, or a
    component of the attitude. ``trajectory[i]`` is a single trajectory, and ``len(trajectory)`` is the number of rows
    m. Of a single trajectory, as of a config without ``ensemble``, the batch axis is left out of all shapes.

    Attributes
    ----------
    scheme : str
        Name of the scheme.
    endings : Endings
        Outcome, last or failed step, and event counts of each trajectory; ``ending`` is that of a single one.
    last, last_n : ndarray, shapes (B, d) and (B,)
        State at step N or, of a trajectory that ended early, its last recorded one, and its step.
    seconds : mapping
        Wall times in seconds: ``compile`` for compiling or loading the machine code, and ``run`` for the steps.

    Examples
    --------
    >>> import topcli
    >>> trajectory = topcli.simulate("kowalevski_hk", h=0.01, N=1000)
    >>> trajectory
    <Trajectory of kowalevski under hk: 1001 rows, completed 1000 steps (t = 10)>
    >>> trajectory.states.shape, float(trajectory.t[-1]), trajectory["gamma1"].shape
    ((1001, 6), 10.0, (1001,))
    >>> print(trajectory.invariants().loc["energy", "statement"])
    undecided: covers half an oscillation of omega1; run T >= 40

    Many trajectories:

    >>> states = [[0.0, 0.0, 1.0, 0.6, 0.0, 0.8], [0.0, 1.0, 0.0, 0.6, 0.0, 0.8]]
    >>> many = topcli.simulate("kowalevski_hk", states=states, h=0.01, N=100)
    >>> many
    <2 trajectories of kowalevski under hk: 101 rows, 2 completed>
    >>> many.states.shape, many["energy"].shape, many[1].ending.step
    ((2, 101, 6), (2, 101), 100)
    """

    def __init__(
        self,
        rows: Rows,
        scheme: str,
        endings: Endings,
        last: Array,
        last_n: NDArray[np.int64],
        seconds: Mapping[str, Any],
        tallies: Sequence[Tally] = (),
        parts: tuple[Trajectory, ...] = (),
    ) -> None:
        self.rows, self.scheme, self.endings, self.last, self.last_n = rows, scheme, endings, last, last_n
        self.seconds, self.tallies, self._parts = seconds, tuple(tallies), parts

    @property
    def parts(self) -> tuple[Trajectory, ...]:
        """Parts of an ensemble whose tops differ, or which is large; otherwise this one alone."""
        return self._parts or (self,)

    @property
    def top(self) -> Top:
        """Top with its parameters; of an ensemble with several tops, the first one."""
        return self.rows.plan.top

    @property
    def h(self) -> float:
        """Step size, in units of time."""
        return self.rows.plan.h

    @property
    def n(self) -> NDArray[np.int64]:
        """Step numbers of the rows, shape (m,), or of the steps before the crossings of a section; the first is 0."""
        return self.rows.n if self.rows.n.dtype.kind == "i" else self.rows["n"]

    @property
    def t(self) -> Array:
        """Times of the rows or, for a Poincaré section, of its crossings, shape (m,)."""
        return self.rows.n * self.h

    @property
    def states(self) -> Array:
        """States in the order of ``top.components``, shape (B, m, d); nan after the end of a trajectory that failed.

        Those of a run in another precision are rounded to doubles.
        """
        return self.rows.states.astype(np.float64, copy=False)

    @property
    def initial(self) -> Array:
        """Initial states, shape (B, d)."""
        each = [part.rows.plan.states[:, : len(self.top.components)] for part in self.parts]
        return np.concatenate(each).astype(np.float64, copy=False) if self._many else each[0][0].astype(np.float64)

    @property
    def attitude(self) -> Array | None:
        """Unit quaternions, shape (m, 4), of the rotation from the body's frame to space, scalar part first.

        None unless the config has ``output.attitude``.
        """
        return self.rows.recorded[..., self.rows.states.shape[-1] :] if self.rows.plan.attitude else None

    @property
    def _many(self) -> bool:
        return self.rows.states.ndim == 3

    @property
    def ending(self) -> Ending:
        """Ending of a single trajectory."""
        return self.endings[0]

    @property
    def outcome(self) -> Outcome:
        """Outcome of a single trajectory."""
        return self.ending.outcome

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        what, ends = "Trajectory", self.ending.message
        if self._many:
            what = counted(len(self.endings), "trajectory")
            ends = ", ".join(f"{count} {outcome.value}" for outcome, count in self.endings.outcomes.items())
        return f"<{what} of {self.top.kind} under {self.scheme}: {counted(len(self), 'row')}, {ends}>"

    def __getitem__(self, name: Any) -> Any:
        """Column by name, shape (B, m), or trajectory by number. Raises UsageError or IndexError."""
        if isinstance(name, str):
            return self.rows[name] if len(self.parts) == 1 else np.concatenate([part.rows[name] for part in self.parts])
        number = range(len(self.endings))[name]
        if not len(self.rows):
            raise UsageError("the rows were not stored; use store: trajectories")
        starts = np.cumsum([0, *(len(part.endings) for part in self.parts)])
        at = int(np.searchsorted(starts, number, side="right")) - 1
        part, i = self.parts[at].rows, number - int(starts[at])
        alone, length = slice(i, i + 1), int(part.lengths[i])
        plan = replace(part.plan, states=part.plan.states[alone])
        rows, endings = Rows(plan, part.n[:length], part.recorded[i, :length]), self.endings.of([number])
        return Trajectory(rows, self.scheme, endings, self.last[number], self.last_n[number], self.seconds)

    def to_pandas(self) -> pd.DataFrame:
        """Return all columns as a DataFrame: n, t, the components, the invariants, the quantities, the attitude.

        That of many trajectories begins with a column ``trajectory``.
        """
        import pandas as pd

        plan = self.rows.plan
        names = column_names(plan.top, (each.name for each in plan.quantities), ATTITUDES.get(plan.attitude, ()))
        names = ["trajectory", *names] if self._many else names
        return pd.concat([pd.DataFrame(part.rows.columns(names)) for part in self.parts], ignore_index=True)

    def invariants(self) -> pd.DataFrame:
        """Return a DataFrame with one row per invariant and modified integral.

        A row holds the deviations, drift and verdict of a single trajectory; of many, quantiles of the deviations over
        the trajectories, and the number of those on which the invariant is constant to round-off.
        """
        import pandas as pd

        if not self._many:
            rows = [row.as_dict() for row in self.invariant_rows()]
            return pd.DataFrame(rows, columns=None if rows else ["name"]).set_index("name")
        tallies = self.tallies
        within = np.sum([tally.within_round_off.sum(axis=1) for tally in tallies], axis=0)
        judged = sum(int((tally.steps > 0).sum()) for tally in tallies)
        flat = []
        for row in summary(self.rows.plan, _joined([tally.columns() for tally in tallies]), within, judged):
            measures = {key: value for key, value in row.items() if isinstance(value, dict)}
            cells = {f"{measure}, {name}": x for measure, levels in measures.items() for name, x in levels.items()}
            flat.append({key: value for key, value in row.items() if key not in measures} | cells)
        return pd.DataFrame(flat).set_index("name")

    def invariant_rows(self) -> Sequence[InvariantRow]:
        """Return the report on a single trajectory, with one ``InvariantRow`` for each invariant of top and scheme."""
        rows, plan = self.rows, self.rows.plan
        if rows.n.dtype.kind == "f" and len(rows) > 1:  # crossings of a section
            span = float(self.t[-1] - self.t[0])
            numbers = np.arange(len(rows))
            return invariant_report(plan.top, plan.invariants, numbers, 1.0, self.states, int(self.last_n), span)[0]
        return tally_of(Rows(plan, rows.n, rows.recorded[None])).report() if len(rows) else []

    def trajectories(self) -> pd.DataFrame:
        """Return a DataFrame with one row for each of many trajectories.

        A row contains the parameters of the top that vary, the initial state, the outcome, the deviations and drifts of
        the invariants, and figures of the quantities.
        """
        import pandas as pd

        tops = [part.top for part in self.parts]
        varied = [name for name in type(tops[0]).model_fields if len({getattr(top, name) for top in tops}) > 1]
        tables = [
            trajectory_columns(tally, part.endings, varied)
            for part, tally in zip(self.parts, self.tallies, strict=True)
        ]
        return pd.DataFrame(_joined(tables)).set_index("trajectory")


def _joined(tables: Sequence[Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Columns of several tables below each other."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
