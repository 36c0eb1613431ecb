"""Finished run folders: the manifest, validated before use, and the checksums of the files.

``manifest.json`` lists every file of the run with its size and SHA-256. A run counts as up to date only if all sizes
agree, and the checksums of files up to ``CHECKED_AT_ONCE`` bytes, which takes some hundredths of a second; so must the
checksum that the manifest holds of its other entries.
``topcli verify`` compares all checksums.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, FiniteFloat, StrictInt, ValidationError

from topcli.contracts import Outcome
from topcli.errors import RunError

MANIFEST = "manifest.json"
MANIFEST_VERSION = 2
"""Version 1 held the sizes of the files and no checksums."""
CHECKED_AT_ONCE = 1 << 24
"""Largest file, in bytes, whose checksum is compared before a run counts as up to date."""
REPORT = "report.json"
_SEAL = "manifest_sha256"
_LARGEST_JSON = 1 << 26
_BLOCK = 1 << 20

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
    h: FiniteFloat
    N: Annotated[StrictInt, Field(ge=0, lt=1 << 63)]


class _Manifest(BaseModel):
    """Entries that topcli reads; all others are kept as they are."""

    manifest_version: Literal[1, 2]
    name: _Words
    digest: _Sha256
    code: _Words
    outcome: Outcome
    step: _Size = 0
    series: _FileName
    files: Annotated[dict[_FileName, _File | _Size], Field(max_length=1000)]
    config: _Config
    ended: _Words


SWEEP = "sweep"
"""Entry ``kind`` of the manifest of a sweep, which is no run."""


class _SweepManifest(BaseModel):
    kind: Literal["sweep"]
    manifest_version: Literal[2]
    files: Annotated[dict[_FileName, _File], Field(max_length=1000)]


class _NoRunError(ValueError):
    """The manifest is that of a sweep."""


class DamagedError(ValueError):
    """A file of a run differs from what was written; the message describes the difference."""


def _open_without_waiting(path: str, flags: int) -> int:
    """Open a file; if it is a named pipe, do not wait for a writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_json(path: str | Path) -> dict[str, Any]:
    """JSON object in a file. Raises OSError, and DamagedError for any other content."""
    with open(path, "rb", buffering=0, opener=_open_without_waiting) as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode):
            raise DamagedError("no regular file")
        if found.st_size > _LARGEST_JSON:
            raise DamagedError(f"longer than {_LARGEST_JSON} bytes")
        text = file.read()
    try:
        content = json.loads(text)
    except RecursionError:
        raise DamagedError("nested too deeply") from None
    except ValueError as error:
        raise DamagedError(f"not JSON: {error}") from None
    if not isinstance(content, dict):
        raise DamagedError("not a JSON object")
    return content


def _read_manifest(folder: str | Path) -> dict[str, Any]:
    found = read_json(os.path.join(folder, MANIFEST))
    if found.get("kind") == SWEEP:
        raise _NoRunError
    try:
        _Manifest.model_validate(found)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])).encode("unicode_escape").decode()
        raise DamagedError(f"{where[:80]}: {first['msg'].lower()}") from None
    if found["series"] not in found["files"]:
        raise DamagedError("series: not among the files")
    return found


def json_text(content: Mapping[str, Any]) -> str:
    """Text of a JSON file of topcli."""
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def sealed(content: Mapping[str, Any], seal: str = _SEAL) -> dict[str, Any]:
    """``content`` with the checksum of all its other entries as the last one, called ``seal``."""
    content = {name: value for name, value in content.items() if name != seal}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return {**content, seal: hashlib.sha256(text.encode()).hexdigest()}


def check_seal(content: Mapping[str, Any], seal: str = _SEAL) -> None:
    """Raise DamagedError if an entry has changed since ``sealed``; manifests of version 1 had no checksum."""
    if content.get("manifest_version") != 1 and content.get(seal) != sealed(content, seal)[seal]:
        raise DamagedError("its SHA-256 differs from the one that it holds")


def sha256_of(path: Path, length: int | None = None) -> str:
    """SHA-256 of a file, or of its first ``length`` bytes. Raises OSError."""
    digest = hashlib.sha256()
    with path.open("rb", buffering=0) as file:
        left = length
        while block := file.read(_BLOCK if left is None else min(_BLOCK, left)):
            digest.update(block)
            left = None if left is None else left - len(block)
    return digest.hexdigest()


