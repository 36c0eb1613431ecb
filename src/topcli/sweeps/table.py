"""Tables of a sweep: a value or an aggregate of measures for each combination of keys."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from topcli.analysis.order import convergence
from topcli.errors import RunError, UnknownNameError, UsageError, nearest, quoted
from topcli.runs.report import finite
from topcli.sweeps.store import COMPLETED, ROWS_FILE
from topcli.table import DASH, Cells, is_number, number, plus_minus, significant

Frame = Any
"""A DataFrame or Series of pandas, whose operations have types that say nothing."""
ORDER, STEP = "order", "h"
SPREADS = {"median": "quartiles", "mean": "standard error", "max": "", ORDER: ""}
"""Aggregates, each with the spread that is given beside it, if there is one; ``order`` is the observed order in h."""
FORMATS = ("text", "csv", "markdown", "latex")
ENDS = ("", ":low", ":high")
CLOSE = 1e-9
"""Relative difference within which a number given for a key is its value in the file."""


def read_rows(folder: Path, where: Sequence[str] = ()) -> Frame:
    """Finished rows of the sweep in ``folder`` that satisfy the conditions ``key=value``, in the order of the sweep.

    ``attrs`` of the table holds the ``name`` of the sweep, the names of its ``keys`` and ``measures``, the keys whose
    range is logarithmic (``log``), the ``path`` of the file, and the conditions (``where``). Several values of one key
    are alternatives. Raises UsageError if there is no sweep or no such row, UnknownNameError for an unknown key, and
    RunError for a damaged file.
    """
    import pandas as pd

    path = folder / ROWS_FILE
    if not path.is_file():
        names = [file.parent.name for file in sorted(folder.parent.glob(f"*/{ROWS_FILE}"))]
        near = f"; {nearest(folder.name, names)}" if names else ""
        raise UsageError(f"{folder}: no sweep is stored here ({ROWS_FILE} is missing){near}")
    try:
        rows = pd.read_parquet(path)
        missing = {"row", "outcome", *rows.attrs["keys"], *rows.attrs["measures"]} - set(rows.columns)
    except (OSError, ValueError, KeyError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise RunError(f"{path}: cannot be read ({reason[:120]}); run topcli sweep again") from None
    if missing:
        raise RunError(f"{path}: not the rows of a sweep ({min(missing)} is missing)")
    if rows.empty:
        raise UsageError(f"{folder}: the sweep has no rows yet")
    rows.attrs |= {"path": str(path), "where": list(where)}
    return _selected(rows, where)


def _selected(rows: Frame, where: Sequence[str]) -> Frame:
    """Rows that satisfy the conditions."""
    equal: dict[str, Any] = {}
    for text in where:
        key, _, value = map(str.strip, text.partition("="))
        if not value:
            raise UsageError(f"--where {quoted(text)}: expected key=value, such as --where h=0.01")
        known, column = [*rows.attrs["keys"], "outcome"], rows.get(key)
        if key not in known or column is None:
            raise UnknownNameError(f"--where: unknown key {quoted(key)}; {nearest(key, known)}")
        if column.dtype.kind in "fi":
            number = float(value) if is_number(value) else math.nan
            same = np.isclose(column, number, rtol=CLOSE, atol=0.0)
        else:
            same = (column == value).to_numpy()
        if not same.any():
            values = ", ".join(key_labels(column).values())
            raise UsageError(f"--where {quoted(text)}: no row has this value; {key} is one of: {values}")
        equal[key] = equal.get(key, False) | same
    chosen = rows[np.logical_and.reduce([np.ones(len(rows), dtype=bool), *equal.values()])]
    if chosen.empty:
        raise UsageError("--where: no row satisfies all conditions")
    return chosen


def names_of(rows: Frame) -> str:
    """Keys and measures that a table or a figure may show, as a hint."""
    return f"keys: {', '.join(rows.attrs['keys'])}; measures: {', '.join(rows.attrs['measures'])}"


def require_names(rows: Frame, kind: str, names: Sequence[str], options: str) -> None:
    """Raise UnknownNameError for a name that is no key or measure, its ``kind``, and UsageError for one given twice."""
    known = rows.attrs[f"{kind}s"]
    for name in names:
        if name not in known:
            raise UnknownNameError(f"{options}: unknown {kind} {quoted(name)}; {nearest(name, known)}")
        if names.count(name) > 1:
            raise UsageError(f"{options}: {kind} {quoted(name)} is named twice")


def key_labels(values: Frame) -> dict[Any, str]:
    """Text of each different value of a key, in the order of their first appearance.

    Numbers of up to six digits are written in full, longer ones with three digits, or as many as keep them apart.
    """
    different, labels = values.unique().tolist(), {}
    for digits in range(3, 18):
        labels = {value: _label(value, digits) for value in different}
        if len(set(labels.values())) == len(labels):
            break
    return labels


def _label(value: Any, digits: int) -> str:
    if not isinstance(value, float):
        return str(value)
    short = f"{value:.6g}"
    text = short if float(short) == value else f"{value:.{digits}g}"
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}e{int(exponent)}" if e else text


def summary(values: Frame, aggregate: str | None) -> tuple[float, ...]:
    """Aggregate of values and the ends of its spread; empty without a value.

    The median has the quartiles, which halve the values below and above it; the mean has its standard error on both
    sides, if there are two values or more; the maximum, and a single value without ``aggregate``, have no spread.
    """
    values = values.dropna()
    if values.empty:
        return ()
    if aggregate == "median":
        levels, ordered = np.array([0.5, 0.25, 0.75]) * (len(values) - 1), np.sort(values.to_numpy(float))
        low, high, part = ordered[np.floor(levels).astype(int)], ordered[np.ceil(levels).astype(int)], levels % 1.0
        with np.errstate(invalid="ignore"):  # of infinite neighbours
            return tuple(np.where((low == high) | (part == 0.0), low, (1.0 - part) * low + part * high).tolist())
    if aggregate == "mean":
        mean = float(values.mean())
        error = float(values.sem()) if len(values) > 1 and math.isfinite(mean) else math.nan
        return (mean,) if math.isnan(error) else (mean, mean - error, mean + error)
    return (float(values.max()),)


@dataclass(frozen=True)
class SweepTable:
    """Table of a sweep: ``cells`` are an aggregate with its spread; ``title`` and ``notes`` say what they are."""

    cells: Frame
    aggregate: str | None
    title: str
    notes: list[str]

    def lines(self) -> list[list[str]]:
        """Texts of the table, with rounded numbers, the header first."""
        texts = self.cells.map(lambda cell: cell_text(cell, self.aggregate)).reset_index()
        for key in self.cells.index.names:
            texts[key] = texts[key].map(key_labels(texts[key]))
        return [[str(name) for name in texts.columns], *texts.to_numpy().tolist()]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON, with all digits: each cell holds a value and the ends of its spread."""
        lines = [
            {"row": list(key) if isinstance(key, tuple) else [key], "cells": list(cells)}
            for key, *cells in self.cells.itertuples()
        ]
        names = {"rows": list(self.cells.index.names), "columns": list(map(str, self.cells.columns))}
        return finite({"title": self.title, **names, "aggregate": self.aggregate, "table": lines, "notes": self.notes})

    def text(self, form: str) -> str:
        """Table as ``csv`` with all digits, or with rounded numbers as ``markdown`` or ``latex``."""
        if form == "csv":
            import pandas as pd

            ends = ENDS if SPREADS.get(self.aggregate or "") else ENDS[:1]
            wide = {f"{name}{end}": self.cells[name].str[i] for name in self.cells for i, end in enumerate(ends)}
            return pd.DataFrame(wide).to_csv(lineterminator="\n")
        header, *lines = self.lines()
        cells = Cells(self.title, header, lines, ". ".join(self.notes), self.cells.index.nlevels)
        if form == "latex":
            return "\n".join(cells.latex(self.title)) + "\n"
        notes = [f"{note}." for note in self.notes]
        return "\n".join([f"{self.title}:", "", *cells.markdown(), "", *notes]) + "\n"


