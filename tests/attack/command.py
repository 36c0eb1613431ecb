"""The command line called in a fork of this process: its output, exit code and signal, and the files it writes.

A fork shares what is imported already, so that a call costs milliseconds.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

LIMIT = float(os.environ.get("ATTACK_LIMIT", "60"))
"""Seconds that a call may take."""
HEED = 5.0
"""Seconds after which a signal must have taken effect."""
_NOFOLLOW = {"os.remove", "os.rename", "os.rmdir", "os.symlink", "os.link"}
_WRITING = {"open", "os.mkdir", "os.truncate", "os.chmod", "os.chown", "os.utime", *_NOFOLLOW}
_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass(frozen=True)
class Said:
    """One call: its arguments, what it printed, its exit code, negative for a signal; None when it did not end.

    A call that takes longer than allowed is ``slow`` when SIGTERM ends it as interrupted. ``touched`` are
    the files that it wrote outside the folders where it may write.
    """

    argv: tuple[str, ...]
    code: int | None
    out: str
    err: str
    touched: tuple[str, ...] = ()
    slow: bool = False


class Watch:
    """Notes every write of this process that Python's audit hooks see outside ``roots``, while ``active``."""

    def __init__(self, note: Callable[[str], object]) -> None:
        self.active = False
        self.roots: tuple[str, ...] = ()
        self._relative: list[str] = []
        self._note = note
        sys.addaudithook(self._look)

    def _look(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.active or event not in _WRITING:
            return
        self.active = False
        try:
            for path in self._paths(event, arguments):
                self._judge(event, path)
        finally:
            self.active = True

    def _judge(self, event: str, path: str) -> None:
        if not any(path == root or path.startswith(root + os.sep) for root in self.roots):
            self._note(f"{event} {path}")

    def _paths(self, event: str, arguments: tuple[Any, ...]) -> Iterator[str]:
        if event == "open":
            path = arguments[0]
            if not arguments[2] & _FLAGS:
                return
            if isinstance(path, (str, bytes, os.PathLike)) and not os.path.isabs(os.fsdecode(path)):
                self._relative.append(os.path.realpath(os.fsdecode(path)))  # or in a folder that the event leaves out
                return
            named = [(path, -1)]
        elif event == "os.rename":
            named = [(arguments[0], arguments[2]), (arguments[1], arguments[3])]
        elif event in ("os.symlink", "os.link"):
            named = [(arguments[1], arguments[-1])]
        else:
            named = [(arguments[0], -1 if event == "os.truncate" else arguments[-1])]
        for path, folder in named:
            if isinstance(path, (str, bytes, os.PathLike)):
                text = os.fsdecode(path)
                if isinstance(folder, int) and folder >= 0 and not os.path.isabs(text):
                    text = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), text)
                stays = event == "open" and isinstance(arguments[2], int) and arguments[2] & os.O_NOFOLLOW
                if event in _NOFOLLOW or stays:
                    yield os.path.join(os.path.realpath(os.path.dirname(text) or "."), os.path.basename(text))
                else:
                    yield os.path.realpath(text)

    @contextmanager
    def over(self, roots: Sequence[Path]) -> Iterator[None]:
        """Watch, while the folders ``roots`` may be written to."""
        self.roots = (*(os.path.realpath(root) for root in roots), os.devnull, "/dev/tty")
        self.active = True
        try:
            yield
        finally:
            self.active = False
            for path in filter(os.path.lexists, self._relative):
                self._judge("open", path)
            self._relative.clear()


def in_process(argv: Sequence[str]) -> int:
    """The exit code of the command called in this process; what it prints goes to the streams of this process."""
    from topcli.__main__ import main

    sys.argv = ["topcli", *argv]
    code: object = None
    try:
        main()
    except SystemExit as leaving:
        code = leaving.code
    sys.stdout.flush()
    sys.stderr.flush()
    return code if isinstance(code, int) else int(code is not None)


def redirect(out: BinaryIO, err: BinaryIO) -> None:
    """Send all that this process prints, machine code included, into two open files."""
    empty = os.open(os.devnull, os.O_RDONLY)
    for handle, number in ((empty, 0), (out.fileno(), 1), (err.fileno(), 2)):
        os.dup2(handle, number)
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115 (for the whole process)
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)  # noqa: SIM115
    faulthandler.enable(err.fileno())


def content_of(file: BinaryIO) -> str:
    """All that was written to an open file; bytes that are no text become U+FFFD."""
    file.seek(0)
    return file.read().decode("utf-8", "replace")


def fork(work: Callable[[], int]) -> int:
    """Run ``work`` in a process of its own, which exits with the code that it returns; return the process number."""
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if not pid:
        try:
            os._exit(work())
        except BaseException as error:
            print(repr(error), file=sys.stderr, flush=True)
            os._exit(99)
    return pid


def _ended(pid: int, limit: float) -> tuple[int | None, bool]:
    """Exit code of a process, None if it had to be killed, and whether SIGTERM had to ask for its end."""
    deadline, pause, asked = time.monotonic() + limit, 0.0005, False
    while True:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return None if asked and code == -signal.SIGTERM else code, asked
        if time.monotonic() > deadline:
            os.kill(pid, signal.SIGKILL if asked else signal.SIGTERM)
            if asked:
                os.waitpid(pid, 0)
                return None, True
            asked, deadline = True, deadline + HEED
        time.sleep(pause)
        pause = min(0.02, 1.5 * pause)


def call(
    argv: Sequence[str],
    cwd: Path,
    writable: Sequence[Path],
    environment: Mapping[str, str] = {},
    limit: float = LIMIT,
    prepare: Callable[[], object] = lambda: None,
) -> Said:
    """Call the command with the working folder ``cwd``, in a fork; it may write in the folders ``writable``.

    ``prepare`` is called before it, in its process. After ``limit`` seconds SIGTERM asks for its end.
    """
    files = (tempfile.TemporaryFile(), tempfile.TemporaryFile(), tempfile.TemporaryFile())  # noqa: SIM115

    def work() -> int:
        os.chdir(cwd)
        os.environ.update(environment)
        redirect(files[0], files[1])
        watch = Watch(lambda line: os.write(files[2].fileno(), (line + "\n").encode("utf-8", "replace")))
        with watch.over(writable):
            prepare()
            return in_process(argv)

    code, asked = _ended(fork(work), limit)
    out, err, touched = (content_of(file) for file in files)
    for file in files:
        file.close()
    return Said(tuple(argv), code, out, err, tuple(touched.splitlines()), asked and code is not None)
