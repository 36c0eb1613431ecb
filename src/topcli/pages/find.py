"""Find what an argument of ``topcli report`` names: a run, an ensemble, a sweep or a stored study."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from topcli.errors import UsageError, nearest, quoted
from topcli.pages.contents import Chapter
from topcli.pages.runs import DAMAGED, damaged_chapter, part_chapter, run_chapter
from topcli.pages.studies import bench_chapter, claims_chapter, comparison_chapter, stress_chapter
from topcli.pages.study import study_chapter
from topcli.pages.sweeps import sweep_chapter
from topcli.store.manifest import MANIFEST, DamagedError, DamagedRun, StoredRun, look, read_json
from topcli.store.parts import is_part, linked_file, parts_of
from topcli.store.study import SEAL, check_study
from topcli.studies.study import STUDIES, Result, find_study
from topcli.sweeps.rows import ROWS
from topcli.sweeps.run import SWEEP_FILE, is_sweep

STUDY_FILES = ("stress.json", "order.json")
"""Files of studies, found in a folder of their own."""
_RUN_FILES = ("report.json", "config.yaml", "series.parquet", "series.csv", "trajectories.parquet", "trajectories.csv")


def chapters_of(place: str, results: Path, first: int) -> list[Chapter]:
    """Chapters on what ``place`` names: a path, or the name of a folder in ``results``.

    The chapters are numbered from ``first`` on the page. Raises UsageError if there is nothing that topcli stored.
    """
    try:
        for path in (Path(place), results / place):
            if path.is_dir():
                return [_of_folder(path, f"part{first}")]
            if path.exists():
                return [_of_file(path, f"part{first}")]
        parts = parts_of(results, place)
    except OSError as error:
        raise UsageError(f"{place[:400]}: cannot be read ({error.strerror})") from None
    if not parts:
        known = _names(results)
        hint = f"; {nearest(place, known)}" if known else ""
        raise UsageError(f"{quoted(place)}: no such file or folder, and no run of this name in {results}{hint}")
    return [part_chapter(part, place) for part in parts]


def _names(results: Path) -> list[str]:
    """Names of the folders in ``results``."""
    try:
        return [entry.name for entry in os.scandir(results) if entry.is_dir() and not entry.name.startswith(".")]
    except OSError:
        return []


def _link_in(folder: Path) -> Path | None:
    """A link, or anything but a regular file, in the place of a file of a result; None if there is none."""
    others = (folder / name for name in (ROWS, SWEEP_FILE, *STUDY_FILES))
    return linked_file(folder) or next((path for path in others if path.is_symlink()), None)


def _of_folder(folder: Path, name: str) -> Chapter:
    if link := _link_in(folder):  # a page shows nothing of files that its results do not hold
        chapter = Chapter(folder.name, "run", state=DAMAGED, good=False)
        chapter.missing.append(f"{link.name}: is not a regular file; nothing of this folder is shown")
        return chapter
    found = look(folder)
    if isinstance(found, StoredRun):
        return bench_chapter(found) if found.manifest.get("kind") == "bench" else run_chapter(found, name)
    if is_sweep(folder) or (folder / ROWS).exists():
        return sweep_chapter(folder, name)
    if isinstance(found, DamagedRun):
        return damaged_chapter(found, name)
    if is_part(folder):
        own = folder.absolute()
        for part in parts_of(own.parent, own.name[1:].rpartition(".part-")[0]):
            if part.folder.name == own.name:
                return part_chapter(part, own.name)
    for file in STUDY_FILES:
        if (folder / file).is_file():
            return _of_file(folder / file, name)
    if any((folder / file).exists() for file in _RUN_FILES):
        return damaged_chapter(DamagedRun(folder, f"{MANIFEST}: missing; the run is not finished"), name)
    inside = [entry.name for entry in sorted(folder.iterdir()) if look(entry) or is_sweep(entry)]
    hint = f"; name what is in it, such as {folder / inside[0]}" if inside else ""
    raise UsageError(f"{folder}: no run, sweep or study is stored here{hint}")


def _of_file(path: Path, name: str) -> Chapter:
    """Chapter on a file: a study as JSON, or a file of a run or sweep, which stands for its folder."""
    if path.name in (ROWS, SWEEP_FILE, MANIFEST, *_RUN_FILES):
        return _of_folder(path.parent, name)
    try:
        data = read_json(path)
    except DamagedError as error:
        wrong = f"{error}" if path.suffix == ".json" else "not a file that topcli report reads"
        raise UsageError(f"{path}: {wrong}", _KNOWN) from None
    chapter = _study(data, name)
    if chapter is None:
        raise UsageError(f"{path}: not a result that topcli report shows", _KNOWN)
    if SEAL in data:
        try:
            check_study(data)
        except DamagedError as error:
            chapter.state, chapter.good = DAMAGED, False
            chapter.missing.append(f"{path.name}: {error}")
    return chapter


_KNOWN = "give the folder of a run or sweep, or a JSON file of topcli compare, order or stress"


def _study(data: dict[str, Any], name: str) -> Chapter | None:
    """Chapter on a study; None if the data is that of none."""
    if data.get("command") == "compare":
        series = data.get("series")
        return comparison_chapter(data, series if isinstance(series, dict) else {}, name)
    if isinstance(data.get("claims"), list):
        return claims_chapter(data, name)
    if "trials" in data:
        return stress_chapter(data)
    for study in map(find_study, STUDIES):
        if data.get("command") == study.name or study.known(data):
            return study_chapter(study, Result(data), name)
    return None


def all_chapters(places: Sequence[str], results: Path) -> list[Chapter]:
    """Chapters on all ``places``, each once. Raises UsageError."""
    found: list[Chapter] = []
    for place in dict.fromkeys(places):
        found += chapters_of(place, results, len(found) + 1)
    return found
