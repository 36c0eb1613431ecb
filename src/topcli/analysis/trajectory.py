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
from topcli.errors import counted

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Recorded states of one run, as returned by ``topcli.simulate``.

    ``trajectory[name]`` is the column called ``name``, shape (m,). The name is ``n``, ``t``, a component of the state,
    an invariant of the top, a modified integral of the scheme, a quantity of ``output.quantities``, or a component of
    the attitude. ``len(trajectory)`` is the number of rows m.

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
        Outcome of the run, its last or failed step, and its event counts.
    compile_seconds, run_seconds : float
        Wall times in seconds for compiling or loading the machine code, and for the steps.
    modified : tuple of Invariant
        Modified integrals of the scheme: functions of the state and of h that the scheme conserves.
    rows : tuple of InvariantRow or None
        For a run that is not in double precision: report on the invariants, computed in the precision of the run. The
        ``states`` of such a run are rounded to doubles.
    attitude : ndarray, shape (m, 4), or None
        Unit quaternions of the rotation from the body's frame to space, scalar part first. None unless the config has
        ``output.attitude``.
    attitude_form : str
        Value of ``output.attitude`` in the config, ``quaternion`` or ``euler-angles``; empty without an attitude.
        ``to_pandas`` returns the attitude in this form. ``trajectory[name]`` gives columns of both forms.
    quantities : tuple of Quantity
        Formulas given in ``output.quantities`` of the config.
    theta : ndarray, shape (m,), or None
        Fraction of a step from step ``n`` to the crossing, for a run that records the crossings of a Poincaré section.
        None for other runs.

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
        """Carry out ``run`` and return its trajectory; ``ending`` says whether the run left its energy surface.

        ``attitude`` is the value of ``output.attitude``; if it is given, each state of ``run`` is followed by the
        quaternion of the attitude. With ``search``, only the crossings of a Poincaré section are kept.
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
        return cls(run.top, scheme, run.h, n, states, ending, *seconds, modified, **fields)

    @property
    def t(self) -> Array:
        """Times of the recorded states or, for a Poincaré section, of its crossings, shape (m,)."""
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
        return (
            f"<Trajectory of {self.top.kind} under {self.scheme}: {counted(len(self), 'row')}, {self.ending.message}>"
        )

    def __len__(self) -> int:
        return len(self.n)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the column called ``name``, shape (m,). Raises UsageError if there is none."""
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
        """Return a DataFrame with one row per invariant and modified integral: deviations, drift, verdict."""
        import pandas as pd

        rows = self.invariant_rows() if len(self) else ()  # a section may never be crossed
        return pd.DataFrame([row.as_dict() for row in rows], columns=None if rows else ["name"]).set_index("name")

    def invariant_rows(self) -> Sequence[InvariantRow]:
        """Return the report on the invariants and modified integrals, with one ``InvariantRow`` for each."""
        if self.rows is not None:
            return self.rows
        return invariant_report((*self.top.invariants(), *self.modified), self.n, self.h, self.states, self.top)


@dataclass(frozen=True, repr=False)
class Ensemble:
    """Trajectories of one scheme from many initial states, as returned by ``topcli.simulate_ensemble``.

    ``ensemble[name]`` is the column called ``name``, shape (trajectories, m). The name is a component of the state, an
    invariant of the top, or a modified integral of the scheme. ``len(ensemble)`` is the number of trajectories.

    Attributes
    ----------
    tops : tuple of Top
        Top of each trajectory, with its parameters.
    scheme : str
        Name of the scheme.
    h : float
        Step size, in units of time.
    n : ndarray of int64, shape (m,)
        Step numbers of the m rows (recorded states); m is 0 if the rows were not stored.
    states : ndarray, shape (trajectories, m, d)
        States in the order of ``top.components``. They are nan after the end of a trajectory that ended early.
    initial : ndarray, shape (trajectories, d)
        Initial states.
    last : ndarray, shape (trajectories, d)
        State of each trajectory at step N or, if the trajectory ended early, its last recorded state.
    last_n : ndarray of int64, shape (trajectories,)
        Step numbers of ``last``.
    endings : Endings
        Ending of each trajectory.
    tallies : tuple of InvariantTally
        Deviations of the invariants, with one object for each group of trajectories that have the same top.
    table : dict of str to ndarray
        Columns of the DataFrame that ``trajectories()`` returns.
    modified : tuple of tuple of Invariant
        Modified integrals (functions of the state and of h that the scheme conserves) for each trajectory.
    compile_seconds, run_seconds : float
        Wall times in seconds for compiling or loading the machine code, and for the steps.
    quantities : tuple of Quantity
        Formulas given in ``output.quantities`` of the config.

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
    quantities: tuple[Quantity, ...] = ()

    @property
    def t(self) -> Array:
        """Times ``n * h`` of the recorded states, shape (m,)."""
        return self.n * self.h

    @property
    def outcomes(self) -> dict[Outcome, int]:
        """Number of trajectories with each outcome that occurs."""
        return self.endings.outcomes

    def __len__(self) -> int:
        return len(self.endings)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {outcome.value}" for outcome, count in self.outcomes.items())
        return f"<Ensemble of {len(self)} under {self.scheme}: {counted(len(self.n), 'row')} each, {counts}>"

    def _kept(self, index: int) -> int:
        """Number of rows of trajectory ``index``."""
        return int(np.count_nonzero(self.n <= self.last_n[index]))

    def trajectory(self, index: int) -> Trajectory:
        """Return one trajectory.

        Raises IndexError if no trajectory has the number ``index``, and ValueError if the rows were not stored.
        """
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
        """Return the column called ``name``, shape (trajectories, m). Raises UsageError if there is none."""
        made = np.empty(self.states.shape[:2])
        for i, (top, modified) in enumerate(zip(self.tops, self.modified, strict=True)):
            made[i] = columns(top, self.n, self.h, self.states[i], [name], modified, quantities=self.quantities)[name]
        return made

    def trajectories(self) -> pd.DataFrame:
        """Return a DataFrame with one row per trajectory.

        A row contains the parameters of the top that vary in the ensemble, the initial state, the outcome, and the
        deviations and drifts of the invariants.
        """
        import pandas as pd

        return pd.DataFrame(self.table).set_index("trajectory")

    def invariants(self) -> pd.DataFrame:
        """Return a DataFrame with one row per invariant.

        A row contains quantiles of the deviations over the trajectories, and the number of trajectories on which the
        invariant is constant to round-off.
        """
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
