"""Working states of steps: the sums of state and change, and what is carried beside the state.

A scheme gives the change of its state; ``stepper`` writes the step for the compiler. The slots of the working state
are the state, the kept quantities, the rounding errors of the sums, the status of an iteration, and the counters.

**Compensated sums.** A change of size h has a rounding error of about h times the last bit of the state, whereas the
addition state + change has an error of the last bit itself (``arithmetic.increments``). Its rounding error starts at
zero, is not recorded, and does not depend on h, so that a compensated scheme can be composed like a plain one. Cost:
one addition more on the critical path of a step; the rest overlaps with the next step. The errors are not tested for
finiteness, because one that is not finite makes the state non-finite. Measured: 1.03 to 1.25 times the plain step; 0.71
times the straightforward HK step, including the compensation of the change of gamma.

**Counters** report failures that would otherwise be silent. An event uses quantities that the step computes anyway:
once both are inlined, the compiler merges them, and only a comparison and an addition are added, off the critical path.
The state is unchanged, bit for bit. Measured (ratio to the time of a step without counter): HK 1.00 (Kowalevski), 1.02
(Euler, heavy), 1.03 (Lagrange), 1.08 (Euler with gamma, 0.9 ns); the hybrids 1.01, Bohlin's methods 1.02. A slot that
counts nothing has the same cost. Counters are always finite and are not tested for finiteness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.double_double import compensated_sum
from topcli.arithmetic.fused import unlikely
from topcli.contracts import Floats, StepFunction, Stepper

Change = StepFunction
"""``change(state, h, p)``: change of the state, then the status and the events to be counted, if there are any."""
Event = Callable[[Floats, Floats, float, Floats], bool]
"""``event(old, new, h, p)`` is true if the step from working state ``old`` to ``new`` is to be counted."""
Prediction = Callable[[Floats, float, Floats], tuple[float, float]]

NEAR_SINGULAR = "near_singular_solves"
AMBIGUOUS = "ambiguous_roots"
SMALL = 2.0**-10
"""A determinant below this fraction of the sum of the magnitudes of its terms has lost three digits to cancellation."""


class CompensatedOption(BaseModel):
    """Option to compensate the rounding errors of the sums old + change."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    compensated: bool = Field(
        default=False,
        description="carry the rounding error of each sum state + change to the next: reduces round-off by about h",
    )


def is_compensated(options: object) -> bool:
    """True if ``options`` have the option ``compensated`` and it is set."""
    return isinstance(options, CompensatedOption) and options.compensated


@cache
def _writer(moved: int, kept: int, lost: tuple[int, ...], iterative: bool, counters: int, adds: bool) -> Any:
    """Function that makes a step of a change; see ``stepper``."""
    state, constants = [f"y{i}" for i in range(moved)], [f"c{i}" for i in range(kept)]
    errors, counts, status = [f"e{i}" for i in lost], [f"n{i}" for i in range(counters)], ["status"] * iterative
    changes = [f"x{i}" for i in range(moved)] if adds else state
    lines = [
        f"{', '.join([*state, *constants, *errors, *status, *counts])}, = s",
        f"{', '.join([*changes, *status, *(f'more_{n}' for n in counts)])}, = change"
        f"(({', '.join([*state, *constants])},), h, p)",
        *(f"y{i}, e{i} = compensated_sum(y{i}, e{i}, x{i})" for i in lost),
        *(f"y{i} = y{i} + x{i}" for i in range(moved) if adds and i not in lost),
        f"return ({', '.join([*state, *constants, *errors, *status, *(f'{n} + more_{n}' for n in counts)])},)",
    ]
    text = "def make(change):\n    def step(s, h, p):\n        " + "\n        ".join(lines) + "\n    return step"
    scope: dict[str, Any] = {"compensated_sum": compensated_sum, "__name__": __name__}
    exec(compile(text, f"<step {moved}/{kept}/{lost}>", "exec"), scope)
    return scope["make"]


def summed(change: Change, count: int) -> StepFunction:
    """Step state + change of ``count`` components."""
    return _writer(count, 0, (), False, 0, True)(change)


def first(count: int) -> StepFunction:
    """``leave`` of a working state that begins with the ``count`` components of the physical one."""

    def leave(s: Floats, h: float, p: Floats) -> Floats:
        return s[:count]

    return leave


