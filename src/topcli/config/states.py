"""Initial states (m, d): of one trajectory, of a list, of every combination of components, or drawn at random.

Sample i of a seed has the same random numbers under every top, scheme and centre, and whatever else is drawn: row i of
tables of uniform numbers (``numpy.random.PCG64``), of which each vector takes its own three columns. So a larger count
begins with the smaller one, and trajectory i of an ensemble is sample i + 1 of a sweep.

``sphere`` is uniform in area. ``near`` is uniform in area on a cap around a unit vector, uniform in volume in a ball
around any other vector, and uniform in length around a number. ``energy`` takes a direction uniform on the sphere and
scales it until the whole state has the given energy; this is not the measure that the flow conserves, because
directions of large moments do not get less weight. If the potential alone exceeds the energy, no scale exists, and the
whole state is drawn again; so the other vectors are distributed as drawn on the part of their sphere that the energy
allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field

from topcli.config.document import STRICT, Document, as_integer, describe, number_of, unknown_key
from topcli.config.text import KeyPath
from topcli.contracts import Array, Top
from topcli.engine.consumers import energy_of
from topcli.errors import quoted
from topcli.tops import forms

UNIT_TOLERANCE, UNIT_LIMIT = 1e-12, 1e-2
"""Deviations of the square of a unit vector from 1: up to the first it counts as 1, up to the second with a warning.

The limit covers a vector that is rounded to two or three digits, and the last state of a scheme that does not conserve
the length: under HK, the squares in the packaged scenes deviate by up to 0.003.
"""
AUTO = {"auto": 1.0, "+auto": 1.0, "-auto": -1.0}
"""Texts for a component that completes a unit vector, with the component's sign."""
MAX_TRAJECTORIES = 10**6
_PATIENCE = 4096
"""States of a sample that are drawn until one can have the energy."""
_BLOCK = 1024
"""Rows of a table of random numbers that are made together."""
NO_ENERGY = f"no state has this energy: the potential energy alone exceeds it in {_PATIENCE} draws of a sample"
NOTHING_DRAWN = "needs a count and a vector; for example random: {count: 100, gamma: sphere, omega: {near: 0.1}}"

_Columns = Mapping[str, Array]
_Integers = NDArray[np.int64]


def vectors_in(cls: type[Top], initial: Any) -> dict[str, Any]:
    """Section ``initial`` in which components that are given by themselves lie in their vectors."""
    whole = dict(initial)
    for name, names in _vectors(cls):
        single = {key: whole.pop(key) for key in names if key != name and key in whole}
        base = whole.get(name, [None] * len(names))
        if single and isinstance(base, list) and len(base) == len(names):
            whole[name] = [single.get(*pair) for pair in zip(names, base, strict=True)]
    return whole


def vectors_named(kind: str, keys: Iterable[str]) -> list[str]:
    """Vectors of the top ``kind`` that ``keys`` name, by themselves or by a component; they choose its form."""
    vectors = [pair for cls in forms(kind) for pair in _vectors(cls)]
    owner = {component: name for name, components in vectors for component in (name, *components)}
    return [owner[key] for key in keys if key in owner]


def _vectors(cls: type[Top]) -> list[tuple[str, tuple[str, ...]]]:
    return [(name, cls.components[start:stop]) for name, (start, stop) in cls.vectors.items()]


def read_states(
    cls: type[Top], initial: object, document: Document, columns: _Columns | None = None, path: KeyPath = ("initial",)
) -> Array:
    """Return the states (m, d) of the section ``initial`` at ``path``, with unit vectors completed and checked.

    ``columns`` (m,) replace components; without any, m is 1.
    """
    columns = columns or {}
    if not isinstance(initial, dict):
        document.fault(path, f"must be a section with {', '.join(cls.vectors)}, not {describe(initial)}")
    keys = [*cls.vectors, *cls.components, "normalize"]
    unknown = [key for key in initial if key not in keys] + [key for key in columns if key not in cls.components]
    for key in unknown:
        vector = cls.components[slice(*cls.vectors.get(key, (0, 0)))]
        text = f"must be vectors, as in [[{', '.join(vector)}]]" if vector else unknown_key(key, keys)
        document.fault((*path, key), text)
    if not isinstance(normalize := initial.get("normalize", False), bool):
        document.fault((*path, "normalize"), f"must be true or false, not {describe(normalize)}")
    whole, vectors = vectors_in(cls, initial), []
    for name, names in _vectors(cls):
        single, unit = [key for key in names if key in columns or key in initial], name in cls.unit_vectors
        with document.at(*path, single[-1] if single else name):
            if name not in whole and not single:
                form = f"({', '.join(names)})" if len(names) > 1 else "a number"
                raise ValueError(f"missing; give {form}{'; auto completes it to a unit vector' if unit else ''}")
            values, auto = _components(whole.get(name, [None] * len(names)), names, unit, columns)
            vectors.append(_unit(values, auto, name, normalize is True) if unit else values)
    return np.hstack(vectors)


