"""Runs in a folder as ``topcli list runs`` shows them: finished, interrupted, killed, running, damaged."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import DamagedRun, StoredRun, all_runs, stored_run
from topcli.store.parts import Part, all_parts

RUNNING, KILLED, DAMAGED = "running", "killed", "damaged"
"""Outcomes of runs that have none of their own."""


def listed_runs(out: Path) -> list[dict[str, Any]]:
    """Runs in ``out`` by name, as plain data.

    ``step`` is the last step of a single run that is kept, ``resumable`` is true if ``--resume`` continues it. What is
    not known is None. Nothing in the folder is changed.
    """
    items = [_damaged(run) if isinstance(run, DamagedRun) else _stored(run) for run in all_runs(out)]
    items += [_unfinished(part) for part in all_parts(out)]
    return sorted(items, key=lambda item: item["name"])


def _item(name: str, outcome: object, about: dict[str, Any], step: object, resumable: bool) -> dict[str, Any]:
    """Entry of a run from its manifest or the data of its checkpoint, ``about``."""
    config = about.get("config") or {}
    scheme = config.get("scheme")
    digest = about.get("digest")
    return {
        "name": name,
        "outcome": outcome,
        "step": step,
        "resumable": resumable,
        "scheme": scheme.get("name") if isinstance(scheme, dict) else None,
        "h": config.get("h"),
        "N": config.get("N"),
        "digest": digest[:8] if isinstance(digest, str) else None,
        "ended": about.get("ended"),
    }


def _damaged(run: DamagedRun) -> dict[str, Any]:
    return {**_item(run.folder.name, DAMAGED, {}, None, False), "reason": run.reason}


def _stored(run: StoredRun) -> dict[str, Any]:
    resumable = run.interrupted and read_checkpoint(run.folder) is not None
    return _item(run.folder.name, run.manifest["outcome"], run.manifest, run.manifest.get("step"), resumable)


def _unfinished(part: Part) -> dict[str, Any]:
    """Entry of a part folder; one with a complete run only has to be renamed, which ``--resume`` does."""
    outcome = RUNNING if part.alive else KILLED
    if complete := stored_run(part.folder):
        about = {**complete.manifest, "ended": None}
        return _item(part.name, outcome, about, about.get("step"), not part.alive)
    checkpoint = read_checkpoint(part.folder)
    if checkpoint is None:
        return _item(part.name, outcome, part.owner, None, False)
    return _item(part.name, outcome, checkpoint.about, checkpoint.done, not part.alive)
