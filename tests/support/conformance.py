"""Requirements of every scheme beside ``topcli.analysis.conformance``: its choices, compositions and observed order.

See ``test_conformance`` for the bounds and for the methods without the traits, which the same measures condemn.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from conftest import GEN
from steppers import physical
from topcli.analysis.order import observed_order
from topcli.analysis.reference import reference_states
from topcli.contracts import Invariant, Method, Scheme, Stepper, Top
from topcli.engine.collect import orbit
from topcli.engine.numbers import Numbers, precise_top, rationals
from topcli.errors import UsageError
from topcli.schemes.compose import COMPOSITIONS, compose, obstacle

LADDERS = {
    4: (2.0, (40, 57, 80, 113, 160, 226, 320)),
    6: (2.0, (16, 20, 25, 32, 40, 50, 64, 80)),
    8: (4.0, (6, 8, 10, 12, 14, 17, 20, 24, 28, 34)),
}
"""Durations and numbers of steps of compositions, whose errors fall from 1e-3 to round-off."""
FINER = ("dmv", "splitting")
"""Bases whose compositions need shorter steps: dmv has none beyond |h omega| of about 1, and some stages are longer."""


@dataclass(frozen=True)
class Subject:
    """A scheme with options, on a top."""

    scheme: Scheme
    top: Top
    options: Any

    @property
    def method(self) -> Method:
        return self.scheme.build(self.top, self.options)

    @property
    def stages(self) -> int:
        """Steps of the base scheme in one step."""
        _, plus, composition = self.scheme.name.rpartition("+")
        return COMPOSITIONS[composition].stages if plus else 1

    def __str__(self) -> str:
        chosen = self.options.model_dump(exclude_defaults=True)
        return f"{self.scheme.name}/{self.top!r}" + (f" {chosen}" if chosen else "")


def choices(scheme: Scheme, top: Top) -> Iterator[Any]:
    """The default options and, one at a time, every other choice of an enumerated option or a switch.

    A choice that the scheme refuses for this top is left out.
    """
    yield scheme.options()
    for name, schema in scheme.options.model_json_schema().get("properties", {}).items():
        for value in [False, True] if schema.get("type") == "boolean" else schema.get("enum", []):
            if value != schema.get("default"):
                options = scheme.options(**{name: value})
                try:
                    scheme.build(top, options)
                except UsageError:
                    continue
                yield options


def compositions_of(scheme: Scheme) -> list[str]:
    """Compositions to try a scheme with: one, chosen by its name; all for two schemes."""
    if obstacle(scheme):
        return []
    if (scheme.name, scheme.top) in (("hk", "kowalevski"), ("kick-turn", "kowalevski")):
        return [*COMPOSITIONS]
    return [[*COMPOSITIONS][zlib.crc32(f"{scheme.name}/{scheme.top}".encode()) % len(COMPOSITIONS)]]


def subjects(scheme: Scheme, tops: Sequence[Top], compositions: Sequence[str] = ()) -> list[Subject]:
    """The scheme with all choices of its options on these tops, and composed, on the first one."""
    alone = [Subject(scheme, top, options) for top in tops for options in choices(scheme, top)]
    return alone + [Subject(compose(scheme, COMPOSITIONS[name]), tops[0], scheme.options()) for name in compositions]


def errors_after(top: Top, method: Method, duration: float, counts: Sequence[int], y0: Any = None) -> list[float]:
    """Errors after ``duration`` of as many steps as ``counts`` say, each."""
    y0 = GEN[: len(top.components)] if y0 is None else y0
    exact = reference_states(top, y0, np.array([duration]))[0]
    ends = [orbit(top, method, y0, duration / N, int(N), int(N)).states[-1] for N in counts]
    return [float(np.linalg.norm(end - exact)) for end in ends]


def order_of(
    top: Top, method: Method, duration: float = 2.0, counts: Sequence[int] = (25 * 2 ** np.arange(7))
) -> float:
    """Observed order of convergence."""
    order = observed_order([duration / N for N in counts], errors_after(top, method, duration, counts), 1e-12)
    assert order is not None
    return order


def ladder(subject: Subject) -> dict[str, Any]:
    """Duration and numbers of steps at which the order of a scheme is observed."""
    if subject.stages == 1:
        return {}
    order, finer = subject.scheme.order, subject.scheme.name.startswith(FINER)
    assert order is not None
    duration, counts = LADDERS[order]
    longer = 5 if order == 8 and len(subject.top.components) == 3 else 1  # free: errors need time to rise
    return {"duration": duration * longer, "counts": [longer * N * (3 if finer else 2) // 2 for N in counts]}


def named(top: Top, *names: str) -> list[Invariant]:
    """Invariants of the top with these names."""
    return [invariant for invariant in top.invariants() if invariant.name in names]


def plain_step(subject: Subject, y: np.ndarray, h: float) -> np.ndarray:
    """Six numbers, of which the state has the first: those after a step in plain Python."""
    d, method = len(subject.top.components), subject.method
    assert isinstance(method, Stepper)
    p = method.parameters(subject.top)
    new = physical(method)(tuple(y[:d].tolist()), h, p)
    return np.append(new, [0.0] * (6 - d))


class ExactStep:
    """A step of a scheme in rational numbers or many digits, with the constants of the top that doubles hold.

    ``top`` has the exact parameters.
    """

    def __init__(self, subject: Subject, arithmetic: Numbers | None = None) -> None:
        self.arithmetic = arithmetic or rationals()
        parameters = {name: x for name, x in subject.top.model_dump().items() if isinstance(x, float)}
        numbers = dict(zip(parameters, self.numbers(*parameters.values()), strict=True))
        self.top = precise_top(subject.top, numbers)
        fractions = {name: Fraction(x) for name, x in parameters.items()}
        self.method = subject.scheme.build(precise_top(subject.top, fractions), subject.options)
        assert isinstance(self.method, Stepper)
        self.constants = (*subject.top.constants(), *self.method.constants)
        self.step = self.arithmetic.rebuilt(self.method.step)

    def numbers(self, *values: Any) -> tuple[Any, ...]:
        return tuple(self.arithmetic.number(Fraction(x)) for x in values)

    def __call__(self, y: Any, *sizes: float) -> list[Fraction]:
        """State after steps of these sizes from ``y``, of floats or fractions."""
        s = self.method.enter(tuple(y), sizes[0], self.constants) if self.method.enter else tuple(y)
        with self.arithmetic.active():
            state, p = self.numbers(*s), self.numbers(*self.constants)
            for h in self.numbers(*sizes):
                state = self.step(state, h, p)
            return [self.arithmetic.fraction(x) for x in state[: len(y)]]
