"""``topcli analyse``: analyse a time series of another program like a run."""

from __future__ import annotations

import bz2
import csv
import gzip
import lzma
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from topcli.analysis.reference import reference_states
from topcli.analysis.swings import first_swing_spacing, swing_times
from topcli.analysis.tally import invariant_report
from topcli.analysis.verdict import InvariantRow
from topcli.config.load import load_experiment
from topcli.contracts import Array, Top
from topcli.errors import TopcliError, UsageError, counted, nearest, quoted, shortened
from topcli.runs.report import invariant_table, open_lines
from topcli.studies import SILENT, Watch
from topcli.studies.report import Report, Table
from topcli.table import ten_digits

if TYPE_CHECKING:
    import pandas as pd

START_AGREEMENT = 1e-6
"""Difference from the config's initial state, relative to its largest component, that writing few digits explains."""
_EVEN = 1e-6
"""Deviation from even times, in units of their spacing, that writing few digits explains."""
BRIEF = ("max_deviation", "drift", "drift_error", "model", "verdict")
"""Fields of an invariant that are shown without --verbose."""
LOOKED_AT = 100
"""Lines of a CSV file from which its form is taken."""
OPENERS: Mapping[str, Callable[..., Any]] = {".gz": gzip.open, ".bz2": bz2.open, ".xz": lzma.open}


def analyse(
    path: str | Path,
    *,
    config: str | Path | Mapping[str, Any],
    overrides: Sequence[str] = (),
    rename: Sequence[str] = (),
    steps: int | None = None,
    watch: Watch = SILENT,
) -> Report:
    """Analyse a time series that another program computed.

    The report on the series has the same form as the report of a run. The times may start anywhere, increase or
    decrease, and have uneven spacing, for which there are deviations but no drifts. The reference solution starts from
    the initial state of the config if the first row agrees with this state to 1e-6, and otherwise from the first row.

    Parameters
    ----------
    path : path or str
        CSV or Parquet file with the time t and the components of the state as columns. CSV has commas, semicolons, tabs
        or spaces between columns, with semicolons or tabs also decimal commas, and may be compressed.
    config : path, str or mapping
        Config that gives the top and the initial state.
    overrides : sequence of str, optional
        Override a key of the config, e.g. h=0.01, top.c0=-1, scheme.branch=sign.
    rename : sequence of str, optional
        Read t or a component from another column or a formula of columns, e.g. t=time or omega1=w_x/2.
    steps : int, optional
        Number of steps that the program took, for the bound of round-off. By default, it is the difference between the
        last and the first step number in a column n or, without this column, the number of rows minus 1.
    watch : Watch, optional
        Observer of the study.

    Returns
    -------
    Report
        ``table`` has the numbers of rows and steps, the errors against the reference solution, and the spacing of the
        first swings (falls of the top); the second table has the deviations and drifts of the invariants. ``columns``
        contains the error and the deviations over the time.

    Raises
    ------
    UsageError
        If the file is not a series of this top. The message names the row and the column.
    """
    if steps is not None and steps < 1:
        raise UsageError(f"--steps {steps}: must be at least 1")
    experiment = load_experiment(config, overrides, any_precision=isinstance(config, Mapping))
    path, top = Path(path), experiment.top
    t, states, counted_steps = _series(path, top, rename)
    taken = steps or counted_steps or len(t) - 1
    watch.begin("analyse", experiment)
    invariants, left, kind = _judged(top, t, states, taken)
    notes = open_lines([(row.symbol, row.as_dict()) for row in invariants])
    if left is not None:
        notes.append(f"warning: {path}: far off its energy surface at row {left + 1} (t = {t[left]:.6g})")

    # from the config's initial state, so that rounding in the file is not taken for the motion
    y0 = np.array(experiment.y0, dtype=float)
    difference = float(np.abs(states[0] - y0).max())
    agrees = difference <= START_AGREEMENT * np.abs(y0).max()
    reference, no_error = _reference(top, y0 if agrees else states[0], t)
    columns = {"t": t, **_deviations(top, states, reference)}
    spacing, no_minima = _first_spacings(top, t, states, reference)
    notes = [*no_error, *notes, *no_minima]
    error = columns.get("error")
    summary = {
        "rows": len(t),
        "times": f"{ten_digits(float(t[0]))} to {ten_digits(float(t[-1]))}, {kind}",
        "steps": taken,
        "steps from": "--steps" if steps else "column n" if counted_steps else "rows - 1",
        "reference from": "none" if error is None else "the config's initial state" if agrees else "the first row",
        "first row − config": difference,
        "max error": None if error is None else float(error.max()),
        "final error": None if error is None else float(error[-1]),
        f"first spacing of minima of {top.swing}": spacing,
    }
    laws = invariant_table([row.as_dict() for row in invariants])
    tables = [
        Table("Series", [{"figure": name, "value": value} for name, value in summary.items()]),
        replace(laws, across=False, detail=[key for key in laws.columns()[1:] if key not in BRIEF]),
    ]
    title, draw = f"{path}: {top.title}", partial(_draw, columns, path.name)
    return Report("analyse", title, "", tables, notes, config=experiment.resolved(), columns=columns, draw=draw)


