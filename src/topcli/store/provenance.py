"""Provenance of a result: versions, platform, CPU and commit."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from topcli import __version__

PACKAGES = ("numpy", "numba", "llvmlite", "pyarrow", "pydantic")


@cache
def installed(package: str) -> str | None:
    """Version of an installed package, found without importing it; None if it is not installed.

    A package that is imported already knows its version; reading the metadata of some takes 5 ms.
    """
    loaded = getattr(sys.modules.get(package), "__version__", None)
    if isinstance(loaded, str):
        return loaded
    try:
        return version(package)
    except PackageNotFoundError:
        return None


@cache
def cpu_name() -> str:
    """Name of the processor, as far as the system knows it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()


def now() -> str:
    """Current time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def git_commit() -> dict[str, Any]:
    """``commit`` of the running topcli, and ``dirty`` if a tracked file differs from it; None outside a checkout."""
    root = Path(__file__).resolve().parents[3]
    state: dict[str, Any] = {"commit": None, "dirty": None}
    if not (root / ".git").exists():
        return state
    command = ["git", "-C", str(root), "status", "--porcelain=v2", "--branch", "--untracked-files=no"]
    unlocked = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=2, check=False, env=unlocked)
    except (OSError, subprocess.TimeoutExpired):
        return state
    lines = done.stdout.splitlines()
    for line in lines:
        if line.startswith("# branch.oid ") and "(initial)" not in line:
            state = {"commit": line.split()[-1], "dirty": any(not line.startswith("#") for line in lines)}
    return state


def environment() -> dict[str, Any]:
    """Versions, platform and CPU of this process."""
    system = platform.uname()  # platform.platform() starts a process
    return {
        "topcli": __version__,
        "python": sys.version.split()[0],
        "platform": f"{system.system}-{system.release}-{system.machine}",
        "cpu": cpu_name(),
        **{package: installed(package) for package in PACKAGES},
    }
