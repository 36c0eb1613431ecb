"""Plan of a sweep: which rows have to run and why, by comparison with its journal, and the table of finished rows.

A plan has 26 bytes for each row: digests and codes, no configs. The rows themselves are read again, one after the
other, when they run.
"""

from __future__ import annotations

import itertools
import json
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.config.document import Problems
from topcli.config.rows import Row, RowReader
from topcli.config.sweep import Sweep
from topcli.errors import TopcliError, UnknownNameError
from topcli.runs.identity import method_fingerprint
from topcli.store.files import json_text
from topcli.store.manifest import SWEEP, sealed_manifest
from topcli.store.provenance import Commit, environment, now
from topcli.sweeps.evaluate import Shared, shared_experiment
from topcli.sweeps.journal import DIGEST, JOURNAL, Index, Journal, Names, short_digest
from topcli.sweeps.measures import NoCounterError, resolve_measures
from topcli.sweeps.rows import METADATA, ROWS_FILE
from topcli.tops import TOPS

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
    problems = Problems(sweep.document)
    lacking: dict[str, list[NoCounterError | None]] = {}
    for row in RowReader(sweep).rows():
        pair = (row.form, row.scheme)
        if pair not in known:
            _check_measures(row, sweep, problems, lacking)
            known[pair] = names.setdefault(_code_of(row), len(names))
        if row.top not in tops and len(tops) < WARNED_TOPS:
            tops[row.top] = shared_experiment(Shared.of(row)).top.warnings()
        digests += short_digest(row.digest)
        codes.append(known[pair])
        for kinds, value in zip(types.values(), row.keys, strict=True):
            kinds.add(type(value))
    for errors in lacking.values():  # a counter that one scheme has may be lacking elsewhere
        if errors and None not in errors:
            problems.add(("measure",), str(errors[0]), unknown_name=True)
    problems.raise_any()
    columns = {key: _column_type(kinds) for key, kinds in types.items()}
    warnings = tuple(dict.fromkeys(line for lines in tops.values() for line in lines))
    arrays = np.frombuffer(digests, dtype=DIGEST), np.frombuffer(codes, dtype=np.int16)
    return Survey(sweep, *arrays, list(names), columns, warnings)


def _column_type(kinds: set[type]) -> str:
    """Type of a column that holds values of these types; None leaves a gap."""
    if kinds <= {int, type(None)} and int in kinds:
        return "int64"
    return "float64" if kinds <= {int, float, type(None)} else "string"


def _check_measures(
    row: Row, sweep: Sweep, problems: Problems, lacking: dict[str, list[NoCounterError | None]]
) -> None:
    """Add the measures that do not fit to ``problems``; ``lacking`` gets a counter's error, None where it exists."""
    experiment = shared_experiment(Shared.of(row))
    for name in sweep.measures:
        errors = lacking.setdefault(name, [])
        try:
            resolve_measures([name], experiment.top, experiment.scheme, experiment.options)
            errors.append(None)
        except NoCounterError as error:
            errors.append(error)
        except TopcliError as error:
            problems.add(("measure",), str(error), unknown_name=isinstance(error, UnknownNameError))


def _code_of(row: Row) -> str:
    """Digest of the code of a row's scheme; made ready for the default top, so that it is the same for all tops.

    It includes the code of a user's top.
    """
    experiment = shared_experiment(Shared.of(row))
    build, options = experiment.scheme.build, experiment.options
    for method in (lambda: build(TOPS[row.form].new(), options), experiment.method):
        with suppress(TopcliError):
            return method_fingerprint(method()) + experiment.own_code
    return ""  # the row will fail, and say why


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


TABLE_ROW_GROUP = 1 << 14
DRAWN = "drawn."
"""Beginning of the columns of drawn values, which keys may vary the centre of."""
Columns = dict[str, list[Any]]


def metadata(sweep: Sweep) -> dict[str, Any]:
    """Description of the table: names of varied keys, measures and drawn values, logarithmically spaced keys."""
    return {
        "name": sweep.name,
        "keys": list(sweep.keys),
        "measures": list(sweep.measures),
        "log": sweep.log,
        "drawn": [DRAWN + name for name in sweep.drawn],
        "digest": sweep.digest,
    }


