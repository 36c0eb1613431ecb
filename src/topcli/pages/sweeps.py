"""Chapters on sweeps: their rows, and pictures of the measures over the key that varies most."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from topcli.config.problems import Problems
from topcli.config.sweep.document import MISSING, Sweep
from topcli.config.sweep.rows import RowReader
from topcli.errors import TopcliError
from topcli.figures.picture import Grid
from topcli.figures.sweep import Choice, curves
from topcli.pages.contents import Cells, Chapter, Facts, Notes, Picture, Pictures
from topcli.pages.origin import citation_block, files_block, provenance_block, text_block
from topcli.pages.svg import svg_of
from topcli.store.manifest import StoredRun, stored_sweep
from topcli.sweeps.rows import SweepRows, encoded, key_labels, read_rows
from topcli.sweeps.run import SWEEP_FILE, stored_sweep_file
from topcli.sweeps.table_text import significant

MOST_ROWS = 200
"""Rows of a sweep that a page lists."""
MOST_PICTURES = 6
MOST_CURVES = 12
"""Largest number of values of a key that is drawn as curves of their own."""
SIZE = (5.6, 3.2)


def sweep_chapter(folder: Path, name: str | None) -> Chapter:
    """Chapter on the sweep in ``folder``, finished or not.

    ``name`` is unique within the page; None leaves out pictures.
    """
    chapter = Chapter(folder.name, "sweep", "rows of a sweep")
    stored = stored_sweep(folder)
    _state(chapter, stored)
    rows = None
    try:
        rows = read_rows(folder)
    except TopcliError as error:
        chapter.missing.append(f"rows: {str(error).splitlines()[0]}")
    total = _planned(folder)
    if rows is not None:
        _outcomes(chapter, rows, total)
        if name:
            chapter.attempt("pictures", lambda: sweep_pictures(rows, name))
        chapter.attempt("rows", lambda: rows_table(rows))
    chapter.attempt("sweep file", lambda: text_block("Sweep file", (folder / SWEEP_FILE).read_text(encoding="utf-8")))
    if stored is not None:
        manifest = stored.manifest
        chapter.attempt("provenance", lambda: provenance_block(manifest))
        chapter.attempt("files", lambda: files_block(folder, manifest["files"], stored.damage()))
    chapter.attempt("citation", lambda: _citation(folder, stored))
    return chapter


def _state(chapter: Chapter, stored: StoredRun | None) -> None:
    if stored is None:
        chapter.state, chapter.good = "unfinished", False
        chapter.missing.append("manifest: the sweep is not finished; topcli sweep continues it")
        chapter.missing.append("provenance: it is part of the manifest")
        return
    damage = stored.damage()
    chapter.missing += [f"{file}: {why}" for file, why in damage.items()]
    chapter.state, chapter.good = ("damaged", False) if damage else ("finished", True)


def _planned(folder: Path) -> int | None:
    """Number of rows of the sweep file; None if it cannot be read."""
    try:
        return stored_sweep_file(folder).count
    except TopcliError:
        return None


def _outcomes(chapter: Chapter, rows: SweepRows, total: int | None) -> None:
    """Say how many rows there are, and add their outcomes."""
    planned = f" of {total}" if total is not None else ""
    chapter.message = f"{len(rows)}{planned} rows"
    if total is not None and len(rows) < total:
        chapter.missing.append(f"{total - len(rows)} of {total} rows, which have not run yet")
    counted = Counter(str(one) for one in rows.columns["outcome"])
    facts = [
        ("varied keys", ", ".join(rows.keys)),
        ("measures", ", ".join(rows.measures)),
        *((f"rows {outcome}", str(count)) for outcome, count in counted.items()),
    ]
    if rows.left_out:
        facts.append(("rows left out", f"{rows.left_out}, of an earlier version of the sweep file"))
    chapter.blocks.append(Facts("Setup", facts))


def _citation(folder: Path, stored: StoredRun | None) -> Notes:
    environment = stored.manifest.get("environment", {}) if stored else {}
    return citation_block(_parts(stored_sweep_file(folder)), environment.get("topcli"))


def _parts(sweep: Sweep) -> list[tuple[str, str]]:
    """Forms of the tops and names of the schemes of all rows, each pair once. Raises ConfigError."""
    reader, problems = RowReader(sweep), Problems(sweep.document)
    chosen = [key in ("top", "top.kind") or key.partition(".")[0] == "scheme" for key in sweep.keys]
    found: dict[tuple[str, str], None] = {}
    seen: set[tuple[object, ...]] = set()
    for number, values in enumerate(sweep.assignments()):
        # of other keys, such as vectors, it matters only whether they are there
        kind = tuple(id(value) if chooses else value is MISSING for chooses, value in zip(chosen, values, strict=True))
        if kind not in seen:
            seen.add(kind)
            if row := reader.read(number, values, problems):
                found[row.form, json.loads(row.scheme)["name"]] = None
    problems.raise_any()
    return list(found)


def rows_table(rows: SweepRows) -> Cells:
    """The first rows of a sweep with their keys, outcome and measures."""
    labels = {key: key_labels(rows.columns[key]) for key in rows.keys}
    lines = []
    for i in range(min(len(rows), MOST_ROWS)):
        keys = [labels[key].get(_plain(rows.columns[key][i]), "–") for key in rows.keys]
        values = [significant(float(rows.columns[name][i]), 4) for name in rows.measures]
        lines.append([str(int(rows.columns["row"][i])), *keys, str(rows.columns["outcome"][i]), *values])
    more = len(rows) - len(lines)
    caption = f"The first {MOST_ROWS} rows; {more} more are in {rows.path}." if more > 0 else ""
    outcomes = {str(one): "bad" for one in rows.columns["outcome"][~rows.completed]}
    header = ["row", *rows.keys, "outcome", *rows.measures]
    return Cells("Rows", header, lines, caption, keys=1 + len(rows.keys), marks=outcomes)


def _plain(value: Any) -> Any:
    """Value of a column as the labels of ``key_labels`` know it."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and np.isnan(plain) else plain


