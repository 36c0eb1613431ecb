"""Many values of a key, a list or a range, and the section ``ensemble``: states in a list, on a grid or drawn."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, model_validator

from topcli.config.document import STRICT, Document, as_integer, describe, number_of, unknown_key
from topcli.config.states import MAX_TRAJECTORIES, drawn_states, read_draws, read_random, read_states, vectors_in
from topcli.config.text import KeyPath
from topcli.contracts import Array, Top

MAX_SWEEP_ROWS = 10**7
EXAMPLE = "[0.1, 0.2] or {from: 0.1, to: 1, count: 10}"


class Interval(BaseModel):
    """Interval from which a parameter of the top is drawn, uniform in the values or in their logarithms."""

    model_config = STRICT

    first: float = Field(alias="from")
    """the first value"""
    last: float = Field(alias="to")
    """the last value"""
    spacing: Literal["linear", "log"] = "linear"
    """linear or logarithmic (log)"""

    @model_validator(mode="after")
    def check_signs(self) -> Self:
        """Refuse logarithms of numbers of different signs."""
        if self.spacing == "log" and not self.first * self.last > 0.0:
            ends = f"{self.first!r} and {self.last!r}"
            raise ValueError(f"from and to must be both positive or both negative for spacing: log, not {ends}")
        return self

    def value(self, share: float) -> float:
        """Value at ``share`` (0 to 1) of the way, rounded to 15 digits.

        The rounding makes the values independent of the machine's logarithms, and 0.001 of 0.0010000000000000002.
        """
        first, last = self.first, self.last
        if self.spacing == "log":
            value = math.copysign(math.exp(math.log(abs(first)) * (1.0 - share) + math.log(abs(last)) * share), first)
        else:
            value = first * (1.0 - share) + last * share
        return float(f"{value:.15g}")


class Range(Interval):
    """Evenly spaced values, both ends included."""

    count: Annotated[int, Field(ge=1, le=MAX_SWEEP_ROWS), BeforeValidator(as_integer)]
    """the number of values"""

    @model_validator(mode="after")
    def check_ends(self) -> Self:
        """Refuse several values without two ends."""
        if self.count > 1 and self.first == self.last:
            raise ValueError(f"from and to are both {self.first!r}; a range of {self.count} values needs two ends")
        return self

    def values(self) -> list[float]:
        """Return the values in order."""
        inner = (self.value(i / (self.count - 1)) for i in range(1, self.count - 1))
        return [self.first, *inner, self.last][: self.count]

    def spaced(self) -> list[float]:
        """Return the values of an ensemble; those of a linear range have all their digits, as in ``numpy.linspace``."""
        return self.values() if self.spacing == "log" else np.linspace(self.first, self.last, self.count).tolist()


def is_range(raw: object) -> bool:
    """True if ``raw`` is meant as a range."""
    return isinstance(raw, dict) and not raw.keys().isdisjoint(("from", "to", "count", "spacing"))


def read_axis(raw: object, document: Document, *path: str | int) -> list[Any] | Range:
    """Return a list of values or a range, at ``path``."""
    if is_range(raw):
        return document.read(Range, raw, *path)
    if isinstance(raw, list) and raw:
        return raw
    document.fault(path, f"must be a list of values or a range, not {describe(raw)}; for example {EXAMPLE}")


SOURCES = ("states", "grid", "random")


class EnsembleSection(BaseModel):
    """One of three sources of initial states, and which rows of the trajectories are kept."""

    model_config = STRICT

    states: list[dict[str, Any]] | None = Field(default=None, min_length=1)
    """a list of initial states; a vector that a state omits is taken from initial"""
    grid: dict[str, Any] | None = Field(default=None, min_length=1)
    """a list of values or a range (from, to, count) for components of the state and for parameters (top.NAME); every
    combination is a trajectory"""
    random: dict[str, Any] | None = None
    """random initial states: their count, a seed, and how each vector is drawn"""
    store: Literal["trajectories", "final", "statistics"] = "trajectories"
    """what to store: every recorded row (trajectories), the last state of each trajectory (final), or neither
    (statistics); statistics of the invariants are always stored"""

    @model_validator(mode="after")
    def check_one(self) -> Self:
        """Require one source."""
        if sum(getattr(self, source) is not None for source in SOURCES) != 1:
            example = "for example random: {count: 100, gamma: sphere}"
            raise ValueError(f"must have exactly one of {', '.join(SOURCES)}; {example}")
        return self

    @property
    def named(self) -> list[str]:
        """Vectors and components that the states name; they choose the form of the top."""
        return [key for section in (*(self.states or ()), self.random or {}) for key in section]


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Initial ``states`` (m, d) of the trajectories of an experiment, under each of its ``tops`` in turn.

    ``section`` and ``initial`` are the sections of the config from which the states can be read again.
    """

    tops: tuple[Top, ...]
    states: Array
    section: dict[str, Any]
    initial: dict[str, Any]

    @property
    def count(self) -> int:
        """Number of trajectories."""
        return len(self.tops) * len(self.states)

    @property
    def store(self) -> str:
        """Kept rows: ``trajectories``, ``final`` or ``statistics``."""
        return self.section["store"]


