"""Rows of a finished or running sweep, read from ``DIR/NAME/rows.parquet`` for tables and figures."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Outcome
from topcli.errors import RunError, UnknownNameError, UsageError, nearest, quoted, shortened
from topcli.store.series import open_parquet

ROWS_FILE = "rows.parquet"
METADATA = "topcli.sweep"
OWN = ("row", "outcome", "current")
"""Columns that are read besides keys and measures."""
_CLOSE = 1e-9
"""Relative difference within which a number given for a key is its value in the file."""


@dataclass(frozen=True)
class SweepRows:
    """Current rows of a sweep in the order of the plan.

    Attributes
    ----------
    name : str
        Name of the sweep.
    path : Path
        File that the rows were read from.
    keys, measures : tuple of str
        Names of the varied keys and of the measures.
    log : tuple of str
        Keys whose range was logarithmic.
    columns : mapping of str to ndarray, shape (m,)
        Columns of the file.
    left_out : int
        Number of rows in the file that no longer belong to the sweep.
    chosen : tuple of str
        The conditions that the rows satisfy, as texts ``key = value``.
    """

    name: str
    path: Path
    keys: tuple[str, ...]
    measures: tuple[str, ...]
    log: tuple[str, ...]
    columns: Mapping[str, NDArray[Any]]
    left_out: int
    chosen: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.columns["row"])

    @property
    def completed(self) -> NDArray[np.bool_]:
        """True for the rows whose run was completed, shape (m,)."""
        return np.array(self.columns["outcome"] == Outcome.COMPLETED.value, dtype=bool)

    @property
    def names(self) -> str:
        """The keys and measures that a table or a figure may show, as a hint."""
        return f"keys: {', '.join(self.keys)}; measures: {', '.join(self.measures)}"

    def require_key(self, name: str, option: str) -> str:
        """Return the key ``name``. Raises UnknownNameError, naming the ``option`` and the nearest keys."""
        if name in self.measures and name not in self.keys:
            raise UsageError(f"{option}: {quoted(name)} is a measure; give a varied key: {', '.join(self.keys)}")
        return _require(name, self.keys, f"{option}: unknown key", f"keys of {self.path.parent}")

    def require_measure(self, name: str, option: str) -> str:
        """Return the measure ``name``. Raises UnknownNameError, naming the ``option`` and the nearest measures."""
        if name in self.keys and name not in self.measures:
            raise UsageError(f"{option}: {quoted(name)} is a key; give a measure: {', '.join(self.measures)}")
        return _require(name, self.measures, f"{option}: unknown measure", f"measures of {self.path.parent}")

    def where(self, conditions: Sequence[str]) -> SweepRows:
        """Return the rows that satisfy the ``conditions``, texts ``key=value``.

        Several values of one key are alternatives. Numbers need to agree to nine digits. Raises UsageError for a
        condition of another form or that no row satisfies, UnknownNameError for an unknown key.
        """
        wanted: dict[str, NDArray[np.bool_]] = {}
        for text in conditions:
            name, equals, value = (part.strip() for part in text.partition("="))
            if not equals or not value:
                raise UsageError(f"--where {quoted(text)}: expected key=value, such as --where h=0.01")
            known = (*self.keys, "outcome")
            _require(name, known, "--where: unknown key", f"keys of {self.path.parent}")
            equal = _equal(self.columns[name], value)
            if not equal.any():
                values = ", ".join(key_labels(self.columns[name]).values())
                raise UsageError(f"--where {quoted(text)}: no row has this value; {name} is one of: {values}")
            wanted[name] = wanted.get(name, np.zeros(len(self), dtype=bool)) | equal
        kept = np.logical_and.reduce([np.ones(len(self), dtype=bool), *wanted.values()])
        if not kept.any():
            raise UsageError("--where: no row satisfies all conditions")
        columns = {name: values[kept] for name, values in self.columns.items()}
        chosen = tuple(" = ".join(part.strip() for part in text.split("=", 1)) for text in conditions)
        return replace(self, columns=columns, chosen=(*self.chosen, *chosen))


def _require(name: str, known: Sequence[str], wrong: str, listed: str) -> str:
    if name in known:
        return name
    if not known:
        raise UsageError(f"{wrong} {quoted(name)}; there are no {listed}")
    raise UnknownNameError(f"{wrong} {quoted(name)}; {nearest(name, known)}")


def _equal(values: NDArray[Any], text: str) -> NDArray[np.bool_]:
    """True where a value of a column is that of ``text``."""
    if values.dtype.kind in "OU":
        same = [value == text or _json_equal(value, text) for value in values]
        return np.array(same, dtype=bool)
    try:
        number = float(text)
    except ValueError:
        return np.zeros(len(values), dtype=bool)
    return np.abs(values - number) <= _CLOSE * abs(number)


def _json_equal(text: str, other: str) -> bool:
    """True for equal vectors, however they are written."""
    try:
        return bool(json.loads(text) == json.loads(other))
    except ValueError:
        return False


def encoded(values: NDArray[Any]) -> tuple[NDArray[np.int64], list[Any]]:
    """Code of each value (m,), and the different values in the order of their first appearance; None for nan."""
    import pyarrow as pa

    coded = pa.array(values, from_pandas=True).dictionary_encode(null_encoding="encode")
    return coded.indices.to_numpy().astype(np.int64), coded.dictionary.to_pylist()


def key_labels(values: NDArray[Any]) -> dict[Any, str]:
    """Text of each different value of a key, in the order of their first appearance; a dash for None.

    Numbers of up to six digits are written in full, longer ones with three digits, or as many as keep them apart.
    """
    _, different = encoded(values)
    labels: dict[Any, str] = {}
    for digits in range(3, 18):
        labels = {value: _label(value, digits) for value in different}
        if len(set(labels.values())) == len(labels):
            break
    return labels


def _label(value: Any, digits: int) -> str:
    if value is None:
        return "–"
    if not isinstance(value, float):
        return str(value)
    short = f"{value:.6g}"
    text = short if float(short) == value else f"{value:.{digits}g}"
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}e{int(exponent)}" if e else text


def read_rows(place: Path) -> SweepRows:
    """Read the current rows of the sweep in the folder ``place``, or in the file.

    Raises UsageError if there is no sweep or it has no rows, and RunError if the file is damaged.
    """
    path = place if place.name == ROWS_FILE else place / ROWS_FILE
    if not os.path.isfile(path):
        usual = Path("results") / path.parent
        beside = [file.parent.name for file in sorted(path.parent.parent.glob(f"*/{ROWS_FILE}"))]
        hint = f"; {nearest(path.parent.name, beside)}" if beside else ""
        if os.path.isfile(usual / ROWS_FILE):
            hint = f"; did you mean {usual}?"
        folder = str(path.parent)
        shown = folder if os.path.lexists(folder) else shortened(folder)
        raise UsageError(f"{shown}: no sweep is stored here ({ROWS_FILE} is missing){hint}")
    about, columns = _read(path)
    current = columns["current"].astype(bool)
    order = np.flatnonzero(current)[np.argsort(columns["row"][current], kind="stable")]
    if not len(order):
        raise UsageError(f"{path.parent}: the sweep has no rows yet")
    return SweepRows(
        name=str(about["name"]),
        path=path,
        keys=tuple(about["keys"]),
        measures=tuple(about["measures"]),
        log=tuple(about.get("log", ())),
        columns={name: values[order] for name, values in columns.items()},
        left_out=int((~current).sum()),
    )


def _read(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Metadata and columns of the file. Raises RunError."""
    import pyarrow as pa

    try:
        with open_parquet(path) as file:
            schema = file.schema_arrow
            about = json.loads((schema.metadata or {}).get(METADATA.encode(), b"{}"))
            missing = [key for key in ("name", "keys", "measures") if not isinstance(about, dict) or key not in about]
            names = [] if missing else list(dict.fromkeys([*OWN, *about["keys"], *about["measures"]]))
            missing += [name for name in names if name not in schema.names]
            if missing:
                raise RunError(f"{path}: not the rows of a sweep ({missing[0]} is missing)")
            table = file.read(columns=names)
        columns = {name: table.column(name).to_numpy() for name in names}
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise RunError(f"{path}: cannot be read ({reason[:120]}); run topcli sweep again") from None
    return about, columns
