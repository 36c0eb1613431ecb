"""Machine code of a method: a loop over the steps of one trajectory, and loops over steps and lanes.

``nanoseconds_per_step`` times the former.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from copy import copy
from typing import Any

import numpy as np

from topcli.contracts import Array, Method, Sampler, Scheme, Stepper, Top
from topcli.engine.compile import Native
from topcli.engine.loops import Loop, lanes_code, loop_of, more_parameters, same_code

SIDE_BY_SIDE = 4
"""Smallest batch whose trajectories advance side by side; fewer are faster one by one."""
FEW_LANES, MANY_LANES = 8, 64
"""Trajectories in a call of machine code: one vector of eight, or enough to hide the latency of a step."""


def lanes_of(count: int) -> int:
    """Trajectories side by side in a batch of ``count``."""
    return MANY_LANES if count > MANY_LANES // 2 else FEW_LANES


class Machine:
    """Machine code of a ``method`` for a ``top``.

    Each loop is compiled, or loaded from the cache, when it is first used. A ``loop`` that is given, such as one of
    another arithmetic, is the only one.
    """

    def __init__(self, top: Top, method: Method, loop: Loop | None = None) -> None:
        self.method, self.d = method, len(top.components)
        self.p = np.array(top.constants(), dtype=None if loop else np.float64)
        self.stepper: Stepper | None = None
        """The method if its steps can be taken side by side; otherwise None."""
        if loop is None and isinstance(method, Stepper) and not method.plain:
            self.stepper = method
        self._loop, self._lanes = loop, dict[int, Native]()

    def for_top(self, top: Top, method: Method) -> Machine:
        """The same machine code for a top with other constants, whose ``method`` is the ``same_code``."""
        other = copy(self)
        other.method, other.p = method, np.array(top.constants(), dtype=np.float64)
        other.stepper = method if self.stepper and isinstance(method, Stepper) else None
        if self._loop and isinstance(method, Stepper):
            other._loop = self._loop.of(method)
        return other

    def lanes_for(self, count: int) -> int:
        """Trajectories that a call advances, for a batch of ``count``."""
        return lanes_of(count) if count >= SIDE_BY_SIDE and self.stepper else 1

    @property
    def loop(self) -> Loop:
        """Loop over the steps of one trajectory."""
        if self._loop is None:
            self._loop = loop_of(self.method, self.d, len(self.p))
        return self._loop

    def lanes(self, width: int) -> Native:
        """Loop over steps and ``width`` lanes. Raises SchemeCodeError for a step that cannot be compiled."""
        assert self.stepper
        if width not in self._lanes:
            self._lanes[width] = lanes_code(self.stepper, self.d, len(self.p), width)
        return self._lanes[width]

    @property
    def counters(self) -> tuple[str, ...]:
        """Names of the events that the method counts."""
        if self._loop:
            return self._loop.counters
        return () if isinstance(self.method, Sampler) else self.method.counters

    @property
    def params(self) -> Array:
        """Arguments ``params`` of ``lanes``: the constants of the top, then those of the step."""
        assert self.stepper
        return np.concatenate([self.p, more_parameters(self.stepper)])

    @property
    def width(self) -> int:
        """Length of a working state."""
        return self.stepper.width if self.stepper else self.loop.width

    def entered(self, states: Array, h: Any) -> Array:
        """Working states (B, width) of the physical ``states`` (B, d)."""
        if self.stepper and self.stepper.enter is None:
            return states
        work = np.zeros((len(states), self.width), dtype=states.dtype)
        p = (*self.p.tolist(), *self.stepper.doubles) if self.stepper else ()
        with np.errstate(all="ignore"):
            for y, row in zip(states, work, strict=True):
                if self.stepper and self.stepper.enter:
                    row[:] = self.stepper.enter(tuple(y.tolist()), h, p)
                else:
                    self.loop.enter(y, row, self.p, h)
        return work

    @property
    def seconds(self) -> dict[str, Any]:
        """Time to compile or load the code, and whether all of it came from disk."""
        loaded = [*([self._loop] if self._loop else []), *self._lanes.values()]
        return {"compile": sum(code.seconds for code in loaded), "compile_cached": all(code.cached for code in loaded)}


_machines: dict[tuple[Any, ...], Machine] = {}
"""The latest machine of each scheme, class of tops and options."""


def machine_of(top: Top, scheme: Scheme, options: Any) -> Machine:
    """Machine code of a scheme with ``options`` for a top; tops that differ in constants only share it."""
    method = scheme.build(top, options)
    kind = (scheme.build, type(top), options.model_dump_json())
    latest = _machines.get(kind)
    if latest is not None and same_code(method, latest.method):
        return latest.for_top(top, method)
    _machines[kind] = Machine(top, method)
    return _machines[kind]


REPETITIONS = 9
"""Times that each step is timed."""
PLAIN_STEPS = 1 << 9
"""Most steps that are timed at once if they run in the interpreter."""
PLAIN_NANOSECONDS = 1e8
"""Time for which they are timed at once."""
SAMPLED_STATES = 5000
"""States of a closed form that are timed together."""


def nanoseconds_per_step(
    runs: Sequence[tuple[Top, Method, Sequence[float], float]],
    steps: int = 50_000,
    clock: Callable[[], int] = time.perf_counter_ns,
) -> list[float]:
    """Median warm time of one step, in nanoseconds, for each (top, method, y0, h), measured in turn.

    Nothing is recorded while the clock runs, and the repetitions are interleaved so that a change of the machine's
    speed affects all of them. A trajectory that blows up is timed up to that point; a step that runs in the interpreter
    is timed over as many as take a tenth of a second. Of a closed form the time of one state is returned.
    """
    prepared = []
    for top, method, y0, h in runs:
        p = np.array(top.constants(), dtype=np.float64)
        loop = loop_of(method, len(y0), len(p))
        prepared.append((loop, np.array(y0, dtype=np.float64), p, h, np.zeros(loop.width)))
    sampled = np.empty(SAMPLED_STATES * max((len(y0) for _, y0, *_ in prepared), default=0))
    times: list[list[float]] = [[] for _ in prepared]
    interpreted = [1] * len(prepared)
    for repetition in range(REPETITIONS + 1):
        for i, (loop, y0, p, h, work) in enumerate(prepared):
            loop.enter(y0, work, p, h)
            start = clock()
            count = steps if loop.compiled else min(steps, interpreted[i])
            if loop.sampled:
                count = min(steps, SAMPLED_STATES)
                taken = loop.drive(work, sampled[: count * len(y0)], p, h, count, 1, 1)
            else:
                taken = 0
                while not taken:  # a block may return before its first step is done
                    taken = loop.drive(work, work, p, h, count, count + 1, count + 1)
            elapsed = clock() - start
            if not repetition:
                interpreted[i] = min(PLAIN_STEPS, 1 + int(PLAIN_NANOSECONDS / max(elapsed, 1)))
            else:
                times[i].append(elapsed / max(1, abs(taken)))
    return [float(np.median(of_run)) for of_run in times]