def _reference(top: Top, y0: Array, t: Array) -> tuple[Array | None, list[str]]:
    """States of the reference from ``y0`` at the times ``t`` (m,); None and a warning if it is out of reach."""
    try:
        return reference_states(top, tuple(y0.tolist()), t - t[0]), []
    except TopcliError as failure:
        return None, [f"warning: no error: {failure.lines[0]}"]


def _deviations(top: Top, states: Array, reference: Array | None) -> dict[str, Array]:
    """Distances from the reference, if there is one, and deviations of the invariants from their first values."""
    with np.errstate(all="ignore"):
        error = {} if reference is None else {"error": np.linalg.norm(states - reference, axis=1)}
        values = {invariant.symbol: invariant.value(states) for invariant in top.invariants()}
        return error | {f"deviation of {symbol}": np.abs(each - each[0]) for symbol, each in values.items()}


def _first_spacings(top: Top, t: Array, states: Array, reference: Array | None) -> tuple[str, list[str]]:
    """First spacing of swings in the series and in the reference, and a warning if the rows are too few to show it."""
    series = [states] if reference is None else [states, reference]
    notes, texts = [], [ten_digits(None)] * len(series)
    try:
        texts = [ten_digits(first_swing_spacing(swing_times(top, t, each))) for each in series]
    except UsageError as failure:
        notes = [f"warning: no minima: {failure.lines[0]}"]
    return texts[0] + "".join(f" (reference {text})" for text in texts[1:]), notes


def _draw(columns: Mapping[str, Array], name: str, axes: Any, looks: Callable[..., Any]) -> None:
    """Draw the error and the deviations over time."""
    for label, values in columns.items():
        if label != "t":
            axes.semilogy(columns["t"], np.where(values > 0.0, values, np.nan), label=label)
    axes.set(xlabel="time $t$", ylabel="error, deviations", title=name.replace("$", r"\$"))


def read_frame(path: Path) -> pd.DataFrame:
    """Table of a CSV or Parquet file. Raises UsageError, in one line, for a file that is neither."""
    import pandas as pd

    try:
        if path.suffix == ".parquet":
            return pd.read_parquet(path)
        with OPENERS.get(path.suffix, open)(path, "rt", encoding="utf-8-sig", newline="") as file:
            lines = [line.strip() for line in islice(file, LOOKED_AT)]
        # the header is the first line, or before a line of numbers the last comment, as numpy.savetxt writes it
        filled = [i for i, line in enumerate(lines) if line]
        data = [i for i in filled if not lines[i].startswith("#")]
        above = [i for i in filled if i < min(data, default=len(lines))]
        names_first = data and not re.match(r"[-+]?\.?\d", lines[data[0]])
        header = data[0] if names_first else max(above, default=None)
        if header is None:
            raise ValueError("it has no line of names")
        text = lines[header].lstrip("# ")
        separator = next((mark for mark in ";\t," if mark in text), " ")
        names = next(csv.reader([text], delimiter=separator, skipinitialspace=True))
        comma = separator in ";\t" and any("," in lines[i] for i in data if i > header)
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # rows that are longer than the header
            return pd.read_csv(
                path,
                sep=r"\s+" if separator == " " else separator,
                decimal="," if comma else ".",
                names=[name.strip() for name in names],
                skiprows=header + 1,
                comment="#",
                index_col=False,
                skipinitialspace=True,
                na_filter=False,
                encoding="utf-8",
            )
    except Exception as error:  # of the file, its compression, its encoding or its form
        kind = "Parquet" if path.suffix == ".parquet" else "CSV with a header"
        reason = shortened(getattr(error, "strerror", None) or str(error).partition("\n")[0])
        raise UsageError(f"{path}: cannot be read as {kind} ({reason})") from None