def write_rows(path: Path, plan: Plan, journal: Journal) -> dict[str, int]:
    """Write the table of finished rows to ``path``; return the numbers of its current rows by outcome.

    ``plan`` is that of the journal as it is. Rows that no longer belong to the sweep come last and are not current;
    rows of earlier code, or without one of the measures, are left out until they have run again. Raises OSError.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    sweep = plan.survey.sweep
    fields = [pa.field("row", pa.int64())]
    fields += [pa.field(key, pa.type_for_alias(plan.survey.types[key])) for key in sweep.keys]
    fields += [pa.field(DRAWN + name, pa.float64()) for name in sweep.drawn]
    fields += [pa.field("outcome", pa.string()), pa.field("message", pa.string())]
    fields += [pa.field(name, pa.float64()) for name in sweep.measures]
    fields += [pa.field("digest", pa.string()), pa.field("cpu", pa.string()), pa.field("current", pa.bool_())]
    schema = pa.schema(fields, metadata={METADATA: json.dumps(metadata(sweep))})
    outcomes: Counter[str] = Counter()
    index = journal.index()
    with pq.ParquetWriter(path, schema, write_page_checksum=True) as writer:
        for columns in itertools.chain(_current(plan, journal, index), _left(plan, journal, index)):
            for kind in schema:
                if kind.type == pa.string() and kind.name in sweep.keys:
                    columns[kind.name] = [None if value is None else str(value) for value in columns[kind.name]]
            writer.write_table(pa.table(columns, schema=schema))
            outcomes.update(
                outcome for outcome, current in zip(columns["outcome"], columns["current"], strict=True) if current
            )
    return dict(outcomes)


def _current(plan: Plan, journal: Journal, index: Index) -> Iterator[Columns]:
    """Yield the finished rows of the plan, in its order."""
    sweep = plan.survey.sweep
    names = ("row", *sweep.keys, *(DRAWN + name for name in sweep.drawn))
    at = index.find(plan.survey.digests)  # a row that repeats one that is not finished has no entry
    finished = np.isin(plan.status, (DONE, REPEATED)) & (at >= 0)
    rows = (row for row in RowReader(sweep, labels_only=True).rows() if finished[row.number])
    while group := list(itertools.islice(rows, TABLE_ROW_GROUP)):
        values = [(row.number, *row.keys, *_drawn(row, sweep.drawn)) for row in group]
        columns: Columns = {name: [row[i] for row in values] for i, name in enumerate(names)}
        entries = index.rows[at[columns["row"]]]
        yield columns | _results(sweep, journal, entries) | {"current": [True] * len(group)}


def _drawn(row: Row, names: Sequence[str]) -> tuple[float | None, ...]:
    """Values of ``names``, which ``Sweep.drawn`` gives, in a row; None for one that its top does not have."""
    if not names:
        return ()
    state = dict(zip(TOPS[row.form].components, row.initial, strict=True))
    of = {"initial": state, "top": json.loads(row.top)}
    return tuple([of[section].get(name) for section, _, name in (name.partition(".") for name in names)])


def _results(sweep: Sweep, journal: Journal, entries: NDArray[np.void]) -> Columns:
    """Columns of results of the rows at these ``entries`` of the index."""
    columns: Columns = {name: [] for name in ("outcome", "message", *sweep.measures, "digest", "cpu")}
    for number, place in entries[["block", "place"]].tolist():
        block = journal.block(number)
        columns["outcome"].append(block.outcome[place])
        columns["message"].append(block.message[place])
        columns["digest"].append(block.digest[place])
        columns["cpu"].append(block.cpu)
        for name in sweep.measures:
            columns[name].append(block.values[name][place] if name in block.values else float("nan"))
    return columns


def _left(plan: Plan, journal: Journal, index: Index) -> Iterator[Columns]:
    """Yield the finished rows that no longer belong to the sweep, with the values of those keys that they had."""
    sweep = plan.survey.sweep
    others = index.rows[~np.isin(index.rows["digest"], plan.survey.digests)] if plan.left else index.rows[:0]
    others = np.sort(others, order=("block", "place"))
    for start in range(0, len(others), TABLE_ROW_GROUP):
        entries = others[start : start + TABLE_ROW_GROUP]
        columns: Columns = {"row": [-1] * len(entries)}
        for key in sweep.keys:
            kind = plan.survey.types[key]
            had = [journal.block(number).keys.get(key) for number in entries["block"].tolist()]
            places = entries["place"].tolist()
            columns[key] = [
                _fitting(None if values is None else values[place], kind)
                for values, place in zip(had, places, strict=True)
            ]
        columns |= {DRAWN + name: [None] * len(entries) for name in sweep.drawn}
        yield columns | _results(sweep, journal, entries) | {"current": [False] * len(entries)}


def _fitting(value: Any, kind: str) -> Any:
    """``value`` if a column of this type can hold it, otherwise None."""
    if value is None or kind == "string":
        return value
    if kind == "int64":
        return value if isinstance(value, int) else None
    return float(value) if isinstance(value, (int, float)) else None


def manifest_text(
    folder: Path, sweep: Sweep, outcomes: dict[str, int], started: str, seconds: float, commit: Commit
) -> str:
    """Manifest of a finished sweep as JSON."""
    content = {
        "kind": SWEEP,
        **metadata(sweep),
        "rows": sum(outcomes.values()),
        "outcomes": outcomes,
        "started": started,
        "ended": now(),
        "seconds": seconds,
        "environment": environment(),
        **commit.read(),
    }
    return json_text(sealed_manifest(folder, content, dict.fromkeys([ROWS_FILE, "sweep.yaml", JOURNAL])))
