"""Writing a file that the user names."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

Overwrite = Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")]


def require_new(path: Path, force: bool, option: str = "--out") -> None:
    """Raise UsageError if ``path`` exists and may not be overwritten, or is a folder."""
    from topcli.errors import UsageError

    if os.path.isdir(path):
        raise UsageError(f"{option} {path}: is a folder; name a file")
    if os.path.lexists(path) and not force:
        raise UsageError(f"{option} {path}: exists already; choose another file, or use --force to overwrite it")


def write_text(text: str, path: Path, option: str = "--out") -> None:
    """Write a file whole or not at all, and its folder if there is none. Raises UsageError."""
    from topcli.errors import UsageError
    from topcli.store.files import write_whole

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{option} {path}".lstrip() + f": cannot be written ({error.strerror})") from None
