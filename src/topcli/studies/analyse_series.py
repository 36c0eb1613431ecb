"""Analysis of a time series of another program: invariants, error against the reference, swings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.reference import reference_states
from topcli.analysis.series_report import invariant_report, uneven_report
from topcli.analysis.swings import first_swing_spacing, minima_times
from topcli.analysis.verdict import InvariantRow
from topcli.config.models import Experiment
from topcli.contracts import Array, Top
from topcli.errors import TopcliError, UsageError, counted, nearest, quoted
from topcli.runs.report import report_data
from topcli.schemes.own_tops import other_forms
from topcli.store.files import sha256_of
from topcli.store.foreign import ForeignSeries
from topcli.studies.study import Result

UNIT = 1e-3
"""Deviation of the length of a unit vector from 1 that the first row may have; beyond it the units are wrong."""
START_AGREEMENT = 1e-6
"""Difference from the config's initial state, relative to its largest component, that writing few digits explains."""
EVEN = 1e-6
"""Deviation from even times, in units of their spacing, that writing few digits explains."""
ERROR, SWING, DEVIATION = "error", "swing", "deviation"
"""Kinds of columns in the series of an analysis."""


@dataclass(frozen=True)
class Rows:
    """Rows of a series: times ``t`` (m,), ``states`` (m, d), and step numbers ``n`` (m,) if the file has them."""

    t: Array
    states: Array
    n: NDArray[np.int64] | None = None


def column_map(texts: Sequence[str], top: Top) -> dict[str, str]:
    """Columns of a file by the names of topcli, from texts such as ``"omega1=w_x,t=time"``. Raises UsageError."""
    known = ("n", "t", *top.components)
    columns: dict[str, str] = {}
    for pair in (part for text in texts for part in text.split(",") if part.strip()):
        name, equals, column = (part.strip() for part in pair.partition("="))
        if not (name and equals and column):
            raise UsageError(f"--rename {quoted(pair)}: write NAME=COLUMN, such as {top.components[0]}=w_x")
        if name not in known:
            raise UsageError(f"--rename {quoted(pair)}: unknown name {quoted(name)}; {nearest(name, known)}")
        if name in columns:
            raise UsageError(f"--rename {quoted(pair)}: {name} is given twice")
        columns[name] = column
    return columns


def _sources(file: ForeignSeries, top: Top, given: Mapping[str, str]) -> dict[str, str]:
    """Column of the file for the time and each component. Raises UsageError for missing and repeated columns."""
    sources = {name: given.get(name, name) for name in ("t", *top.components)} | dict(given)
    for name, column in given.items():
        if column not in file.names:
            hint = nearest(column, file.names)
            raise UsageError(f"--rename {name}={column}: {file.path} has no column {quoted(column)}; {hint}")
    missing = [name for name, column in sources.items() if column not in file.names]
    if missing:
        hint = _other_form(file, top) or f"{nearest(missing[0], file.names)}; --rename {missing[0]}=COLUMN names it"
        raise UsageError(f"{file.path}: no column{'s' * (len(missing) > 1)} {', '.join(missing)}; {hint}")
    columns = list(sources.values())
    for name, column in sources.items():
        if columns.count(column) > 1:
            both = " and ".join(own for own, other in sources.items() if other == column)
            raise UsageError(
                f"{file.path}: column {quoted(column)} is taken for {both}; name one with --rename {name}=..."
            )
    return sources


def _other_form(file: ForeignSeries, top: Top) -> str:
    """Hint that the columns of the file are the state of another form of the top; empty if they are not."""
    for form in other_forms(top):
        if set(form.components) <= set(file.names):
            wanted = " and ".join(f"initial.{name}" for name in form.vectors)
            return f"the file has the state of {form.form!r}, which a config with {wanted} alone describes"
    return ""


def unread_components(file: ForeignSeries, top: Top) -> list[str]:
    """Columns of the file that are components of a larger form of the top, which the config leaves out."""
    larger = [form for form in other_forms(top) if set(top.components) < set(form.components) <= set(file.names)]
    return [name for name in larger[0].components if name not in top.components] if larger else []


