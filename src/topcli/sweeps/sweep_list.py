"""Finished and unfinished sweeps in a folder, for ``topcli list runs``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from topcli.config.files import scene_files, sweep_files
from topcli.errors import TopcliError, UsageError, nearest, quoted
from topcli.store.manifest import all_runs, stored_sweep
from topcli.sweeps.journal import Journal
from topcli.sweeps.run import is_sweep, stored_sweep_file

COMPLETED, UNFINISHED = "completed", "unfinished"
SWEEP = "sweep"
"""Kind of the entries."""


def listed_sweeps(out: Path) -> list[dict[str, Any]]:
    """Sweeps in ``out`` by name, with the keys of ``listed_runs``, as plain data.

    ``step`` is the number of finished rows and ``N`` that of all rows; ``resumable`` is true if ``topcli sweep``
    continues it. What is not known is None. Nothing in the folder is changed.
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
    known = [run.folder.name for run in all_runs(results)] + [item["name"] for item in listed_sweeps(results)]
    near = f"; {nearest(folder.name, set(known), 'topcli list runs')}" if known else ""
    if os.path.lexists(usual := Path("results") / place):
        near = f"; did you mean {usual}?"
    hint = f"; run it first: topcli {command} {name}" if command else near
    return UsageError(f"{quoted(place)}: no such file or folder, and no run of this name in {results}{hint}")


def _item(folder: Path) -> dict[str, Any]:
    try:
        rows = stored_sweep_file(folder).count_left
    except TopcliError:
        rows = None
    finished = stored_sweep(folder)
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
        "resumable": not whole,
        "scheme": None,
        "h": None,
        "N": rows,
        "digest": digest[:8] if isinstance(digest, str) else None,
        "ended": finished.manifest.get("ended") if finished else None,
    }
