"""Checks of stored results (runs, ensembles, sweeps and studies) by ``topcli verify``."""

from __future__ import annotations

from pathlib import Path

from topcli.errors import UsageError
from topcli.store.files import DamagedError, check_study, read_json
from topcli.store.manifest import MANIFEST
from topcli.store.parts import parts_of
from topcli.store.verify import CheckedFile, CheckedRun, check_run
from topcli.sweeps.journal import JOURNAL, damaged_lines
from topcli.sweeps.run import is_sweep
from topcli.sweeps.sweep_list import missing_result


def _unfinished_sweep(folder: Path) -> CheckedRun:
    """Check the journal, from which an unfinished sweep is continued; its table is written again.

    A manifest is there once it has finished; one that cannot be understood is damaged.
    """
    try:
        damaged = damaged_lines(folder / JOURNAL)
        reason = f"{damaged} damaged lines, whose rows run again" if damaged else "every line has its checksum"
    except OSError as error:
        damaged, reason = 1, f"cannot be read ({error.strerror})"
    manifest = [CheckedFile(MANIFEST, True, "no manifest of a sweep")] if (folder / MANIFEST).exists() else []
    return CheckedRun(folder, False, (CheckedFile(JOURNAL, bool(damaged), reason), *manifest))


def _study(path: Path) -> CheckedRun:
    """Check a file of a study, which holds its own checksum."""
    reason, damaged = "", False
    try:
        check_study(read_json(path), path.read_text(encoding="utf-8"))
    except (DamagedError, UnicodeDecodeError) as error:
        reason, damaged = str(error), True
    return CheckedRun(path.parent, True, (CheckedFile(path.name, damaged, reason),))


def _checked(place: Path) -> CheckedRun | None:
    """Result in a folder or file; None if there is none."""
    if place.is_file():
        return _study(place)
    checked = check_run(place)
    if checked is None and is_sweep(place):
        checked = _unfinished_sweep(place)
    return checked


def check_all(name: str, out: Path) -> list[CheckedRun]:
    """Check what is at the path ``name``, or the run or sweep of this name in ``out`` and its part folders.

    Raises UsageError if there is nothing that topcli stored.
    """
    try:
        place = Path(name)
        places = [place] if place.exists() else [out / name, *(part.folder for part in parts_of(out, name))]
        checked = [run for run in map(_checked, places) if run is not None]
    except OSError as error:
        raise UsageError(f"{name[:400]}: cannot be read ({error.strerror})") from None
    if not checked:
        raise missing_result(name, out)
    return checked
