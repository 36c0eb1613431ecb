"""Writing of complete files, JSON with a checksum of its content, and messages on failures."""

from __future__ import annotations

import hashlib
import io
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topcli.errors import RunError, UsageError, quoted
from topcli.store.provenance import git_commit, now

if TYPE_CHECKING:
    from numpy.typing import NDArray

SEAL = "content_sha256"
"""Entry of a manifest or a study with the checksum of all others."""


class DamagedError(ValueError):
    """A file differs from what was written; the message describes the difference."""


def sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to the disk. Raises OSError."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file atomically, under a temporary name of the same suffix at first. Raises OSError.

    The content is flushed to the disk before the rename, and the folder after it: when the machine fails, ``path`` is
    the earlier file or the new one, never an empty one.
    """
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        write(temporary)
        sync(temporary)
        os.replace(temporary, path)
        sync(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file with this text atomically. Raises OSError."""
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def io_failure(error: OSError, path: Path, consequence: str = "nothing of this run was stored") -> RunError:
    """Error message for a failed write to ``path`` that names the ``consequence`` for what is stored.

    If ``error`` names another file, the message names that file in the folder of ``path``.
    """
    name = Path(error.filename).name if isinstance(error.filename, str) else ""
    if name and not name.startswith(".") and name != path.name:
        path = path / name
    return RunError(f"{path}: cannot be written ({error.strerror or error}); {consequence}")


def require_writable(out: Path) -> None:
    """Create the folder ``out`` if it does not exist. Raises UsageError if it cannot be written to."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):  # has no name that a killed process could leave behind
            pass
    except OSError as error:
        raise UsageError(
            f"output folder {out}: cannot be written to ({error.strerror}); choose another with --out"
        ) from None


def sha256_of(path: Path) -> str:
    """SHA-256 of a file. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_json(path: str | Path) -> dict[str, Any]:
    """JSON object in a file. Raises OSError, and DamagedError for any other content."""
    try:
        content = json.loads(Path(path).read_bytes())
    except (ValueError, RecursionError) as error:
        raise DamagedError(f"not JSON: {error}") from None
    if not isinstance(content, dict):
        raise DamagedError("not a JSON object")
    return content


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays by name into one file atomically, with their SHA-256 at its end. Raises OSError."""
    import numpy as np

    content = io.BytesIO()
    np.savez(content, **arrays)
    content.write(hashlib.sha256(content.getbuffer()).digest())
    write_whole(path, lambda temporary: temporary.write_bytes(content.getbuffer()))


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays by name, as ``write_arrays`` stored them. Raises OSError, and DamagedError if the checksum differs."""
    import numpy as np

    content = path.read_bytes()
    if hashlib.sha256(content[:-32]).digest() != content[-32:]:
        raise DamagedError("its SHA-256 differs from that at its end")
    with np.load(io.BytesIO(content[:-32]), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def json_text(content: Mapping[str, Any]) -> str:
    """Text of a JSON file of topcli."""
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """``content`` with the checksum of all its other entries as the last one."""
    content = {name: value for name, value in content.items() if name != SEAL}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return {**content, SEAL: hashlib.sha256(text.encode()).hexdigest()}


def require_new(paths: Iterable[Path], option: str = "--out") -> None:
    """Raise UsageError if one of ``paths`` exists; the message names ``--force``."""
    for path in paths:
        if os.path.lexists(path):
            raise UsageError(
                f"{option} {path}: exists already; choose another name or folder, or use --force to replace it".lstrip()
            )


def sealed_text(data: Mapping[str, Any]) -> str:
    """JSON text of a stored report with its checksum, the time and the commit."""
    complete = {**data, "written": now(), **git_commit()}
    return json_text(sealed(json.loads(json.dumps(complete, allow_nan=False))))


def check_seal(data: Mapping[str, Any]) -> None:
    """Compare a manifest or a study with the checksum stored in it. Raises DamagedError."""
    if SEAL not in data:
        raise DamagedError(f"holds no {SEAL}")
    if data[SEAL] != sealed(data)[SEAL]:
        raise DamagedError("its SHA-256 differs from the one stored in it")


def write_by_ending(path: str | Path, contents: Mapping[str, Callable[[], str | bytes]]) -> Path:
    """Write the content for the ending of the name of a file, whole or not at all, and return the path.

    Raises UsageError for another ending or a folder that cannot be written to, and RunError if writing fails.
    """
    path = Path(path)
    if path.suffix.lower() not in contents:
        raise UsageError(f"save: {quoted(path.name)}: unknown type of file; use {', '.join(contents)}")
    content = contents[path.suffix.lower()]()
    require_writable(path.parent)
    try:
        write_whole(path, lambda file: file.write_bytes(content if isinstance(content, bytes) else content.encode()))
    except OSError as error:
        raise io_failure(error, path, "nothing was written") from error
    return path
