"""The one time loop: iterate a step, record every k-th state, stop at the first state that is not finite.

numba needs tuples of known length, so the loop is a template filled in with the lengths of the working state,
the recorded state and the constants; the text below is all the code there is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from topcli.contracts import Stepper
from topcli.engine.native import Native, native

SIGNATURE = "pppdqqq"

_TEMPLATE = """
def make(step, enter, leave):
    def enter_state(y, work, params, h):
        {set_p}
        s = enter(({y_items}), h, p)
        {store_s}
        return 0

    def drive(work, out, params, h, steps, every, until_record):
        # returns the number of steps done, or minus the number of the first step whose result is not finite
        {set_p}
        s = ({work_items})
        k = 0
        left = until_record
        for i in range(steps):
            s = step(s, h, p)
            if not ({finite} == 0.0):
                return -(i + 1)
            left -= 1
            if left == 0:
                y = leave(s, h, p)
                {record}
                k += {d}
                left = every
        {store_s}
        return steps

    return enter_state, drive
"""


def _same(state: Any, h: float, p: Any) -> Any:
    """Enter and leave of a scheme that works on the physical state itself."""
    return state


@cache
def _template(width: int, d: int, constants: int) -> Callable[..., tuple[Any, Any]]:
    newline = "\n        "
    text = _TEMPLATE.format(
        set_p=f"p = ({''.join(f'params[{i}], ' for i in range(constants))})",
        y_items="".join(f"y[{i}], " for i in range(d)),
        work_items="".join(f"work[{i}], " for i in range(width)),
        store_s=newline.join(f"work[{i}] = s[{i}]" for i in range(width)),
        finite=" + ".join(f"(s[{i}] - s[{i}])" for i in range(width)),
        record=(newline + " " * 8).join(f"out[k + {i}] = y[{i}]" for i in range(d)),
        d=d,
    )
    scope: dict[str, Any] = {}
    exec(compile(text, f"<time loop {width}/{d}/{constants}>", "exec"), scope)
    return scope["make"]


def plain_loop(stepper: Stepper, d: int, constants: int) -> tuple[Callable[..., int], Callable[..., int]]:
    """``(enter, drive)`` as plain Python functions over indexable buffers: what gets compiled, and its twin."""
    make = _template(stepper.width, d, constants)
    return make(stepper.step, stepper.enter or _same, stepper.leave or _same)


def compiled_loop(stepper: Stepper, d: int, constants: int) -> tuple[Callable[..., int], Native]:
    """``(enter, drive)`` with ``drive`` as machine code; ``enter`` runs once and stays plain Python."""
    enter, drive = plain_loop(stepper, d, constants)
    return enter, native(drive, SIGNATURE)