def read_rows(file: ForeignSeries, top: Top, given: Mapping[str, str]) -> Rows:
    """Rows of a file, checked: finite values, times in one direction, unit vectors. Raises UsageError."""
    sources = _sources(file, top, given)
    columns = file.read([sources[name] for name in ("t", *top.components)])
    t = columns[sources["t"]]
    if len(t) < 2:
        raise UsageError(f"{file.path}: {counted(len(t), 'row')}; a series needs at least 2")
    states = np.column_stack([columns[sources[name]] for name in top.components])
    _check_times(file.path, sources["t"], t)
    _check_units(file.path, top, states)
    return Rows(t, states, _step_numbers(file, sources.get("n", "n"), required="n" in given))


def _check_times(path: Path, name: str, t: Array) -> None:
    """Raise UsageError at the first time that repeats the one before, or leads back."""
    with np.errstate(over="ignore"):
        ahead, span = np.diff(t), float(t[-1] - t[0])
    direction = 1.0 if 2 * np.count_nonzero(ahead > 0.0) >= len(ahead) else -1.0
    wrong = ~(direction * ahead > 0.0)
    if not wrong.any():
        if not math.isfinite(span):
            raise UsageError(f"{path}: {name} from {t[0]:g} to {t[-1]:g} is a time beyond double precision")
        return
    row = int(np.argmax(wrong)) + 2
    now, before = float(t[row - 1]), float(t[row - 2])
    if now == before:
        raise UsageError(f"{path}: row {row}: {name} = {now!r} repeats that of row {row - 1}; times must differ")
    order = "increase" if direction > 0.0 else "decrease"
    raise UsageError(f"{path}: row {row}: {name} = {now!r} after {before!r}; times must be sorted (here: {order})")


def _check_units(path: Path, top: Top, states: Array) -> None:
    """Raise UsageError if a unit vector of the top does not begin with unit length."""
    for name in top.unit_vectors:
        start, stop = top.vectors[name]
        length = float(np.linalg.norm(states[0, start:stop]))
        if not abs(length - 1.0) <= UNIT:
            raise UsageError(
                f"{path}: row 1: {name} has length {length:.6g}, and {top.kind} takes a unit vector (within {UNIT:g}); "
                f"divide {name} by its length"
            )


def _step_numbers(file: ForeignSeries, column: str, required: bool) -> NDArray[np.int64] | None:
    """Step numbers of the rows; None if the file has none, or another quantity of that name unless ``required``."""
    if column not in file.names:
        return None
    try:
        n = file.read([column])[column]
        increasing = bool((np.diff(n) > 0.0).all() and (n == np.floor(n)).all() and np.abs(n).max() < 2.0**53)
        if increasing:
            return n.astype(np.int64)
        if required:
            raise UsageError(f"{file.path}: column {quoted(column)} does not hold increasing step numbers")
    except UsageError:
        if required:
            raise
    return None


def _even_steps(experiment: Experiment, rows: Rows) -> tuple[NDArray[np.int64], float, bool] | None:
    """Numbers of the rows (m,) on a grid of times and its step, if the times are even; None otherwise.

    True if they are step numbers of a run with the config's own h.
    """
    t, n, h = rows.t, rows.n, experiment.h
    if n is not None and np.ptp(np.diff(n)) == 0 and np.array_equal(n * h, t):
        return n - n[0], h, True
    numbers = np.arange(len(t))
    spacing = float(t[-1] - t[0]) / (len(t) - 1)
    off = np.abs(t - (t[0] + numbers * spacing)).max()
    rounding = 4.0 * np.finfo(np.float64).eps * np.abs(t).max()
    return (numbers, spacing, False) if off <= EVEN * abs(spacing) + rounding else None


def _judged(experiment: Experiment, rows: Rows, steps: int) -> tuple[list[InvariantRow], int | None, str]:
    """Report on the invariants, the index of the first row that left the energy surface, and the kind of times."""
    even, top = _even_steps(experiment, rows), experiment.top
    if even is None:
        report, left = uneven_report(top, top.invariants(), rows.t, rows.states, steps)
        return report, left, "uneven"
    numbers, spacing, own = even
    invariants = (*top.invariants(), *(experiment.modified if own else ()))
    report, step = invariant_report(top, invariants, numbers, spacing, rows.states, steps)
    left = None if step is None else int(np.searchsorted(numbers, step))
    return report, left, "steps of the config's h" if own else "even"


