"""Checkpoints: the exact state of an unfinished run, as named arrays and plain data in one file.

``checkpoint.npz`` is written atomically. Its last 32 bytes are the SHA-256 of its content, which reveals damage.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.store.files import write_whole
from topcli.store.series import SeriesMark

CHECKPOINT = "checkpoint.npz"
VERSION = 2
_ABOUT = {
    "digest": str,
    "code": str,
    "started": str,
    "run_seconds": float,
    "resumed": list,
    "chunks": list,
    "config": dict,
    "environment": dict,
}
"""Keys of ``about`` and their types; a file with others is damaged."""

_UNREADABLE = (OSError, ValueError, KeyError, EOFError, TypeError, RecursionError, MemoryError, NotImplementedError)


@dataclass(frozen=True)
class Checkpoint:
    """A run stopped between two chunks after ``done`` steps.

    ``work`` is the working state of the engine, ``tally`` the sums of the invariant report, ``series`` a mark of how
    far the series has been written. ``rows`` are in neither of them yet: step numbers (m,) and states (m, d).
    ``about`` is plain data: experiment, code, environment, times.
    """

    done: int
    work: NDArray[Any]
    tally: dict[str, NDArray[Any]]
    series: SeriesMark
    rows: tuple[NDArray[Any], NDArray[Any]]
    about: dict[str, Any]


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Write ``checkpoint`` into ``folder`` atomically and flush it to the disk. Raises OSError naming the file."""
    path = folder / CHECKPOINT
    head = {
        "version": VERSION,
        "done": checkpoint.done,
        "length": checkpoint.series.length,
        "sha256": checkpoint.series.sha256,
        "columns": list(checkpoint.series.held),
        "about": checkpoint.about,
    }
    arrays = {
        "head": np.frombuffer(json.dumps(head).encode(), dtype=np.uint8),
        "work": checkpoint.work,
        "rows_n": checkpoint.rows[0],
        "rows_states": checkpoint.rows[1],
        **{f"tally_{name}": values for name, values in checkpoint.tally.items()},
        **{f"held_{i}": values for i, values in enumerate(checkpoint.series.held.values())},
    }
    content = io.BytesIO()
    np.savez(content, **arrays)
    content.write(hashlib.sha256(content.getbuffer()).digest())
    try:
        write_whole(path, lambda temporary: temporary.write_bytes(content.getbuffer()))
    except OSError as error:
        error.filename = str(path)
        raise


def read_checkpoint(folder: Path) -> Checkpoint | None:
    """Checkpoint in ``folder``; None if there is none, or if it is damaged or of another version."""
    try:
        content = (folder / CHECKPOINT).read_bytes()
        if hashlib.sha256(memoryview(content)[:-32]).digest() != content[-32:]:
            return None
        with np.load(io.BytesIO(content[:-32]), allow_pickle=False) as file:
            arrays: Mapping[str, NDArray[Any]] = {name: file[name] for name in file.files}
        head = json.loads(arrays["head"].tobytes())
        if head["version"] != VERSION:
            return None
        held = {name: arrays[f"held_{i}"] for i, name in enumerate(head["columns"])}
        tally = {name.removeprefix("tally_"): values for name, values in arrays.items() if name.startswith("tally_")}
        numbers = (head["done"], head["length"], *head["about"]["chunks"])
        if not all(isinstance(number, int) and number >= 0 for number in numbers):
            return None
        if not all(isinstance(head["about"][key], kind) for key, kind in _ABOUT.items()):
            return None
        mark = SeriesMark(head["length"], held, str(head["sha256"]))
        rows = (arrays["rows_n"], arrays["rows_states"])
        return Checkpoint(head["done"], arrays["work"], tally, mark, rows, head["about"])
    except (*_UNREADABLE, zipfile.BadZipFile):
        return None
