"""The loop over steps with a loop over trajectories inside it: what the compiler turns into vector instructions.

Nothing is checked in it: it adds up the working state, and an infinity or a nan anywhere makes the sum one. What
single runs do behind a rare branch, such as calling libm for a large angle, stands as a nan here, because in a vector
both sides of a branch are computed always; who runs the loop takes such trajectories through the single loop instead.

The bits are those of single runs: additions and multiplications are not contracted, and a call of libm that is left is
made for one trajectory after the other. Intel's vector library SVML would change last bits; numba uses it
only where the package icc-rt is installed, which topcli does not ask for, and not with NUMBA_DISABLE_INTEL_SVML=1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import VECTOR_VARIANTS
from topcli.contracts import StepFunction, Stepper
from topcli.engine.source import compilable_copy

SIGNATURE = "pppdqqqq"

_TEMPLATE = """
def make(step, leave):
    def drive(work, out, params, h, steps, every, until_record, stride):
        {set_p}
        k = 0
        left = until_record
        {set_part}
        for i in range(steps):
            for stage in range({stages}):
                {each_part}
                for j in range({tile}):
                    s = step(({work_items}), part, p)
                    {store_s}
                    work[{check} + j] += {sum_s}
            left -= 1
            if left == 0:
                for j in range({tile}):
                    y = leave(({work_items}), h, p)
                    {record}
                k += {row}
                left = every
        return steps

    return drive
"""


def _same(state: Any, h: float, p: Any) -> Any:
    """Leave of a scheme that works on the physical state itself."""
    return state


@cache
def _template(width: int, checked: int, d: int, constants: int, tile: int, stages: int) -> Callable[..., Any]:
    newline = "\n" + " " * 20
    text = _TEMPLATE.format(
        set_p=f"p = ({''.join(f'params[{i}], ' for i in range(constants))})",
        constants=constants,
        tile=tile,
        stages=stages,
        # what depends on h alone is ready before the loop where there is one stage: else every step waits for it
        set_part=f"part = params[{constants}] * h" if stages == 1 else "",
        each_part="" if stages == 1 else f"part = params[{constants} + stage] * h",
        work_items="".join(f"work[{i * tile} + j], " for i in range(width)),
        store_s=newline.join(f"work[{i * tile} + j] = s[{i}]" for i in range(width)),
        check=width * tile,
        sum_s=" + ".join(f"s[{i}]" for i in range(checked)),
        record=newline.join(f"out[k + j * stride + {i}] = y[{i}]" for i in range(d)),
        row=d,
    )
    scope: dict[str, Any] = {}
    exec(compile(text, f"<lanes {width}/{checked}/{d}/{constants}/{tile}/{stages}>", "exec"), scope)
    return scope["make"]


def plain_lanes(stepper: Stepper, d: int, constants: int, tile: int) -> Callable[..., int]:
    """The loop over steps and lanes as a plain Python function over indexable buffers.

    ``work`` holds ``width`` rows of ``tile`` numbers and one more, which gathers the sums of the states; ``out`` gets
    ``d`` numbers for every recorded step of a trajectory, whose rows follow each other and begin ``stride`` numbers
    after those of the trajectory before. ``params`` holds the constants, then the fractions of h.
    """
    inlined = {id(kernel): stand_in for kernel, stand_in in VECTOR_VARIANTS.items()} | {id(fma): fma}
    stage, fractions = stages_of(stepper)
    step = compilable_copy(stage, lambda kernel: kernel, inlined)
    # all but the counters, which are finite always: a nan that stands for a rare branch may be in any other slot
    checked = stepper.width - len(stepper.counters)
    return _template(stepper.width, checked, d, constants, tile, len(fractions))(step, stepper.leave or _same)


def stages_of(stepper: Stepper) -> tuple[StepFunction, tuple[float, ...]]:
    """What is taken one after the other in a step: a step, and the fractions of h."""
    return stepper.stages or (stepper.step, (1.0,))
