"""Schemes to try: with all choices of their options, composed, and in exact arithmetic."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from steppers import physical
from topcli.contracts import Method, Scheme, Stepper, Top
from topcli.engine.numbers import Numbers, precise_top, rationals
from topcli.errors import UsageError
from topcli.schemes.compose import COMPOSITIONS, compose, composition_obstacle


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
    """Compositions to try a scheme with: all for two schemes, and one for others of the Kowalevski top."""
    if composition_obstacle(scheme) or scheme.top != "kowalevski":
        return []
    return [*COMPOSITIONS] if scheme.name in ("hk", "kick-turn") else ["suzuki4"]


def subjects(scheme: Scheme, tops: Sequence[Top], compositions: Sequence[str] = ()) -> list[Subject]:
    """The scheme with all choices of its options on these tops, and composed, on the first one."""
    alone = [Subject(scheme, top, options) for top in tops for options in choices(scheme, top)]
    return alone + [Subject(compose(scheme, COMPOSITIONS[name]), tops[0], scheme.options()) for name in compositions]


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
        state, p = self.numbers(*s), self.numbers(*self.constants)
        for h in self.numbers(*sizes):
            state = self.step(state, h, p)
        return [self.arithmetic.fraction(x) for x in state[: len(y)]]
