"""Steps from the change that they make, plain and compensated.

A change of size h has a rounding error of about h times the last bit of the state, whereas the addition state + change
has an error of the last bit itself. A compensated step carries the rounding error of each addition to the next step
(Kahan, Comm. ACM 8 (1965) 40), which divides round-off by about h. The errors start at zero, are not recorded and do
not depend on h. They are not tested for finiteness, because one that is not finite makes the state non-finite. A
compensated step has one addition more on its critical path; the rest overlaps with the next step.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

from topcli.arithmetic.fused import compensated_sum, defined
from topcli.contracts import Floats, StepFunction, Stepper, same_state


@cache
def _writer(moved: int, rest: int, compensated: bool, iterative: bool, counters: int) -> Any:
    """Function that makes a step of a change of ``moved`` slots, which ``rest`` constant slots follow."""
    state, constants = [f"y{i}" for i in range(moved)], [f"c{i}" for i in range(rest)]
    errors, counts = [f"e{i}" for i in range(moved)] * compensated, [f"n{i}" for i in range(counters)]
    changes, status = [f"x{i}" for i in range(moved)], ["status"] * iterative
    lines = [
        f"{', '.join([*state, *constants, *errors, *status, *counts])}, = s",
        f"{', '.join([*changes, *status, *(f'more_{n}' for n in counts)])}, = change"
        f"(({', '.join([*state, *constants])},), h, p)",
        *(f"y{i}, e{i} = compensated_sum(y{i}, e{i}, x{i})" for i in range(moved) if compensated),
        *(f"y{i} = y{i} + x{i}" for i in range(moved) if not compensated),
        f"return ({', '.join([*state, *constants, *errors, *status, *(f'{n} + more_{n}' for n in counts)])},)",
    ]
    text = "def make(change):\n    def step(s, h, p):\n        " + "\n        ".join(lines) + "\n    return step"
    return defined(text, f"step {moved}/{rest}", compensated_sum=compensated_sum, __name__=__name__)["make"]


def first(count: int) -> StepFunction:
    """``leave`` of a working state that begins with the ``count`` components of the physical state."""

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return s[:count]

    return leave


def stepper(
    change: StepFunction,
    d: int,
    rest: int = 0,
    *,
    iterative: bool = False,
    counters: tuple[str, ...] = (),
    enter: StepFunction | None = None,
    leave: StepFunction | None = None,
    compensated: bool = False,
) -> Stepper:
    """Stepper that adds ``change`` to the first ``d`` slots of its working state.

    Parameters
    ----------
    change : callable
        ``change(state, h, p)`` returns the changes of ``d`` slots; then, if it is ``iterative``, the status (0.0, or
        nan without convergence); then the number of events of each of the ``counters``.
    d, rest : int
        Slots that move, and constant slots that follow them. ``enter`` and ``leave`` convert the physical state to
        these slots and back; by default it is the first ``d`` of them.
    compensated : bool, optional
        Carry the rounding errors of the sums, in ``d`` slots before the status.
    """
    begin, tail = enter or same_state, (0.0,) * (d * compensated + iterative + len(counters))

    def enter_slots(y: Floats, h: float, p: Floats) -> Floats:
        return (*begin(y, h, p), *tail)

    return Stepper(
        _writer(d, rest, compensated, iterative, len(counters))(change),
        d + rest + len(tail),
        enter_slots if enter or tail else None,
        leave or (first(d) if rest or tail else None),
        counters,
        iterative=iterative,
        checked=d if compensated and not iterative else 0,  # a status must be seen
        change=change,
    )


def compensated(method: Stepper, d: int) -> Stepper:
    """``method``, which has a ``change`` of its d components, with compensated sums."""
    assert method.change is not None
    summed = stepper(method.change, d, iterative=method.iterative, counters=method.counters, compensated=True)
    return replace(summed, constants=method.constants, source=method.source, tangent=method.tangent)