def sweep_choices(rows: SweepRows) -> Iterator[Choice]:
    """Yield a choice for each measure: over the numeric key with most values, with curves of the next key if few.

    Values of rows that differ in other keys are combined by their median.
    """
    values = {key: len(encoded(rows.columns[key])[1]) for key in rows.keys}
    varied = sorted((key for key in rows.keys if values[key] > 1), key=lambda key: -values[key])
    numeric = [key for key in varied if rows.columns[key].dtype.kind in "fi"]
    if not varied:
        return
    x = (numeric or varied)[0]
    by = next((key for key in varied if key != x and values[key] <= MOST_CURVES), None)
    used = [key for key in (x, by) if key]
    combinations = len({tuple(_plain(rows.columns[key][i]) for key in used) for i in range(len(rows))})
    aggregate = "median" if combinations < len(rows) else None
    for measure in rows.measures:
        if np.isfinite(rows.columns[measure].astype(float)).any():
            yield Choice(x, measure, by, aggregate=aggregate)


def sweep_pictures(rows: SweepRows, name: str) -> Pictures | None:
    """Pictures of the first measures; None if no key varies. Raises UsageError."""
    pictures = []
    for number, choice in zip(range(MOST_PICTURES), sweep_choices(rows), strict=False):
        panel, data = curves(rows, choice)
        combined = f", {choice.aggregate} over the rows" if choice.aggregate else ""
        caption = f"{choice.y} over {choice.x}{f' for each {choice.by}' if choice.by else ''}{combined}"
        pictures.append(Picture(svg_of(panel, data, f"{name}-measure{number}", caption, Grid(figsize=SIZE)), caption))
    return Pictures("Pictures", pictures) if pictures else None
