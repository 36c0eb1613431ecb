"""Plan of a sweep: rows that must run, with the reason, found by comparison with the journal.

A plan has 26 bytes for each row: digests and codes, no configs. The rows themselves are read again, one after the
other, when they run.
"""

from __future__ import annotations

import json
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.config.document import Document
from topcli.config.models import unit_warnings
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import Sweep
from topcli.errors import TopcliError
from topcli.runs.identity import code_digest
from topcli.sweeps.journal import DIGEST, Index, Names, short_digest
from topcli.sweeps.measures import NoCounterError, resolve_measures
from topcli.sweeps.row_results import Shared, shared_experiment
from topcli.tops import TOPS
from topcli.tops.bodies import moment_warnings

DONE, NEW, CODE, MEASURE, RETRY, REPEATED = range(6)
REASONS = {
    NEW: "new",
    CODE: "the code of the scheme changed",
    MEASURE: "a measure is new",
    RETRY: "failed before",
}
"""Reasons why a row has to run."""
WARNED_TOPS = 64
"""Tops of a sweep whose parameters are looked at for warnings."""
WARNED_STATES = 1000
"""Initial states of a sweep that are looked at for warnings."""


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


def survey(sweep: Sweep) -> Survey:
    """Validate every row of a sweep.

    Raises ConfigError or UnknownNameError with the file, the line and the key of the fault; also for a measure that
    does not exist or does not fit the top.
    """
    digests, codes = bytearray(), array("h")
    known: dict[tuple[str, str], int] = {}
    names: dict[str, int] = {}
    types: dict[str, set[type]] = {key: set() for key in sweep.keys}
    tops: dict[str, tuple[str, ...]] = {}
    states: dict[tuple[float, ...], tuple[str, ...]] = {}
    document = replace(sweep.document, faults=[])
    lacking: dict[str, list[NoCounterError | None]] = {}
    for row in RowReader(sweep).rows():
        pair = (row.form, row.scheme)
        if pair not in known:
            _check_measures(row, sweep, document, lacking)
            shared = shared_experiment(Shared.of(row))
            known[pair] = names.setdefault(code_digest(type(shared.top), shared.scheme), len(names))
        if row.top not in tops and len(tops) < WARNED_TOPS:
            tops[row.top] = tuple(moment_warnings(shared_experiment(Shared.of(row)).top))
        if row.initial not in states and len(states) < WARNED_STATES:
            states[row.initial] = tuple(unit_warnings(TOPS[row.form], np.array([row.initial])))
        digests += short_digest(row.digest)
        codes.append(known[pair])
        for kinds, value in zip(types.values(), row.keys, strict=True):
            kinds.add(type(value))
    for errors in lacking.values():  # a counter that one scheme has may be lacking elsewhere
        if errors and None not in errors:
            document.fault(("measure",), str(errors[0]))
    document.check()
    columns = {key: _column_type(kinds) for key, kinds in types.items()}
    warnings = tuple(dict.fromkeys(line for lines in (*tops.values(), *states.values()) for line in lines))
    arrays = np.frombuffer(digests, dtype=DIGEST), np.frombuffer(codes, dtype=np.int16)
    return Survey(sweep, *arrays, list(names), columns, warnings)


def _column_type(kinds: set[type]) -> str:
    """Type of a column that holds values of these types; None leaves a gap."""
    if kinds <= {int, type(None)} and int in kinds:
        return "int64"
    return "float64" if kinds <= {int, float, type(None)} else "string"


def _check_measures(
    row: Row, sweep: Sweep, document: Document, lacking: dict[str, list[NoCounterError | None]]
) -> None:
    """Add the measures that do not fit to ``document``; ``lacking`` gets a counter's error, None where it exists."""
    experiment = shared_experiment(Shared.of(row))
    for name in sweep.measures:
        errors = lacking.setdefault(name, [])
        try:
            quantities = tuple(experiment.output.quantities or ())
            resolve_measures([name], experiment.top, experiment.scheme, experiment.options, quantities=quantities)
            errors.append(None)
        except NoCounterError as error:
            errors.append(error)
        except TopcliError as error:
            document.fault(("measure",), str(error))


def plan_sweep(surveyed: Survey, index: Index, retry_failed: bool = False) -> Plan:
    """Compare a survey with the journal."""
    status = np.full(surveyed.count, NEW, dtype=np.int8)
    at = index.find(surveyed.digests)
    there = np.flatnonzero(at >= 0)
    entries = index.rows[at[there]]
    code_of = {code: number for number, code in enumerate(index.codes)}
    wanted = np.array([code_of.get(code, -1) for code in surveyed.code_names], dtype=np.int32)
    same = entries["code"] == wanted[surveyed.codes[there]]
    measured = np.array([set(surveyed.sweep.measures) <= names for names in index.measured], dtype=bool)
    enough, kept = measured[entries["measures"]], entries["completed"] | (not retry_failed)
    status[there] = np.select([~same, ~enough, kept], [CODE, MEASURE, DONE], RETRY)
    failed = int((~entries["completed"] & (status[there] == DONE)).sum())
    order = np.argsort(surveyed.digests, kind="stable")
    ordered = surveyed.digests[order]
    again = order[1:][ordered[1:] == ordered[:-1]]
    status[again] = np.where(status[again] == DONE, DONE, REPEATED)
    left = len(index.rows) - len(np.unique(at[there]))
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
