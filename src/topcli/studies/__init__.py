"""Studies: functions that measure and return a report, each a command and a function of the Python interface.

Their names are in ``topcli.STUDIES``.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from topcli import STUDIES


class Watch:
    """Observer of a study while it runs; this one is silent. It is called with (done, total) as the study proceeds."""

    def begin(self, name: str, *experiments: Any, unit: str = "steps") -> None:
        """Note that the ``experiments`` are run from now on; progress counts the ``unit``.

        Everything that the user gave is checked before.
        """

    def __call__(self, done: int, total: int, note: str = "") -> None:
        """Note that ``done`` of ``total`` are done."""


SILENT = Watch()


def find_study(name: str) -> Any:
    """Function of the study called ``name``."""
    return getattr(import_module(STUDIES[name][0]), name)
