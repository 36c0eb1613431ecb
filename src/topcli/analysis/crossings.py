"""Crossings of a section: where an orbit passes through the surface g(y) = 0 in a given direction.

Two successive states with g of different signs enclose a crossing. It is located on the scheme's own steps from the
first of them (``engine.loops``): the fraction theta of the step with g = 0, to its last bit. For ``taylor`` and
``exact`` the crossings are those of the motion. For a map of order r they differ from those of its interpolating flow
by O(h^(r+1)); what the scheme conserves at every h is conserved at the crossings.

``SectionRows`` hands the crossings in the rows of a plan to another consumer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from topcli.analysis.tally import Tally
from topcli.contracts import Array, Method, Top
from topcli.engine.consumers import Consumer, State
from topcli.engine.integration import Integration
from topcli.engine.loops import part_steps_of
from topcli.engine.rows import Plan, Rows

Direction = Literal["up", "down", "both"]
Function = Callable[[NDArray[Any], Array], Array]
"""``g(n, states)``: values (k,) of the section's function at ``states`` (k, d) after ``n`` (k,) steps."""

_TOLERANCE = 2.0**-52
"""Uncertainty of theta."""
TRIALS = 160
"""Largest number of trials; a third of them are bisections, of which a root needs 51."""
ZERO = 1e-3
"""A sign change is a jump or a pole, not a zero, if |g| there exceeds this part of its values at the ends."""


@dataclass(frozen=True)
class Crossings:
    """Crossings of several orbits.

    Attributes
    ----------
    which : ndarray of int64, shape (k,)
        Numbers of the orbits.
    n : ndarray of int64, shape (k,)
        Steps done before the crossing.
    theta : ndarray, shape (k,)
        Fraction of the next step at which the orbit crosses, from 0 to 1.
    states : ndarray, shape (k, d)
        States at the crossing.
    """

    which: NDArray[np.int64]
    n: NDArray[np.int64]
    theta: Array
    states: Array


class CrossingSearch:
    """Search for crossings of g = 0 by orbits of ``method`` with steps ``h`` from ``y0`` (m, d).

    ``last`` (m, d) are the latest states that ``add`` has seen, from which another search may continue.
    """

    def __init__(
        self,
        top: Top,
        method: Method,
        h: float,
        y0: Array,
        function: Function,
        direction: Direction = "up",
    ) -> None:
        self.function, self.y0 = function, y0
        self.direction: Direction = direction
        self.parts = part_steps_of(method, top, h)
        self.last = y0.copy()

    def add(self, n: NDArray[np.int64], states: Array, first: int, lengths: NDArray[np.int64]) -> Crossings:
        """Crossings within the next states (c, m, d) of the orbits from ``first`` on, after ``n`` (m,) steps in a row.

        Only the first ``lengths[i]`` states of each count. The initial states are no crossings.
        """
        count, rows, d = states.shape
        values = self.function(np.tile(n, count), states.reshape(-1, d)).reshape(count, rows)
        here = slice(first, first + count)
        if continues := rows > 0 and n[0] > 0:
            before = self.function(np.full(count, n[0] - 1), self.last[here])
            values = np.concatenate([before[:, None], values], axis=1)
        changes = self._changes(values)
        changes &= np.arange(1, changes.shape[1] + 1) < lengths[:, None] + continues
        orbit, row = np.divmod(np.flatnonzero(changes), max(changes.shape[1], 1))
        beginning = states[orbit, row - continues]
        if continues:
            beginning[row == 0] = self.last[here][orbit[row == 0]]
        ended = np.flatnonzero(lengths)
        self.last[first + ended] = states[ended, lengths[ended] - 1]
        begun = n[0] - continues + row if rows else row
        return self._located(first + orbit, begun, beginning, values[orbit, row], values[orbit, row + 1])

    def _changes(self, g: Array) -> NDArray[np.bool_]:
        """True where the values (c, m) change their sign in the section's direction before the next one (c, m - 1)."""
        up = (g[:, :-1] < 0.0) & (g[:, 1:] >= 0.0) if self.direction != "down" else False
        down = (g[:, :-1] > 0.0) & (g[:, 1:] <= 0.0) if self.direction != "up" else False
        return np.asarray(up | down)

    def _located(
        self, which: NDArray[np.int64], n: NDArray[np.int64], before: Array, g0: Array, g1: Array
    ) -> Crossings:
        """Crossings in the steps from the states ``before`` (k, d), with the values of g at both ends (k,)."""

        def value(i: NDArray[np.int64], theta: Array) -> Array:
            return self.function(n[i] + theta, self.parts(y0[i], n[i], before[i], theta))

        y0 = self.y0[which]
        theta, remainder = roots(value, g0, g1)
        ends = np.maximum(np.abs(g0), np.abs(g1))
        zero = np.isfinite(ends) & (np.abs(remainder) <= ZERO * ends)
        states = self.parts(y0[zero], n[zero], before[zero], theta[zero])
        return Crossings(which[zero], n[zero], theta[zero], states)


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


def roots(function: Callable[[NDArray[np.int64], Array], Array], at_zero: Array, at_one: Array) -> tuple[Array, Array]:
    """Roots in [0, 1] of functions that change their sign there, and their values (k,).

    ``function(i, x)`` evaluates the functions numbered ``i`` (j,) at ``x`` (j,); ``at_zero`` and ``at_one`` (k,) are
    the values at both ends. A value that is not finite counts as one of the sign at the upper end. Every third trial
    bisects the interval; the others interpolate linearly (regula falsi), at least ``_TOLERANCE`` away from its ends.
    """
    i = np.arange(len(at_zero))
    best, least = np.ones(len(i)), at_one.copy()  # the better end of the last interval
    a, b, fa, fb = np.zeros(len(i)), np.ones(len(i)), at_zero, at_one
    for trial in range(TRIALS):
        with np.errstate(all="ignore"):
            x = 0.5 * (a + b) if trial % 3 == 2 else b - fb * ((b - a) / (fb - fa))
        x = np.fmin(np.fmax(x, a + _TOLERANCE), b - _TOLERANCE)
        fx = function(i, x)
        fx = np.where(np.isfinite(fx), fx, at_one[i])
        below = np.sign(fx) == np.sign(fa)
        a, fa = np.where(below, [x, fx], [a, fa])
        b, fb = np.where(below, [b, fb], [x, fx])
        best[i], least[i] = np.where(np.abs(fa) < np.abs(fb), [a, fa], [b, fb])
        left = (b - a > 2.0 * _TOLERANCE) & (fx != 0.0)
        if not left.any():
            break
        i, a, b, fa, fb = (values[left] for values in (i, a, b, fa, fb))
    return best, least