def cell_text(cell: tuple[float, ...], aggregate: str | None) -> str:
    """Text of a cell: three digits; a mean to the second digit of its error.

    Quartiles and median end where their distance has two significant digits, but have two themselves at least.
    """
    if not cell:
        return DASH
    value, *spread = cell
    if not spread:
        return f"{value:.2f}" if aggregate == ORDER else number(value)
    low, high = spread
    if aggregate == "mean":
        return plus_minus(value, high - value)
    width = high - low
    if not (math.isfinite(width) and width > 0.0):
        return f"{number(value)} [{number(low)}, {number(high)}]"
    place = _exponent(float(f"{width:.1e}")) - 1  # of the second digit of the width
    texts = (significant(each, max(2, min(_exponent(each) - place + 1, 15))) for each in cell)
    return "{} [{}, {}]".format(*texts)


def _exponent(value: float) -> int:
    """Decimal exponent of a number; 0 for zero."""
    return math.floor(math.log10(abs(value))) if value else 0


def sweep_table(
    rows: Frame, index: Sequence[str], column: str | None, measures: Sequence[str], aggregate: str | None
) -> SweepTable:
    """Table of ``measures`` with a line for each combination of values of the keys ``index``.

    The columns are the values of the key ``column``, or the measures without one. Raises UnknownNameError for unknown
    names, and UsageError if several rows fall into one cell without an ``aggregate``.
    """
    import pandas as pd

    keys = [*index, *([column] if column else [])]
    require_names(rows, "key", keys, "--rows and --columns")
    require_names(rows, "measure", measures, "--value")
    if column and len(measures) > 1:
        raise UsageError(f"--columns {column}: the columns show a single --value; {len(measures)} are given")
    grouped = grouped_rows(rows, keys, aggregate)
    cells: Frame = pd.DataFrame({name: aggregated(grouped, name, aggregate) for name in measures})
    if column:
        cells = cells[measures[0]].unstack(column)[list(rows[column].unique())]
        cells.columns = [f"{column} = {label}" for label in key_labels(rows[column]).values()]
        cells = cells.map(lambda cell: cell if isinstance(cell, tuple) else ())  # where the sweep has no such row

    # title: measures, aggregate with its spread, the keys over which it is taken, and the conditions
    over = [key for key in rows.attrs["keys"] if key not in keys and (grouped[key].nunique(dropna=False) > 1).any()]
    title = f"{', '.join(measures)} of {rows.attrs['name']}"
    if aggregate:
        spread = {"quartiles": " [quartiles]", "standard error": " ± standard error"}.get(SPREADS[aggregate], "")
        title += f": {'observed ' * (aggregate == ORDER)}{aggregate}{spread}"
        title += f" over {', '.join(over)}" if over else ""
    title = ", ".join([title, *rows.attrs["where"]])
    few, most = int(grouped.size().min()), int(grouped.size().max())
    notes = [f"{few if few == most else f'{few} to {most}'} rows in each cell"] if aggregate else []
    return SweepTable(cells, aggregate, title, [*notes, *missing_notes(rows, measures)])