def read_ensemble(
    section: EnsembleSection,
    initial: object,
    top: Top,
    with_parameters: Callable[[Mapping[str, Any], KeyPath], Top],
    document: Document,
) -> Ensemble:
    """Return the initial states of an ensemble of ``top``.

    ``with_parameters(values, path)`` is the top with other values of some parameters, which have their place at
    ``path``.
    """
    cls, tops = type(top), [top]
    if not isinstance(initial, dict):
        document.fault(("initial",), f"must be a section with {', '.join(cls.vectors)}, not {describe(initial)}")
    if section.states:
        key, source = "states", floats(section.states)
        states = [
            read_states(cls, {**initial, **state}, document, path=("ensemble", "states", index))
            for index, state in enumerate(section.states)
        ]
    elif section.grid:
        # parameters vary slowest, then the components in their order, the last fastest
        key, path = "grid", ("ensemble", "grid")
        inner, source = _read_axes(section.grid, cls, document)
        varied = {name: inner.pop(name) for name in list(inner) if name not in cls.components}
        columns = dict(zip(inner, map(np.ravel, np.meshgrid(*inner.values(), indexing="ij")), strict=True))
        states = [read_states(cls, initial, document, columns, path if columns else ("initial",))]
        names = [name.removeprefix("top.") for name in varied]
        chosen = [dict(zip(names, values, strict=True)) for values in itertools.product(*varied.values())]
        if varied:
            tops = [with_parameters(values, path) for values in chosen]
    else:
        key, path = "random", ("ensemble", "random")
        random, rules = read_random(section.random or {}, document, *path)
        draws, samples = read_draws(cls, rules, document, path), np.arange(1, random.count + 1)
        states = [drawn_states(top, initial, document, rules, samples, random.seed, path)]
        source = random.model_dump() | {name: draw.model_dump(exclude_none=True) for name, draw in draws.items()}
    # numbers as floats, and components in their vectors, so that equal sections have equal digests
    return Ensemble(
        tuple(tops), np.vstack(states), {key: source, "store": section.store}, floats(vectors_in(cls, initial))
    )


def _read_axes(
    grid: Mapping[str, Any], cls: type[Top], document: Document
) -> tuple[dict[str, list[float]], dict[str, Any]]:
    """Return the values of the keys of a grid in the order of parameters and components, and the grid as plain data."""
    path, axes, source = ("ensemble", "grid"), {}, {}
    keys = [*(f"top.{name}" for name in cls.model_fields), *cls.components]
    for key in sorted(grid, key=lambda key: keys.index(key) if key in keys else 0):
        if key not in keys:
            document.fault((*path, key), unknown_key(key, keys))
        axis = read_axis(grid[key], document, *path, key)
        values = axis.spaced() if isinstance(axis, Range) else axis
        axes[key] = [number for value in values if (number := number_of(value)) is not None]
        if len(axes[key]) < len(values):
            document.fault((*path, key), f"must be numbers, not {describe(values)}")
        source[key] = axis.model_dump(by_alias=True) if isinstance(axis, Range) else axes[key]
    if (total := math.prod(map(len, axes.values()))) > MAX_TRAJECTORIES:
        document.fault(path, f"{total} combinations; an ensemble has at most {MAX_TRAJECTORIES} trajectories")
    return axes, source


def floats(value: Any) -> Any:
    """Return plain data with whole numbers as floats."""
    if isinstance(value, dict):
        return {key: floats(item) for key, item in value.items()}
    if isinstance(value, list):
        return [floats(item) for item in value]
    number = number_of(value)
    return value if number is None else number
