"""Measures: numbers that a sweep computes from each finished run, such as ``max_error``.

A measure is a function of a ``Batch``, which contains finished runs that differ only in their initial states. A measure
with a name that ends in ``.NAME`` is a family: it has one member for every invariant of the top, for example, or for
every counter of the scheme.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

import topcli
from topcli.analysis.frequencies import agreement_digits, strongest_line
from topcli.analysis.lyapunov import LEAST_STEPS, shares_of_chaos
from topcli.analysis.order import probe_rows
from topcli.analysis.swings import first_swing_spacing
from topcli.analysis.tally import OF_INVARIANT
from topcli.contracts import Array, Scheme, Top
from topcli.engine.tangent import tangent_obstacle
from topcli.errors import UnknownNameError, UsageError, nearest, quoted
from topcli.plugins import is_built_in, origin_of, plugin_failures, sources_of, without_users_errors
from topcli.runs.references import error_obstacle
from topcli.schemes.registry import schemes_of

if TYPE_CHECKING:
    from topcli.sweeps.batch import Batch

STATES = "states"
ERROR, FINAL_ERROR = "error", "final_error"
COLUMN, FIGURE = "column", "figure"
RECORDED = (STATES, ERROR, FINAL_ERROR)
"""Words that ``needs`` may hold beside the names of columns. A family may also need ``COLUMN``, the column of its name,
or ``FIGURE``, the figure of an invariant that the measure is."""
_TAKEN = {"row", "outcome", "message", "digest", "drawn", "top", "initial", "scheme", "h", "N", "T", "output", "sample"}
"""Names of other columns of a table of rows; those of keys may be followed by a dot."""
FAMILY = ".NAME"
"""End of the name of a family."""
NUMBER, TIME, OF_NAME, OF_STATE = "number", "time", "unit of NAME", "unit of the state"
"""Units in words; the numbers themselves are dimensionless."""
Names = Callable[[Top, Scheme, BaseModel], Iterable[str]]
Obstacle = Callable[[Top, Scheme], str]


def is_figure(need: str) -> bool:
    """True for a figure of an invariant, such as ``drift.energy``."""
    figure, dot, _ = need.partition(".")
    return bool(dot) and figure in OF_INVARIANT


@dataclass(frozen=True)
class Measure:
    """Measure of a sweep: a number computed from each finished run.

    The decorator ``topcli.measure`` creates measures; its documentation explains the parameters.
    """

    name: str
    function: Callable[..., Any]
    summary: str
    unit: str
    needs: tuple[str, ...]
    names: Names | None
    obstacle: Obstacle | None
    of_failed: bool
    origin: str
    """Distribution or file that registered the measure."""
    argument: str = ""
    """For a member of a family: its own name."""

    def evaluate(self, batch: Batch) -> Any:
        """Numbers of the runs of a batch, shape (runs,), unless the function of a user returns something else."""
        return self.function(batch, self.argument) if self.argument else self.function(batch)

    def member(self, name: str) -> Measure:
        """Measure of this family for ``name``."""
        texts = {key: getattr(self, key).replace("NAME", name) for key in ("name", "summary", "unit")}
        special = {COLUMN: name, FIGURE: texts["name"]}
        needs = tuple(special.get(need, need) for need in self.needs)
        return replace(self, needs=needs, names=None, argument=name, **texts)

    def misfit(self, columns: Collection[str], top: Top, scheme: Scheme) -> str:
        """Reason why the measure does not fit runs with these ``columns``; empty if it does."""
        for need in self.needs:
            if need not in (*RECORDED, *columns) and not is_figure(need):
                return f"it needs {quoted(need)}, which top {top.kind!r} under scheme {scheme.name!r} does not have"
        return self.obstacle(top, scheme) if self.obstacle else ""


MEASURES: dict[str, Measure] = {}
"""Measures and families by name; ``all_measures`` includes those of plugins."""


def measure(
    name: str,
    summary: str,
    unit: str = "1",
    *,
    needs: Iterable[str] = (),
    names: Names | None = None,
    obstacle: Obstacle | None = None,
    of_failed: bool = False,
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
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
        ``"states"`` for all components, or ``"error"`` and ``"final_error"`` for the distance from the reference
        solution.
    names : callable, optional
        For a family of measures: ``names(top, scheme, options)`` returns the names of its members.
    obstacle : callable, optional
        ``obstacle(top, scheme)`` returns the reason why the measure cannot be computed for a top and a scheme. It
        returns an empty text if the measure can be computed.
    of_failed : bool, optional
        True if the measure has a meaning for failed runs. If False, its number is nan for a failed run.

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
    fault = ""
    if not name.isprintable() or len(name.split()) != 1:
        fault = "a name has no spaces or control characters"
    elif name.partition(".")[0] in _TAKEN:
        fault = "a column of the results has this name already; choose another"
    elif name in MEASURES:
        fault = f"already registered by {MEASURES[name].origin}"
    elif name.endswith(FAMILY) != (names is not None):
        fault = f"a family, and no other measure, has names=... and a name ending in {FAMILY}"
    if fault:
        raise ValueError(f"measure {name!r}: {fault}")

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        MEASURES[name] = Measure(
            name, function, summary, unit, tuple(needs), names, obstacle, of_failed, origin_of(function)
        )
        return function

    return register


def in_words(name: str) -> str:
    """Name of a measure for the axis of a figure: "drift of energy" for ``drift.energy``."""
    base, _, member = name.partition(".")
    return (f"{base} of {member}" if base + FAMILY in MEASURES else name).replace("_", " ")


def all_measures() -> tuple[Measure, ...]:
    """Return all measures and families, those of plugins included, sorted by name."""
    plugin_failures()
    return tuple(MEASURES[name] for name in sorted(MEASURES))


def integral_names(top: Top, scheme: Scheme, options: BaseModel) -> list[str]:
    """Names of the invariants of the top and of the integrals of the scheme, which are those at any step."""
    modified = scheme.modified(top, 2.0**-10, options) if scheme.modified else ()
    return [integral.name for integral in (*top.invariants(), *modified)]


def measured_columns(top: Top, scheme: Scheme, options: BaseModel) -> list[str]:
    """Names of the components of the state and of the integrals."""
    return [*top.components, *integral_names(top, scheme, options)]


def counter_names(top: Top, scheme: Scheme, options: BaseModel) -> list[str]:
    """Names of the events that the scheme or another one of the top counts."""
    names = list[str]()
    for each, chosen in ((scheme, options), *((other, other.options()) for other in schemes_of(top.form))):
        with without_users_errors():
            names += getattr(each.build(top, chosen), "counters", ())  # a closed form counts nothing
    return list(dict.fromkeys(names))


def fitting_measures(top: Top, scheme: Scheme, options: BaseModel, quantities: Sequence[str] = ()) -> Iterator[Measure]:
    """Yield all measures that fit ``top`` and ``scheme``, with the members of families."""
    columns = [*measured_columns(top, scheme, options), *quantities]
    for each in all_measures():
        members = map(each.member, _member_names(each, top, scheme, options, quantities)) if each.names else [each]
        yield from (member for member in members if not member.misfit(columns, top, scheme))


def _member_names(family: Measure, *of: Any) -> list[str]:
    """Names of the members of a family; quantities are columns too."""
    *experiment, quantities = of
    assert family.names is not None
    return [*family.names(*experiment), *(quantities if COLUMN in family.needs else ())]


def resolve_measures(
    names: Sequence[str], top: Top, scheme: Scheme, options: BaseModel | None = None, quantities: Sequence[str] = ()
) -> tuple[Measure, ...]:
    """Return the measures called ``names`` for runs of ``top`` under ``scheme``, in this order.

    ``quantities`` are names of ``output.quantities``, which are columns too. Raises UnknownNameError for a name that is
    no measure of this top and scheme, with the nearest ones, and UsageError for a measure that cannot be computed.
    """
    options = options or scheme.options()
    columns = [*measured_columns(top, scheme, options), *quantities]
    resolved: list[Measure] = []
    for name in names:
        measure = _measure_called(name, top, scheme, options, quantities)
        if reason := measure.misfit(columns, top, scheme):
            raise UsageError(f"measure {quoted(name)} does not fit: {reason}")
        resolved.append(measure)
    return tuple(resolved)


def _measure_called(name: str, top: Top, scheme: Scheme, options: BaseModel, quantities: Sequence[str]) -> Measure:
    """Measure, or member of a family, that is called ``name``. Raises UnknownNameError."""
    base, _, member = name.partition(".")
    if name not in MEASURES:
        plugin_failures()
    if name in MEASURES and not name.endswith(FAMILY):
        return MEASURES[name]
    family = MEASURES.get(base + FAMILY)
    if family and member in _member_names(family, top, scheme, options, quantities):
        return family.member(member)
    fitting = [each.name for each in fitting_measures(top, scheme, options, quantities)]
    near = nearest(name, fitting, "topcli list measures")
    raise UnknownNameError(f"unknown measure {quoted(name)} of top {top.kind!r} under scheme {scheme.name!r}; {near}")


def definition_texts(names: Iterable[str]) -> list[str]:
    """Texts of the code that defines measures: of topcli's own, and the files of users' functions.

    Raises SchemeCodeError for a function without a file.
    """
    keys = (name if name in MEASURES else name.partition(".")[0] + FAMILY for name in names)
    functions = (MEASURES[key].function for key in keys if key in MEASURES)
    return [*_own_texts(), *sources_of(function for function in functions if not is_built_in(function)).values()]


@cache
def _own_texts() -> tuple[str, ...]:
    """Texts of the files of topcli that make numbers of finished runs."""
    root = Path(topcli.__file__).parent
    named = (root / "sweeps" / "measures.py", root / "sweeps" / "batch.py", root / "runs" / "references.py")
    files = [*sorted(root.glob("analysis/**/*.py")), *named]
    return tuple(file.read_text(encoding="utf-8") for file in files)


for _figure, (_summary, _unit) in OF_INVARIANT.items():

    @measure(_figure + FAMILY, _summary, _unit, needs=[FIGURE], names=integral_names)
    def of_invariant(batch: Batch, name: str, figure: str = _figure) -> Array:
        """Figure of an invariant."""
        return batch.figures[f"{figure}.{name}"]


for _name, _word, _function in (("min", "smallest", np.min), ("max", "largest", np.max), ("mean", "mean", np.mean)):
    _summary = f"{_word} value of NAME over the recorded rows"

    @measure(_name + FAMILY, _summary, OF_NAME, needs=[COLUMN], names=measured_columns)
    def of_column(batch: Batch, column: str, function: Callable[..., Array] = _function) -> Array:
        """Function of the recorded rows of a column."""
        return function(batch.columns[column], axis=1)


def _of_swings(batch: Batch, figure: Callable[[Array], float | None]) -> Array:
    """``figure`` of the times of the swings of each run (runs,); nan where it is None. Raises UsageError."""
    return np.array([figure(times) for times in batch.swings], dtype=np.float64)


@measure("swings", "number of swings, which are deep minima of one component of the state", NUMBER, needs=[STATES])
def number_of_swings(batch: Batch) -> Array:
    """Number of deep minima within the recorded rows."""
    return _of_swings(batch, len)


@measure("median_swing_spacing", "median time from one swing to the next", TIME, needs=[STATES])
def median_swing_spacing(batch: Batch) -> Array:
    """Median distance of neighbouring deep minima; nan for fewer than two."""
    return _of_swings(batch, lambda times: float(np.median(np.abs(np.diff(times)))) if len(times) > 1 else None)


@measure("first_swing_spacing", "time from the first swing to the second", TIME, needs=[STATES])
def first_spacing(batch: Batch) -> Array:
    """Distance of the first two deep minima; nan for fewer than two."""
    return _of_swings(batch, first_swing_spacing)


@measure(
    "frequency.NAME",
    "frequency of the strongest spectral line of NAME in the recorded rows",
    "cycles per unit time",
    needs=[COLUMN],
    names=measured_columns,
)
def frequency(batch: Batch, column: str) -> Array:
    """Frequency, below half a cycle per row; 0 for a constant column, nan below 2.5 cycles over the run."""
    spacing = abs(batch.experiment.h) * batch.experiment.output.every
    return np.array([strongest_line(rows).frequency for rows in batch.columns[column]]) / spacing


@measure(
    "digits.NAME",
    "number of decimal digits in which the weighted averages of NAME over the two halves of the run agree",
    NUMBER,
    needs=[COLUMN],
    names=measured_columns,
)
def average_digits(batch: Batch, column: str) -> Array:
    """Weighted Birkhoff digits: few on a chaotic orbit, up to 16 on a regular one."""
    return agreement_digits(batch.columns[column])


for _name, _need, _summary in (
    ("max_error", ERROR, "largest distance of a recorded state from the reference solution"),
    ("final_error", FINAL_ERROR, "distance of the last state from the reference solution"),
):

    @measure(_name, _summary, OF_STATE, needs=[_need], obstacle=error_obstacle)
    def error_of(batch: Batch, name: str = _name) -> Array:
        """Euclidean distance."""
        return getattr(batch, name)


@measure(
    "reversal_defect",
    "difference between a state and the result of one step of |h| forward and one step back; the largest over "
    "16 states of the run",
    OF_STATE,
    needs=[STATES],
)
def reversal_of_runs(batch: Batch) -> Array:
    """Largest component of the defect; infinite if one of the steps fails."""
    start = batch.states[:, probe_rows(batch.states.shape[1])]
    there = batch.one_step(start.reshape(-1, start.shape[2]), abs(batch.experiment.h))
    back = batch.one_step(there, -abs(batch.experiment.h)).reshape(start.shape)
    with np.errstate(all="ignore"):
        defect = np.abs(back - start).max(axis=(1, 2))
    return np.where(np.isnan(defect), np.inf, defect)


@measure("counter.NAME", "number of events called NAME that the scheme counted", NUMBER, names=counter_names)
def counter(batch: Batch, name: str) -> Array:
    """Count at the end of the run; nan for a scheme that does not count it."""
    if name not in batch.endings.counters:
        return np.full(len(batch), np.nan)
    return batch.endings.counts[:, batch.endings.counters.index(name)].astype(np.float64)


def _tangent_obstacle(top: Top, scheme: Scheme) -> str:
    reason = tangent_obstacle(scheme.build(top, scheme.options()))
    return reason and f"scheme {scheme.name!r} {reason}"


def _require_steps(batch: Batch) -> None:
    if (N := batch.experiment.N) < LEAST_STEPS:
        raise UsageError(f"N = {N}: too few steps for an exponent; take at least {LEAST_STEPS}")


@measure("lyapunov", "largest Lyapunov exponent; needs 1000 steps", "inverse time", obstacle=_tangent_obstacle)
def lyapunov_exponent(batch: Batch) -> Array:
    """Growth of a tangent vector after a transient, divided by the time. Raises UsageError for too few steps."""
    _require_steps(batch)
    return batch.growth.exponents


@measure(
    "chaotic",
    "1 for a chaotic orbit, 0 for a regular one or a point; otherwise missing",
    NUMBER,
    obstacle=_tangent_obstacle,
)
def chaotic(batch: Batch) -> Array:
    """Verdict on each run from the growth of a tangent vector; nan if undecided. Raises UsageError as ``lyapunov``."""
    _require_steps(batch)
    return shares_of_chaos(batch.growth.verdicts)


@measure("steps", "number of steps taken; for a failed run, the number of the step that failed", NUMBER, of_failed=True)
def steps(batch: Batch) -> Array:
    """Step number at which the run ended."""
    return batch.endings.step.astype(np.float64)


@measure(
    "seconds",
    "wall time of the steps; runs computed together in a batch share its time equally; not reproducible",
    "seconds",
)
def seconds(batch: Batch) -> Array:
    """Wall time without compiling and without measuring."""
    return batch.seconds
