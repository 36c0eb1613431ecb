"""The models of an ensemble: one experiment from many initial states."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from topcli.config.models import Experiment, as_integer, digest_of
from topcli.contracts import Array, Top

MAX_TRAJECTORIES = 10**6
SOUGHT = 1 << 14
"""States made at a time in search of one of them."""
Size = Annotated[int, Field(ge=1, le=MAX_TRAJECTORIES), BeforeValidator(as_integer)]


class Section(BaseModel):
    """Where the initial states come from, one of the three, and what is kept of the trajectories."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    states: Any = Field(default=None, description="a list of initial states; a vector left out is that of initial")
    grid: Any = Field(
        default=None,
        description="for components of the state and parameters (top.NAME), a list of values or start, stop, count; "
        "every combination is a trajectory",
    )
    random: Any = Field(default=None, description="count, seed, and how each vector is drawn")
    store: Literal["trajectories", "final", "statistics"] = Field(
        default="trajectories",
        description="what is kept: every recorded row, the last state of each trajectory, or neither; "
        "the statistics of the invariants are kept always",
    )


class Random(BaseModel):
    """How many draws, and from which seed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    count: Size = Field(description="the number of trajectories, 1 to 1e6")
    seed: Annotated[int, Field(ge=0, lt=2**63), BeforeValidator(as_integer)] = Field(
        default=0, description="the seed of the random numbers"
    )


class Spaced(BaseModel):
    """Evenly spaced values, both ends included."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    start: float = Field(description="the first value")
    stop: float = Field(description="the last value")
    count: Size = Field(description="the number of values")

    def values(self) -> list[float]:
        """The values in order."""
        return np.linspace(self.start, self.stop, self.count).tolist()


class Source(Protocol):
    """Initial states that are made when they are needed, ``count`` in all."""

    @property
    def count(self) -> int:
        """The number of states."""
        ...

    def blocks(self, size: int) -> Iterator[Array]:
        """The states in order, in arrays (``size``, d), of which the last may be shorter."""
        ...


@dataclass(frozen=True)
class Listed:
    """States (m, d) in memory."""

    states: Array

    @property
    def count(self) -> int:
        """The number of states."""
        return len(self.states)

    def blocks(self, size: int) -> Iterator[Array]:
        """The states in order, ``size`` at a time."""
        for start in range(0, self.count, size):
            yield self.states[start : start + size]


@dataclass(frozen=True)
class Combined:
    """Every combination of a row of each of ``pieces``, side by side; the last piece varies fastest."""

    pieces: tuple[Array, ...]

    @property
    def count(self) -> int:
        """The number of states."""
        return math.prod(map(len, self.pieces))

    def blocks(self, size: int) -> Iterator[Array]:
        """The states in order, ``size`` at a time."""
        shape = tuple(map(len, self.pieces))
        for start in range(0, self.count, size):
            rows = np.unravel_index(np.arange(start, min(start + size, self.count)), shape)
            yield np.hstack([piece[row] for piece, row in zip(self.pieces, rows, strict=True)])


@dataclass(frozen=True)
class Group:
    """Trajectories that share the parameters of the top, and where their initial states come from."""

    top: Top
    source: Source

    @property
    def count(self) -> int:
        """The number of trajectories."""
        return self.source.count

    @property
    def states(self) -> Array:
        """All initial states (m, d) at once."""
        return next(self.source.blocks(self.count))

    def state(self, index: int) -> tuple[float, ...]:
        """The initial state of trajectory ``index`` of the group; others before it may have to be drawn first."""
        for block in self.source.blocks(min(index + 1, SOUGHT)):
            if index < len(block):
                return tuple(block[index].tolist())
            index -= len(block)
        raise IndexError(f"no trajectory {index} after the last one")


@dataclass(frozen=True)
class Members:
    """What the section means: the groups, and the section with all defaults as plain data."""

    groups: tuple[Group, ...]
    section: dict[str, Any]
    initial: dict[str, Any]


@dataclass(frozen=True)
class EnsembleExperiment:
    """One experiment from many initial states. ``first`` is its first trajectory as an experiment of its own."""

    first: Experiment
    members: Members
    top: Top
    """The top as the config gives it: a grid over parameters changes it."""

    @property
    def name(self) -> str:
        """The name of the ensemble and its run folder."""
        return self.first.name

    @property
    def count(self) -> int:
        """The number of trajectories."""
        return sum(group.count for group in self.members.groups)

    @property
    def store(self) -> str:
        """What is kept: ``trajectories``, ``final`` or ``statistics``."""
        return self.members.section["store"]

    @property
    def rows(self) -> int:
        """Rows of the series, if no trajectory ends early."""
        each = self.first.N // self.first.output.every + 1
        return self.count * {"trajectories": each, "final": 1, "statistics": 0}[self.store]

    def of_group(self, group: Group) -> Experiment:
        """The first trajectory of a group, which has the group's top."""
        return self.first.model_copy(update={"top": group.top, "y0": group.state(0)})

    def member(self, index: int) -> Experiment:
        """Trajectory ``index`` (from 0) as an experiment of its own. Raises IndexError."""
        left = index
        for group in self.members.groups:
            if 0 <= left < group.count:
                name = f"{self.name}_{index}"
                return self.first.model_copy(update={"name": name, "top": group.top, "y0": group.state(left)})
            left -= group.count
        raise IndexError(f"trajectory {index}: there are {self.count}")

    def resolved(self) -> dict[str, Any]:
        """Everything the ensemble depends on as plain data, which loads to the same initial states, bit for bit."""
        given = self.first.model_copy(update={"top": self.top})
        plain = {**given.resolved(), "initial": self.members.initial}
        keys = ("name", "top", "initial", "ensemble", "scheme", "h", "N", "output")
        return {key: self.members.section if key == "ensemble" else plain[key] for key in keys}

    @cached_property
    def digest(self) -> str:
        """sha256 of the resolved config as canonical JSON, 64 hexadecimal digits."""
        return digest_of(self.resolved())

    def to_yaml(self) -> str:
        """The resolved config as a YAML text that loads to the same ensemble."""
        from topcli.config.emit import to_yaml

        return to_yaml(self.resolved())
