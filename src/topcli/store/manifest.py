"""Manifest of a finished run folder: its validation, and the checksums of the files.

``manifest.json`` lists every file of the run with its size and SHA-256. A run counts as up to date only if all sizes
agree, and the checksums of files up to ``CHECKED_AT_ONCE`` bytes, which takes some hundredths of a second; so must the
checksum that the manifest holds of its other entries.
``topcli verify`` compares all checksums.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, FiniteFloat, StrictInt, ValidationError

from topcli.contracts import Outcome
from topcli.errors import RunError
from topcli.store.files import DamagedError, check_seal, read_json, sealed, sha256_of

MANIFEST = "manifest.json"
MANIFEST_VERSION = 2
CHECKED_AT_ONCE = 1 << 24
"""Largest file, in bytes, whose checksum is compared before a run counts as up to date."""
REPORT = "report.json"
SWEEP = "sweep"
"""Entry ``kind`` of the manifest of a sweep, which is not a run."""
MANIFEST_SEAL = "manifest_sha256"

_Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,99}$")]
_Size = Annotated[StrictInt, Field(ge=0)]
_Words = Annotated[str, Field(max_length=1000)]


class _File(BaseModel):
    size: _Size
    sha256: _Sha256


class _Scheme(BaseModel):
    name: _Words


class _Config(BaseModel):
    scheme: _Scheme
    h: FiniteFloat | Annotated[str, Field(pattern=r"^-?[0-9]+/[0-9]+$")]  # a fraction, in other precisions than double
    N: Annotated[StrictInt, Field(ge=0, lt=1 << 63)]


class _Manifest(BaseModel):
    """Entries that topcli reads; all others are kept as they are."""

    manifest_version: Literal[2]
    files: Annotated[dict[_FileName, _File], Field(max_length=1000)]


class _SweepManifest(_Manifest):
    kind: Literal["sweep"]


class _RunManifest(_Manifest):
    name: _Words
    digest: _Sha256
    code: _Words
    outcome: Outcome
    step: _Size = 0
    series: _FileName
    config: _Config
    ended: _Words


def sealed_manifest(folder: Path, content: Mapping[str, Any], names: Mapping[str, str | None]) -> dict[str, Any]:
    """Manifest of the files ``names``, with the checksums that are known; that of all its entries comes last."""
    files = {
        name: {"size": (folder / name).stat().st_size, "sha256": sha256 or sha256_of(folder / name)}
        for name, sha256 in names.items()
    }
    return sealed({"manifest_version": MANIFEST_VERSION, **content, "files": files}, MANIFEST_SEAL)


def check_file(path: Path, entry: Mapping[str, Any], largest: int | None = None) -> None:
    """Compare a file with its ``entry`` in the manifest; if it is larger than ``largest`` bytes, its size only.

    Raises DamagedError.
    """
    size = entry["size"]
    try:
        if not path.is_file():
            raise DamagedError("missing")
        if (actual := path.stat().st_size) != size:
            raise DamagedError(f"{actual} bytes, not {size}")
        if (largest is None or size <= largest) and sha256_of(path) != entry["sha256"]:
            raise DamagedError("its SHA-256 differs from the manifest's")
    except OSError as error:
        raise DamagedError(f"cannot be read ({error.strerror})") from None


@dataclass(frozen=True)
class StoredRun:
    """A finished run folder and its manifest."""

    folder: Path
    manifest: dict[str, Any]

    @property
    def series(self) -> Path:
        """File of the time series."""
        return self.folder / str(self.manifest["series"])

    @property
    def outcome(self) -> Outcome:
        """Outcome of the run."""
        return Outcome(self.manifest["outcome"])

    @property
    def interrupted(self) -> bool:
        """True if the run was stopped before its end."""
        return self.manifest.get("outcome") == Outcome.INTERRUPTED

    def report(self) -> dict[str, Any]:
        """Content of ``report.json``. Raises RunError if it is missing or damaged."""
        path = self.folder / REPORT
        try:
            return read_json(path)
        except (OSError, DamagedError) as error:
            raise RunError(f"{path}: cannot be read ({str(error)[:120]}); run again with --force") from None

    def damage(self, quick: bool = False) -> dict[str, str]:
        """Damaged files and their faults; if ``quick``, of files beyond ``CHECKED_AT_ONCE`` bytes only by size."""
        faults = {}
        try:
            check_seal(self.manifest, MANIFEST_SEAL)
        except DamagedError as error:
            faults[MANIFEST] = str(error)
        for name, entry in self.manifest["files"].items():
            try:
                check_file(self.folder / name, entry, CHECKED_AT_ONCE if quick else None)
            except DamagedError as error:
                faults[name] = str(error)
        return faults

    def same(self, about: Mapping[str, Any], *more: str) -> bool:
        """True if ``about`` has the digest and the code of this run, and agrees in ``more`` entries."""
        return all(self.manifest.get(key) == about.get(key) for key in ("digest", "code", *more))

    def complete(self, about: Mapping[str, Any]) -> bool:
        """True if this is a complete run of the experiment and code that ``about`` has."""
        return self.same(about) and not self.interrupted and REPORT in self.manifest["files"]

    def identical(self, other: Mapping[str, Any]) -> bool:
        """True if ``other`` is the manifest of the same run with a bit-identical series."""
        return self.same(other, "outcome", "step", "series") and (
            self.manifest["files"][self.manifest["series"]] == other["files"][other["series"]]
        )


@dataclass(frozen=True)
class DamagedRun:
    """A folder with an invalid manifest, and the reason."""

    folder: Path
    reason: str


def read_run(folder: Path) -> StoredRun | DamagedRun | None:
    """Run in ``folder``; None if it has no manifest, or that of a sweep."""
    try:
        manifest = read_json(os.path.join(folder, MANIFEST))
        if manifest.get("kind") == SWEEP:
            return None
        _RunManifest.model_validate(manifest)
        if manifest["series"] not in manifest["files"]:
            raise DamagedError("series: not among the files")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        reason = f"cannot be read ({error.strerror})"
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])).encode("unicode_escape").decode()
        reason = f"{where[:80]}: {first['msg'].lower()}"
    except DamagedError as error:
        reason = str(error)
    else:
        return StoredRun(folder, manifest)
    return DamagedRun(folder, f"{MANIFEST}: {reason}")


def stored_sweep(folder: Path) -> StoredRun | None:
    """Return the finished sweep in ``folder``; None if there is none."""
    try:
        manifest = read_json(folder / MANIFEST)
        _SweepManifest.model_validate(manifest)
    except (OSError, ValueError):
        return None
    return StoredRun(folder, manifest)


def stored_run(folder: Path) -> StoredRun | None:
    """Finished run in ``folder``; None if the manifest is missing or damaged."""
    run = read_run(folder)
    return run if isinstance(run, StoredRun) else None


def all_runs(out: Path) -> list[StoredRun | DamagedRun]:
    """Runs in the folders of ``out``, including damaged ones, by name."""
    try:
        with os.scandir(out) as entries:
            names = sorted(entry.name for entry in entries if not entry.name.startswith(".") and entry.is_dir())
    except OSError:
        return []
    return [run for name in names if (run := read_run(out / name))]


def stored_runs(out: Path) -> list[StoredRun]:
    """Finished runs in the folders of ``out``, by name."""
    return [run for run in all_runs(out) if isinstance(run, StoredRun)]
