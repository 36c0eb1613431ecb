"""Measures: numbers that a sweep computes from each finished run, such as ``max_error``.

A measure is a function of a ``Batch``, which contains finished runs that differ only in their initial states. A measure
with a name that ends in ``.NAME`` is a family: it has one member for every invariant of the top, for example, or for
every counter of the scheme.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import BaseModel

from topcli.analysis.frequencies import agreement_digits, strongest_line
from topcli.analysis.lyapunov import LEAST_STEPS, shares_of_chaos
from topcli.analysis.swings import first_swing_spacing as first_spacing_of
from topcli.analysis.swings import minima_times
from topcli.contracts import Array, Invariant, Sampler, Scheme, Top
from topcli.engine.tangent import obstacle as tangent_obstacle
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.runs.references import obstacle
from topcli.schemes.plugins import origin_of, plugin_failures, without_users_errors
from topcli.schemes.registry import schemes_of
from topcli.tops import TOPS

STATES, SWING, PROBES = "states", "swing", "probes"
ERROR, FINAL_ERROR = "error", "final_error"
DEVIATION, DRIFT, COLUMN = "deviation", "drift", "column"
RECORDED = (STATES, SWING, PROBES, ERROR, FINAL_ERROR)
"""Words that ``needs`` may hold beside the names of columns; a family may also need ``DEVIATION``, ``DRIFT`` or
``COLUMN``, the column of its name."""
TAKEN = frozenset(
    "row outcome message digest cpu current top initial scheme h N T output sample seed drawn".split()  # noqa: SIM905
)
"""Names of other columns of a table of rows; those of keys may be followed by a dot."""
FAMILY = ".NAME"
"""End of the name of a family."""
H_OF_NAMES = 2.0**-10
"""Step at which the integrals of a scheme are built when only their names are asked for."""

Batch = Any
"""Batch of finished runs: ``sweeps.batch.Batch``, whose module imports this one."""
Evaluation = Callable[..., Any]
Names = Callable[[Top, Scheme, BaseModel], Iterable[str]]
Obstacle = Callable[[Top, Scheme], str]


def _no_evaluation(batch: Any) -> Any:
    raise NotImplementedError


@dataclass(frozen=True)
class Measure:
    """Measure of a sweep: a number computed from each finished run.

    The decorator ``topcli.measure`` creates measures; its documentation explains the parameters.
    """

    name: str
    """Name in sweep files. The name of a family of measures ends in ``.NAME``."""
    summary: str
    """Description on one line."""
    unit: str = "1"
    """Unit of the number, in words."""
    evaluate: Evaluation = _no_evaluation
    """``evaluate(batch)`` returns an array, shape (runs,). The function of a family also takes a name."""
    needs: tuple[str, ...] = ()
    """Data that a run must record for the measure: names of columns, or words of ``RECORDED``."""
    names: Names | None = None
    """For a family: ``names(top, scheme, options)`` returns the names of its members."""
    noun: str = "name"
    """For a family: word for its members in messages, such as "invariant"."""
    obstacle: Obstacle | None = None
    """``obstacle(top, scheme)`` returns the reason why the measure cannot be computed; empty if it can."""
    of_failed: bool = False
    """True if the number has a meaning for failed runs; other measures are nan for them."""
    reproducible: bool = True
    """True if a repeated run gives the same bits; False for computing times."""
    origin: str = "topcli"
    """Distribution or file that registered the measure."""

    @property
    def family(self) -> str:
        """Name of a family without its end, such as ``drift``; empty for a single measure."""
        return self.name.removesuffix(FAMILY) if self.name.endswith(FAMILY) else ""

    def member(self, name: str) -> Measure:
        """Measure of this family for ``name``."""
        evaluate = self.evaluate
        return replace(
            self,
            name=f"{self.family}.{name}",
            summary=self.summary.replace("NAME", name),
            unit=self.unit.replace("NAME", name),
            evaluate=lambda batch: evaluate(batch, name),
            needs=tuple(_need(need, name) for need in self.needs),
            names=None,
        )


def _need(need: str, name: str) -> str:
    """Needs of a member of a family, from those of the family."""
    return name if need == COLUMN else f"{need}.{name}" if need in (DEVIATION, DRIFT) else need


class MeasureMisfitError(UsageError):
    """The measure exists but does not fit the top or the scheme (exit code 2)."""


class NoCounterError(MeasureMisfitError):
    """The scheme does not have the counter of a measure (exit code 2)."""


COUNTER = "counter"
MEASURES: dict[str, Measure] = {}
"""Measures and families by name; ``all_measures`` includes those of plugins."""


def measure(name: str, *, summary: str, **declared: Any) -> Callable[[Evaluation], Evaluation]:
    """Register the decorated function ``evaluate(batch)`` as a measure of ``topcli sweep``.

    The function takes a ``Batch``, which contains finished runs that differ only in their initial states, and returns
    an array with one number for each run. The number of a run must not depend on the other runs in the batch.

    Parameters
    ----------
    name : str
        Name in sweep files, such as ``"gamma3.min"``. A name that ends in ``.NAME`` is the name of a family of
        measures. The function of a family, ``evaluate(batch, name)``, also takes the name of one member, such as the
        name of an invariant.
    summary : str
        Description on one line.
    unit : str, optional
        Unit in words, such as ``"inverse time"``; the numbers themselves are dimensionless.
    needs : iterable of str, optional
        Data that the runs must record for the measure: names of columns (components and invariants),
        ``"states"`` for all components, ``"swing"`` for the component whose minima mark the swings of the top (each
        fall and rise), ``"error"`` and ``"final_error"`` for the distance from the reference solution, or ``"probes"``
        for a few states along the run.
    names : callable, optional
        For a family of measures: ``names(top, scheme, options)`` returns the names of its members.
    noun : str, optional
        For a family: word for its members in messages, such as "invariant".
    obstacle : callable, optional
        ``obstacle(top, scheme)`` returns the reason why the measure cannot be computed for a top and a scheme. It
        returns an empty text if the measure can be computed.
    of_failed : bool, optional
        True if the measure has a meaning for failed runs. If False, its number is nan for a failed run.
    reproducible : bool, optional
        False if the number differs when a run is repeated, as a computing time does.

    Returns
    -------
    callable
        Decorator that registers the function and returns it unchanged.

    Raises
    ------
    ValueError
        If the name is already registered, contains spaces, or is the name of a column of results.

    Examples
    --------
    >>> import topcli
    >>> @topcli.measure("gamma3.min", summary="lowest gamma3 that the top reaches", needs=["gamma3"])
    ... def lowest(batch):
    ...     return batch.columns["gamma3"].min(axis=1)
    """
    if not name.isprintable() or not name.strip() or any(letter.isspace() for letter in name):
        raise ValueError(f"measure {name!r}: a name has no spaces or control characters")
    if name.partition(".")[0] in TAKEN:
        raise ValueError(f"measure {name!r}: a column of the results has this name already; choose another")
    if name in MEASURES:
        raise ValueError(f"measure {name!r} is already registered by {MEASURES[name].origin}")
    if name.endswith(FAMILY) != (declared.get("names") is not None):
        raise ValueError(
            f"measure {name!r}: a family, and no other measure, has names=... and a name ending in {FAMILY}"
        )

    made = Measure(name, summary, **{**declared, "needs": tuple(declared.get("needs", ()))})

    def register(evaluate: Evaluation) -> Evaluation:
        # the functions of topcli may be imported because a plugin registers its own
        MEASURES[name] = replace(made, evaluate=evaluate, origin=origin_of(evaluate))
        return evaluate

    return register


def of_name(name: str) -> Measure | None:
    """Measure or member of a family such as ``drift.energy``; None for any other name."""
    base, _, member = name.partition(".")
    family = MEASURES.get(base + FAMILY)
    return MEASURES.get(name) or (family and family.member(member))


def in_words(name: str) -> str:
    """Name of a measure for the axis of a figure: "drift of energy" for ``drift.energy``."""
    base, _, member = name.partition(".")
    return (f"{base} of {member}" if base + FAMILY in MEASURES else name).replace("_", " ")


def all_measures() -> tuple[Measure, ...]:
    """Return all measures and families, those of plugins included, sorted by name."""
    plugin_failures()
    return tuple(MEASURES[name] for name in sorted(MEASURES))


def integrals_of(
    top: Top, scheme: Scheme, h: float = H_OF_NAMES, options: BaseModel | None = None
) -> tuple[Invariant, ...]:
    """Integrals of ``top``, and those of ``scheme`` itself at step ``h``."""
    modified = scheme.modified(top, h, options or scheme.options()) if scheme.modified else ()
    return (*top.invariants(), *modified)


def names_of(top: Top, scheme: Scheme, options: BaseModel | None = None) -> list[str]:
    """Names of all measures that fit ``top`` and ``scheme``, those of families included."""
    return [measure.name for measure in _fitting(top, scheme, options)]


def _fitting(top: Top, scheme: Scheme, options: BaseModel | None = None) -> list[Measure]:
    single = [
        made
        for listed in all_measures()
        for made in (
            map(listed.member, listed.names(top, scheme, options or scheme.options())) if listed.names else [listed]
        )
    ]
    return [made for made in single if not _misfit(made, top, scheme, options)]


def measures_of_form(form: str) -> list[Measure]:
    """Measures that fit the top of this form under any of its schemes, those of families included, sorted by name."""
    top = TOPS[form].new()
    named: dict[str, Measure] = {}
    for scheme in schemes_of(form):
        with without_users_errors():
            named |= {each.name: each for each in _fitting(top, scheme)}
    return [named[name] for name in sorted(named)]


def resolve_measures(
    names: Sequence[str],
    top: Top,
    scheme: Scheme,
    options: BaseModel | None = None,
    *,
    any_counter: bool = False,
    quantities: Collection[str] = (),
) -> tuple[Measure, ...]:
    """Return the measures called ``names`` for runs of ``top`` under ``scheme``.

    Parameters
    ----------
    names : sequence of str
        Names such as ``"median_swing_spacing"`` or ``"drift.energy"``.
    top : Top
        Top of the runs; its parameters do not matter.
    scheme : Scheme
        Scheme of the runs.
    options : BaseModel, optional
        Options of the scheme, by default its defaults.
    any_counter : bool, optional
        True to accept counters that the scheme does not have; their values are nan.
    quantities : collection of str, optional
        Names of ``output.quantities`` of the runs, which are columns too.

    Returns
    -------
    tuple of Measure
        In the order of ``names``.

    Raises
    ------
    UnknownNameError
        For a name that is not a measure of this top and scheme; the message suggests the nearest ones.
    MeasureMisfitError
        For a measure that does not fit the top or the scheme, with the reason.
    NoCounterError
        For a counter that the scheme does not have.
    UsageError
        For a name that is given twice.
    """
    resolved = []
    for i, name in enumerate(names):
        if name in names[:i]:
            raise UsageError(f"measure {quoted(name)} is named twice")
        try:
            measure = _find(name, top, scheme, options, quantities)
        except NoCounterError:
            if not any_counter:
                raise
            measure = MEASURES[COUNTER + FAMILY].member(name.partition(".")[2])
        if reason := _misfit(measure, top, scheme, options, quantities):
            raise MeasureMisfitError(f"measure {quoted(name)} does not fit: {reason}")
        resolved.append(replace(measure, needs=tuple(top.swing if need == SWING else need for need in measure.needs)))
    return tuple(resolved)


def _find(name: str, top: Top, scheme: Scheme, options: BaseModel | None, quantities: Collection[str]) -> Measure:
    if name not in MEASURES or name.endswith(FAMILY):
        plugin_failures()
    if name in MEASURES and not name.endswith(FAMILY):
        return MEASURES[name]
    base, _, member = name.partition(".")
    family = MEASURES.get(base + FAMILY)
    if family is None or family.names is None:
        raise UnknownNameError(f"unknown measure {quoted(name)}; {nearest(name, names_of(top, scheme, options))}")
    known = list(family.names(top, scheme, options or scheme.options()))
    known += quantities if COLUMN in family.needs else []
    if member in known:
        return family.member(member)
    whose = f"top {top.kind!r} under scheme {scheme.name!r}"
    if base == COUNTER and member not in ("", "NAME"):
        hint = f"; {nearest(member, known)}" if known else ""
        raise NoCounterError(f"measure {quoted(name)}: {whose} has no {family.noun} {quoted(member)}{hint}")
    if not known:
        raise MeasureMisfitError(f"measure {quoted(name)} does not fit: {whose} has no {family.noun}")
    if member in ("", "NAME"):
        raise UnknownNameError(
            f"measure {quoted(name)}: give one of {', '.join(f'{base}.{member}' for member in known)}"
        )
    raise UnknownNameError(
        f"measure {quoted(name)}: {whose} has no {family.noun} {quoted(member)}; {nearest(member, known)}"
    )


def _misfit(
    measure: Measure, top: Top, scheme: Scheme, options: BaseModel | None, quantities: Collection[str] = ()
) -> str:
    """Reason why a measure does not fit; empty if it does."""
    columns = [
        need for need in measure.needs if need not in RECORDED and need.partition(".")[0] not in (DEVIATION, DRIFT)
    ]
    if columns:
        known = [*column_names(top, scheme, options or scheme.options()), *quantities]
        for column in columns:
            if column not in known:
                return f"it needs {quoted(column)}, which top {top.kind!r} under scheme {scheme.name!r} does not have"
    return measure.obstacle(top, scheme) if measure.obstacle else ""


def integral_names(top: Top, scheme: Scheme, options: BaseModel) -> list[str]:
    """Names of the invariants of the top and of the integrals of the scheme."""
    return [integral.name for integral in integrals_of(top, scheme, options=options)]


def column_names(top: Top, scheme: Scheme, options: BaseModel) -> list[str]:
    """Names of the components of the state and of the integrals."""
    return [*top.components, *integral_names(top, scheme, options)]


def counter_names(top: Top, scheme: Scheme, options: BaseModel) -> list[str]:
    """Names of the events that the scheme counts."""
    method = scheme.build(top, options)
    return [] if isinstance(method, Sampler) else list(method.counters)


INTEGRAL = "invariant"
NUMBER, TIME, OF_NAME, OF_STATE = "number", "time", "unit of NAME", "unit of the state"
"""Units in words; the numbers themselves are dimensionless."""


def _of_swings(batch: Batch, figure: Callable[[Array], float]) -> Array:
    """``figure`` of the times of the swings of each run (runs,)."""
    values = batch.columns[batch.experiment.top.swing]
    return np.array([figure(minima_times(batch.t, of_one)) for of_one in values])


@measure(
    "swings",
    summary="number of swings, which are deep minima of one component of the state",
    unit=NUMBER,
    needs=[SWING],
)
def swings(batch: Batch) -> Array:
    """Number of deep minima within the recorded rows."""
    return _of_swings(batch, len)


@measure(
    "median_swing_spacing",
    summary="median time from one swing to the next",
    unit=TIME,
    needs=[SWING],
)
def median_swing_spacing(batch: Batch) -> Array:
    """Median distance of neighbouring deep minima; nan for fewer than two."""
    return _of_swings(batch, lambda times: float(np.median(np.abs(np.diff(times)))) if len(times) > 1 else np.nan)


@measure(
    "first_swing_spacing",
    summary="time from the first swing to the second",
    unit=TIME,
    needs=[SWING],
)
def first_spacing(batch: Batch) -> Array:
    """Distance of the first two deep minima; nan for fewer than two."""
    values = batch.columns[batch.experiment.top.swing]
    spacings = [first_spacing_of(batch.t, of_one) for of_one in values]
    return np.array([np.nan if spacing is None else spacing for spacing in spacings])


@measure(
    "drift.NAME",
    summary="slope of a line fitted to NAME, per unit time",
    unit="unit of NAME per time",
    needs=[DRIFT],
    names=integral_names,
    noun=INTEGRAL,
)
def drift(batch: Batch, name: str) -> Array:
    """Slope of the line that ``analysis.tally`` fits; nan for fewer than eight recorded rows."""
    return batch.drifts[name]


@measure(
    "max_deviation.NAME",
    summary="largest deviation of NAME from its first value",
    unit=OF_NAME,
    needs=[DEVIATION],
    names=integral_names,
    noun=INTEGRAL,
)
def deviation(batch: Batch, name: str) -> Array:
    """Largest magnitude of the deviation over the recorded rows."""
    return batch.deviations[name]


def _figure_of_column(name: str, word: str, figure: Callable[[Array], Array]) -> None:
    """Register a family: a figure of the recorded rows of one column."""

    @measure(
        name + FAMILY,
        summary=f"{word} value of NAME over the recorded rows",
        unit=OF_NAME,
        needs=[COLUMN],
        names=column_names,
        noun="column",
    )
    def evaluate(batch: Batch, column: str) -> Array:
        return figure(batch.columns[column])


_figure_of_column("min", "smallest", lambda rows: rows.min(axis=1))
_figure_of_column("max", "largest", lambda rows: rows.max(axis=1))
_figure_of_column("mean", "mean", lambda rows: rows.mean(axis=1))


@measure(
    "frequency.NAME",
    summary="frequency of the strongest spectral line of NAME in the recorded rows",
    unit="cycles per unit time",
    needs=[COLUMN],
    names=column_names,
    noun="column",
)
def frequency(batch: Batch, column: str) -> Array:
    """Frequency, below half a cycle per row; 0 for a constant column, nan below 2.5 cycles over the run."""
    spacing = abs(batch.experiment.h) * batch.experiment.output.every
    return np.array([strongest_line(rows).frequency for rows in batch.columns[column]]) / spacing


@measure(
    "digits.NAME",
    summary="number of decimal digits in which the weighted averages of NAME over the two halves of the run agree",
    unit=NUMBER,
    needs=[COLUMN],
    names=column_names,
    noun="column",
)
def digits(batch: Batch, column: str) -> Array:
    """Weighted Birkhoff digits: few on a chaotic orbit, up to 16 on a regular one."""
    return agreement_digits(batch.columns[column])


@measure(
    "max_error",
    summary="largest distance of a recorded state from the reference solution",
    unit=OF_STATE,
    needs=[ERROR],
    obstacle=obstacle,
)
def max_error(batch: Batch) -> Array:
    """Largest Euclidean norm of the error over the recorded rows."""
    return batch.max_error


@measure(
    "final_error",
    summary="distance of the last state from the reference solution",
    unit=OF_STATE,
    needs=[FINAL_ERROR],
    obstacle=obstacle,
)
def final_error(batch: Batch) -> Array:
    """Euclidean norm of the error at step N."""
    return batch.final_error


@measure(
    "reversal_defect",
    summary="difference between a state and the result of one step of |h| forward and one step back; the largest over "
    "16 states of the run",
    unit=OF_STATE,
    needs=[PROBES],
)
def reversal(batch: Batch) -> Array:
    """Largest component of the defect; infinite if one of the steps fails."""
    count, probes, d = batch.probes.shape
    h = abs(batch.experiment.h)
    there = batch.one_step(batch.probes.reshape(count * probes, d), h)
    back = batch.one_step(there, -h)
    with np.errstate(all="ignore"):
        defect = np.abs(back.reshape(count, probes, d) - batch.probes).max(axis=(1, 2))
    return np.where(np.isnan(defect), np.inf, defect)


@measure(
    "counter.NAME",
    summary="number of events called NAME that the scheme counted",
    unit=NUMBER,
    names=counter_names,
    noun=COUNTER,
)
def counter(batch: Batch, name: str) -> Array:
    """Count at the end of the run; nan for a scheme that does not count it."""
    if name not in batch.endings.counters:
        return np.full(len(batch), np.nan)
    return batch.endings.counts[:, batch.endings.counters.index(name)].astype(np.float64)


def _tangent_obstacle(top: Top, scheme: Scheme) -> str:
    reason = tangent_obstacle(scheme.build(top, scheme.options()))
    return reason and f"scheme {scheme.name!r} {reason}"


@measure(
    "lyapunov",
    summary="largest Lyapunov exponent, after a transient",
    unit="inverse time",
    obstacle=_tangent_obstacle,
)
def lyapunov(batch: Batch) -> Array:
    """Growth of a tangent vector after a transient, divided by the time; nan for too few steps."""
    if batch.experiment.N < LEAST_STEPS:
        return np.full(len(batch), np.nan)
    return batch.growth.exponents


@measure(
    "chaotic",
    summary="1 for a chaotic orbit, 0 for a regular one or a point; otherwise missing",
    unit=NUMBER,
    obstacle=_tangent_obstacle,
)
def chaotic(batch: Batch) -> Array:
    """Verdict on each run from the growth of a tangent vector; nan if it is undecided."""
    return shares_of_chaos(batch.growth.verdicts)


@measure(
    "steps",
    summary="number of steps taken; for a failed run, the number of the step that failed",
    unit=NUMBER,
    of_failed=True,
)
def steps(batch: Batch) -> Array:
    """Step number at which the run ended."""
    return batch.endings.step.astype(np.float64)


@measure(
    "seconds",
    summary="wall time of the steps; runs computed together in a batch share its time equally; not reproducible",
    unit="seconds",
    reproducible=False,
)
def seconds(batch: Batch) -> Array:
    """Wall time without compiling and without measuring."""
    return batch.seconds