def _components(raw: object, names: Sequence[str], unit: bool, columns: _Columns) -> tuple[Array, dict[int, float]]:
    """Return a vector (m, k), and the places of ``auto`` with their signs. Raises ValueError."""
    vector = raw if isinstance(raw, list) or len(names) > 1 else [raw]
    if not isinstance(vector, list) or len(vector) != len(names):
        length = len(vector) if isinstance(vector, list) else describe(vector)
        raise ValueError(f"must be a list of {len(names)} numbers ({', '.join(names)}), not {length}")
    values, auto = np.zeros((len(next(iter(columns.values()), [0])), len(names))), {}
    for i, (name, value) in enumerate(zip(names, vector, strict=True)):
        if name in columns:
            values[:, i] = columns[name]
        elif unit and isinstance(value, str) and value in AUTO:
            auto[i] = AUTO[value]
        elif (number := number_of(value)) is not None:
            values[:, i] = number
        else:
            text = f"{name} must be a number{', or auto, +auto, -auto' * unit}, not {describe(value)}"
            raise ValueError(f"{name} is missing; give all of {', '.join(names)}" if value is None else text)
    if len(auto) > 1:
        raise ValueError(f"only one component may be auto, not {len(auto)}")
    return values, auto


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _unit(vectors: Array, auto: Mapping[int, float], name: str, normalize: bool) -> Array:
    """Return unit vectors (m, k): completed at the place in ``auto``, scaled, or as they are. Raises ValueError."""
    for i, sign in auto.items():
        rest = _square(np.delete(vectors, i, axis=1))
        if not (rest <= 1.0 + UNIT_TOLERANCE).all():
            others = f"the squares of the others sum to {rest.max():.15g} > 1"
            raise ValueError(f"auto cannot make it a unit vector: {others}; make them smaller")
        size = np.sqrt(np.maximum(1.0 - rest, 0.0))
        vectors[:, i] = np.where(size > 0.0, np.copysign(size, sign), 0.0)
        return vectors
    if normalize:
        largest = np.abs(vectors).max(axis=1)
        if not largest.all():
            raise ValueError("is the zero vector, which has no direction to normalize")
        scaled = vectors / largest[:, None]  # first, so that no square over- or underflows
        return scaled / np.array([math.hypot(*vector) for vector in scaled.tolist()])[:, None]
    excess = _square(vectors) - 1.0
    worst = excess[np.argmax(np.abs(excess))]
    if not abs(worst) <= UNIT_LIMIT:
        raise ValueError(
            f"must be a unit vector: {name}² = {1.0 + worst:.15g} is off by {worst:.3g} (allowed: "
            f"{UNIT_LIMIT:g}); write one component as auto, or set initial.normalize: true"
        )
    return vectors


def _square(vectors: Array) -> Array:
    """Squares of vectors (m, k), summed from the first component to the last."""
    return sum((column * column for column in vectors.T), np.zeros(len(vectors)))


def unit_warnings(cls: type[Top], states: Array) -> Iterator[str]:
    """Yield a warning for each unit vector whose square is off 1 in some of the ``states`` (m, d)."""
    for name in cls.unit_vectors:
        excess = (states[:, slice(*cls.vectors[name])] ** 2).sum(axis=1) - 1.0
        worst = float(excess[np.argmax(np.abs(excess))])
        if abs(worst) > UNIT_TOLERANCE:
            fault = f"initial {name} is not a unit vector: {name}² is off by {worst:.3g}, which the run keeps"
            yield f"{fault}; initial.normalize: true makes it one"


class Draw(BaseModel):
    """Distribution of a vector of the initial state."""

    model_config = STRICT

    sphere: float | None = Field(default=None, gt=0.0)
    """uniform on the sphere of this radius"""
    near: float | None = Field(default=None, gt=0.0)
    """uniform within this distance, or angle, of the vector in initial"""
    energy: float | None = None
    """a direction uniform on the sphere, scaled to this energy of the state"""


Seed = Annotated[int, Field(ge=0, le=2**63 - 1), BeforeValidator(as_integer)]


class Random(BaseModel):
    """Number of random draws and their seed; further keys are the vectors to draw, and in a sweep parameters."""

    model_config = STRICT

    count: Annotated[int, Field(ge=1, le=MAX_TRAJECTORIES), BeforeValidator(as_integer)]
    """the number of draws, 1 to 1e6"""
    seed: Seed = 0
    """the seed of the random numbers"""
    version: Literal[2] = 2
    """the way of drawing, of which this one is known"""


