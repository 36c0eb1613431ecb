"""Tables of a sweep: a value or an aggregate for each combination of rows and columns."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.order import convergence
from topcli.contracts import Array
from topcli.errors import UsageError, nearest, quoted
from topcli.runs.report import finite
from topcli.sweeps.rows import SweepRows, encoded, key_labels

ORDER = "order"
"""Observed order of a measure: the slope of its logarithm against that of h."""
SPREADS = {"median": "quartiles", "mean": "standard error", "max": "", ORDER: ""}
"""Aggregates, each with the spread that is given beside it, if there is one."""
STEP = "h"


@dataclass(frozen=True)
class Summary:
    """One number for several: its ``value``, and the interval from ``low`` to ``high``, None without a spread."""

    value: float
    low: float | None = None
    high: float | None = None


def summary(values: Array, aggregate: str) -> Summary:
    """Aggregate of ``values`` (m,), m > 0, with its spread.

    The median has the quartiles, which halve the values below and above it; the mean has its standard error, on both
    sides, if there are two values or more; the maximum has no spread.
    """
    if aggregate == "max":
        return Summary(float(values.max()))
    with np.errstate(invalid="ignore", over="ignore"):  # of infinite values
        if aggregate == "median":
            low, middle, high = _quantiles(values, np.array([0.25, 0.5, 0.75])).tolist()
            return Summary(middle, low, high)
        mean = float(values.mean())
        error = float(values.std(ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return Summary(mean, mean - error, mean + error) if math.isfinite(error) else Summary(mean)


def _quantiles(values: Array, levels: Array) -> Array:
    """Quantiles as numpy interpolates them; it makes nan of infinite neighbours, which are averaged instead."""
    quantiles = np.quantile(values, levels)
    if np.isnan(quantiles).any():
        place = levels * (len(values) - 1)
        part = place % 1.0
        low, high = (np.sort(values)[round_(place).astype(int)] for round_ in (np.floor, np.ceil))
        quantiles = np.where(part > 0.0, (1.0 - part) * low + part * high, low)
    return quantiles


@dataclass(frozen=True)
class Cell:
    """Content of one cell of a table.

    ``count`` of its ``rows`` have a value; ``outcomes`` counts the rows that did not complete, by outcome. ``summary``
    is None without a value; both are zero where the sweep has no such row.
    """

    summary: Summary | None
    count: int
    rows: int
    outcomes: Mapping[str, int]

    @property
    def incomplete(self) -> bool:
        """True if a row of the cell did not complete or has no value."""
        return self.count < self.rows or bool(self.outcomes)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON."""
        data = {**asdict(self), **asdict(self.summary or Summary(math.nan))}
        return finite({key: data[key] for key in ("value", "low", "high", "count", "rows", "outcomes")})


