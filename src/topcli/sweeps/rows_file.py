"""Table of a sweep, ``rows.parquet``, and its manifest, written from plan and journal."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.config.rows import Row, RowReader
from topcli.config.sweep import Sweep
from topcli.store.files import sha256_of
from topcli.store.provenance import environment, git_commit, now
from topcli.store.results import MANIFEST_VERSION, SWEEP, manifest_text
from topcli.sweeps.journal import JOURNAL, Index, Journal
from topcli.sweeps.plan import DONE, REPEATED, Plan
from topcli.sweeps.rows import METADATA, ROWS_FILE
from topcli.tops import TOPS

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
    cls = TOPS[row.form]
    state = dict(zip(cls.components, row.initial, strict=True))
    of = {"initial": state, "top": cls.parameters_in(json.loads(row.top))}
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


def sweep_manifest(folder: Path, sweep: Sweep, outcomes: dict[str, int], started: str, seconds: float) -> str:
    """Manifest of a finished sweep as JSON."""
    files = {name: folder / name for name in (ROWS_FILE, "sweep.yaml", JOURNAL)}
    content = {
        "manifest_version": MANIFEST_VERSION,
        "kind": SWEEP,
        "outcome": "completed",
        **metadata(sweep),
        "rows": sum(outcomes.values()),
        "outcomes": outcomes,
        "started": started,
        "ended": now(),
        "seconds": seconds,
        "environment": environment(),
        **git_commit(),
    }
    listed = {name: {"size": path.stat().st_size, "sha256": sha256_of(path)} for name, path in files.items()}
    return manifest_text({**content, "files": listed})
