"""Stored results: what a folder holds, the rows and the report in it, and whether all its files are whole.

``manifest.json`` of a folder ``results/NAME`` says what the folder holds: name, config, digest, code and outcome, and
for a result that can be read its files with their SHA-256. As long as the outcome is null, or ``interrupted``, there
is something left to compute, and the folder ``unfinished`` in it holds what is needed for that.
"""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from topcli.contracts import Outcome
from topcli.errors import RunError, UsageError, nearest
from topcli.store.files import DamagedError, check_seal, read_arrays, read_json, sha256_of

MANIFEST, REPORT = "manifest.json", "report.json"
UNFINISHED, CHECKPOINT = "unfinished", "checkpoint.npz"
MANIFEST_VERSION = 3
SWEEP = "sweep"
"""Entry ``kind`` of the manifest of a finished sweep."""


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
        if not self.complete and self.checkpoint.exists():
            try:
                read_arrays(self.checkpoint)
            except (OSError, DamagedError) as error:
                faults[f"{UNFINISHED}/{CHECKPOINT}"] = str(error)
        return faults


def read_result(folder: Path) -> StoredResult | None:
    """Result in ``folder``, finished or not; None if it has no manifest. Raises RunError for a damaged manifest."""
    path = folder / MANIFEST
    try:
        manifest = read_json(path)
        check_seal(manifest)
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG):
            return None
        raise RunError(f"{path}: cannot be read ({error.strerror})") from None
    except DamagedError as error:
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
    """Result in ``folder`` that can be read, as an interrupted run but no interrupted sweep, all checksums compared.

    Raises UsageError if there is none or it is not finished, and RunError if it is damaged.
    """
    result = read_result(folder)
    if result is None:
        inside, beside = ([str(parent / name) for name in stored_results(parent)] for parent in (folder, folder.parent))
        hint = f"; {nearest(str(folder), inside or beside)}" if inside or beside else ""
        raise UsageError(f"{folder}: no run is stored here ({MANIFEST} is missing){hint}")
    sweep = result.manifest.get("kind") == SWEEP
    if not result.complete if sweep else result.outcome is None:
        raise UsageError(f"{folder}: the {'sweep' if sweep else 'run'} is unfinished; run it again to continue it")
    for name, fault in result.damage().items():
        raise RunError(f"{folder / name}: damaged: {fault}; run again{'' if sweep else ' with --force'}")
    return result
