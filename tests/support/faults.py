"""Faults of the disk and of the process at the n-th operation: full disk, kill before, within or after it, lost power.

Operations are what this process does to files under a folder: creating, writing, flushing, renaming, cutting and
removing them. They are counted where Python calls the system, so a fault falls on the same operation every time,
however fast the machine is. Instead of a fault something else may be done there. The rows that pyarrow writes by itself
count as one operation for each piece.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import re
import signal
import tempfile
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

_WRITES = frozenset("wax+")
_REAL = {name: getattr(os, name) for name in ("write", "pwrite", "fsync", "ftruncate", "truncate", "readlink", "kill")}
_OPEN = io.open


class Disk:
    """Operations under ``root``, counted; at number ``at`` the fault ``how`` happens, with 0 none.

    The faults are kills ``before``, in the middle of (``torn``) and ``after`` the operation, or with the loss of what
    was not flushed (``power``), and a disk that is ``full`` from then on, or ``full once``.

    Those count whose line in ``log``, such as ``replace manifest.json``, matches ``only``. With ``meanwhile`` this is
    called there instead of a fault. ``install`` is for the process to be disturbed; the log is shared with its parent.
    """

    def __init__(
        self,
        root: Path,
        at: int = 0,
        how: str = "before",
        meanwhile: Callable[[], object] | None = None,
        only: str = "",
    ) -> None:
        self.root, self.at, self.how, self._meanwhile = os.path.realpath(root), at, how, meanwhile
        self._only = only
        self.log: BinaryIO = tempfile.TemporaryFile()  # noqa: SIM115 (it lives as long as this)
        weakref.finalize(self, self.log.close)
        self.count, self.full = 0, False
        self._flushed: dict[int, int] = {}

    def operations(self) -> list[str]:
        """The operations so far."""
        self.log.seek(0)
        return self.log.read().decode("utf-8", "replace").splitlines()

    def _inside(self, path: Any) -> bool:
        return isinstance(path, (str, bytes, os.PathLike)) and os.path.realpath(
            os.path.dirname(os.path.abspath(os.fsdecode(path)))
        ).startswith(self.root)

    def _name(self, handle: int) -> str:
        return _REAL["readlink"](f"/proc/self/fd/{handle}")

    def operation(self, name: str, path: Any, do: Callable[[], Any], half: Callable[[], Any] | None = None) -> Any:
        """Do it, unless it is its turn to fail; ``half`` does a part of a write."""
        line = f"{name} {os.path.basename(os.fsdecode(path))}"
        if not re.search(self._only, line):
            return do()
        self.count += 1
        _REAL["write"](self.log.fileno(), f"{line}\n".encode())
        writing = name in ("create", "write", "fsync")
        if self.full and writing:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if self.count != self.at:
            return do()
        if self._meanwhile is not None:
            self._meanwhile()
            return do()
        if self.how.startswith("full"):
            self.full = self.how == "full"
            if half is not None:
                half()
            raise OSError(errno.ENOSPC if writing else errno.EIO, "injected")
        if self.how == "torn" and half is not None:
            half()
        elif self.how in ("after", "power"):
            do()
        if self.how == "power":
            self._lose()
        _REAL["kill"](os.getpid(), signal.SIGKILL)
        raise AssertionError("unreachable: the process is dead")

    def _lose(self) -> None:
        """Cut every file to what was there at the start or has been flushed since."""
        for folder, _, names in os.walk(self.root):
            for name in names:
                path = os.path.join(folder, name)
                found = os.lstat(path)
                if not os.path.islink(path) and found.st_size > (kept := self._flushed.get(found.st_ino, 0)):
                    _REAL["truncate"](path, kept)

    def install(self, put: Callable[[Any, str, Any], None] = setattr) -> Disk:
        """Take the place of the functions of this process that write; ``put`` may be one that takes them back."""
        for folder, _, names in os.walk(self.root):
            for name in names:
                found = os.lstat(os.path.join(folder, name))
                self._flushed[found.st_ino] = found.st_size

        def pwrite(handle: int, data: bytes, offset: int) -> int:
            half = lambda: _REAL["pwrite"](handle, data[: len(data) // 2], offset)  # noqa: E731
            return self._of_handle("write", handle, lambda: _REAL["pwrite"](handle, data, offset), half)

        def fsync(handle: int) -> None:
            def flush() -> None:
                found = os.fstat(handle)
                self._flushed[found.st_ino] = found.st_size

            self._of_handle("fsync", handle, flush)

        def ftruncate(handle: int, length: int) -> None:
            self._of_handle("cut", handle, lambda: _REAL["ftruncate"](handle, length))

        for function in (pwrite, fsync, ftruncate):
            put(os, function.__name__, function)
        for name in ("replace", "rename", "unlink", "remove", "rmdir", "mkdir", "truncate"):
            put(os, name, self._named(name, getattr(os, name)))
        self._files(put)
        return self

    def _of_handle(self, name: str, handle: int, do: Callable[[], Any], half: Any = None) -> Any:
        path = self._name(handle)
        return self.operation(name, path, do, half) if path.startswith(self.root) else do()

    def _named(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def called(path: Any, *others: Any, **options: Any) -> Any:
            do = lambda: real(path, *others, **options)  # noqa: E731
            gone = name in ("unlink", "remove", "rmdir") and not os.path.lexists(path)
            target = others[0] if name in ("replace", "rename") else path
            return self.operation(name, target, do) if self._inside(target) and not gone else do()

        return called

    def _files(self, put: Callable[[Any, str, Any], None]) -> None:
        import pyarrow.parquet as pq

        disk = self

        class Raw(io.FileIO):
            def write(self, data: Any, /) -> int | None:
                whole, write = memoryview(data).cast("B"), super().write
                do, half = lambda: write(whole), lambda: write(whole[: len(whole) // 2])
                return disk._of_handle("write", self.fileno(), do, half)

        def opened(
            file: Any,
            mode: str = "r",
            buffering: int = -1,
            encoding: str | None = None,
            errors: str | None = None,
            newline: str | None = None,
            closefd: bool = True,
            opener: Any = None,
        ) -> Any:
            if not _WRITES & set(mode) or not self._inside(file):
                return _OPEN(file, mode, buffering, encoding, errors, newline, closefd, opener)
            plain = mode.replace("b", "").replace("t", "")
            make = lambda: Raw(file, plain, closefd, opener)  # noqa: E731
            raw = make() if os.path.lexists(file) and "w" not in mode else self.operation("create", file, make)
            if buffering == 0:
                return raw
            buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
            return buffered if "b" in mode else io.TextIOWrapper(buffered, encoding, errors, newline)

        put(io, "open", opened)
        put(builtins, "open", opened)
        written = pq.ParquetWriter.write_table

        def write_table(writer: Any, *arguments: Any, **options: Any) -> None:
            do = lambda: written(writer, *arguments, **options)  # noqa: E731
            disk.operation("write", "pieces.parquet", do) if isinstance(writer.where, (str, os.PathLike)) else do()

        put(pq.ParquetWriter, "write_table", write_table)
