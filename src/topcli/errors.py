"""What a user can do wrong, and what a run can do wrong: messages without tracebacks.

Every error carries a message of one to three lines that says what is wrong, where, and what would be
right. The command line prints the message and leaves with the error's exit code:

====  =========================================================
code  meaning
====  =========================================================
0     fine
1     a run failed (blew up, could not be written)
2     wrong usage or wrong configuration
3     part of a sweep failed
4     a stated tolerance or claim was violated
70    a bug in topcli, reported with a traceback
130   interrupted
====  =========================================================
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class TopcliError(Exception):
    """A failure to be told in a few lines; ``exit_code`` is what the process leaves with."""

    exit_code = 1


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
    """Half a sentence that helps with a misspelt ``name``: the nearest of the ``known`` ones, or all of them.

    >>> nearest("hkk", ["hk", "hybrid"])
    "did you mean 'hk'?"
    """
    names = sorted(known)
    close = difflib.get_close_matches(name.lower(), names, n=2, cutoff=0.6)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    return "known: " + ", ".join(names)
