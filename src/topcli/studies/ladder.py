"""Ladders of settings, coarse to fine: errors and CPU times of schemes and of other integrators.

Errors are the largest Euclidean distances of states from a reference at common times. Times are CPU seconds of a warm
call, which depend least on the load of the machine.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from pydantic import ValidationError

from topcli.analysis.reference import distances
from topcli.config.models import Experiment
from topcli.contracts import Array, Scheme
from topcli.engine.machine import machine_of
from topcli.errors import SchemeCodeError

SATURATED_BELOW = 1e-6
"""Below this error a ladder of step sizes ends when two finer ones in a row gain less than a factor of two."""
SLICE, LONG = 0.002, 0.25
"""Seconds: the shortest repetition, in which a quick call is repeated, and the longest call that is repeated."""
USELESS = 1.0
"""Settings with a larger error than this are timed once, because their speed is of no interest."""


class NoResultError(SchemeCodeError):
    """One setting of a competitor gave no trajectory; the message is the reason."""


Call = Callable[[], Array]
"""Integrates once, warm, and returns the states (m, d) at the times of comparison. Raises NoResultError."""
Prepare = Callable[[float], Call]
"""Prepares the call for a setting, h or a tolerance; everything is compiled then. Raises NoResultError."""
Measurement = Callable[[float, int], tuple[Array, float]]
"""States of a setting, and the mean CPU seconds of a number of calls. Raises NoResultError."""


def measured(prepare: Prepare, times: Array) -> Measurement:
    """Measurements of calls, each of which is prepared once."""
    prepared = cache(prepare)

    def measure(setting: float, calls: int) -> tuple[Array, float]:
        call, states = prepared(setting), np.empty(0)
        started = time.process_time()
        for _ in range(calls):
            states = call()
        seconds = (time.process_time() - started) / calls
        if len(states) != len(times) or not np.isfinite(states).all():
            raise NoResultError("gave states that are not complete and finite")
        return states, seconds

    return measure


def scheme_calls(experiment: Experiment, times: Array, setups: list[float]) -> Prepare:
    """Calls of a scheme in the engine's loop over the whole run, by h or, for an adaptive scheme, by tolerance.

    ``setups`` gets the CPU seconds of what is computed once for the initial state.
    """
    scheme, interval, count = experiment.scheme, float(times[1]), len(times) - 1
    states, tolerance = np.array([experiment.y0] * len(times)), tolerance_option(scheme)

    def prepare(setting: float) -> Call:
        options = experiment.options.model_dump() | ({tolerance: setting} if tolerance else {})
        if "atol" in options:
            options["atol"] = 1e-2 * setting  # states are of size one
        try:
            machine = machine_of(experiment.top, scheme, scheme.options.model_validate(options))
        except ValidationError as error:
            raise NoResultError(error.errors()[0]["msg"]) from None
        steps = 1 if tolerance else round(interval / setting)
        run = steps * count, steps, steps
        start, work = np.zeros((2, machine.loop.width))
        started = time.process_time()
        machine.loop.enter(states[0], start, machine.p, interval / steps)
        setups.append(time.process_time() - started)

        def call() -> Array:
            np.copyto(work, start)  # as the peers' calls do
            taken = machine.loop.take_steps(work, states[1:].reshape(-1), machine.p, interval / steps, *run)
            if taken != steps * count:
                raise NoResultError(f"{'fails at' if taken < 0 else 'returns after'} step {abs(taken)}")
            return states

        return call

    return prepare


def tolerance_option(scheme: Scheme) -> str:
    """Option that the ladder of an adaptive scheme varies; empty for others, and without such an option."""
    names = [name for name in ("tol", "rtol") if name in scheme.options.model_fields]
    return names[0] if scheme.adaptive and names else ""


def ladder(experiment: Experiment, interval: float) -> Iterator[float]:
    """Settings of a scheme, coarse to fine, with a comparison every ``interval``.

    An adaptive scheme has half decades of its tolerance. The others have up to 60 steps that divide the interval, by a
    factor 2 up to order 2 and otherwise sqrt(2). The first is about four over the largest component of the state, an
    angle of four radians per step; nobody needs a coarser one.
    """
    if experiment.scheme.adaptive:
        yield from (float(f"{digits}e-{k}") for k in range(2, 19) for digits in ("1", "0.32"))
        return
    ratio = 2.0 if (experiment.scheme.order_for(experiment.options) or 9) <= 2 else math.sqrt(2.0)
    first = max(1.0, math.ceil(0.25 * interval * max(map(abs, experiment.y0))))
    yield from (interval / steps for steps in dict.fromkeys(round(first * ratio**k) for k in range(60)))


@dataclass
class Point:
    """One setting of a competitor: the error reached, CPU seconds of the first call, and those of repetitions."""

    setting: float
    error: float
    first: float
    samples: list[float] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Median over the repetitions; those of the first call if there are none."""
        return statistics.median(self.samples or [self.first])


@dataclass
class ErrorCurve:
    """Points of a competitor of the ``kind`` scheme or peer, over ``settings`` of a parameter, coarse to fine.

    ``limit`` is the longest call in CPU seconds. ``failure`` is the reason why the first of the settings without a
    point has none.
    """

    name: str
    kind: str
    parameter: str
    settings: Iterable[float]
    limit: float
    measure: Measurement
    points: list[Point] = field(default_factory=list)
    setups: list[float] = field(default_factory=list)
    failure: str = ""

    def climb(self, reference: Array) -> None:
        """Call each setting once, for the errors and a first estimate of the times.

        The ladder ends when the next call, about twice as long, would exceed the limit, or at round-off.
        """
        for setting in self.settings:
            try:
                states, seconds = self.measure(setting, 1)
            except NoResultError as error:
                self.failure = self.failure or f"{self.parameter}={setting:.2g} {error}"
                continue
            self.points.append(Point(setting, float(distances(states, reference).max()), seconds))
            # finer steps gain nothing; tolerances cost little and are all tried
            best = min((point.error for point in self.points[:-2]), default=1.0)
            latest = min(point.error for point in self.points[-2:])
            saturated = self.parameter == "h" and best < SATURATED_BELOW and latest > 0.5 * best
            if saturated or 2.0 * seconds > self.limit:
                break

    def repeat(self) -> None:
        """Time each point once more, quick calls several times; not those that take long or are useless."""
        for point in self.points:
            if point.error <= USELESS and point.first <= LONG:
                calls = max(1, math.ceil(SLICE / max(point.first, 1e-7)))
                point.samples.append(self.measure(point.setting, calls)[1])
