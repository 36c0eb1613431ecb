"""Checks of stored results (runs, ensembles, sweeps and studies) by ``topcli verify``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from topcli.errors import RunError, UsageError
from topcli.store.files import DamagedError, check_seal, read_json
from topcli.store.results import MANIFEST, read_result
from topcli.sweeps.store import missing_result


@dataclass(frozen=True)
class Checked:
    """A stored result, ``finished`` or not, the ``files`` that belong to it, and its damaged ones with the fault."""

    folder: Path
    finished: bool
    files: tuple[str, ...]
    damage: dict[str, str]

    def data(self) -> dict[str, Any]:
        """Plain data, ready for JSON."""
        return {**asdict(self), "folder": str(self.folder), "state": "damaged" if self.damage else "whole"}


def check_all(name: str, out: Path) -> Checked:
    """Check what is at the path ``name``, or the run or sweep of this name in ``out``.

    Raises UsageError if there is nothing that topcli stored.
    """
    try:
        place = Path(name) if Path(name).exists() else out / name
        checked = _study(place) if place.is_file() else _folder(place)
    except OSError as error:
        raise UsageError(f"{name[:400]}: cannot be read ({error.strerror})") from None
    if checked is None:
        raise missing_result(name, out)
    return checked


def _folder(folder: Path) -> Checked | None:
    """Check every file of a run, an ensemble or a sweep; None if there is none."""
    try:
        stored = read_result(folder)
    except RunError as error:
        return Checked(folder, True, (MANIFEST,), {MANIFEST: str(error).partition(": ")[2].removeprefix("damaged ")})
    if stored is None:
        return None
    return Checked(folder, stored.complete, (MANIFEST, *stored.manifest["files"]), stored.damage())


def _study(path: Path) -> Checked:
    """Check a file of a study, which holds its own checksum."""
    try:
        check_seal(read_json(path))
    except DamagedError as error:
        return Checked(path.parent, True, (path.name,), {path.name: str(error)})
    return Checked(path.parent, True, (path.name,), {})