def _column(path: Path, frame: pd.DataFrame, source: str) -> Array:
    """Finite numbers of a column, or of a formula of columns. Raises UsageError."""
    import pandas as pd

    try:
        cells = frame[source] if source in frame else frame.eval(source)
        assert isinstance(cells, pd.Series)
    except Exception as error:  # pandas' words on a formula
        hint = nearest(source, list(map(str, frame.columns)))
        reason = shortened(str(error))
        raise UsageError(f"{path}: {quoted(source)}: no column and no formula of columns ({reason}); {hint}") from None
    values = np.full(len(cells), np.nan)
    if cells.dtype.kind in "iufO":  # no dates, whose numbers would be nanoseconds
        values = np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values)))
        cell = quoted(str(cells.iloc[row]))
        raise UsageError(f"{path}: row {row + 1}: {source} is not a finite number: {cell}")
    return values


def _series(path: Path, top: Top, rename: Sequence[str]) -> tuple[Array, Array, int | None]:
    """Times (m,), states (m, d), and the steps between the ends by a column n, if any. Raises UsageError."""
    frame, names = read_frame(path), ("n", "t", *top.components)
    sources: dict[str, str] = {}
    for pair in (part for text in rename for part in text.split(",") if part.strip()):
        name, _, source = (part.strip() for part in pair.partition("="))
        if not (name and source):
            raise UsageError(f"--rename {quoted(pair)}: write NAME=COLUMN, such as {top.components[0]}=w_x")
        if name not in names:
            raise UsageError(f"--rename {quoted(pair)}: unknown name {quoted(name)}; {nearest(name, names)}")
        sources[name] = source
    missing = [name for name in names[1:] if name not in sources and name not in frame]
    if missing:
        hint = f"{nearest(missing[0], list(map(str, frame.columns)))}; --rename {missing[0]}=COLUMN names it"
        raise UsageError(f"{path}: no column{'s' * (len(missing) > 1)} {', '.join(missing)}; {hint}")
    t, *components = (_column(path, frame, sources.get(name, name)) for name in names[1:])
    states = np.column_stack(components)

    # times that lead one way
    if len(t) < 2:
        raise UsageError(f"{path}: {counted(len(t), 'row')}; a series needs at least 2")
    order = "increase" if t[-1] >= t[0] else "decrease"
    wrong = ~((np.diff(t) if order == "increase" else -np.diff(t)) > 0.0)
    if wrong.any():
        row = int(np.argmax(wrong)) + 2
        raise UsageError(f"{path}: row {row}: t = {t[row - 1]} after {t[row - 2]}; times must {order} from row to row")

    # a column n may be another quantity
    if "n" not in sources and "n" not in frame:
        return t, states, None
    n = _column(path, frame, sources.get("n", "n"))
    counts = bool((np.diff(n) > 0.0).all() and (n == np.floor(n)).all() and np.abs(n).max() < 2.0**53)
    return t, states, int(n[-1] - n[0]) if counts else None


def _judged(top: Top, t: Array, states: Array, steps: int) -> tuple[list[InvariantRow], int | None, str]:
    """Report on the invariants, the index of the first row that left the energy surface, and the kind of times."""
    rows, span = np.arange(len(t)), float(t[-1] - t[0])
    spacing, rounding = span / rows[-1], 4.0 * np.finfo(np.float64).eps * np.abs(t).max()
    even = np.abs(t - (t[0] + rows * spacing)).max() <= _EVEN * abs(spacing) + rounding
    h, uneven_span = (spacing, None) if even else (1.0, span)
    return *invariant_report(top, top.invariants(), rows, h, states, steps, uneven_span), "even" if even else "uneven"