def read_random(raw: Mapping[str, Any], document: Document, *path: str) -> tuple[Random, dict[str, Any]]:
    """Return number and seed of the draws of a section ``random`` at ``path``, and the rules for what is drawn."""
    rules = {key: rule for key, rule in raw.items() if key not in Random.model_fields}
    if not rules:
        document.fault(path, NOTHING_DRAWN)
    return document.read(Random, {key: raw[key] for key in raw if key not in rules}, *path), rules


def read_draws(cls: type[Top], rules: Mapping[str, Any], document: Document, path: KeyPath) -> dict[str, Draw]:
    """Return the distributions of vectors that a section ``random`` at ``path`` has as ``rules``."""
    draws: dict[str, Draw] = {}
    drawable = [name for name, names in _vectors(cls) if len(names) in (1, 3)]
    for key, rule in rules.items():
        if key not in drawable:
            document.fault((*path, key), unknown_key(key, [*drawable, *Random.model_fields]))
        rule = {"sphere": 1.0} if rule == "sphere" and key in cls.unit_vectors else rule
        draws[key] = draw = document.read(Draw, rule, *path, key)
        if fault := _draw_fault(cls, key, draw):
            document.fault((*path, key), fault)
    return draws


def _example(cls: type[Top], vector: str) -> str:
    return "sphere" if vector in cls.unit_vectors else "{near: 0.1}"


def _draw_fault(cls: type[Top], name: str, draw: Draw) -> str:
    """Reason why the vector ``name`` cannot be drawn like this; empty if it can."""
    unit, (start, stop) = name in cls.unit_vectors, cls.vectors[name]
    ways = ["near"] if stop - start == 1 else ["sphere", "near"] if unit else ["sphere", "near", "energy"]
    chosen = list(draw.model_fields_set)
    if len(chosen) != 1 or chosen[0] not in ways:
        return f"must have one of {', '.join(ways)}, not {' and '.join(chosen) or 'none'}; write {_example(cls, name)}"
    if unit and (draw.sphere not in (None, 1.0) or not (draw.near or 0.0) <= math.pi):
        return f"its length is 1, and an angle is at most pi; write {_example(cls, name)}"
    return _energy_fault(cls.new(), name) if draw.energy is not None else ""


def _energy_fault(top: Top, vector: str) -> str:
    """Reason why ``vector`` cannot be scaled to a given energy of the state; empty if it can."""
    energy = energy_of(top)
    if energy is None:
        return f"cannot have an energy: the top {top.kind} has no invariant {top.energy!r}, the name of its energy"
    states = np.tile(np.cos(np.arange(1.0, len(top.components) + 1.0)), (3, 1))  # in general position
    states[:, slice(*top.vectors[vector])] *= np.array([[0.0], [1.0], [2.0]])
    with np.errstate(all="ignore"):
        none, once, twice = energy.value(states)
        if abs((twice - none) - 4.0 * (once - none)) <= 1e-12 * energy.scale(states).max():
            return ""
    return f"cannot have an energy: {quoted(energy.name)} of the top {top.kind} is not quadratic in {vector}"


def drawn_states(
    top: Top,
    initial: object,
    document: Document,
    rules: Mapping[str, Any],
    samples: _Integers,
    seed: int,
    path: KeyPath = ("random",),
    columns: _Columns | None = None,
) -> Array:
    """Return the states (m, d) of the numbered ``samples`` (m,), with the vectors drawn that have a rule.

    The ``rules`` are those of the section ``random`` at ``path``. ``columns`` (m,) replace components of ``initial``. A
    vector that is drawn without a centre need not be in ``initial``.
    """
    cls, columns, draws = type(top), columns or {}, read_draws(type(top), rules, document, path)
    if not isinstance(initial, dict):
        return read_states(cls, initial, document)
    free = {name: [0.0, 0.0, 1.0] for name, draw in draws.items() if draw.near is None}
    for name in free:
        for component in (key for key in columns if key in cls.components[slice(*cls.vectors[name])]):
            document.fault((*path, name), f"is drawn in every row, and initial.{component} is varied; keep one of them")
    centres = read_states(cls, {**initial, **free}, document, columns)
    if not columns:
        centres = centres.repeat(len(samples), axis=0)
    with document.at(*path):
        return draw_states(top, draws, centres, samples, seed) if draws else centres


def drawn_number(seed: int, key: str, sample: int) -> float:
    """Uniform random number of a sample for a parameter of the top; it does not depend on what else is drawn."""
    block, row = divmod(sample, _BLOCK)
    return float(_block((seed, *key.encode()), block, 1)[row, 0])


