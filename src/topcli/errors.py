"""Mistakes of a user and failures of a run: messages without tracebacks, safe to print.

Every error carries a message of one to three lines that says what is wrong, where, and what would be
right. The command line prints the message and exits with the error's code:

====  =========================================================
code  meaning
====  =========================================================
0     fine
1     a run failed (blew up, left its motion, not written)
2     wrong usage or wrong configuration
3     part of a sweep failed
4     a stated tolerance or claim was violated
70    an internal error: a bug in topcli, printed with a traceback
130   interrupted
====  =========================================================

A reader that closes the pipe (``topcli ... | head -1``) changes none of these: the command goes on to its end without
printing. On Windows, which topcli does not support, every command exits with 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

NAME_LENGTH = 60
"""Longest name or value that a message repeats."""
MESSAGE_LENGTH = 900
"""Longest message; what a command puts before it stays below 1,000 characters in all."""


def printable(text: str) -> str:
    """Return ``text`` with an escape for every character that a terminal would obey: controls, newlines, bidi marks.

    >>> print(printable("a\\x1b[31m\\n\\u202eb"))
    a\\x1b[31m\\n\\u202eb
    """
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def shortened(text: str, length: int = NAME_LENGTH) -> str:
    """Beginning of ``text``, with dots where more than ``length`` characters are cut."""
    return text if len(text) <= length else text[: length - 3] + "..."


def quoted(name: str) -> str:
    """A name from the user as messages repeat it: quoted, short and printable."""
    return repr(shortened(name))


def clipped(text: str, length: int = MESSAGE_LENGTH) -> str:
    """``text`` without its middle where it is longer than ``length``: the place and the reason are at its ends."""
    if len(text) <= length:
        return text
    tail = (length - 5) // 2
    return f"{text[: length - 5 - tail]} ... {text[-tail:]}"


class TopcliError(Exception):
    """A failure reported in a few ``lines``, printable and of bounded length; ``exit_code`` ends the process."""

    exit_code = 1

    def __init__(self, *lines: str) -> None:
        super().__init__(*lines)
        self.lines = tuple(map(printable, lines))
        if len(str(self)) > MESSAGE_LENGTH:
            self.lines = tuple(clipped(line, MESSAGE_LENGTH // len(lines) - 1) for line in self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)


class UsageError(TopcliError):
    """The user's mistake: a wrong argument, file or value (exit code 2)."""

    exit_code = 2


class ConfigError(UsageError):
    """A mistake in a config; the message names file, line and key (exit code 2)."""


class UnknownNameError(UsageError):
    """A scheme, top or figure that does not exist; the message offers the nearest names (exit code 2)."""


class SchemeCodeError(UsageError):
    """A scheme's or top's code that raises, or cannot be compiled or identified (exit code 2)."""


class RunError(TopcliError):
    """A run that could not be carried out or written (exit code 1)."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Half a sentence that helps with a misspelt ``name``: the nearest of the ``known`` names, or all of them.

    >>> nearest("hkk", ["hk", "hybrid"])
    "did you mean 'hk'?"
    """
    names = sorted(known)
    close = difflib.get_close_matches(name[:NAME_LENGTH].lower(), names, n=2, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    return "known: " + ", ".join(names)
