"""Plan of a sweep: which rows have to run and why, compared with what its journal holds.

A plan has 26 bytes for each row: digests and codes, no configs. The rows themselves are read again, one after the
other, when they run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.config.document import Problems
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import Sweep
from topcli.errors import TopcliError, UnknownNameError
from topcli.runs.identity import method_fingerprint
from topcli.sweeps.evaluate import Shared, shared_experiment
from topcli.sweeps.journal import DIGEST, Index, Names, short_digest
from topcli.sweeps.measures import NoCounterError, resolve_measures
from topcli.tops import TOPS

DONE, NEW, CODE, MEASURE, RETRY, REPEATED = range(6)
REASONS = {
    NEW: "new",
    CODE: "the code of the scheme changed",
    MEASURE: "a measure is new",
    RETRY: "failed before",
}
"""Reasons why a row has to run."""
GROWTH = 1 << 14
WARNED_TOPS = 64
"""Tops of a sweep whose parameters are looked at for warnings."""


@dataclass(frozen=True)
class Survey:
    """All rows of a sweep, validated: short digests, codes (indices into ``code_names``), and types of the columns."""

    sweep: Sweep
    digests: Names
    codes: NDArray[np.int16]
    code_names: list[str]
    types: Mapping[str, str]
    warnings: tuple[str, ...]
    """Warnings about unusual parameters of the first tops, each once."""

    @property
    def count(self) -> int:
        """Number of rows."""
        return len(self.digests)


@dataclass(frozen=True)
class Plan:
    """Plan for each row of a survey: ``status`` is DONE, REPEATED (an earlier row is equal) or a reason to run.

    ``failed`` is the number of rows that are done and did not complete; ``left`` is the number of finished rows in the
    journal that no longer belong to the sweep.
    """

    survey: Survey
    status: NDArray[np.int8]
    failed: int
    left: int

    @property
    def to_run(self) -> int:
        """Number of rows that have to run."""
        return int(np.isin(self.status, list(REASONS)).sum())

    @property
    def done(self) -> int:
        """Number of rows that are done."""
        return int((self.status == DONE).sum())

    @property
    def repeated(self) -> int:
        """Number of rows that repeat an earlier one."""
        return int((self.status == REPEATED).sum())

    def reasons(self) -> dict[str, int]:
        """Number of rows to run by reason."""
        counts = np.bincount(self.status, minlength=6).tolist()
        return {text: counts[reason] for reason, text in REASONS.items() if counts[reason]}


class _Grown:
    """An array that grows block by block."""

    def __init__(self, dtype: Any) -> None:
        self._dtype, self._full, self._open = dtype, list[NDArray[Any]](), list[Any]()

    def add(self, value: Any) -> None:
        self._open.append(value)
        if len(self._open) == GROWTH:
            self._close()

    def _close(self) -> None:
        self._full.append(np.array(self._open, dtype=self._dtype))
        self._open = []

    def array(self) -> NDArray[Any]:
        self._close()
        return np.concatenate(self._full)


def survey(sweep: Sweep) -> Survey:
    """Validate every row of a sweep.

    Raises ConfigError or UnknownNameError with the file, the line and the key of the fault; also for a measure that
    does not exist or does not fit the top.
    """
    digests, codes = _Grown(DIGEST), _Grown(np.int16)
    known: dict[tuple[str, str], int] = {}
    names: dict[str, int] = {}
    types: dict[str, set[type]] = {key: set() for key in sweep.keys}
    tops: dict[str, tuple[str, ...]] = {}
    problems = Problems(sweep.document)
    lacking: dict[str, list[NoCounterError | None]] = {}
    for row in RowReader(sweep).rows():
        pair = (row.form, row.scheme)
        if pair not in known:
            _check_measures(row, sweep, problems, lacking)
            known[pair] = names.setdefault(_code_of(row), len(names))
        if row.top not in tops and len(tops) < WARNED_TOPS:
            tops[row.top] = shared_experiment(Shared.of(row)).top.warnings()
        digests.add(short_digest(row.digest))
        codes.add(known[pair])
        for found, value in zip(types.values(), row.keys, strict=True):
            found.add(type(value))
    for errors in lacking.values():  # a counter that one scheme has may be lacking elsewhere
        if errors and None not in errors:
            problems.add(("measure",), str(errors[0]), unknown_name=True)
    problems.raise_any()
    kinds = {key: _column_type(found) for key, found in types.items()}
    warnings = tuple(dict.fromkeys(line for lines in tops.values() for line in lines))
    return Survey(sweep, digests.array(), codes.array(), list(names), kinds, warnings)


def _column_type(found: set[type]) -> str:
    """Type of a column that holds values of these types; None leaves a gap."""
    if found <= {int, type(None)} and int in found:
        return "int64"
    return "float64" if found <= {int, float, type(None)} else "string"


def _check_measures(
    row: Row, sweep: Sweep, problems: Problems, lacking: dict[str, list[NoCounterError | None]]
) -> None:
    """Add the measures that do not fit to ``problems``; ``lacking`` gets a counter's error, None where it exists."""
    one = shared_experiment(Shared.of(row))
    for name in sweep.measures:
        found = lacking.setdefault(name, [])
        try:
            resolve_measures([name], one.top, one.scheme, one.options)
            found.append(None)
        except NoCounterError as error:
            found.append(error)
        except TopcliError as error:
            problems.add(("measure",), str(error), unknown_name=isinstance(error, UnknownNameError))


