"""Finished and unfinished sweeps in a folder, for ``topcli list runs``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from topcli.config.files import scene_files, sweep_files
from topcli.errors import RunError, TopcliError, UsageError, nearest, quoted
from topcli.store.results import SWEEP, StoredResult, read_result, stored_results
from topcli.sweeps.journal import Journal
from topcli.sweeps.run import is_sweep, stored_sweep_file

COMPLETED, UNFINISHED = "completed", "unfinished"


def listed_sweeps(out: Path) -> list[dict[str, Any]]:
    """Sweeps in ``out`` by name, with the keys of ``listed_runs``, as plain data.

    ``step`` is the number of finished rows and ``N`` that of all rows. What is not known is None.
    """
    try:
        folders = sorted(folder for folder in out.iterdir() if folder.is_dir() and is_sweep(folder))
    except OSError:
        return []
    return [_item(folder) for folder in folders]


def missing_result(place: str, results: Path) -> UsageError:
    """Error for a ``place`` where nothing is stored, with the command that computes it or the nearest stored names."""
    folder = Path(place)
    name = folder.name if folder.parent in (Path(), results) else ""
    command = "run" if name in scene_files() else "sweep" if name in sweep_files() else ""
    known = [*stored_results(results), *(item["name"] for item in listed_sweeps(results))]
    near = f"; {nearest(folder.name, set(known), 'topcli list runs')}" if known else ""
    if os.path.lexists(usual := Path("results") / place):
        near = f"; did you mean {usual}?"
    hint = f"; run it first: topcli {command} {name}" if command else near
    return UsageError(f"{quoted(place)}: no such file or folder, and no run of this name in {results}{hint}")


def finished_sweep(folder: Path) -> StoredResult | None:
    """Finished sweep in ``folder``; None if there is none."""
    try:
        stored = read_result(folder)
    except RunError:
        return None
    return stored if stored is not None and stored.manifest.get("kind") == SWEEP else None


def intact_sweep(folder: Path) -> StoredResult:
    """Finished sweep in ``folder``, with all its checksums compared.

    Raises UsageError if it is not finished, and RunError if it is damaged.
    """
    sweep = finished_sweep(folder)
    if sweep is None:
        raise UsageError(f"{folder}: the sweep is not finished; topcli sweep continues it")
    for name, fault in sweep.damage().items():
        raise RunError(f"{folder / name}: damaged: {fault}; topcli sweep writes it again")
    return sweep


def _item(folder: Path) -> dict[str, Any]:
    try:
        rows = stored_sweep_file(folder).count_left
    except TopcliError:
        rows = None
    finished = finished_sweep(folder)
    if finished is None:
        try:
            with Journal(folder) as journal:
                done = len(journal.index().rows)
        except TopcliError:
            done = None
    else:
        done = finished.manifest.get("rows")
    whole = finished is not None and done == rows
    digest = finished.manifest.get("digest") if finished else None
    return {
        "name": folder.name,
        "kind": SWEEP,
        "outcome": COMPLETED if whole else UNFINISHED,
        "step": done,
        "scheme": None,
        "h": None,
        "N": rows,
        "digest": digest[:8] if isinstance(digest, str) else None,
        "ended": finished.manifest.get("ended") if finished else None,
    }
