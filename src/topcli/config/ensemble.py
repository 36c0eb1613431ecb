"""An ensemble, one experiment from many initial states, and the sources of its states.

Random states are made from ``numpy.random.Generator(PCG64(seed)).random``, uniform doubles, by arithmetic, square
roots, sine and cosine only. Each candidate takes a fixed count of numbers, whether it is used or not, and the first
``count`` valid candidates are the ensemble; so a larger ensemble begins with the smaller one.

The measures: ``sphere`` is uniform in area. ``near`` is uniform in area on a cap around a unit vector, and uniform in
volume in a ball around any other vector. ``energy`` takes a direction uniform on the sphere and scales it until the
whole state has the given energy; this is not the measure that the flow conserves, because directions of large moments
do not get less weight. If the potential alone exceeds the energy, no scale exists and the candidate is skipped; the
other vectors then stay distributed as drawn, on the part of their sphere that the energy allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from topcli.analysis.leaving import energy_of
from topcli.config.models import Experiment, as_integer, digest_of
from topcli.config.yaml_text import to_yaml
from topcli.contracts import Array, Top

MAX_TRAJECTORIES = 10**6
SEARCH_BLOCK = 1 << 14
"""States made at a time in search of a single one."""
BATCH = 1024
"""Candidates drawn at a time."""
PATIENCE = 64
"""Batches without a single state of the wanted energy after which the search ends."""

Kind = Literal["sphere", "near", "energy"]
NUMBERS = {"sphere": 2, "near": 3, "energy": 2}
"""Uniform numbers that one draw of a vector takes."""

Size = Annotated[int, Field(ge=1, le=MAX_TRAJECTORIES), BeforeValidator(as_integer)]


class Section(BaseModel):
    """One of three sources of initial states, and which rows of the trajectories are kept."""

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
    """Number of draws and their seed."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    count: Size = Field(description="the number of trajectories, 1 to 1e6")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1), BeforeValidator(as_integer)] = Field(
        default=0, description="the seed of the random numbers"
    )


class Spaced(BaseModel):
    """Evenly spaced values, both ends included."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    start: float = Field(description="the first value")
    stop: float = Field(description="the last value")
    count: Size = Field(description="the number of values")

    def values(self) -> list[float]:
        """Return the values in order."""
        return np.linspace(self.start, self.stop, self.count).tolist()


class Source(Protocol):
    """``count`` initial states that are made when needed."""

    @property
    def count(self) -> int:
        """Number of states."""
        ...

    def blocks(self, size: int) -> Iterator[Array]:
        """Yield the states in order, in arrays (``size``, d), of which the last may be shorter."""
        ...


@dataclass(frozen=True)
class Listed:
    """States (m, d) in memory."""

    states: Array

    @property
    def count(self) -> int:
        """Number of states."""
        return len(self.states)

    def blocks(self, size: int) -> Iterator[Array]:
        """Yield the states in order, ``size`` at a time."""
        for start in range(0, self.count, size):
            yield self.states[start : start + size]


@dataclass(frozen=True)
class Combined:
    """Every combination of a row of each of ``pieces``, side by side; the last piece varies fastest."""

    pieces: tuple[Array, ...]

    @property
    def count(self) -> int:
        """Number of states."""
        return math.prod(map(len, self.pieces))

    def blocks(self, size: int) -> Iterator[Array]:
        """Yield the states in order, ``size`` at a time."""
        shape = tuple(map(len, self.pieces))
        for start in range(0, self.count, size):
            rows = np.unravel_index(np.arange(start, min(start + size, self.count)), shape)
            yield np.hstack([piece[row] for piece, row in zip(self.pieces, rows, strict=True)])


@dataclass(frozen=True)
class Draw:
    """A rule to draw a vector; ``size`` is the radius of ``sphere``, the reach of ``near``, or the energy."""

    vector: str
    kind: Kind
    size: float


def energy_fault(top: Top, vector: str) -> str:
    """Reason why ``vector`` cannot be scaled to a given energy of the state; empty if it can."""
    energy = energy_of(top)
    if energy is None:
        return f"the top {top.form} has no invariant {top.energy!r}, the name of its energy"
    states = np.tile(np.cos(np.arange(1.0, len(top.components) + 1.0)), (3, 1))  # in general position
    states[:, slice(*top.vectors[vector])] *= np.array([[0.0], [1.0], [2.0]])
    with np.errstate(all="ignore"):
        none, once, twice = energy.value(states)
        if abs((twice - none) - 4.0 * (once - none)) <= 1e-12 * energy.scale(states).max():
            return ""
    return f"{energy.name!r}, the energy of the top {top.form}, is not quadratic in {vector}; use sphere or near"


def draw_examples(cls: type[Top], vector: str) -> list[str]:
    """One example, as a config writes it, of each way to draw ``vector``."""
    if vector in cls.unit_vectors:
        return ["sphere", "{near: 0.1}"]
    return ["{sphere: 2}", "{near: 0.1}", *([] if energy_fault(cls.new(), vector) else ["{energy: 1.5}"])]


def directions(u: Array) -> Array:
    """Return points (m, 3) of the unit sphere, uniform in area, from uniform numbers (m, 2), by Archimedes' theorem."""
    z = 2.0 * u[:, 0] - 1.0
    rho = np.sqrt((1.0 - z) * (1.0 + z))
    phi = 2.0 * np.pi * u[:, 1]
    return _unit(np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1))


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(vectors[:, 0] ** 2 + vectors[:, 1] ** 2 + vectors[:, 2] ** 2)[:, None]


