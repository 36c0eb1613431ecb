"""Machine code of a method: a loop over the steps of one trajectory, and loops over steps and lanes."""

from __future__ import annotations

from typing import Any

import numpy as np

from topcli.contracts import Array, Method, Scheme, Stepper, Top
from topcli.engine.loops import Loop, lanes_code, loop_of, more_parameters
from topcli.engine.native import Native

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
        self.stepper = method if isinstance(method, Stepper) and not method.plain and loop is None else None
        """The method if its steps can be taken side by side; otherwise None."""
        self._loop, self._lanes = loop, dict[int, Native]()

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
        return getattr(self._loop or self.method, "counters", ())  # a closed form has none

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


def machine_of(top: Top, scheme: Scheme, options: Any) -> Machine:
    """Machine code of a scheme with ``options`` for a top."""
    return Machine(top, scheme.build(top, options))
