"""Chapters on sweeps: their rows, and pictures of the measures over the key that varies most."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.document import Problems
from topcli.config.rows import RowReader
from topcli.config.sweep import MISSING, Sweep
from topcli.errors import TopcliError
from topcli.figures.sweep import Choice, curves
from topcli.pages.contents import (
    UNFINISHED,
    Chapter,
    Facts,
    Parts,
    Picture,
    Pictures,
    add_files,
    add_origin,
    text_block,
)
from topcli.store.manifest import stored_sweep
from topcli.sweeps.rows import SweepRows, encoded, key_labels, read_rows
from topcli.sweeps.run import SWEEP_FILE, stored_sweep_file
from topcli.sweeps.table_text import significant
from topcli.table import DASH, Cells

MOST_ROWS = 200
"""Rows of a sweep that a page lists."""
MOST_PICTURES = 6
MOST_CURVES = 12
"""Largest number of values of a key that is drawn as curves of their own."""


def sweep_chapter(folder: Path, name: str | None) -> Chapter:
    """Chapter on the sweep in ``folder``, finished or not.

    ``name`` is unique within the page; None leaves out pictures.
    """
    chapter = Chapter(folder.name, "sweep", "rows of a sweep", "finished")
    stored, manifest = stored_sweep(folder), {}
    damage: Mapping[str, str] = {}
    if stored is None:
        chapter.state, chapter.good = UNFINISHED, False
        chapter.missing.append("manifest: the sweep is not finished; topcli sweep continues it")
        chapter.missing.append("provenance: it is part of the manifest")
    else:
        manifest, damage = stored.manifest, chapter.check(stored)
    try:
        rows = read_rows(folder)
    except TopcliError as error:
        chapter.missing.append(f"rows: {str(error).splitlines()[0]}")
    else:
        _add_setup(chapter, rows, folder)
        if name:
            chapter.attempt("pictures", sweep_pictures, rows, name)
        chapter.attempt("rows", rows_table, rows)
    chapter.attempt("sweep file", lambda: text_block("Sweep file", (folder / SWEEP_FILE).read_text(encoding="utf-8")))
    add_origin(chapter, manifest, lambda: _parts(stored_sweep_file(folder)))
    if stored is not None:
        add_files(chapter, folder, manifest, damage)
    return chapter


def _add_setup(chapter: Chapter, rows: SweepRows, folder: Path) -> None:
    """Say how many of the planned rows there are, and add their outcomes."""
    chapter.message = f"{len(rows)} rows"
    with contextlib.suppress(TopcliError):  # of the sweep file, which the chapter shows by itself
        total = stored_sweep_file(folder).count
        chapter.message = f"{len(rows)} of {total} rows"
        if len(rows) < total:
            chapter.missing.append(f"{total - len(rows)} of {total} rows, which have not run yet")
    outcomes = Counter(map(str, rows.columns["outcome"]))
    facts = [
        ("varied keys", ", ".join(rows.keys)),
        ("measures", ", ".join(rows.measures)),
        *((f"rows {outcome}", str(count)) for outcome, count in outcomes.items()),
    ]
    if rows.left_out:
        facts.append(("rows left out", f"{rows.left_out}, of an earlier version of the sweep file"))
    chapter.blocks.append(Facts("Setup", facts))


def _parts(sweep: Sweep) -> Parts:
    """Forms of the tops and names of the schemes of all rows, each pair once. Raises ConfigError."""
    reader, problems = RowReader(sweep), Problems(sweep.document)
    chosen = [key in ("top", "top.kind") or key.partition(".")[0] == "scheme" for key in sweep.keys]
    parts: dict[tuple[str, str], None] = {}
    seen: set[tuple[object, ...]] = set()
    for number, values in enumerate(sweep.assignments()):
        # of other keys, such as vectors, it matters only whether they are there
        kind = tuple(id(value) if chooses else value is MISSING for chooses, value in zip(chosen, values, strict=True))
        if kind not in seen:
            seen.add(kind)
            if row := reader.read(number, values, problems):
                parts[row.form, json.loads(row.scheme)["name"]] = None
    problems.raise_any()
    return list(parts)


def rows_table(rows: SweepRows) -> Cells:
    """The first rows of a sweep with their keys, outcome and measures."""
    labels = {key: key_labels(rows.columns[key]) for key in rows.keys}
    lines = []
    for i in range(min(len(rows), MOST_ROWS)):
        keys = [labels[key].get(_plain(rows.columns[key][i]), DASH) for key in rows.keys]
        values = [significant(float(rows.columns[name][i]), 4) for name in rows.measures]
        lines.append([str(int(rows.columns["row"][i])), *keys, str(rows.columns["outcome"][i]), *values])
    more = len(rows) - len(lines)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.path}." if more > 0 else ""
    marks = dict.fromkeys(map(str, rows.columns["outcome"][~rows.completed]), "bad")
    header = ["row", *rows.keys, "outcome", *rows.measures]
    return Cells("Rows", header, lines, caption, keys=1 + len(rows.keys), marks=marks)


def _plain(value: Any) -> Any:
    """Value of a column as the labels of ``key_labels`` know it."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and np.isnan(plain) else plain


def sweep_choices(rows: SweepRows) -> Iterator[Choice]:
    """Yield a choice for each measure: over the numeric key with most values, with curves of the next key if few.

    Values of rows that differ in other keys are combined by their median.
    """
    codes = {key: encoded(rows.columns[key]) for key in rows.keys}
    counts = {key: len(values) for key, (_, values) in codes.items() if len(values) > 1}
    varied = sorted(counts, key=lambda key: -counts[key])
    if not varied:
        return
    x = next((key for key in varied if rows.columns[key].dtype.kind in "fi"), varied[0])
    by = next((key for key in varied if key != x and counts[key] <= MOST_CURVES), None)
    combinations = set(zip(*(codes[key][0].tolist() for key in (x, by) if key), strict=True))
    aggregate = "median" if len(combinations) < len(rows) else None
    for measure in rows.measures:
        if np.isfinite(rows.columns[measure].astype(float)).any():
            yield Choice(x, measure, by, aggregate=aggregate)


def sweep_pictures(rows: SweepRows, name: str) -> Pictures:
    """Pictures of the first measures; none if no key varies. Raises UsageError."""
    pictures = []
    for number, choice in zip(range(MOST_PICTURES), sweep_choices(rows), strict=False):
        combined = f", {choice.aggregate} over the rows" if choice.aggregate else ""
        caption = f"{choice.y} over {choice.x}{f' for each {choice.by}' if choice.by else ''}{combined}"
        pictures.append(Picture(*curves(rows, choice), f"{name}-measure{number}", caption))
    return Pictures(pictures)
