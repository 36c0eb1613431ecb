"""Time loop over an interpreted step in another arithmetic, with the interface of the compiled loops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Outcome, Scheme, Stepper, Top
from topcli.engine.driver import Loop, same_state
from topcli.engine.precise.floating import arithmetic_of
from topcli.engine.precise.numbers import MAX_DIGITS, Arithmetic
from topcli.engine.precise.rational import Exact, TooLongError, at_most
from topcli.engine.precise.rebuild import precise_method, precise_top
from topcli.engine.precise.texts import exact_text, from_exact_text

BITS_PER_DIGIT = 3.3219280948873626
ROOM = 4
"""Length of the longest number within a step, in units of ``max_digits``. The numbers of ``hk`` are at most 1.8 times
as long as those of the state after the step, those of ``rk4`` 1.05 times."""


def longest(state: Any) -> int:
    """Binary digits of the longest numerator or denominator of a state in rational numbers; 0 for other numbers."""
    return max((x.length for x in state if isinstance(x, Exact)), default=0)


@dataclass(frozen=True)
class PreciseLoop(Loop):
    """Loop whose buffers hold objects; ``max_bits`` bounds the length of rational numbers."""

    max_bits: int = 0
    overlong: list[bool] = field(default_factory=list)
    """Not empty after a step whose numbers became too long before it ended."""

    def failure(self, work: NDArray[Any]) -> Outcome:
        """Outcome of a run whose failed step left ``work``."""
        if self.overlong or (self.max_bits and longest(work) > self.max_bits):
            return Outcome.DIGIT_LIMIT
        return super().failure(work)


def precise_loop(
    stepper: Stepper, d: int, constants: tuple[Any, ...], arithmetic: Arithmetic, max_digits: int = MAX_DIGITS
) -> PreciseLoop:
    """Loop over a rebuilt step for physical states of length ``d``, with the ``constants`` of the top."""
    step, enter, leave = stepper.step, stepper.enter or same_state, stepper.leave or same_state
    checked, nothing = stepper.checked or stepper.width, arithmetic.number(Fraction(0))
    max_bits = int(max_digits * BITS_PER_DIGIT) if arithmetic.bits == 0 else 0
    overlong: list[bool] = []

    def enter_state(y: Any, work: Any, p: Any, h: Any) -> int:
        # a counter or status that a scheme begins with a plain 0.0 is a number too
        with arithmetic.active():
            work[:] = [x + nothing for x in enter(tuple(y), h, constants)]
        return 0

    def drive(work: Any, out: Any, p: Any, h: Any, steps: int, every: int, until_record: int) -> int:
        with arithmetic.active(), at_most(ROOM * max_bits):
            return taken(work, out, h, steps, every, until_record)

    def taken(work: Any, out: Any, h: Any, steps: int, every: int, until_record: int) -> int:
        s, k, left = tuple(work), 0, until_record
        for i in range(steps):
            try:
                s = step(s, h, constants)
                good = all(map(arithmetic.finite, s[:checked]))
            except ZeroDivisionError:
                good = False
            except TooLongError:
                overlong.append(True)
                good = False
            if not good or (max_bits and longest(s) > max_bits):
                work[:] = s
                return -(i + 1)
            left -= 1
            if left == 0:
                out[k : k + d] = leave(s, h, constants)
                k += d
                left = every
        work[:] = s
        return steps

    width, counters, iterative = stepper.width, stepper.counters, stepper.iterative
    return PreciseLoop(
        enter_state, drive, width, counters, iterative=iterative, compiled=False, max_bits=max_bits, overlong=overlong
    )


@dataclass(frozen=True)
class PreciseRun:
    """All that a run in another arithmetic needs: its ``top`` with numbers of it, the ``loop``, ``h`` and ``y0``."""

    arithmetic: Arithmetic
    top: Top
    loop: PreciseLoop
    h: Any
    y0: NDArray[Any]

    def encoded(self, values: NDArray[Any]) -> NDArray[Any]:
        """Array of numbers as an array of texts, exact to the last bit."""
        texts = [exact_text(self.arithmetic.fraction(x)) for x in values.ravel()]
        return np.array(texts, dtype=np.str_).reshape(values.shape)

    def decoded(self, texts: NDArray[Any]) -> NDArray[Any]:
        """Array of numbers that ``encoded`` has written."""
        made = np.empty(texts.size, dtype=np.object_)
        made[:] = [self.arithmetic.number(from_exact_text(str(text))) for text in texts.ravel()]
        return made.reshape(texts.shape)


def prepared(
    scheme: Scheme,
    top: Top,
    options: Any,
    precision: int | str,
    numbers: tuple[Fraction, Mapping[str, Fraction], tuple[Fraction, ...]],
    max_digits: int = MAX_DIGITS,
) -> PreciseRun:
    """Prepare a run of a scheme; ``numbers`` are h, the parameters of the top and the initial state, exactly.

    Raises UsageError, naming the scheme and the reason, if it has no such precision.
    """
    arithmetic = arithmetic_of(precision)
    h, parameters, state = numbers
    with arithmetic.active():
        precise = precise_top(top, {name: arithmetic.number(value) for name, value in parameters.items()})
        method, constants = precise_method(scheme, top, options, precise, arithmetic), precise.constants()
    y0 = np.array([arithmetic.number(value) for value in state], dtype=np.object_)
    loop = precise_loop(method, len(y0), constants, arithmetic, max_digits)
    return PreciseRun(arithmetic, precise, loop, arithmetic.number(h), y0)
