"""The loop over steps with an inner loop over trajectories, which the compiler turns into vector instructions.

The loop checks nothing: it adds up the working state, and an infinity or a nan anywhere makes the sum infinite or nan.
A rare branch of single runs, such as calling libm for a large angle, yields nan here, because vector code computes both
sides of a branch; the caller repeats such trajectories in the loop of single runs.

The bits are those of single runs: additions and multiplications are not contracted, and remaining calls of libm are
made for one trajectory after the other. Intel's vector library SVML would change last bits; numba uses it only where
the package icc-rt is installed, which topcli does not require, and not with NUMBA_DISABLE_INTEL_SVML=1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from topcli.arithmetic.fused import fma
from topcli.arithmetic.rotations import VECTOR_VARIANTS
from topcli.contracts import StepFunction, Stepper
from topcli.engine.driver import same_state
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


@cache
def _template(width: int, checked: int, d: int, constants: int, tile: int, stages: int) -> Callable[..., Any]:
    newline = "\n" + " " * 20
    text = _TEMPLATE.format(
        set_p=f"p = ({''.join(f'params[{i}], ' for i in range(constants))})",
        constants=constants,
        tile=tile,
        stages=stages,
        # with one stage, terms of h alone are computed before the loop; otherwise every step would wait for them
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
    # all but the counters, which are always finite: the nan of a rare branch may be in any other slot
    checked = stepper.width - len(stepper.counters)
    return _template(stepper.width, checked, d, constants, tile, len(fractions))(step, stepper.leave or same_state)


def stages_of(stepper: Stepper) -> tuple[StepFunction, tuple[float, ...]]:
    """Step function and fractions of h of the stages that make up a step."""
    return stepper.stages or (stepper.step, (1.0,))