@dataclass(frozen=True)
class SweepTable:
    """Cells of a table, with the keys and texts of its rows and columns.

    Attributes
    ----------
    source : SweepRows
        Rows of the sweep that the cells are made of.
    row_keys : tuple of str
        Keys that name a row.
    column_key : str or None
        Key whose values are the columns; None if the columns are measures.
    measures : tuple of str
        Measures shown: one with a ``column_key``, else one for each column.
    aggregate : str or None
        How the values of several rows become one; None if each cell has at most one.
    over : tuple of str
        Keys that vary within a cell.
    columns : mapping of values to str
        Values of the ``column_key``, or the measures, and their texts.
    lines : mapping of tuples to tuples of Cell
        Cells of each row of the table by the values of its ``row_keys``.
    """

    source: SweepRows
    row_keys: tuple[str, ...]
    column_key: str | None
    measures: tuple[str, ...]
    aggregate: str | None
    over: tuple[str, ...]
    columns: Mapping[Any, str]
    lines: Mapping[tuple[Any, ...], tuple[Cell, ...]]

    @property
    def row_labels(self) -> list[list[str]]:
        """Texts of the values of the ``row_keys`` for each row of the table."""
        labels = [key_labels(self.source.columns[key]) for key in self.row_keys]
        return [[texts[value] for texts, value in zip(labels, line, strict=True)] for line in self.lines]

    @property
    def cells(self) -> list[Cell]:
        """All cells."""
        return [cell for line in self.lines.values() for cell in line]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, ready for JSON, with all digits."""
        return {
            "sweep": self.source.name,
            "rows": list(self.row_keys),
            "columns": self.column_key,
            "values": list(self.measures),
            "aggregate": self.aggregate,
            "spread": SPREADS.get(self.aggregate or "") or None,
            "over": list(self.over),
            "where": list(self.source.chosen),
            "left_out": self.source.left_out,
            "column_values": list(self.columns),
            "table": [
                {"row": list(values), "cells": [cell.as_dict() for cell in cells]}
                for values, cells in self.lines.items()
            ],
        }


def require_aggregate(aggregate: str | None) -> None:
    """Raise UsageError for an unknown aggregate."""
    if aggregate is not None and aggregate not in SPREADS:
        known = nearest(aggregate, SPREADS)
        raise UsageError(f"--aggregate {quoted(aggregate)}: unknown aggregate; {known}")


def groups(rows: SweepRows, keys: Sequence[str]) -> dict[tuple[Any, ...], NDArray[np.int64]]:
    """Indices of the rows for each combination of values of ``keys``, in the order of their first appearance."""
    columns = [encoded(rows.columns[key]) for key in keys]
    combined = np.zeros(len(rows), dtype=np.int64)
    for codes, different in columns:
        _, combined = np.unique(combined * len(different) + codes, return_inverse=True)
    _, first, counts = np.unique(combined, return_index=True, return_counts=True)
    members = np.split(np.argsort(combined, kind="stable"), np.cumsum(counts)[:-1])
    return {
        tuple(different[codes[first[group]]] for codes, different in columns): members[group]
        for group in np.argsort(first)
    }


def varying(rows: SweepRows, members: Mapping[tuple[Any, ...], NDArray[np.int64]]) -> tuple[str, ...]:
    """Keys that have several values within one of the groups ``members``."""
    several = [indices for indices in members.values() if len(indices) > 1]
    columns = {key: encoded(rows.columns[key])[0] for key in rows.keys}
    return tuple(key for key, codes in columns.items() if any(np.ptp(codes[indices]) > 0 for indices in several))


def aggregated(rows: SweepRows, indices: NDArray[np.int64], measure: str, aggregate: str | None) -> Summary | None:
    """Aggregate of a measure over the rows with these ``indices``; None if they have no value, or no order."""
    values = rows.columns[measure][indices].astype(float)
    known = ~np.isnan(values)
    if not known.any():
        return None
    if aggregate == ORDER:
        order = convergence(rows.columns[STEP][indices][known].tolist(), values[known].tolist()).order
        return None if order is None else Summary(order)
    return summary(values[known], aggregate or "max")  # without an aggregate there is one value


def require_groups(
    rows: SweepRows, keys: Sequence[str], place: str, options: Sequence[str], aggregate: str | None
) -> dict[tuple[Any, ...], NDArray[np.int64]]:
    """Return the ``groups`` of ``keys``.

    Raises UsageError if a group has several rows without an ``aggregate``, or several at one h for an order.
    ``place`` is what a group is called, ``options`` are those that could hold a key.
    """
    members = groups(rows, keys)
    if aggregate == ORDER:
        if STEP not in rows.keys:
            raise UsageError(f"--aggregate order: h does not vary; the keys are {', '.join(rows.keys)}")
        if STEP in keys:
            raise UsageError(
                f"--aggregate order: the order is fitted against h, so h cannot distinguish one {place} from another"
            )
        _require_single(rows, groups(rows, (*keys, STEP)), f"{place} at one h", options)
    elif aggregate is None:
        _require_single(rows, members, place, options)
    return members


def _require_single(
    rows: SweepRows, members: Mapping[tuple[Any, ...], NDArray[np.int64]], place: str, options: Sequence[str]
) -> None:
    """Raise UsageError if a group has several rows; the message names the keys that vary within it."""
    most = max(map(len, members.values()))
    if most < 2:
        return
    keys = varying(rows, members)
    if not keys:
        raise UsageError(f"{most} rows fall into one {place} although no key varies within it; add --aggregate median")
    named = ", ".join(keys)
    use = "".join(f", use {option} {keys[0]}" for option in options)
    raise UsageError(
        f"up to {most} values fall into one {place}, because {named} still {'varies' if len(keys) == 1 else 'vary'}",
        f"choose with --where {keys[0]}=VALUE{use}, or add --aggregate median",
    )


def sweep_table(
    rows: SweepRows, row_keys: Sequence[str], column_key: str | None, measures: Sequence[str], aggregate: str | None
) -> SweepTable:
    """Table of ``measures`` with a line for each combination of ``row_keys``.

    The columns are the values of ``column_key``, or the measures without one. Raises UsageError for unknown names, and
    if several rows fall into one cell without an ``aggregate``.
    """
    require_aggregate(aggregate)
    keys = [rows.require_key(name, "--rows") for name in row_keys]
    keys += [rows.require_key(column_key, "--columns")] if column_key else []
    if repeated := [key for key in keys if keys.count(key) > 1]:
        raise UsageError(f"key {quoted(repeated[0])} is named twice in --rows and --columns")
    for name in measures:
        rows.require_measure(name, "--value")
    if len(set(measures)) < len(measures):
        raise UsageError("--value: a measure is named twice")
    if column_key and len(measures) > 1:
        raise UsageError(f"--columns {column_key}: the columns show a single --value; {len(measures)} are given")
    members = require_groups(rows, keys, "cell", ("--rows",) if column_key else ("--rows", "--columns"), aggregate)
    columns = key_labels(rows.columns[column_key]) if column_key else dict(zip(measures, measures, strict=True))
    nothing, failed = np.array([], dtype=np.int64), ~rows.completed

    def cell(line: tuple[Any, ...], column: Any) -> Cell:
        values, measure = ((*line, column), measures[0]) if column_key else (line, column)
        indices = members.get(values, nothing)
        outcomes = Counter(map(str, rows.columns["outcome"][indices[failed[indices]]]))
        count = int((~np.isnan(rows.columns[measure][indices].astype(float))).sum())
        return Cell(aggregated(rows, indices, measure, aggregate), count, len(indices), dict(outcomes))

    lines = {line: tuple(cell(line, column) for column in columns) for line in groups(rows, row_keys)}
    over = varying(rows, members)
    return SweepTable(rows, tuple(row_keys), column_key, tuple(measures), aggregate, over, columns, lines)