def _reference(experiment: Experiment, rows: Rows) -> tuple[dict[str, Any], Array | None]:
    """Description of the reference and its states (m, d); None and the reason if it cannot be computed.

    It starts from the config's initial state if the first row agrees with that, so that rounding in the file is not
    taken for the motion, and otherwise from the first row.
    """
    initial, first = experiment.y0, tuple(rows.states[0].tolist())
    difference = max(abs(value - other) for value, other in zip(first, initial, strict=True))
    agrees = difference <= START_AGREEMENT * max(map(abs, initial))
    about = {
        "method": "Taylor series in double-double arithmetic",
        "start": "config" if agrees else "first row",
        "difference": difference,
        "message": "",
    }
    try:
        return about, reference_states(experiment.top, initial if agrees else first, rows.t - rows.t[0])
    except TopcliError as error:
        return about | {"message": error.lines[0]}, None


def _swings(top: Top, t: Array, values: Array, reference: Array | None) -> dict[str, Any]:
    """Swings of the series and of the reference: the spacing of the first two deep minima, and the times of all."""
    return {
        "component": top.swing,
        "first_swing_spacing": first_swing_spacing(t, values),
        "times": minima_times(t, values).tolist(),
        "reference_first_swing_spacing": None if reference is None else first_swing_spacing(t, reference),
        "reference_times": None if reference is None else minima_times(t, reference).tolist(),
    }


def analyse_series(
    experiment: Experiment, file: ForeignSeries, given: Mapping[str, str], steps: int | None = None
) -> Result:
    """Judge the series in ``file`` as the motion of the experiment's top.

    Its scheme and step size are of no account, unless the file has step numbers ``n`` and the times are ``n * h``, as
    in series of topcli: the report is then that of the run, modified integrals included.

    Parameters
    ----------
    experiment : Experiment
        Top and initial state.
    file : ForeignSeries
        File with the series.
    given : mapping of str to str
        Columns of the file by the names of topcli, where they differ (see ``column_map``).
    steps : int or None
        Steps of the method behind the rows, for the round-off bound; by default those between the first and the last
        number in a column ``n``, or one step from each row to the next.

    Returns
    -------
    Result
        The report; ``arrays`` has ``t``, ``swing``, ``deviation:<invariant>`` and, with a reference, ``error`` and
        ``swing:reference``, each (m,).

    Raises
    ------
    UsageError
        For a file that is no such series; the message names row and column.
    """
    top, rows = experiment.top, read_rows(file, experiment.top, given)
    taken, origin = len(rows.t) - 1, "rows - 1"
    if steps is not None:
        taken, origin = steps, "--steps"
    elif rows.n is not None:
        taken, origin = int(rows.n[-1] - rows.n[0]), "column n"
    invariants, left, times = _judged(experiment, rows, taken)
    about, reference = _reference(experiment, rows)
    place = top.components.index(top.swing)
    series = {"t": rows.t, SWING: rows.states[:, place]}
    if reference is not None:
        with np.errstate(over="ignore"):
            series[ERROR] = np.linalg.norm(rows.states - reference, axis=1)
        series[f"{SWING}:reference"] = reference[:, place]
    for invariant in top.invariants():
        with np.errstate(all="ignore"):
            values = invariant.value(rows.states)
            series[f"{DEVIATION}:{invariant.name}"] = np.abs(values - values[0])
    error = series.get(ERROR)
    summary = {
        "file": str(file.path),
        "sha256": sha256_of(file.path),
        "config": experiment.resolved(),
        "top": top.kind,
        "top_title": top.title,
        "rows": len(rows.t),
        "t_first": float(rows.t[0]),
        "t_last": float(rows.t[-1]),
        "times": times,
        "steps": taken,
        "steps_from": origin,
        "reference": about,
        "max_error": None if error is None else float(error.max()),
        "final_error": None if error is None else float(error[-1]),
        "swing": _swings(top, rows.t, series[SWING], series.get(f"{SWING}:reference")),
        "left_motion": None if left is None else {"row": left + 1, "t": float(rows.t[left])},
        "unread": unread_components(file, top),
    }
    return Result(report_data(summary, invariants), series)
