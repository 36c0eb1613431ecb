"""The option ``compensated`` of schemes that write a step as old + change, and the one way to make both of its forms.

A scheme gives the change; plain and compensated step are made from the same function. What is carried starts at zero,
is no part of what is recorded, and means the same for every h, so that a compensated scheme composes like a plain one.

What makes it cheap: one addition more is waited for in a step, and the rest is done beside the next one; what is
carried is not looked at for what is not finite, because it cannot but spoil the state. Measured: 1.03 to 1.25 times
the plain step; 0.71 times the straightforward HK step, with what the change of gamma rounds carried as well.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from topcli.arithmetic.increments import Change, compensated3, compensated6, first3, first6, plain3, plain6
from topcli.contracts import Floats, Stepper


class CompensatedOption(BaseModel):
    """Whether the rounding errors of the sums old + change are carried along."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    compensated: bool = Field(
        default=False,
        description="carry the rounding error of each sum state + change to the next: round-off smaller by about h",
    )


def compensation_wanted(options: object) -> bool:
    """Whether ``options`` ask for it; a scheme built without options of its own is plain."""
    return isinstance(options, CompensatedOption) and options.compensated


def enter_compensated(y: Floats, h: float, p: Floats) -> Floats:
    """The physical state, and as many zeros: nothing lost yet."""
    return (*y, *(0.0 for _ in y))


def increment_stepper(change: Change, d: int, options: object) -> Stepper:
    """The stepper of d = 3 or 6 components whose ``change`` is given, compensated where ``options`` ask for it."""
    if not compensation_wanted(options):
        return Stepper(plain3(change) if d == 3 else plain6(change), d)
    if d == 3:
        return Stepper(compensated3(change), 6, enter_compensated, first3, checked=3)
    return Stepper(compensated6(change), 12, enter_compensated, first6, checked=6)