def stepper(
    change: Change,
    moved: int,
    kept: int = 0,
    *,
    lost: Iterable[int] = (),
    adds: bool = True,
    counters: tuple[str, ...] = (),
    iterative: bool = False,
    checked: int = 0,
    enter: StepFunction | None = None,
    leave: StepFunction | None = None,
    advice: Callable[[Sequence[float], float], str] | None = None,
) -> Stepper:
    """Stepper that adds ``change`` to the first ``moved`` slots of its state.

    ``kept`` slots that do not change follow. The rounding errors of the sums of the slots ``lost`` are carried. After
    the changes, ``change`` returns the status if it is ``iterative``, and an addition to each of the ``counters``; it
    returns the new slots themselves instead of changes if not ``adds``. ``enter`` gives the moved and kept slots, by
    default the physical state; ``leave`` is by default that of a state of 6 components, or of fewer if fewer are moved.
    """
    errors = tuple(lost)
    tail = (0.0,) * (len(errors) + iterative + len(counters))
    begin = enter

    def enter_slots(y: Floats, h: float, p: Floats) -> Floats:
        return (*(begin(y, h, p) if begin else y), *tail)

    width = moved + kept + len(tail)
    return Stepper(
        _writer(moved, kept, errors, iterative, len(counters), adds)(change),
        width,
        enter_slots if begin or tail else None,
        leave or (first(min(moved, 6)) if width > 6 or tail else None),
        counters,
        iterative=iterative,
        checked=checked,
        advice=advice,
    )


def increment_stepper(change: Change, d: int, options: object, iterative: bool = False) -> Stepper:
    """Stepper of d components from their ``change``, compensated if ``options`` say so."""
    compensated = is_compensated(options)
    return stepper(change, d, lost=range(d * compensated), checked=d * compensated, iterative=iterative)


def with_counter(stepper: Stepper, name: str, event: Event, branch: bool = False) -> Stepper:
    """Add to ``stepper`` a counter ``name`` of the steps for which ``event`` is true.

    With ``branch`` the machine code branches to the addition instead of selecting its result. This saves operations but
    splits the step into two parts that the compiler schedules separately; which is faster has to be measured.
    """
    step, inner_enter, inner_leave = stepper.step, stepper.enter, stepper.leave

    def counted(s: Floats, h: float, p: Floats) -> Floats:
        old = s[:-1]
        new = step(old, h, p)
        count = s[-1]
        if event(old, new, h, p):
            count = count + 1.0
        return (*new, count)

    def branching(s: Floats, h: float, p: Floats) -> Floats:
        old = s[:-1]
        new = step(old, h, p)
        count = s[-1]
        if unlikely(event(old, new, h, p)):
            count = count + 1.0
        return (*new, count)

    def enter(y: Floats, h: float, p: Floats) -> Floats:
        return (*(inner_enter(y, h, p) if inner_enter else y), 0.0)

    if inner_leave is None:

        def leave(s: Floats, h: float, p: Floats) -> Floats:
            return s[:-1]
    else:

        def leave(s: Floats, h: float, p: Floats) -> Floats:
            return inner_leave(s[:-1], h, p)

    return replace(
        stepper,
        step=branching if branch else counted,
        width=stepper.width + 1,
        enter=enter,
        leave=leave,
        counters=(*stepper.counters, name),
        checked=stepper.checked or stepper.width - len(stepper.counters),
    )


def small_determinant(determinant: Callable[[Floats, float, Floats], tuple[float, float]]) -> Event:
    """Event: a determinant is near zero; ``determinant(state, h, p)`` returns it and the size of its terms."""

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        value, terms = determinant(old, h, p)
        return abs(value) < SMALL * terms

    return event


def ambiguous_root(predict: Prediction) -> Event:
    """Event: both square roots are about equally close to the prediction of omega1 + i omega2.

    The distances of the root r and of -r from the prediction q differ by less than a factor of 1.3 if
    8 |r.q| <= r.r + q.q. Either the prediction is bad, or both roots are near 0, where they coincide.
    """

    def event(old: Floats, new: Floats, h: float, p: Floats) -> bool:
        q1, q2 = predict(old, h, p)
        v1, v2 = new[0], new[1]
        return 8.0 * abs(v1 * q1 + v2 * q2) <= (v1 * v1 + v2 * v2) + (q1 * q1 + q2 * q2)

    return event
