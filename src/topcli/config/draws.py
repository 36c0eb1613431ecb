"""Random initial states: their description in a config, and their distributions.

Random states are made from ``numpy.random.Generator(PCG64(seed)).random``, uniform doubles, by arithmetic, square
roots, sine and cosine only. Each candidate takes a fixed count of numbers, whether it is used or not, and the first
``count`` valid candidates are the ensemble; so a larger ensemble begins with the smaller one.

The measures: ``sphere`` is uniform in area. ``near`` is uniform in area on a cap around a unit vector, uniform in
volume in a ball around any other vector, and uniform in length around a number. ``energy`` takes a direction uniform on
the sphere and scales it until the whole state has the given energy; this is not the measure that the flow conserves,
because directions of large moments do not get less weight. If the potential alone exceeds the energy, no scale exists
and the candidate is skipped; the other vectors then stay distributed as drawn, on the part of their sphere that the
energy allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field, create_model

from topcli.config.document import STRICT, as_integer, describe
from topcli.config.ranges import Interval
from topcli.contracts import Array, Top
from topcli.engine.watch import energy_of
from topcli.errors import quoted
from topcli.tops import TOPS

MAX_TRAJECTORIES = 10**6
CANDIDATES = 1024
"""Candidates drawn at a time."""
PATIENCE = 64
"""Batches without a single state of the wanted energy after which the search ends."""

Kind = Literal["sphere", "near", "energy"]
NUMBERS = {"sphere": 2, "near": 3, "energy": 2}
"""Uniform numbers that one draw of a vector takes."""
ABSOLUTE = ("sphere", "energy")
"""Draws that need no initial vector to start from."""

Size = Annotated[int, Field(ge=1, le=MAX_TRAJECTORIES), BeforeValidator(as_integer)]


class Random(BaseModel):
    """Number of draws and their seed."""

    model_config = STRICT

    count: Size = Field(description="the number of trajectories, 1 to 1e6")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1), BeforeValidator(as_integer)] = Field(
        default=0, description="the seed of the random numbers"
    )

    def draws(self, cls: type[Top]) -> tuple[Draw, ...]:
        """Rules to draw the vectors that the section names."""
        section = self.model_dump(exclude_none=True)
        return tuple(Draw(name, *rule) for name in cls.vectors for rule in section.get(name, {}).items())


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
        return f"the top {TOPS.called(top.form)} has no invariant {top.energy!r}, the name of its energy"
    states = np.tile(np.cos(np.arange(1.0, len(top.components) + 1.0)), (3, 1))  # in general position
    states[:, slice(*top.vectors[vector])] *= np.array([[0.0], [1.0], [2.0]])
    with np.errstate(all="ignore"):
        none, once, twice = energy.value(states)
        if abs((twice - none) - 4.0 * (once - none)) <= 1e-12 * energy.scale(states).max():
            return ""
    owner = TOPS.called(top.form)
    return f"{energy.name!r}, the energy of the top {owner}, is not quadratic in {vector}; use sphere or near"


def drawable(cls: type[Top]) -> list[str]:
    """Vectors that can be drawn: those of three components, or of one."""
    return [name for name, (start, stop) in cls.vectors.items() if stop - start in (1, 3)]


def _is_number(cls: type[Top], vector: str) -> bool:
    start, stop = cls.vectors[vector]
    return stop - start == 1


def draw_examples(cls: type[Top], vector: str) -> list[str]:
    """One example, as a config writes it, of each way to draw ``vector``."""
    if _is_number(cls, vector):
        return ["{near: 0.1}"]
    if vector in cls.unit_vectors:
        return ["sphere", "{near: 0.1}"]
    return ["{sphere: 2}", "{near: 0.1}", *([] if energy_fault(cls.new(), vector) else ["{energy: 1.5}"])]


def _draw_type(cls: type[Top], name: str) -> Any:
    """Annotation of the way to draw the vector ``name``: a model of which one field is given."""
    unit = name in cls.unit_vectors
    fault = "its length is 1" if unit else energy_fault(cls.new(), name)
    within = f"uniform within this {'angle' if unit else 'distance'} of the vector in initial"
    kinds: dict[str, Any] = {
        "sphere": Field(default=None, gt=0.0, description="uniform on the sphere of this radius"),
        "near": Field(default=None, gt=0.0, le=math.pi if unit else None, description=within),
        "energy": Field(
            default=None, description="a direction uniform on the sphere, scaled to this energy of the state"
        ),
    }
    if unit:
        kinds["sphere"] = Field(default=None, ge=1.0, le=1.0, description="uniform on the unit sphere")
    if fault:
        del kinds["energy"]
    if _is_number(cls, name):
        kinds = {"near": kinds["near"]}
    fields: dict[str, Any] = {kind: (float, field) for kind, field in kinds.items()}
    model: Any = create_model("Draw", __config__=STRICT, **fields)

    def read(raw: object) -> object:
        if raw == "sphere" and unit:
            return {"sphere": 1.0}
        *others, last = [f"{name}: {example}" for example in draw_examples(cls, name)]
        if not isinstance(raw, dict) or len(raw) != 1 or not raw.keys() <= {*kinds, "energy"}:
            given = " and ".join(map(quoted, raw)) or "nothing" if isinstance(raw, dict) else describe(raw)
            ways = f"one of {', '.join(kinds)}" if others else next(iter(kinds))
            examples = f"{', '.join(others)} or {last}" if others else last
            raise ValueError(f"must have {ways}, not {given}; write {examples}")
        if fault and "energy" in raw:
            raise ValueError(f"cannot have an energy: {fault}")
        return raw

    return Annotated[model, BeforeValidator(read)]


@cache
def random_model(cls: type[Top], parameters: bool = False) -> type[Random]:
    """Model of the section ``random`` for tops of class ``cls``; that of a sweep also draws ``parameters``."""
    fields: dict[str, Any] = {name: (_draw_type(cls, name), Field(default=None)) for name in drawable(cls)}
    if parameters:
        fields |= {f"top.{name}": (Interval, Field(default=None)) for name in cls.model_fields}
        fields["count"] = (Size, Field(default=1))
    return create_model("Random", __base__=Random, **fields)


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


def interval(centre: Array, reach: float, u: Array) -> Array:
    """Return numbers (m, 1) within ``reach`` of ``centre`` (1,), uniform in length."""
    return centre + reach * (2.0 * u[:, :1] - 1.0)


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
            if _is_number(type(top), draw.vector):
                around = interval
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
        accepted: list[Array] = []
        left, have, batches = self.count, 0, 0
        while left:
            accepted.append(_candidates(self.top, self.centre, self.draws, generator.random((CANDIDATES, total))))
            have += len(accepted[-1])
            batches += 1
            if not have and left == self.count and batches == PATIENCE:
                return
            wanted = min(size, left)
            if have < wanted:
                continue
            states = np.concatenate(accepted)
            while left and len(states) >= wanted:
                yield states[:wanted]
                states = states[wanted:]
                left -= wanted
                wanted = min(size, left)
            accepted, have = [states], len(states)


def first_drawn(top: Top, centre: Array, draws: tuple[Draw, ...], seed: int) -> Array | None:
    """First state (d,) of ``Drawn`` with these values; None if no candidate can have the energy."""
    generator = np.random.Generator(np.random.PCG64(seed))
    total = sum(NUMBERS[draw.kind] for draw in draws)
    tried, size = 0, 1
    while tried < PATIENCE * CANDIDATES:
        states = _candidates(top, centre, draws, generator.random((size, total)))
        if len(states):
            return states[0]
        tried, size = tried + size, min(8 * size, CANDIDATES)
    return None
