"""Errors made by the user and failures of runs, with messages that are safe to print.

Every error has a message of one to three lines, which says what is wrong, where, and what would be right. The command
line prints the message without a traceback and exits with the error's ``ExitCode``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path

NAME_LENGTH = 60
"""Length at which messages cut a name or value."""
LIST_LENGTH = 300
"""Longest list of names in a message; instead of a longer one, the message names the command that lists them."""


class ExitCode(IntEnum):
    """Exit codes of the commands, each with its ``meaning`` in the help of ``topcli``.

    A command whose reader closes the pipe (``topcli ... | head -1``) may exit with 1.
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
    PARTLY_FAILED = 3, "only some of several runs failed"
    VIOLATED = 4, "a tolerance is exceeded, or a declaration or claim is false"
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


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as "1 row", "2 rows" and "3 copies"."""
    several = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{count} {noun if count == 1 else several}"


def quoted(name: str) -> str:
    """Return a name given by the user in the form for messages: quoted, short and printable."""
    return repr(shortened(name))


class TopcliError(Exception):
    """Base class of topcli's errors.

    The message consists of a few printable ``lines``. ``exit_code`` is the exit code of a command that ends with this
    error.
    """

    exit_code = ExitCode.FAILED

    def __init__(self, *lines: str) -> None:
        super().__init__(*lines)
        self.lines = tuple(map(printable, lines))

    def __str__(self) -> str:
        return "\n".join(self.lines)


class UsageError(TopcliError):
    """Wrong argument, file or value; the exit code is 2."""

    exit_code = ExitCode.WRONG_USAGE

    def _render_traceback_(self) -> list[str]:
        """Return the lines that IPython and notebooks show instead of a traceback."""
        return [f"{type(self).__name__}: {self}"]


class ConfigError(UsageError):
    """Error in a config; the message names file, line and key, and the exit code is 2."""


class StepTooLongError(ConfigError):
    """Step size too long for the scheme; the message gives the longest one allowed, and the exit code is 2."""


class UnknownNameError(UsageError):
    """Unknown name of a scheme, top, figure and so on; the message gives the nearest names, and the exit code is 2."""


class SchemeCodeError(UsageError):
    """Code of a scheme or top that raises an exception or cannot be compiled or identified; the exit code is 2."""


class RunError(TopcliError):
    """Run that could not be computed or stored; the exit code is 1."""


def successor(name: str) -> str:
    """Return the replacement of a command, option, scheme or key of an earlier version; empty for any other name.

    >>> successor("scheme hybrid-xi")
    'use hybrid'
    """
    import tomllib

    entries = tomllib.loads(Path(__file__).with_name("gone.toml").read_text(encoding="utf-8"))
    return next((text for text, names in entries.items() if name in names), "")


def nearest(name: str, choices: Iterable[str], listed_by: str = "") -> str:
    """Return a hint for a misspelt ``name``: the nearest of the ``choices`` or, if none is near, all of them.

    If ``listed_by`` is given and the list is long, the hint names this command instead.

    >>> nearest("hkk", ["hk", "hybrid"])
    "did you mean 'hk'?"
    """
    names = sorted(choices)
    close = difflib.get_close_matches(name[:NAME_LENGTH].lower(), names, n=2, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    text = ", ".join(names)
    return f"`{listed_by}` lists them" if listed_by and len(text) > LIST_LENGTH else f"known: {text}"
