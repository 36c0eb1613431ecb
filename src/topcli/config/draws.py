"""Seeded random initial states: on spheres, near a given state, on a shell of constant energy.

The numbers are ``numpy.random.Generator(PCG64(seed)).random``, uniform doubles, and nothing but arithmetic, square
roots and sine and cosine is done with them. A candidate takes a fixed count of numbers, whatever becomes of it; the
first ``count`` that exist are the ensemble, so that a larger ensemble begins with the smaller one.

The measures: ``sphere`` is uniform in area, ``near`` uniform in area on a cap around a unit vector and uniform in
volume in a ball around another, and ``energy`` takes a direction uniform on the sphere and scales it until the energy
of the whole state is the given one. That last is not the measure that the flow conserves: on the ellipsoid of
energies the directions of large moments are not given less weight. Where the potential alone exceeds the energy no
scale will do, and the candidate is passed over, which leaves the other vectors distributed as drawn, on the part of
their sphere that the energy allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from topcli.contracts import Array, Invariant, Top

BATCH = 1024
"""Candidates drawn at a time."""
PATIENCE = 64
"""Batches without a single state of the energy asked for, after which there is none."""

Kind = Literal["sphere", "near", "energy"]
NUMBERS = {"sphere": 2, "near": 3, "energy": 2}
"""How many uniform numbers a draw of a vector takes."""


@dataclass(frozen=True)
class Draw:
    """How a vector is drawn: ``size`` is the radius of the sphere, the reach of ``near``, or the energy."""

    vector: str
    kind: Kind
    size: float


def energy_of(top: Top) -> tuple[Invariant, float] | None:
    """The invariant that is the energy, and what it is to be multiplied by; None for a top without one."""
    for invariant in top.invariants():
        if invariant.name == "energy":
            return invariant, 1.0
        if invariant.name == "m_omega":
            return invariant, 0.5
    return None


def draw_examples(cls: type[Top], vector: str) -> list[str]:
    """An example of each way to draw ``vector``, as a config writes it."""
    if vector in cls.unit_vectors:
        return ["sphere", "{near: 0.1}"]
    return ["{sphere: 2}", "{near: 0.1}", *(["{energy: 1.5}"] if energy_of(cls.new()) else [])]


def directions(u: Array) -> Array:
    """Points (m, 3) of the unit sphere, uniform in area, from uniform numbers (m, 2), by Archimedes' theorem."""
    z = 2.0 * u[:, 0] - 1.0
    rho = np.sqrt((1.0 - z) * (1.0 + z))
    phi = 2.0 * np.pi * u[:, 1]
    return _unit(np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=1))


def _unit(vectors: Array) -> Array:
    return vectors / np.sqrt(vectors[:, 0] ** 2 + vectors[:, 1] ** 2 + vectors[:, 2] ** 2)[:, None]


def cap(centre: Array, angle: float, u: Array) -> Array:
    """Points (m, 3) of the unit sphere within ``angle`` of ``centre`` (3,), uniform in area."""
    k = 2.0 * np.sin(0.5 * angle) ** 2 * u[:, 0]  # 1 - cos, without cancellation at small angles
    rho = np.sqrt(k * (2.0 - k))
    phi = 2.0 * np.pi * u[:, 1]
    first = np.cross(centre, np.eye(3)[int(np.argmin(np.abs(centre)))])
    first /= np.sqrt(first @ first)
    second = np.cross(centre, first)
    around = (rho * np.cos(phi))[:, None] * first + (rho * np.sin(phi))[:, None] * second
    return _unit(centre + (around - k[:, None] * centre))


def ball(centre: Array, radius: float, u: Array) -> Array:
    """Points (m, 3) within ``radius`` of ``centre`` (3,), uniform in volume."""
    return centre + (radius * np.cbrt(u[:, 2]))[:, None] * directions(u)


def _on_shell(top: Top, states: Array, where: slice, energy: float) -> NDArray[np.bool_]:
    """Whether there is a scale of the vectors at ``where``, which are unit ones, that gives the energy; scales them."""
    found = energy_of(top)
    assert found is not None
    invariant, factor = found
    without = states.copy()
    without[:, where] = 0.0
    potential = factor * invariant.value(without)
    kinetic = factor * invariant.value(states) - potential
    square = (energy - potential) / kinetic
    possible = square >= 0.0
    states[:, where] *= np.sqrt(np.where(possible, square, 0.0))[:, None]
    return possible


def _candidates(top: Top, centre: Array, draws: tuple[Draw, ...], numbers: Array) -> Array:
    """The states (k, d) that come of uniform ``numbers`` (m, total): all, or those that have the energy asked for."""
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
    """``count`` states around ``centre`` (d,), those of its vectors drawn that ``draws`` name."""

    top: Top
    centre: Array
    draws: tuple[Draw, ...]
    count: int
    seed: int

    def blocks(self, size: int) -> Iterator[Array]:
        """The states in order, ``size`` at a time; nothing when no candidate has the energy asked for."""
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
