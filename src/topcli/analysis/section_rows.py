"""Consumer that turns the rows of a plan into crossings of a section, and hands these to another one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.crossings import CrossingSearch
from topcli.analysis.tally import Tally
from topcli.engine.consumers import Consumer, State
from topcli.engine.integration import Integration
from topcli.engine.rows import Plan, Rows


class SectionRows(Consumer):
    """The crossings of a section, found by ``search_of(plan)``, go to the consumer ``target`` as rows.

    ``counts`` (B,) are the numbers of crossings of each trajectory of all plans so far, and ``quantities`` is a tally
    of the user's quantities at the crossings.
    """

    def __init__(self, search_of: Callable[[Plan], CrossingSearch], target: Consumer) -> None:
        self._search_of, self.target, self.counts = search_of, target, np.zeros(0, dtype=np.int64)
        self.quantities = Tally(drifts=False)

    def begin(self, plan: Plan) -> None:
        """Begin with the initial states of a plan."""
        self._plan, self._search = plan, self._search_of(plan)
        self.counts = np.concatenate([self.counts[: plan.first], np.zeros(len(plan.states), dtype=np.int64)])
        self.quantities = Tally([quantity.name for quantity in plan.quantities], drifts=False)
        self.quantities.begin(plan)
        self.target.begin(plan)

    def add(self, rows: Rows) -> tuple[NDArray[np.int64], Any]:
        """Numbers of the trajectories that cross in a piece, and what the target makes of their crossings."""
        if not len(rows):
            return np.zeros(0, dtype=np.int64), None
        crossings = self._search.add(rows.n, rows.states, rows.first, rows.lengths)
        if not len(crossings.n):
            return crossings.n, None
        n, which = crossings.n + crossings.theta, crossings.which + self._plan.first
        columns = {"n": crossings.n[None], "trajectory": which[None]}
        for i in np.unique(crossings.which).tolist() if self._plan.quantities else ():
            chosen = crossings.which == i
            self.quantities.add(Rows(self._plan, n[chosen], crossings.states[None, chosen], i))
        return which, self.target.add(Rows(self._plan, n, crossings.states[None], columns=columns))

    def take(self, result: tuple[NDArray[np.int64], Any]) -> None:
        """Count the crossings and hand them over."""
        np.add.at(self.counts, result[0], 1)
        if len(result[0]):
            self.target.take(result[1])

    def end(self, run: Integration) -> None:
        """End the target."""
        self.target.end(run)

    def state(self) -> State:
        """States before the next crossing, the counts, and the states of the tally and the target."""
        state = {"before": self._search.last.copy(), "counts": self.counts.copy(), **self.target.state()}
        return state | {f"quantities.{name}": array for name, array in self.quantities.state().items()}

    def restore(self, state: State) -> None:
        """Continue from a ``state()``."""
        self._search.last[:], self.counts = state["before"], np.array(state["counts"])
        begin = "quantities."
        self.quantities.restore({key.removeprefix(begin): state[key] for key in state if key.startswith(begin)})
        self.target.restore(state)
