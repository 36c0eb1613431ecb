"""Reports on series that are made up, of an invariant of a motion of one component."""

from __future__ import annotations

import numpy as np

from topcli.analysis.tally import Tally
from topcli.analysis.verdict import InvariantRow
from topcli.contracts import Invariant, Top
from topcli.engine.rows import Plan, Rows


class Line(Top):
    """A motion of one component, whose states are made up."""

    kind = "line"
    components = ("y",)
    field = staticmethod(lambda y, p: y)


def report_on(
    values: np.ndarray, motion: np.ndarray, h: float, terms: np.ndarray, pieces: int = 1, N: int = 0
) -> InvariantRow:
    """The report on a series (m,), one value a step, of an invariant x with terms (m,) of these sizes.

    ``motion`` (m,) is the component; ``N`` is the number of steps that the run should have taken, if not m - 1.
    """
    invariant = Invariant("x", "x", "x", "a series", lambda y: values, lambda y: terms[: len(y)])
    plan = Plan(Line(), None, motion[:1, None], h, N or max(len(values) - 1, 1), invariants=(invariant,))
    tally = Tally(judged=True)
    tally.begin(plan)
    for n in np.array_split(np.arange(len(values)), pieces):
        tally.add(Rows(plan, n, motion[None, n, None], columns={"x": values[None, n]}))
    return tally.report()[0]
