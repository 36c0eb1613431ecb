"""Step size, number of steps and recorded rows of a row of a sweep, of which the duration T may be given instead."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from topcli.config.document import describe
from topcli.config.duration import MAX_STEPS, steps_of
from topcli.config.models import as_integer, duration_fault, number_of
from topcli.config.problems import Problems
from topcli.config.sweep.document import MISSING, Assignment, Sweep
from topcli.errors import UsageError

MAX_RECORDED = 10**8
"""Largest count of recorded states of a row."""


class StepReader:
    """Reader of h, N and output.every of the rows of a sweep."""

    def __init__(self, sweep: Sweep) -> None:
        self._sweep = sweep
        self._at = {key: index for index, key in enumerate(sweep.keys)}

    def value(self, key: str, values: Assignment, otherwise: Any) -> Any:
        """Value of a plain key in a row: its own, or ``otherwise``."""
        at = self._at.get(key)
        return otherwise if at is None or values[at] is MISSING else values[at]

    def read(self, values: Assignment, problems: Problems) -> tuple[float, int, int] | None:
        """h, N and output.every of a row; None if they are wrong."""
        base = self._sweep.base
        output = base.get("output") or {}
        if not isinstance(output, dict):
            problems.add(("output",), f"must be a section with keys, not {describe(output)}")
            return None
        for key in output:
            if key == "attitude" and output[key] is None:
                continue
            if key == "attitude":
                problems.add(("output", key), "a sweep records no attitude; run single rows with it")
                return None
            if key not in ("every", "format", "columns"):
                problems.add(("output", key), "unknown key; only 'every' matters in a sweep")
                return None
        h = self.value("h", values, base.get("h"))
        N, T = self._duration(values)
        every = as_integer(self.value("output.every", values, output.get("every", 1)))
        given = [name for name, value in (("h", h), ("N", N), ("T", T)) if value is not None]
        if len(given) != 2:
            found = " and ".join(given) or "none of them"
            problems.add((given[-1],) if given else (), f"two of h, N and T are needed, and there is {found}")
            return None
        numbers = _Numbers(problems)
        if h is not None:
            h = numbers.step(h)
        if N is not None:
            N = numbers.count(N, "N", MAX_STEPS)
        if T is not None:
            T = numbers.step(T, "T")
        every = numbers.count(every, "every", MAX_STEPS)
        if numbers.wrong:
            return None
        if T is not None:
            h, N = self._from_duration(h, N, T, problems)
        if N is None or h is None or every is None:
            return None
        if fault := duration_fault(h, N):
            problems.add(("N",), fault)
        elif every > N:
            problems.add(("output", "every"), f"must be at most N = {N}, not {every}")
        elif N // every + 1 > MAX_RECORDED:
            text = f"records {N // every + 1} states of a row (at most {MAX_RECORDED}); record fewer"
            problems.add(("output", "every"), text)
        else:
            return h, N, every
        return None

    def _duration(self, values: Assignment) -> tuple[Any, Any]:
        """N and T of a row; one that varies replaces the other of the base."""
        base = self._sweep.base
        N, T = self.value("N", values, None), self.value("T", values, None)
        if N is None and T is None:
            return base.get("N"), base.get("T")
        if N is not None and T is None and self.value("h", values, base.get("h")) is None:
            T = base.get("T")
        return N, T

    def _from_duration(
        self, h: float | None, N: int | None, T: float, problems: Problems
    ) -> tuple[float | None, int | None]:
        """h and N of a row of duration ``T``. A step from a range becomes the nearest T/N."""
        if h is None:
            assert N is not None
            return T / N, N
        if "h" in self._sweep.ranged and math.isfinite(T / h) and T / h >= 0.5:
            N = round(T / h)
            return T / N, N
        try:
            return h, steps_of(T, h)
        except UsageError as fault:
            problems.add(("T",), str(fault))
            return None, None


@dataclass
class _Numbers:
    """Checks of the numbers of a row."""

    problems: Problems
    wrong: bool = False

    def _refuse(self, key: str, text: str) -> None:
        self.wrong = True
        self.problems.add(("output", "every") if key == "every" else (key,), text)

    def step(self, value: Any, key: str = "h") -> float:
        """A finite number other than zero."""
        number = number_of(value)
        if number is None:
            self._refuse(key, f"must be a number, not {describe(value)}")
        elif not math.isfinite(number):
            self._refuse(key, f"must be a finite number, not {describe(value)}")
        elif number == 0.0:
            self._refuse(key, "must not be zero (negative is allowed)")
        else:
            return number
        return math.nan

    def count(self, value: Any, key: str, most: int) -> int:
        """A whole number from 1 to ``most``."""
        number = as_integer(value)
        if isinstance(number, bool) or not isinstance(number, int):
            self._refuse(key, f"must be a whole number, not {describe(value)}")
        elif number < 1:
            self._refuse(key, f"must be at least 1, not {describe(value)}")
        elif number > most:
            self._refuse(key, f"must be at most {most}, not {describe(value)}")
        else:
            return number
        return 1
