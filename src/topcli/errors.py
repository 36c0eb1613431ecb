"""Errors of a user and failures of a run: messages without tracebacks, safe to print.

Every error has a message of one to three lines: what is wrong, where, and what would be right. The command line prints
the message and exits with the error's ``ExitCode``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from enum import IntEnum

NAME_LENGTH = 60
"""Longest name or value that a message repeats."""
LIST_LENGTH = 300
"""Longest list of names in a message that could name the command that lists them."""
MESSAGE_LENGTH = 900
"""Longest message; with the prefix of a command it has less than 1,000 characters."""


class ExitCode(IntEnum):
    """Exit codes of the commands, with their ``meaning`` as the help of ``topcli`` lists it.

    A closed pipe (``topcli ... | head -1``) changes none of these: the command continues without printing. On Windows,
    which topcli does not support, every command exits with 2.
    """

    meaning: str

    def __new__(cls, code: int, meaning: str) -> ExitCode:
        """Exit code that is equal to the integer ``code``."""
        member = int.__new__(cls, code)
        member._value_, member.meaning = code, meaning
        return member

    SUCCESS = 0, "success"
    FAILED = 1, "a run failed"
    WRONG_USAGE = 2, "wrong usage or config"
    PARTLY_FAILED = 3, "part of several runs failed"
    VIOLATED = 4, "a stated tolerance or claim was violated"
    BUG = 70, "an internal error"
    INTERRUPTED = 130, "interrupted"


def printable(text: str) -> str:
    """Return ``text`` with escapes for control characters, newlines and bidi marks.

    >>> print(printable("a\\x1b[31m\\n\\u202eb"))
    a\\x1b[31m\\n\\u202eb
    """
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


def shortened(text: str, length: int = NAME_LENGTH) -> str:
    """Return at most ``length`` characters of ``text``, ending in dots if some are cut."""
    return text if len(text) <= length else text[: length - 3] + "..."


def quoted(name: str) -> str:
    """Return a name given by the user as messages repeat it: quoted, short and printable."""
    return repr(shortened(name))


def clipped(text: str, length: int = MESSAGE_LENGTH) -> str:
    """Return ``text`` without its middle if it is longer than ``length``; place and reason are at its ends."""
    if len(text) <= length:
        return text
    tail = (length - 5) // 2
    return f"{text[: length - 5 - tail]} ... {text[-tail:]}"


class TopcliError(Exception):
    """Failure reported in a few printable ``lines`` of bounded length; ``exit_code`` is that of the process."""

    exit_code = ExitCode.FAILED

    def __init__(self, *lines: str) -> None:
        super().__init__(*lines)
        self.lines = tuple(map(printable, lines))
        if len(str(self)) > MESSAGE_LENGTH:
            self.lines = tuple(clipped(line, MESSAGE_LENGTH // len(lines) - 1) for line in self.lines)

    def __str__(self) -> str:
        return "\n".join(self.lines)


class UsageError(TopcliError):
    """Wrong argument, file or value (exit code 2)."""

    exit_code = ExitCode.WRONG_USAGE

    def _render_traceback_(self) -> list[str]:
        """Lines that IPython and notebooks show in place of a traceback through topcli."""
        return [f"{type(self).__name__}: {self}"]


class ConfigError(UsageError):
    """Error in a config; the message names file, line and key (exit code 2)."""


class StepTooLongError(ConfigError):
    """Step size beyond the domain of the scheme; the message names the longest admissible one (exit code 2)."""


class UnknownNameError(UsageError):
    """Unknown scheme, top or figure; the message names the nearest ones (exit code 2)."""


class SchemeCodeError(UsageError):
    """Code of a scheme or top that raises, or cannot be compiled or identified (exit code 2)."""


class RunError(TopcliError):
    """Run that could not be carried out or written (exit code 1)."""


def nearest(name: str, known: Iterable[str], listed_by: str = "") -> str:
    """Return a hint for a misspelt ``name``: the nearest of the ``known`` names, or all of them.

    Instead of more names than fit on a few lines, the command ``listed_by`` is named if it is given.

    >>> nearest("hkk", ["hk", "hybrid"])
    "did you mean 'hk'?"
    """
    names = sorted(known)
    close = difflib.get_close_matches(name[:NAME_LENGTH].lower(), names, n=2, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    text = ", ".join(names)
    return f"`{listed_by}` lists them" if listed_by and len(text) > LIST_LENGTH else f"known: {text}"
