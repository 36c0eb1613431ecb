"""Results held in memory: the trajectory of a run, and the trajectories of an ensemble."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.columns import ATTITUDES, attitude_columns, column_names, columns
from topcli.analysis.crossings import CrossingSearch
from topcli.analysis.leaving import step_of_leaving
from topcli.analysis.quantities import Quantity
from topcli.analysis.tally import EnsembleSummary, InvariantRow, InvariantTally, invariant_report
from topcli.contracts import Array, Ending, Invariant, Outcome, Top
from topcli.engine.run import Endings, Run

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Recorded states of one run, as ``topcli.simulate`` returns them.

    ``trajectory[name]`` is a column of shape (m,) by name: ``n``, ``t``, a component of the state, an invariant of the
    top, a modified integral of the scheme, a quantity of ``output.quantities``, or of the attitude. ``len(trajectory)``
    is the number of rows m.

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
    quantities : tuple of Quantity
        Observables of ``output.quantities``.
    theta : ndarray, shape (m,), or None
        For the crossings of a section, the fraction of the step after ``n`` at which each lies; None otherwise.

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
    quantities: tuple[Quantity, ...] = ()
    theta: Array | None = None

    @classmethod
    def of_run(
        cls,
        run: Run,
        scheme: str,
        modified: tuple[Invariant, ...] = (),
        attitude: str = "",
        quantities: tuple[Quantity, ...] = (),
        search: CrossingSearch | None = None,
    ) -> Trajectory:
        """Carry out ``run`` and return its trajectory, with the step at which it left its energy surface.

        ``attitude`` is the form of the attitude, whose quaternions then follow the states of the run. With ``search``
        the crossings of a section are kept alone.
        """
        fields: dict[str, Any] = {"quantities": quantities}
        if search is None:
            n, states, ending = run.collect()
        else:
            found = search.along(run)
            n, states, fields["theta"] = found.n, found.states, found.theta
            assert run.ending is not None
            ending = run.ending
        if attitude:
            states, q = map(np.ascontiguousarray, np.split(states, [len(run.top.components)], axis=1))
            fields |= {"attitude": q, "attitude_form": attitude}
        ending = ending.with_left(step_of_leaving(run.top, n, states) if len(n) else None, run.h)
        seconds = run.compile_seconds, run.run_seconds
        ready = run.setup.seconds if run.setup else 0.0
        return cls(run.top, scheme, run.h, n, states, ending, *seconds, modified, setup_seconds=ready, **fields)

    @property
    def t(self) -> Array:
        """Times of the recorded states, shape (m,): ``n * h``, or those of the crossings of a section."""
        return self._steps * self.h

    @property
    def _steps(self) -> NDArray[Any]:
        """Numbers of steps, with fractions at the crossings of a section."""
        return self.n if self.theta is None else self.n + self.theta

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
        values: dict[str, NDArray[Any]] = {"n": self.n}
        if self.attitude is not None:
            for form, names in ATTITUDES.items():
                values |= attitude_columns(form, self.attitude) if name in names else {}
        return columns(
            self.top, self._steps, self.h, self.states, [name], self.modified, values, quantities=self.quantities
        )[name]

    def to_pandas(self) -> pd.DataFrame:
        """Return all columns as a DataFrame: n, t, the components, the invariants, the quantities, the attitude."""
        import pandas as pd

        names = [*column_names(self.top, self.quantities), *ATTITUDES.get(self.attitude_form, ())]
        return pd.DataFrame({name: self[name] for name in names})

    def invariants(self) -> pd.DataFrame:
        """Return the report on invariants and modified integrals, one row each (see ``analysis.tally``)."""
        import pandas as pd

        rows = self.invariant_rows() if len(self) else ()  # a section may never be crossed
        return pd.DataFrame([row.as_dict() for row in rows], columns=None if rows else ["name"]).set_index("name")

    def invariant_rows(self) -> Sequence[InvariantRow]:
        """Return the report on invariants and modified integrals as rows, in the order of the columns."""
        if self.rows is not None:
            return self.rows
        return invariant_report((*self.top.invariants(), *self.modified), self.n, self.h, self.states)


@dataclass(frozen=True, repr=False)
class Ensemble:
    """Trajectories of one scheme from many initial states, as ``topcli.simulate_ensemble`` returns them.

    ``ensemble[name]`` is a column of shape (trajectories, m) by name: a component of the state, an invariant of the
    top, or a modified integral of the scheme. ``len(ensemble)`` is the number of trajectories.

    Attributes
    ----------
    tops : tuple of Top
        Top of each trajectory, with its parameters.
    scheme : str
        Name of the scheme.
    h : float
        Step size, in units of time.
    n : ndarray of int64, shape (m,)
        Recorded step numbers; m is 0 if the rows were not stored.
    states : ndarray, shape (trajectories, m, d)
        States in the order of ``top.components``; nan after the end of a trajectory that ended early.
    initial : ndarray, shape (trajectories, d)
        Initial states.
    last : ndarray, shape (trajectories, d)
        State at step N, or the last recorded one of a trajectory that ended early.
    last_n : ndarray of int64, shape (trajectories,)
        Step numbers of ``last``.
    endings : Endings
        Ending of each trajectory.
    tallies : tuple of InvariantTally
        Deviations of the invariants, one tally for each top.
    table : dict of str to ndarray
        Columns of ``trajectories()``.
    modified : tuple of tuple of Invariant
        Integrals of the scheme itself, for each trajectory.
    compile_seconds, run_seconds, setup_seconds : float
        Wall time of compiling or loading the machine code, of the steps, and of the set-ups of a closed form.
    quantities : tuple of Quantity
        Observables of ``output.quantities``.

    Examples
    --------
    >>> import topcli
    >>> states = [[0.0, 0.0, 1.0, 0.6, 0.0, 0.8], [0.0, 1.0, 0.0, 0.6, 0.0, 0.8]]
    >>> ensemble = topcli.simulate_ensemble("kowalevski_hk", states=states, h=0.01, N=100)
    >>> ensemble
    <Ensemble of 2 under hk: 101 rows each, 2 completed>
    >>> ensemble.states.shape, ensemble["energy"].shape
    ((2, 101, 6), (2, 101))
    >>> ensemble.trajectory(1).ending.step
    100
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
    tallies: tuple[InvariantTally, ...]
    table: dict[str, NDArray[Any]]
    modified: tuple[tuple[Invariant, ...], ...]
    compile_seconds: float
    run_seconds: float
    setup_seconds: float = 0.0
    quantities: tuple[Quantity, ...] = ()

    @property
    def t(self) -> Array:
        """Times ``n * h`` of the recorded states, shape (m,)."""
        return self.n * self.h

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """Number of trajectories by outcome, for the outcomes that occur."""
        return self.endings.outcomes

    def __len__(self) -> int:
        return len(self.endings)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {outcome.value}" for outcome, count in self.outcomes.items())
        return f"<Ensemble of {len(self)} under {self.scheme}: {len(self.n)} rows each, {counts}>"

    def _kept(self, index: int) -> int:
        """Number of rows of trajectory ``index``."""
        return int(np.count_nonzero(self.n <= self.last_n[index]))

    def trajectory(self, index: int) -> Trajectory:
        """Single trajectory. Raises IndexError, and ValueError if the rows were not stored."""
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
            quantities=self.quantities,
        )

    def __getitem__(self, name: str) -> Array:
        """Column by name, shape (trajectories, m). Raises UsageError for an unknown name."""
        made = np.empty(self.states.shape[:2])
        for i, (top, modified) in enumerate(zip(self.tops, self.modified, strict=True)):
            made[i] = columns(top, self.n, self.h, self.states[i], [name], modified, quantities=self.quantities)[name]
        return made

    def trajectories(self) -> pd.DataFrame:
        """Return one row per trajectory: varied parameters, initial state, outcome, deviations and drifts."""
        import pandas as pd

        return pd.DataFrame(self.table).set_index("trajectory")

    def invariants(self) -> pd.DataFrame:
        """Return one row per invariant: quantiles of its deviations, and the number within round-off."""
        import pandas as pd

        summary = EnsembleSummary(io.BytesIO())
        for tally in self.tallies:
            summary.add(tally)
        rows = []
        for row in summary.rows():
            measures = {key: value for key, value in row.items() if isinstance(value, dict)}
            flat = {key: value for key, value in row.items() if key not in measures}
            rows.append(
                flat | {f"{measure}, {name}": x for measure, levels in measures.items() for name, x in levels.items()}
            )
        return pd.DataFrame(rows).set_index("name")

    def to_pandas(self) -> pd.DataFrame:
        """Return all recorded rows as a DataFrame: trajectory, n, t, the components, the invariants, the quantities."""
        import pandas as pd

        frames: Sequence[pd.DataFrame] = [
            pd.DataFrame(
                {"trajectory": i, **{name: trajectory[name] for name in column_names(trajectory.top, self.quantities)}}
            )
            for i, trajectory in enumerate(map(self.trajectory, range(len(self))))
        ]
        return pd.concat(frames, ignore_index=True)