def draw_states(top: Top, draws: Mapping[str, Draw], centres: Array, samples: _Integers, seed: int) -> Array:
    """Return the states (m, d) of the numbered ``samples`` (m,), drawn around ``centres`` (m, d).

    Raises ValueError if a sample has no state of the energy among the first ``_PATIENCE`` ones.
    """
    energies = any(draw.energy is not None for draw in draws.values())
    if energies and len(samples) > 1:  # an energy that is never possible is refused without a million attempts
        draw_states(top, draws, centres[:1], samples[:1], seed)
    states, left = centres.copy(), np.arange(len(samples))
    for attempt in range(_PATIENCE):
        numbers = _uniform((seed, attempt), samples[left], 3 * len(top.vectors))
        states[left], possible = _placed(top, draws, centres[left], numbers)
        left = left[~possible]
        if not len(left):
            return states
    raise ValueError(NO_ENERGY)


def _uniform(table: tuple[int, ...], samples: _Integers, width: int) -> Array:
    """Rows ``samples`` (m,) of an endless table of uniform numbers with ``width`` columns."""
    blocks, where = np.unique(samples // _BLOCK, return_inverse=True)
    numbers = np.concatenate([_block(table, block, width) for block in blocks.tolist()])
    return numbers[where * _BLOCK + samples % _BLOCK]


@lru_cache(maxsize=64)
def _block(table: tuple[int, ...], block: int, width: int) -> Array:
    """``_BLOCK`` rows of the table."""
    stream = np.random.PCG64(table).advance(block * _BLOCK * width)
    return np.random.Generator(stream).random((_BLOCK, width))


def _placed(top: Top, vectors: Mapping[str, Draw], centres: Array, numbers: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return states drawn from uniform numbers (m, 3 for each vector), and True for each that can have its energy."""
    states, possible = centres.copy(), np.ones(len(centres), dtype=bool)
    of = {name: numbers[:, 3 * i : 3 * i + 3] for i, name in enumerate(top.vectors)}
    for name, draw in sorted(vectors.items(), key=lambda item: item[1].energy is not None):  # it depends on the others
        where, u = slice(*top.vectors[name]), of[name]
        if draw.near is not None:
            around = _cap if name in top.unit_vectors else _ball
            states[:, where] = around(centres[:, where], draw.near, u)
            continue
        states[:, where] = _directions(u) * (draw.sphere or 1.0)
        if draw.energy is not None:
            size = _size_of_energy(top, states, where, draw.energy)
            possible &= np.isfinite(size)
            states[:, where] *= size[:, None]
    return states, possible


@np.errstate(all="ignore")
def _size_of_energy(top: Top, states: Array, where: slice, energy: float) -> Array:
    """Factors (m,) of the vectors at ``where`` that give the ``states`` an energy; nan where none does."""
    invariant, factor = energy_of(top), top.energy_factor
    assert invariant is not None
    without = states.copy()
    without[:, where] = 0.0
    potential = factor * invariant.value(without)
    kinetic = factor * invariant.value(states) - potential
    return np.sqrt((energy - potential) / kinetic)


def _directions(u: Array) -> Array:
    """Points (m, 3) of the unit sphere, uniform in area, from uniform numbers (m, 2), by Archimedes' theorem."""
    z, phi = 2.0 * u[:, 0] - 1.0, 2.0 * np.pi * u[:, 1]
    rho = np.sqrt((1.0 - z) * (1.0 + z))
    return _normalized(np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1))


def _normalized(vectors: Array) -> Array:
    return vectors / np.sqrt(_square(vectors))[:, None]


def _cap(centres: Array, angle: float, u: Array) -> Array:
    """Points (m, 3) of the unit sphere within ``angle`` of the ``centres`` (m, 3), uniform in area."""
    k = 2.0 * np.sin(0.5 * angle) ** 2 * u[:, 0]  # 1 - cos, without cancellation at small angles
    rho, phi = np.sqrt(k * (2.0 - k)), 2.0 * np.pi * u[:, 1]
    first = _normalized(np.cross(centres, np.eye(3)[np.abs(centres).argmin(axis=1)]))
    second = np.cross(centres, first)
    around = (rho * np.cos(phi))[:, None] * first + (rho * np.sin(phi))[:, None] * second
    return _normalized(centres + (around - k[:, None] * centres))


def _ball(centres: Array, radius: float, u: Array) -> Array:
    """Points within ``radius`` of the ``centres`` (m, 3), uniform in volume, or (m, 1), uniform in length."""
    if centres.shape[1] == 1:
        return centres + radius * (2.0 * u[:, :1] - 1.0)
    return centres + (radius * np.cbrt(u[:, 2]))[:, None] * _directions(u)