def _code_of(row: Row) -> str:
    """Digest of the code of a row's scheme; made ready for the default top, so that it is the same for all tops.

    It includes the code of a user's top.
    """
    one = shared_experiment(Shared.of(row))
    try:
        return method_fingerprint(one.scheme.build(TOPS[row.form].new(), one.options)) + one.own_code
    except TopcliError:
        try:
            return method_fingerprint(one.method()) + one.own_code
        except TopcliError:  # the row will fail, and say why
            return ""


def plan_sweep(surveyed: Survey, index: Index, retry_failed: bool = False) -> Plan:
    """Compare a survey with the journal."""
    count = surveyed.count
    status = np.full(count, NEW, dtype=np.int8)
    at = index.find(surveyed.digests)
    there = np.flatnonzero(at >= 0)
    entry = at[there]
    code_of = {code: number for number, code in enumerate(index.codes)}
    wanted = np.array([code_of.get(code, -1) for code in surveyed.code_names], dtype=np.int32)
    same = index.code[entry] == wanted[surveyed.codes[there]]
    measured = np.array([set(surveyed.sweep.measures) <= names for names in index.measured], dtype=bool)
    enough = measured[index.measures[entry]] if len(measured) else np.zeros(len(entry), dtype=bool)
    completed = index.completed[entry]
    status[there] = np.where(
        ~same, CODE, np.where(~enough, MEASURE, np.where(completed | (not retry_failed), DONE, RETRY))
    )
    failed = int((~completed & (status[there] == DONE)).sum())
    order = np.argsort(surveyed.digests, kind="stable")
    ordered = surveyed.digests[order]
    again = order[1:][ordered[1:] == ordered[:-1]]
    status[again] = np.where(status[again] == DONE, DONE, REPEATED)
    known = np.zeros(len(index.digest), dtype=bool)
    known[entry] = True
    left = int(len(known) - known.sum())
    return Plan(surveyed, status, failed, left)


def changes(before: Mapping[str, Any] | None, now: Mapping[str, Any]) -> list[str]:
    """Differences between two sweep files, one line each: ``base.N: 1000 -> 2000``."""
    if before is None:
        return []
    old, new = dict(_leaves(before)), dict(_leaves(now))
    return [
        f"{key}: {old.get(key, 'absent')} -> {new.get(key, 'absent')}"
        for key in dict.fromkeys([*old, *new])
        if old.get(key) != new.get(key)
    ]


def _leaves(data: Mapping[str, Any], prefix: str = "") -> Any:
    for key, value in data.items():
        if isinstance(value, dict) and prefix.count(".") < 2 and not {"from", "to"} & value.keys():
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            text = json.dumps(value)
            yield f"{prefix}{key}", text if len(text) <= 60 else f"{text[:57]}..."
