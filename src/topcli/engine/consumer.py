"""Consumers, which a driver feeds with rows: tallies, tables, collectors."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from topcli.engine.integration import Integration
from topcli.engine.plan import Plan
from topcli.engine.rows import Rows

State = dict[str, NDArray[Any]]
"""Arrays by name, from which work continues that was stopped."""


class Consumer:
    """Something that is fed with the rows of one plan after the other; every method may be left out."""

    def begin(self, plan: Plan) -> None:
        """Make ready for the trajectories of a plan."""

    def add(self, rows: Rows) -> Any:
        """Evaluate rows, those of a trajectory in the order of time; called in several threads at once.

        The states are views that are overwritten afterwards. The result goes to ``take``.
        """

    def take(self, result: Any) -> None:
        """Take a result of ``add``; called in one thread, in the order of the trajectories and of time."""

    def end(self, run: Integration) -> None:
        """Take note of the end of all trajectories of the plan."""

    def state(self) -> State:
        """Arrays from which ``restore`` continues, called when no row is on its way."""
        return {}

    def restore(self, state: State) -> None:
        """Continue from a ``state()``, after ``begin``."""
