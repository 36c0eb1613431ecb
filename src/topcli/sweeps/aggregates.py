"""Tables of a sweep: a value or an aggregate of measures for each combination of keys."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from topcli.errors import RunError, UnknownNameError, UsageError, nearest, quoted
from topcli.sweeps.store import COMPLETED, ROWS_FILE
from topcli.table import DASH, Cells, Format, Table, is_number, number, plus_minus, significant

Frame = Any
"""A DataFrame or Series of pandas, whose operations have types that say nothing."""
SPREADS = {"median": " [quartiles]", "mean": " ± standard error", "max": ""}
"""Aggregates, each with the spread that is given beside it."""
ENDS = ("", ":low", ":high")
_CLOSE = 1e-9
"""Relative difference within which a number given for a key is its value in the file."""


def read_rows(folder: Path, where: Sequence[str] = ()) -> Frame:
    """Finished rows of the sweep in ``folder`` that satisfy the conditions ``key=value``, in the order of the sweep.

    ``attrs`` of the table holds the ``name`` of the sweep, the names of its ``keys`` and ``measures``, the ``path`` of
    the file, and the conditions (``where``). Several values of one key
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
        rows: Frame = pd.read_parquet(path)
        keys = rows.attrs["keys"]
    except (OSError, ValueError, KeyError) as error:
        raise RunError(f"{path}: cannot be read ({str(error)[:120]}); run topcli sweep again") from None
    rows.attrs |= {"path": str(path), "where": list(where)}
    # conditions on one key are alternatives, those on different keys hold together
    chosen: dict[str, Any] = {}
    for text in where:
        key, _, value = map(str.strip, text.partition("="))
        if not value:
            raise UsageError(f"--where {quoted(text)}: expected key=value, such as --where h=0.01")
        if key not in (*keys, "outcome"):
            raise UnknownNameError(f"--where: unknown key {quoted(key)}; {nearest(key, [*keys, 'outcome'])}")
        column: Frame = rows[key]
        same: Frame = column == value
        if column.dtype.kind in "fi":
            same = np.isclose(column, float(value) if is_number(value) else math.nan, rtol=_CLOSE, atol=0.0)
        if not same.any():
            values = ", ".join(key_labels(column).values())
            raise UsageError(f"--where {quoted(text)}: no row has this value; {key} is one of: {values}")
        chosen[key] = chosen.get(key, False) | same
    rows = rows[np.logical_and.reduce([np.ones(len(rows), dtype=bool), *chosen.values()])]
    if rows.empty:
        raise UsageError(f"{folder}: the sweep has no such row" if where else f"{folder}: the sweep has no rows yet")
    return rows


def names_hint(rows: Frame) -> str:
    """Keys and measures that a table or a figure may show, as a hint."""
    return f"keys: {', '.join(rows.attrs['keys'])}; measures: {', '.join(rows.attrs['measures'])}"


def require_names(rows: Frame, kind: str, names: Sequence[str], options: str) -> None:
    """Raise UnknownNameError for a name that is no key or measure, its ``kind``, and UsageError for one given twice."""
    present = rows.attrs[f"{kind}s"]
    for name in names:
        if name not in present:
            raise UnknownNameError(f"{options}: unknown {kind} {quoted(name)}; {nearest(name, present)}")
        if names.count(name) > 1:
            raise UsageError(f"{options}: {kind} {quoted(name)} is named twice")


def key_labels(values: Frame) -> dict[Any, str]:
    """Text of each different value of a key, in the order of their first appearance; numbers with up to six digits.

    All digits are written if these do not tell the values apart.
    """
    different, texts = values.unique().tolist(), []
    for value in different:
        texts.append(re.sub(r"e\+?(-?)0*", r"e\1", f"{value:.6g}") if isinstance(value, float) else str(value))
    return dict(zip(different, texts if len({*texts}) == len(texts) else map(str, different), strict=True))