def cap(centre: Array, angle: float, u: Array) -> Array:
    """Return points (m, 3) of the unit sphere within ``angle`` of ``centre`` (3,), uniform in area."""
    k = 2.0 * np.sin(0.5 * angle) ** 2 * u[:, 0]  # 1 - cos, without cancellation at small angles
    rho = np.sqrt(k * (2.0 - k))
    phi = 2.0 * np.pi * u[:, 1]
    first = np.cross(centre, np.eye(3)[int(np.argmin(np.abs(centre)))])
    first /= np.sqrt(first @ first)
    second = np.cross(centre, first)
    around = (rho * np.cos(phi))[:, None] * first + (rho * np.sin(phi))[:, None] * second
    return _unit(centre + (around - k[:, None] * centre))


def ball(centre: Array, radius: float, u: Array) -> Array:
    """Return points (m, 3) within ``radius`` of ``centre`` (3,), uniform in volume."""
    return centre + (radius * np.cbrt(u[:, 2]))[:, None] * directions(u)


def _on_shell(top: Top, states: Array, where: slice, energy: float) -> NDArray[np.bool_]:
    """Scale the unit vectors at ``where`` to the energy; True for each state that has such a scale."""
    invariant, factor = energy_of(top), top.energy_factor
    assert invariant is not None
    without = states.copy()
    without[:, where] = 0.0
    potential = factor * invariant.value(without)
    kinetic = factor * invariant.value(states) - potential
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        square = (energy - potential) / kinetic
    possible = square >= 0.0
    states[:, where] *= np.sqrt(np.where(possible, square, 0.0))[:, None]
    return possible


def _candidates(top: Top, centre: Array, draws: tuple[Draw, ...], numbers: Array) -> Array:
    """Return the states (k, d) made from uniform ``numbers`` (m, total), without those that cannot have the energy."""
    states = np.tile(centre, (len(numbers), 1))
    possible = np.ones(len(numbers), dtype=bool)
    at = 0
    for draw in sorted(draws, key=lambda draw: draw.kind == "energy"):  # the energy depends on the others
        where = slice(*top.vectors[draw.vector])
        u = numbers[:, at : at + NUMBERS[draw.kind]]
        at += NUMBERS[draw.kind]
        if draw.kind == "near":
            around = cap if draw.vector in top.unit_vectors else ball
            states[:, where] = around(centre[where], draw.size, u)
        else:
            states[:, where] = directions(u)
        if draw.kind == "sphere":
            states[:, where] *= draw.size
        elif draw.kind == "energy":
            possible &= _on_shell(top, states, where, draw.size)
    return states[possible]


@dataclass(frozen=True)
class Drawn:
    """``count`` states equal to ``centre`` (d,) except for the vectors drawn by ``draws``."""

    top: Top
    centre: Array
    draws: tuple[Draw, ...]
    count: int
    seed: int

    def blocks(self, size: int) -> Iterator[Array]:
        """Yield the states in order, ``size`` at a time; none if no candidate can have the energy."""
        generator = np.random.Generator(np.random.PCG64(self.seed))
        total = sum(NUMBERS[draw.kind] for draw in self.draws)
        found: list[Array] = []
        left, have, batches = self.count, 0, 0
        while left:
            found.append(_candidates(self.top, self.centre, self.draws, generator.random((BATCH, total))))
            have += len(found[-1])
            batches += 1
            if not have and left == self.count and batches == PATIENCE:
                return
            wanted = min(size, left)
            if have < wanted:
                continue
            states = np.concatenate(found)
            while left and len(states) >= wanted:
                yield states[:wanted]
                states = states[wanted:]
                left -= wanted
                wanted = min(size, left)
            found, have = [states], len(states)


