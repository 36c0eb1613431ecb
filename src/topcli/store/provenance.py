"""Provenance of a result: versions, platform, CPU and commit."""

from __future__ import annotations

import contextlib
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


ARM_DESIGNERS = {
    "0x41": "Arm",
    "0x46": "Fujitsu",
    "0x48": "HiSilicon",
    "0x4e": "NVIDIA",
    "0x51": "Qualcomm",
    "0x61": "Apple",
    "0xc0": "Ampere",
}


def cpu_name() -> str:
    """Name of the processor; on Arm, its designer and the numbers that identify the core."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    core = {key.strip().lower(): value.strip() for key, _, value in (line.partition(":") for line in text.splitlines())}
    if name := core.get("model name"):
        return name
    if "cpu part" in core:
        designer = core.get("cpu implementer", "")
        numbers = f"part {core['cpu part']} variant {core.get('cpu variant', '?')}"
        return (
            f"{platform.machine()} {ARM_DESIGNERS.get(designer, designer)} {numbers} r{core.get('cpu revision', '?')}"
        )
    if sys.platform == "darwin":
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            command = ["/usr/sbin/sysctl", "-n", "machdep.cpu.brand_string"]
            if name := subprocess.run(command, capture_output=True, text=True, timeout=2, check=False).stdout.strip():
                return name
    return platform.processor() or platform.machine()


def now() -> str:
    """Current time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


class Commit:
    """Git commit of the running topcli, determined in the background; nothing outside a checkout.

    A context manager, which ends the background process if ``read`` is never called.
    """

    def __init__(self) -> None:
        root = Path(__file__).resolve().parents[3]
        self._process: subprocess.Popen[str] | None = None
        self._state: dict[str, Any] | None = None
        if not (root / ".git").exists():
            return
        with contextlib.suppress(OSError):
            self._process = subprocess.Popen(
                ["git", "-C", str(root), "status", "--porcelain=v2", "--branch", "--untracked-files=no"],
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                stdin=subprocess.DEVNULL,
                text=True,
                env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
            )

    def __enter__(self) -> Commit:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._process is not None and self._process.returncode is None:
            self._process.kill()
            self._process.communicate()

    def read(self) -> dict[str, Any]:
        """``{"commit": hash or None, "dirty": bool or None}``; waits at most two seconds."""
        if self._state is not None:
            return self._state
        state: dict[str, Any] = {"commit": None, "dirty": None}
        self._state = state
        if self._process is None:
            return state
        try:
            lines = self._process.communicate(timeout=2)[0].splitlines()
        except subprocess.TimeoutExpired:
            return state
        for line in lines:
            if line.startswith("# branch.oid ") and "(initial)" not in line:
                state["commit"] = line.split()[-1]
        if state["commit"]:
            state["dirty"] = any(not line.startswith("#") for line in lines)
        return state


@cache
def _platform() -> str:
    """System, release, machine and C library; on Linux without the process that ``platform.platform`` starts."""
    if sys.platform != "linux":
        return platform.platform()
    system, library = platform.uname(), "".join(platform.libc_ver())
    return f"{system.system}-{system.release}-{system.machine}" + (f"-with-{library}" if library else "")


def environment() -> dict[str, Any]:
    """Versions, platform and CPU of this process."""
    return {
        "topcli": __version__,
        "python": sys.version.split()[0],
        "platform": _platform(),
        "cpu": cpu_name(),
        **{package: installed(package) for package in PACKAGES},
    }
