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
    place = out / name
    try:
        place = Path(name) if Path(name).exists() else place
        if place.is_file():  # of a study, which holds its own checksum
            check_seal(read_json(place))
            return Checked(place.parent, True, (place.name,), {})
        stored = read_result(place)
    except DamagedError as error:
        return Checked(place.parent, True, (place.name,), {place.name: str(error)})
    except OSError as error:
        raise UsageError(f"{name[:400]}: cannot be read ({error.strerror})") from None
    except RunError as error:
        fault = str(error).partition(": ")[2].removeprefix("damaged ")
        return Checked(place, True, (MANIFEST,), {MANIFEST: fault})
    if stored is None:
        raise missing_result(name, out)
    return Checked(place, stored.complete, (MANIFEST, *stored.manifest["files"]), stored.damage())
