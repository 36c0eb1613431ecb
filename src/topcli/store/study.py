"""Results of a study in one JSON file, written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from topcli.errors import RunError
from topcli.store.manifest import DamagedError, check_seal, json_text, sealed
from topcli.store.provenance import Commit, now
from topcli.store.run_folder import io_failure, require_writable, write_whole

SEAL = "content_sha256"
"""Entry with the checksum of all others."""


def write_study(path: Path, data: Mapping[str, Any], source: str | None) -> Path:
    """Write a study to ``path`` atomically, with the time, the commit and the ``source`` that it depends on.

    Returns the path. Raises UsageError and RunError.
    """
    require_writable(path.parent)
    with Commit() as commit:
        complete = {**data, "source": source, "written": now(), **commit.read()}
    plain = json.loads(json.dumps(complete, allow_nan=False))
    text = json_text(sealed(plain, SEAL))
    try:
        write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise io_failure(error, path, "nothing was written") from error
    return path


def check_study(data: Mapping[str, Any], text: str | None = None) -> None:
    """Compare a study with the checksum that it holds, and its ``text``, if given, with what is written of it.

    Raises DamagedError.
    """
    if not isinstance(data.get(SEAL), str):
        raise DamagedError(f"holds no {SEAL}; it is not a study that topcli stored")
    check_seal(data, SEAL)
    if text is not None and text != json_text(data):
        raise DamagedError("its text is not as it was written")


def stored_study(path: Path, version: int, command: str) -> dict[str, Any] | None:
    """Return the study at ``path``; None if there is none or it has another schema ``version``.

    Raises RunError if it is damaged; the message names the ``command`` that makes it.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        return data if data["schema_version"] == version else None
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunError(f"{path}: cannot be read ({error}); run {command} again") from None