def aggregate_of(values: Frame, aggregate: str) -> tuple[float, ...]:
    """Aggregate of values and the ends of its spread; empty without a value.

    The median has the quartiles, which halve the values below and above it; the mean has its standard error on both
    sides, if there are two values or more; the maximum has no spread.
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


class SweepTable(Table):
    """Table of a sweep, whose cells are tuples: a value, or an aggregate with the ends of its spread; empty for none.

    The columns that are not right-aligned are the keys of a line.
    """

    def cells(self, verbose: bool = True) -> Cells:
        """Texts of the table, with rounded numbers."""
        return replace(super().cells(verbose), keys=len(self.columns()) - len(self.right or ()))

    def frame(self) -> Frame:
        """DataFrame with all digits, indexed by the keys; the ends of a spread have columns of their own."""
        import pandas as pd

        cells, names = pd.DataFrame(list(self.rows)), self.right or ()
        width = max(cells[name].str.len().max() for name in names)
        ends = {f"{name}{end}": cells[name].str[i] for name in names for i, end in enumerate(ENDS[:width])}
        return pd.DataFrame({**cells.drop(columns=list(names)), **ends}).set_index(self.columns()[: -len(names)])


def cell_text(cell: tuple[float, ...], aggregate: str | None) -> str:
    """Text of a cell: three digits; a mean to the second digit of its error.

    Quartiles and median end where their distance has two significant digits, but have two themselves at least.
    """
    if not cell:
        return DASH
    value, *spread = cell
    if not spread:
        return number(value)
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


def sweep_cells(
    rows: Frame, index: Sequence[str], column: str | None, measures: Sequence[str], aggregate: str | None
) -> Frame:
    """Cells of ``measures`` with a line for each combination of values of the keys ``index``, as tuples.

    The columns are the values of the key ``column``, or the measures without one. ``attrs`` holds the ``sizes``, the
    smallest and largest numbers of rows of a cell, and the keys ``over`` which an aggregate is taken. Raises
    UnknownNameError for unknown names, and UsageError if several rows fall into one cell without an ``aggregate``.
    """
    import pandas as pd

    keys = [*index, *([column] if column else [])]
    require_names(rows, "key", keys, "--rows and --columns")
    require_names(rows, "measure", measures, "--value")
    if column and len(measures) > 1:
        raise UsageError(f"--columns {column}: the columns show a single --value; {len(measures)} are given")
    if aggregate not in (None, *SPREADS):
        raise UsageError(f"--aggregate {quoted(str(aggregate))}: unknown; {nearest(str(aggregate), SPREADS)}")

    # rows of a cell, and the keys that vary in it
    grouped = rows.groupby(keys, sort=False, dropna=False)
    sizes, rest = grouped.size(), [key for key in rows.attrs["keys"] if key not in keys]
    over = [key for key in rest if (grouped[key].nunique(dropna=False) > 1).any()]
    few, most = int(sizes.min()), int(sizes.max())
    if aggregate is None and most > 1:
        advice = f"choose with --where {over[0]}=VALUE, or add --aggregate median" if over else "add --aggregate median"
        because = f", because {', '.join(over)} still {'varies' if len(over) == 1 else 'vary'}" if over else ""
        raise UsageError(f"up to {most} values fall into one cell{because}", advice)
    if aggregate is None:  # each group is one row, in the order of the rows
        numbers = rows[list(measures)].astype(float)
        cells = {name: [() if math.isnan(value) else (value,) for value in numbers[name]] for name in measures}
    else:
        cells = {name: [aggregate_of(part, aggregate) for _, part in grouped[name]] for name in measures}
    values: Frame = pd.DataFrame({name: pd.Series(of, sizes.index, dtype=object) for name, of in cells.items()})
    if column:
        values = values[measures[0]].unstack(column)[list(rows[column].unique())]
        values.columns = [f"{column} = {label}" for label in key_labels(rows[column]).values()]
        values = values.map(lambda cell: cell if isinstance(cell, tuple) else ())  # where the sweep has no such row
    values.attrs = {"sizes": (few, most), "over": over}
    return values


def sweep_table(
    rows: Frame, index: Sequence[str], column: str | None, measures: Sequence[str], aggregate: str | None
) -> SweepTable:
    """Table of the ``sweep_cells`` of these arguments, with the errors that these raise."""
    values = sweep_cells(rows, index, column, measures, aggregate)
    # title: measures, aggregate with its spread, the keys over which it is taken, and the conditions
    title = f"{', '.join(measures)} of {rows.attrs['name']}"
    over, (few, most) = values.attrs["over"], values.attrs["sizes"]
    if aggregate:
        title += f": {aggregate}{SPREADS[aggregate]}" + (f" over {', '.join(over)}" if over else "")
    notes = [f"{few if few == most else f'{few} to {most}'} rows in each cell"] if aggregate else []
    formats: dict[str, Format] = {name: partial(cell_text, aggregate=aggregate) for name in values}
    formats |= {key: key_labels(rows[key]).__getitem__ for key in index}
    lines, caption = values.reset_index().to_dict("records"), "; ".join([*notes, *missing_notes(rows, measures)])
    return SweepTable(", ".join([title, *rows.attrs["where"]]), lines, formats, right=list(values), caption=caption)


def missing_notes(rows: Frame, measures: Sequence[str]) -> list[str]:
    """Sentences on rows that did not complete, and on those without a value of one of the ``measures``."""
    outcomes, notes = rows["outcome"][rows["outcome"] != COMPLETED].value_counts(), []
    if len(outcomes):
        listed = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items())
        notes.append(f"{outcomes.sum()} of {len(rows)} rows did not complete: {listed}")
    if missing := int(rows[list(measures)].isna().any(axis=1).sum()):
        notes.append(f"{missing} of {len(rows)} rows have no value and are left out")
    return notes
