"""Stored results: what a folder holds, the rows and the report in it, and whether all its files are whole.

``manifest.json`` of a folder ``results/NAME`` says what the folder holds: name, config, digest, code and outcome, and
for a result that can be read its files with their SHA-256. As long as the outcome is null, or ``interrupted``, there
is something left to compute, and the folder ``unfinished`` in it holds what is needed for that.
"""

from __future__ import annotations

import errno
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.contracts import Outcome
from topcli.errors import RunError, UsageError, nearest
from topcli.store.files import DamagedError, json_text, read_arrays, read_json, sealed, sha256_of
from topcli.store.table import PARTS, check_parts

MANIFEST, REPORT = "manifest.json", "report.json"
UNFINISHED, CHECKPOINT = "unfinished", "checkpoint.npz"
MANIFEST_VERSION = 3
SWEEP = "sweep"
"""Entry ``kind`` of the manifest of a finished sweep."""
_SEAL = "manifest_sha256"


@dataclass(frozen=True)
class StoredResult:
    """A folder and the manifest in it."""

    folder: Path
    manifest: dict[str, Any]

    @property
    def outcome(self) -> Outcome | None:
        """Outcome of the run; None as long as it is computed, and after a kill."""
        return None if self.manifest["outcome"] is None else Outcome(self.manifest["outcome"])

    @property
    def complete(self) -> bool:
        """True if there is nothing left to compute."""
        return self.outcome not in (None, Outcome.INTERRUPTED)

    @property
    def series(self) -> Path:
        """File of the time series."""
        return self.folder / str(self.manifest["series"])

    @property
    def checkpoint(self) -> Path:
        """File from which the result is continued; it exists only while there is something left to compute."""
        return self.folder / UNFINISHED / CHECKPOINT

    def report(self) -> dict[str, Any]:
        """Content of ``report.json``. Raises RunError if it is missing or damaged."""
        path = self.folder / REPORT
        try:
            return read_json(path)
        except (OSError, DamagedError) as error:
            raise RunError(f"{path}: cannot be read ({str(error)[:120]}); run again with --force") from None

    def damage(self) -> dict[str, str]:
        """Damaged files by name, with the fault; compares all checksums."""
        faults = {}
        for name, entry in self.manifest["files"].items():
            try:
                if sha256_of(self.folder / name) != entry["sha256"]:
                    faults[name] = "its SHA-256 differs from the manifest's"
            except FileNotFoundError:
                faults[name] = "missing"
            except OSError as error:
                faults[name] = f"cannot be read ({error.strerror})"
        if self.complete or not self.checkpoint.exists():
            return faults
        try:
            state = read_arrays(self.checkpoint)
        except (OSError, DamagedError) as error:
            return faults | {f"{UNFINISHED}/{CHECKPOINT}": str(error)}
        return faults | {
            f"{UNFINISHED}/{name}": fault
            for key in state
            if key.endswith(PARTS)
            for name, fault in check_parts(self.folder / UNFINISHED, _table(key), state[key]).items()
        }


def _table(key: str) -> str:
    """Name of the table of a key ``NAME.parts``, before which there may be the number of its consumer."""
    return key.removesuffix(PARTS).rpartition(".")[2]


def manifest_text(content: dict[str, Any]) -> str:
    """Text of a manifest; its last entry is the checksum of the others."""
    return json_text(sealed(content, _SEAL))


def read_result(folder: Path) -> StoredResult | None:
    """Result in ``folder``, finished or not; None if it has no manifest. Raises RunError for a damaged manifest."""
    path = folder / MANIFEST
    try:
        text = path.read_text(encoding="utf-8")
        manifest = json.loads(text)
        if not isinstance(manifest, dict) or text != manifest_text(manifest):
            raise ValueError("its text has changed since it was written")
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG):
            return None
        raise RunError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise RunError(f"{path}: damaged ({str(error)[:120]}); move the folder away to run again") from None
    if manifest.get("manifest_version") != MANIFEST_VERSION:
        raise RunError(f"{path}: written by another version of topcli; move the folder away to run again")
    return StoredResult(folder, manifest)


def stored_results(out: Path) -> dict[str, StoredResult | RunError]:
    """Results in the folders of ``out`` by the name of the folder; for a damaged manifest, the error."""
    results: dict[str, StoredResult | RunError] = {}
    try:
        names = sorted(entry.name for entry in os.scandir(out) if entry.name[0] != "." and entry.is_dir())
    except OSError:
        return {}
    for name in names:
        try:
            if result := read_result(out / name):
                results[name] = result
        except RunError as error:
            results[name] = error
    return results


def intact_result(folder: Path) -> StoredResult:
    """Result in ``folder`` that can be read, with all its checksums compared.

    Raises UsageError if there is none or it is not finished, and RunError if it is damaged.
    """
    result = read_result(folder)
    if result is None:
        hint = ""
        if not folder.is_dir() and not folder.suffix and len(folder.parts) == 1:
            hint = "; give the folder of a run, such as results/NAME"
        elif inside := next(iter(stored_results(folder)), None):
            hint = f"; give one of the runs in it, such as {folder / inside}"
        elif names := stored_results(folder.parent):
            hint = f"; {nearest(folder.name, names)}"
        raise UsageError(f"{folder}: no run is stored here ({MANIFEST} is missing){hint}")
    if result.outcome is None:
        raise UsageError(f"{folder}: the run is unfinished; run it again to continue it")
    for name, fault in result.damage().items():
        raise RunError(f"{folder / name}: damaged: {fault}; run again with --force")
    return result
