"""Results of a sweep: ``rows.parquet``, a tidy table with a row for each finished row, and the manifest."""

from __future__ import annotations

import itertools
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.rows import Row, RowReader
from topcli.config.sweep import Sweep
from topcli.store.files import json_text
from topcli.store.manifest import SWEEP, sealed_manifest
from topcli.store.provenance import Commit, environment, now
from topcli.sweeps.journal import JOURNAL, Index, Journal
from topcli.sweeps.plan import DONE, REPEATED, Plan
from topcli.sweeps.rows import METADATA, ROWS
from topcli.tops import TOPS

ROW_GROUP = 1 << 14
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
    numbers: list[int] = []
    keys: list[tuple[Any, ...]] = []
    for row in RowReader(sweep, labels_only=True).rows():
        if plan.status[row.number] in (DONE, REPEATED):
            numbers.append(row.number)
            keys.append((*row.keys, *_drawn(row, sweep.drawn)))
        if len(numbers) == ROW_GROUP:
            yield _gathered(plan, journal, index, numbers, keys)
            numbers, keys = [], []
    if numbers:
        yield _gathered(plan, journal, index, numbers, keys)


def _drawn(row: Row, names: Sequence[str]) -> tuple[float | None, ...]:
    """Values of ``names``, which ``Sweep.drawn`` gives, in a row; None for one that its top does not have."""
    if not names:
        return ()
    state = dict(zip(TOPS[row.form].components, row.initial, strict=True))
    of = {"initial": state, "top": json.loads(row.top)}
    return tuple([of[section].get(name) for section, _, name in (name.partition(".") for name in names)])


def _gathered(
    plan: Plan, journal: Journal, index: Index, numbers: Sequence[int], keys: Sequence[tuple[Any, ...]]
) -> Columns:
    """Columns of finished rows, from their numbers and the values of their keys and draws."""
    at = index.find(plan.survey.digests[np.array(numbers)])
    there = at >= 0  # a row that repeats one that is not finished has no entry
    sweep = plan.survey.sweep
    found = [(number, values) for number, values, known in zip(numbers, keys, there.tolist(), strict=True) if known]
    columns: Columns = {"row": [number for number, _ in found]}
    names = (*sweep.keys, *(DRAWN + name for name in sweep.drawn))
    columns |= {name: [values[i] for _, values in found] for i, name in enumerate(names)}
    return columns | _results(sweep, journal, index, at[there].tolist()) | {"current": [True] * len(found)}


def _results(sweep: Sweep, journal: Journal, index: Index, entries: Sequence[int]) -> Columns:
    """Columns of results of the rows at ``entries`` of the index."""
    columns: Columns = {name: [] for name in ("outcome", "message", *sweep.measures, "digest", "cpu")}
    for entry in entries:
        block, place = journal.block(int(index.block[entry])), int(index.place[entry])
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
    others = np.flatnonzero(~np.isin(index.digest, plan.survey.digests)) if plan.left else np.empty(0, dtype=np.int64)
    others = others[np.lexsort((index.place[others], index.block[others]))]
    for start in range(0, len(others), ROW_GROUP):
        entries = others[start : start + ROW_GROUP].tolist()
        columns: Columns = {"row": [-1] * len(entries)}
        for key in sweep.keys:
            kind = plan.survey.types[key]
            columns[key] = [_fitting(_old_key(journal, index, entry, key), kind) for entry in entries]
        columns |= {DRAWN + name: [None] * len(entries) for name in sweep.drawn}
        yield columns | _results(sweep, journal, index, entries) | {"current": [False] * len(entries)}


def _old_key(journal: Journal, index: Index, entry: int, key: str) -> Any:
    block = journal.block(int(index.block[entry]))
    return block.keys[key][int(index.place[entry])] if key in block.keys else None


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
    return json_text(sealed_manifest(folder, content, dict.fromkeys([ROWS, "sweep.yaml", JOURNAL])))