def first_drawn(top: Top, centre: Array, draws: tuple[Draw, ...], seed: int) -> Array | None:
    """First state (d,) of ``Drawn`` with these values; None if no candidate can have the energy."""
    generator = np.random.Generator(np.random.PCG64(seed))
    total = sum(NUMBERS[draw.kind] for draw in draws)
    tried, size = 0, 1
    while tried < PATIENCE * BATCH:
        found = _candidates(top, centre, draws, generator.random((size, total)))
        if len(found):
            return found[0]
        tried, size = tried + size, min(8 * size, BATCH)
    return None


@dataclass(frozen=True)
class Group:
    """Trajectories that share the parameters of the top, and the source of their initial states."""

    top: Top
    source: Source

    @property
    def count(self) -> int:
        """Number of trajectories."""
        return self.source.count

    @property
    def states(self) -> Array:
        """All initial states (m, d) at once."""
        return next(self.source.blocks(self.count))

    def state(self, index: int) -> tuple[float, ...]:
        """Initial state of trajectory ``index`` of the group; drawing it may need those before it."""
        for block in self.source.blocks(min(index + 1, SEARCH_BLOCK)):
            if index < len(block):
                return tuple(block[index].tolist())
            index -= len(block)
        raise IndexError(f"no trajectory {index} after the last one")


@dataclass(frozen=True)
class Members:
    """The groups of an ensemble, and the sections ``ensemble``, defaults included, and ``initial`` as plain data."""

    groups: tuple[Group, ...]
    section: dict[str, Any]
    initial: dict[str, Any]


@dataclass(frozen=True)
class EnsembleExperiment:
    """One experiment from many initial states; ``first`` is its first trajectory as a single experiment."""

    first: Experiment
    members: Members
    top: Top
    """Top as the config gives it; a grid may vary its parameters."""

    @property
    def name(self) -> str:
        """Name of the ensemble and its run folder."""
        return self.first.name

    @property
    def count(self) -> int:
        """Number of trajectories."""
        return sum(group.count for group in self.members.groups)

    @property
    def store(self) -> str:
        """Kept rows: ``trajectories``, ``final`` or ``statistics``."""
        return self.members.section["store"]

    @property
    def rows(self) -> int:
        """Number of rows of the series if no trajectory ends early."""
        each = self.first.N // self.first.output.every + 1
        return self.count * {"trajectories": each, "final": 1, "statistics": 0}[self.store]

    def renamed(self, name: str) -> EnsembleExperiment:
        """Return the same ensemble under another name."""
        return replace(self, first=self.first.renamed(name))

    def of_group(self, group: Group) -> Experiment:
        """First trajectory of a group as a single experiment, with the group's top."""
        return self.first.model_copy(update={"top": group.top, "y0": group.state(0)})

    def member(self, index: int) -> Experiment:
        """Return trajectory ``index`` (from 0) as a single experiment. Raises IndexError."""
        left = index
        for group in self.members.groups:
            if 0 <= left < group.count:
                name = f"{self.name}_{index}"
                return self.first.model_copy(update={"name": name, "top": group.top, "y0": group.state(left)})
            left -= group.count
        raise IndexError(f"trajectory {index}: there are {self.count}")

    def resolved(self) -> dict[str, Any]:
        """Return all that the ensemble depends on as plain data that loads to the same states, bit for bit."""
        given = self.first.model_copy(update={"top": self.top})
        plain = {**given.resolved(), "initial": self.members.initial}
        keys = ("name", "top", "initial", "ensemble", "scheme", "h", "N", "output")
        return {key: self.members.section if key == "ensemble" else plain[key] for key in keys}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of what the ensemble computes and records, without name and format (``identity_of``)."""
        return digest_of(self.resolved(), self.first.own_code)

    def to_yaml(self) -> str:
        """Return the resolved config as YAML that loads to the same ensemble."""
        return to_yaml(self.resolved())