def grouped_rows(rows: Frame, keys: Sequence[str], aggregate: str | None) -> Any:
    """Rows grouped by ``keys``, in the order of their first appearance: those of a cell.

    Raises UsageError for an unknown aggregate, and if a group has several rows without an ``aggregate``, or several at
    one h for an order.
    """
    if aggregate not in (None, *SPREADS):
        raise UsageError(f"--aggregate {quoted(str(aggregate))}: unknown; {nearest(str(aggregate), SPREADS)}")
    single = list(keys)
    if aggregate == ORDER:
        if STEP not in rows.attrs["keys"] or STEP in keys:
            raise UsageError("--aggregate order: fits a measure against h, which must vary within a cell")
        single.append(STEP)
    most = rows.groupby(single, sort=False, dropna=False)
    if aggregate in (None, ORDER) and (size := int(most.size().max())) > 1:
        vary = [key for key in rows.attrs["keys"] if key not in single and (most[key].nunique(dropna=False) > 1).any()]
        advice = f"choose with --where {vary[0]}=VALUE, or add --aggregate median" if vary else "add --aggregate median"
        because = f", because {', '.join(vary)} still {'varies' if len(vary) == 1 else 'vary'}" if vary else ""
        raise UsageError(f"up to {size} values fall into one cell{because}", advice)
    return rows.groupby(list(keys), sort=False, dropna=False)


def aggregated(grouped: Any, measure: str, aggregate: str | None) -> Frame:
    """Aggregate of a measure, with its spread, for each group of rows; empty without a value, or without an order."""
    import pandas as pd

    cells = {}
    for keys, rows in grouped:
        values = rows[measure]
        if aggregate == ORDER:
            known = values.notna()
            order = convergence(rows[STEP][known].tolist(), values[known].tolist()).order if known.any() else None
            cells[keys] = () if order is None else (order,)
        else:
            cells[keys] = summary(values, aggregate)
    return pd.Series(list(cells.values()), index=grouped.size().index, dtype=object)


def missing_notes(rows: Frame, measures: Sequence[str]) -> list[str]:
    """Sentences on rows that did not complete, and on those without a value of one of the ``measures``."""
    outcomes, notes = rows["outcome"][rows["outcome"] != COMPLETED].value_counts(), []
    if len(outcomes):
        listed = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
        notes.append(f"{outcomes.sum()} of {len(rows)} rows did not complete: {listed}")
    if missing := int(rows[list(measures)].isna().any(axis=1).sum()):
        notes.append(f"{missing} of {len(rows)} rows have no value and are left out")
    return notes
