"""Ensembles: one experiment from many initial states, given by a list, a grid or random draws."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from pydantic import BaseModel, Field, create_model

from topcli.config.document import STRICT, Document, number_of
from topcli.config.draws import ABSOLUTE, MAX_TRAJECTORIES, Drawn, Random, draw_examples, drawable, random_model
from topcli.config.models import Experiment, digest_of, unit_warnings
from topcli.config.ranges import Numbers, Range
from topcli.config.sections import read_initial, top_with, vectors_of
from topcli.config.text import to_yaml
from topcli.contracts import Array, Top

SEARCH_BLOCK = 1 << 14
"""States made at a time in search of a single one."""
SOURCES = ("states", "grid", "random")


class Section(BaseModel):
    """One of three sources of initial states, and which rows of the trajectories are kept."""

    model_config = STRICT | {"json_schema_extra": {"anyOf": [{"required": [source]} for source in SOURCES]}}

    states: Any = Field(
        default=None, description="a list of initial states; a vector that a state omits is taken from initial"
    )
    grid: Any = Field(
        default=None,
        description="a list of values or a range (from, to, count) for components of the state and for parameters "
        "(top.NAME); every combination is a trajectory",
    )
    random: Any = Field(
        default=None, description="random initial states: their count, a seed, and how each vector is drawn"
    )
    store: Literal["trajectories", "final", "statistics"] = Field(
        default="trajectories",
        description="what to store: every recorded row (trajectories), the last state of each trajectory (final), or "
        "neither (statistics); statistics of the invariants are always stored",
    )


@cache
def section_model(cls: type[Top]) -> type[Section]:
    """Model of the section ``ensemble`` for tops of class ``cls``."""
    keys = (*(f"top.{name}" for name in cls.model_fields), *cls.components)  # the last one varies fastest
    axes: dict[str, Any] = {key: (Numbers, Field(default=None)) for key in keys}
    grid: Any = create_model("Grid", __config__=STRICT, **axes)
    kinds = {"states": Annotated[list[dict[str, Any]], Field(min_length=1)], "grid": grid, "random": random_model(cls)}
    first, (start, stop) = next(iter(cls.vectors.items()))
    one, other = ("[1, 0, 0]", "[0, 1, 0]") if stop - start > 1 else (1, 2)
    examples = {
        "states": f"[{{{first}: {one}}}, {{{first}: {other}}}]",
        "grid": f"{{{cls.components[0]}: {{from: 0, to: 1, count: 11}}}}",
        "random": _example(cls).removeprefix("for example "),
    }
    fields: dict[str, Any] = {
        name: (kind | None, Field(default=None, description=Section.model_fields[name].description, examples=[text]))
        for (name, kind), text in zip(kinds.items(), examples.values(), strict=True)
    }
    return create_model("Ensemble", __base__=Section, **fields)


def vectors_named(raw: object) -> list[str]:
    """Vectors that the section names, valid or not; they help to choose the form of the top."""
    if not isinstance(raw, dict):
        return []
    drawn = raw["random"] if isinstance(raw.get("random"), dict) else {}
    listed = raw["states"] if isinstance(raw.get("states"), list) else []
    named = [key for key in drawn if key not in Random.model_fields]
    return named + [key for state in listed if isinstance(state, dict) for key in state if key != "normalize"]


def read_members(
    raw: object, initial: object, cls: type[Top], top: Top, parameters: Mapping[str, Any], document: Document
) -> Members | None:
    """Return the initial states of an ensemble of ``top``; None if the section or ``initial`` is wrong.

    ``parameters`` are the parameters of the top as the config gives them, for a grid over some of them.
    """
    before = len(document.faults)
    section = document.read(section_model(cls), raw, "ensemble")
    given = [source for source in SOURCES if raw.get(source) is not None] if isinstance(raw, dict) else []
    if len(given) != 1:
        named = f"has {' and '.join(given)}" if given else "has none of them"
        document.fault(("ensemble",), f"must have exactly one of {', '.join(SOURCES)}, and {named}; {_example(cls)}")
        return None
    if not isinstance(initial, dict):
        read_initial(initial, cls, document)
        return None
    if section is None:
        return None
    readers = {"states": _listed, "grid": _gridded, "random": _drawn}
    groups = readers[given[0]](section, initial, cls, top, parameters, document)
    plain = _floats(initial)
    for key, value in plain.items():  # a trajectory may replace any of them
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, float) and not math.isfinite(item):
                document.fault(("initial", key), f"must be finite numbers, not {item!r}")
    if len(document.faults) > before:
        return None
    kept = section.model_dump(exclude_none=True, by_alias=True)[given[0]]
    return Members(
        tuple(groups), {given[0]: _floats(kept) if given[0] == "states" else kept, "store": section.store}, plain
    )


def _example(cls: type[Top]) -> str:
    """End of a message: random draws of every vector."""
    drawn = ", ".join(f"{name}: {draw_examples(cls, name)[0]}" for name in drawable(cls))
    return f"for example random: {{count: 100, {drawn}}}"


def _floats(value: Any) -> Any:
    """Return plain data with whole numbers as floats."""
    if isinstance(value, dict):
        return {key: _floats(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_floats(item) for item in value]
    number = number_of(value)
    return value if number is None else number


def _listed(
    section: Any, initial: dict[str, Any], cls: type[Top], top: Top, _: object, document: Document
) -> list[Group]:
    """Return the listed states as one group."""
    states = [
        read_initial({**initial, **given}, cls, document, ("ensemble", "states", index))
        for index, given in enumerate(section.states)
    ]
    return [Group(top, Listed(np.array(states)))] if None not in states else []


def _gridded(
    section: Any, initial: dict[str, Any], cls: type[Top], top: Top, parameters: Mapping[str, Any], document: Document
) -> list[Group]:
    """Return the product of the axes: parameters vary slowest, then the components in their order, the last fastest."""
    path = ("ensemble", "grid")
    given: dict[str, Any] = {key: axis for key, axis in section.grid if axis is not None}
    if not given:
        document.fault(path, f"has no axes; for example {type(section).model_fields['grid'].examples[0]}")
        return []
    total = math.prod(axis.count if isinstance(axis, Range) else len(axis) for axis in given.values())
    if total > MAX_TRAJECTORIES:
        document.fault(path, f"{total} combinations; an ensemble has at most {MAX_TRAJECTORIES} trajectories")
        return []
    axes = {key: _spaced(axis) if isinstance(axis, Range) else axis for key, axis in given.items()}
    states = _combined({key: values for key, values in axes.items() if key in cls.components}, initial, cls, document)
    tops = []
    for changes in _combinations({key: values for key, values in axes.items() if key not in cls.components}):
        chosen = {key.removeprefix("top."): value for key, value in changes.items()}
        own = Document({})
        tops.append(top_with(cls, {**parameters, **chosen}, own))
        for message in own.faults:
            document.fault(path, f"{_at(chosen)}{message}")
    return [Group(made, states) for made in tops if made and states]


def _spaced(axis: Range) -> list[float]:
    """Values of a range; of a linear one with all their digits, those of ``numpy.linspace``."""
    return axis.values() if axis.spacing == "log" else np.linspace(axis.first, axis.last, axis.count).tolist()


def _combinations(axes: Mapping[str, list[float]]) -> Iterator[dict[str, float]]:
    return (dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values()))


def _at(chosen: Mapping[str, float]) -> str:
    """Beginning of a message about some values."""
    return f"at {', '.join(f'{name} = {value!r}' for name, value in chosen.items())}: " if chosen else ""


def _combined(
    axes: Mapping[str, list[float]], initial: dict[str, Any], cls: type[Top], document: Document
) -> Combined | None:
    """Return every combination of the components' values, the vectors completed as ``initial`` asks for."""
    before = len(document.faults)
    vectors = vectors_of(cls)
    varied = {vector.name: {key: axes[key] for key in vector.components if key in axes} for vector in vectors}
    bases: dict[str, Any] = {
        vector.name: [0.0] * len(vector.components) if len(vector.components) > 1 else 0.0
        for vector in vectors
        if len(varied[vector.name]) == len(vector.components)
    }
    bases |= initial
    whole = {
        vector.name: [0.0] * (len(vector.components) - 1) + [1.0]
        for vector in vectors
        if varied[vector.name]
        and isinstance(base := bases.get(vector.name), list)
        and len(base) == len(vector.components)
    }
    read_initial({**bases, **whole}, cls, document)  # what no axis varies
    pieces = []
    for vector in vectors if len(document.faults) == before else ():
        rows = []
        for chosen in _combinations(varied[vector.name]):
            base = bases[vector.name] if isinstance(bases[vector.name], list) else [bases[vector.name]]
            raw = [chosen.get(key, value) for key, value in zip(vector.components, base, strict=True)]
            try:
                rows.append(vector.read(raw if len(raw) > 1 else raw[0], bases.get("normalize", False)))
            except ValueError as fault:
                document.fault(("ensemble", "grid"), f"{_at(chosen)}{vector.name}: {fault}")
                break
        pieces.append(np.array(rows))
    return Combined(tuple(pieces)) if len(document.faults) == before else None


