"""A terminal of a given width for the tests of what a person sees."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import termios
from collections.abc import Sequence
from pathlib import Path


def in_terminal(command: Sequence[str], cwd: Path, columns: int = 80, **environment: str) -> tuple[int, str]:
    """Exit code of a command and all that it writes to a terminal of this width, with its control sequences."""
    controller, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    inherited = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
    process = subprocess.Popen(
        command,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        cwd=cwd,
        env=inherited | {"TERM": "xterm-256color"} | environment,
    )
    os.close(terminal)
    pieces = []
    while True:
        try:
            piece = os.read(controller, 65536)
        except OSError:  # Linux, when the process has closed the terminal
            break
        if not piece:
            break
        pieces.append(piece)
    os.close(controller)
    return process.wait(60.0), b"".join(pieces).decode("utf-8").replace("\r\n", "\n")