def _regular_size(path: Path) -> int:
    """Size of a regular file. Raises DamagedError for anything else."""
    try:
        if path.is_file():
            return path.stat().st_size
    except OSError as error:
        raise DamagedError(f"cannot be read ({error.strerror})") from None
    raise DamagedError("missing")


def check_file(path: Path, entry: Any, largest: int | None = None) -> None:
    """Compare a file with its ``entry`` in the manifest; if it is larger than ``largest`` bytes, its size only.

    Raises DamagedError.
    """
    size = entry["size"] if isinstance(entry, dict) else entry
    found = _regular_size(path)
    if found != size:
        raise DamagedError(f"{found} bytes, not {size}")
    if isinstance(entry, dict) and (largest is None or size <= largest):
        try:
            same = sha256_of(path) == entry["sha256"]
        except OSError as error:
            raise DamagedError(f"cannot be read ({error.strerror})") from None
        if not same:
            raise DamagedError("its SHA-256 differs from the manifest's")


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

    def same_experiment(self, digest: str) -> bool:
        """True if this is a run of the experiment with this digest."""
        return self.manifest.get("digest") == digest

    def damage(self, largest: int | None = None) -> dict[str, str]:
        """Damaged files and their faults; checksums are compared for files of at most ``largest`` bytes."""
        found = {}
        try:
            check_seal(self.manifest)
        except DamagedError as error:
            found[MANIFEST] = str(error)
        for name, entry in self.manifest["files"].items():
            try:
                check_file(self.folder / name, entry, largest)
            except DamagedError as error:
                found[name] = str(error)
        return found

    def up_to_date(self, digest: str, code: str) -> bool:
        """True if this is a complete, undamaged run of the same experiment and code."""
        return (
            self.same_experiment(digest)
            and self.manifest.get("code") == code
            and not self.interrupted
            and REPORT in self.manifest["files"]
            and not self.damage(CHECKED_AT_ONCE)
        )

    def identical(self, other: Mapping[str, Any]) -> bool:
        """True if ``other`` is the manifest of the same run with a bit-identical series."""
        keys = ("digest", "code", "outcome", "step", "series")
        return all(self.manifest.get(key) == other.get(key) for key in keys) and (
            self.manifest["files"][self.manifest["series"]] == other["files"][other["series"]]
        )


@dataclass(frozen=True)
class DamagedRun:
    """A folder with an invalid manifest, and the reason."""

    folder: Path
    reason: str


def look(folder: Path) -> StoredRun | DamagedRun | None:
    """Run in ``folder``; None if it has no manifest, or that of a sweep."""
    try:
        return StoredRun(folder, _read_manifest(folder))
    except (FileNotFoundError, NotADirectoryError, _NoRunError):
        return None
    except OSError as error:
        return DamagedRun(folder, f"{MANIFEST}: cannot be read ({error.strerror})")
    except DamagedError as error:
        return DamagedRun(folder, f"{MANIFEST}: {error}")


def stored_sweep(folder: Path) -> StoredRun | None:
    """Finished sweep in ``folder``, whose manifest lists its files as that of a run does; None if there is none."""
    try:
        found = read_json(folder / MANIFEST)
        _SweepManifest.model_validate(found)
    except (OSError, ValueError):
        return None
    return StoredRun(folder, found)


def stored_run(folder: Path) -> StoredRun | None:
    """Finished run in ``folder``; None if the manifest is missing or damaged."""
    found = look(folder)
    return found if isinstance(found, StoredRun) else None


def all_runs(out: Path) -> list[StoredRun | DamagedRun]:
    """Runs in the folders of ``out``, including damaged ones, by name."""
    try:
        with os.scandir(out) as entries:
            names = sorted(entry.name for entry in entries if not entry.name.startswith(".") and entry.is_dir())
    except OSError:
        return []
    return [run for name in names if (run := look(out / name))]


def stored_runs(out: Path) -> list[StoredRun]:
    """Finished runs in the folders of ``out``, by name."""
    return [run for run in all_runs(out) if isinstance(run, StoredRun)]
