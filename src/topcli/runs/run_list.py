"""Runs in a folder for ``topcli list runs``: finished, interrupted, killed, running or damaged."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from topcli.store.checkpoint import read_checkpoint
from topcli.store.manifest import DamagedRun, all_runs, stored_run
from topcli.store.parts import Part, parts_of

RUNNING, KILLED, DAMAGED = "running", "killed", "damaged"
"""Outcomes of runs that have none of their own."""


def listed_runs(out: Path) -> list[dict[str, Any]]:
    """Runs in ``out`` by name, as plain data.

    ``step`` is the last step of a single run that is kept, ``resumable`` is true if ``--resume`` continues it. What is
    not known is None. Nothing in the folder is changed.
    """
    items = []
    for run in all_runs(out):
        name = run.folder.name
        if isinstance(run, DamagedRun):
            items.append({**_item(name, DAMAGED, {}, None, False), "reason": run.reason})
        else:
            resumable = run.interrupted and read_checkpoint(run.folder) is not None
            items.append(_item(name, run.manifest["outcome"], run.manifest, run.manifest.get("step"), resumable))
    return sorted([*items, *map(_unfinished, parts_of(out))], key=lambda item: item["name"])


def _item(name: str, outcome: object, about: Mapping[str, Any], step: object, resumable: bool) -> dict[str, Any]:
    """Entry of a run from its manifest or the data of its checkpoint, ``about``."""
    config = about.get("config") or {}
    scheme, digest = config.get("scheme"), about.get("digest")
    return {
        "name": name,
        "kind": "ensemble" if "ensemble" in config else "run",
        "outcome": outcome,
        "step": step,
        "resumable": resumable,
        "scheme": scheme.get("name") if isinstance(scheme, dict) else None,
        "h": config.get("h"),
        "N": config.get("N"),
        "digest": digest[:8] if isinstance(digest, str) else None,
        "ended": about.get("ended"),
    }


def _unfinished(part: Part) -> dict[str, Any]:
    """Entry of a part folder; one with a complete run only has to be renamed, which ``--resume`` does."""
    about, step, resumable = part.owner, None, not part.alive
    if complete := stored_run(part.folder):
        about, step = {**complete.manifest, "ended": None}, complete.manifest.get("step")
    elif checkpoint := read_checkpoint(part.folder):
        about, step = checkpoint.about, checkpoint.done
    else:
        resumable = False
    return _item(part.name, RUNNING if part.alive else KILLED, about, step, resumable)