def _drawn(
    section: Any, initial: dict[str, Any], cls: type[Top], top: Top, _: object, document: Document
) -> list[Group]:
    """Return the group of the drawn states."""
    draws = section.random.draws(cls)
    if not draws:
        document.fault(("ensemble", "random"), f"no vector is random; {_example(cls)}")
        return []
    free = {draw.vector: [0.0, 0.0, 1.0] for draw in draws if draw.kind in ABSOLUTE}
    centre = read_initial({**initial, **free}, cls, document)
    if centre is None:
        return []
    drawn = Drawn(top, np.array(centre), draws, section.random.count, section.random.seed)
    if next(drawn.blocks(1), None) is None:
        energy = next(draw for draw in draws if draw.kind == "energy")
        fault = f"no state has the energy {energy.size!r}: the potential energy alone exceeds it"
        document.fault(("ensemble", "random", energy.vector, "energy"), fault)
        return []
    return [Group(top, drawn)]


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

    def state_warnings(self) -> list[str]:
        """Warnings about initial states that are listed or on a grid; drawn ones have unit vectors."""
        source = self.members.groups[0].source  # grids of parameters have the same states in all groups
        blocks = () if isinstance(source, Drawn) else source.blocks(1 << 16)
        return list(dict.fromkeys(line for block in blocks for line in unit_warnings(type(self.top), block)))[:1]

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

    def of_all_steps(self) -> EnsembleExperiment:
        """Return the same ensemble without its section."""
        return replace(self, first=self.first.of_all_steps())

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
        keys = ("name", "top", "initial", "ensemble", "scheme", "h", "N", "section", "output")
        plain["ensemble"] = self.members.section
        return {key: plain[key] for key in keys if key in plain}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of what the ensemble computes and records, without name and format (``identity_of``)."""
        return digest_of(self.resolved(), self.first.own_code)

    def to_yaml(self) -> str:
        """Return the resolved config as YAML that loads to the same ensemble."""
        return to_yaml(self.resolved())
