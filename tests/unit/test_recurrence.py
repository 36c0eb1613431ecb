"""Recurrence of orbits whose kind is known: resting, periodic, quasi-periodic, wandering, leaving."""

from __future__ import annotations

import math

import numpy as np
import pytest

from topcli.analysis import recurrence
from topcli.analysis.recurrence import LEFT, PASSAGES, STILL, at_rest

T = np.linspace(0.0, 1.0, 257)
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


def recurrence_of(states: np.ndarray) -> str:
    return str(recurrence.recurrence_of(states, np.arange(len(states))))


def orbit(*columns: np.ndarray) -> np.ndarray:
    return np.stack([np.broadcast_to(column, T.shape) for column in columns], axis=1).astype(float)


def turning(cycles: float) -> tuple[np.ndarray, np.ndarray]:
    return np.cos(2.0 * math.pi * cycles * T), np.sin(2.0 * math.pi * cycles * T)


def noise(seed: int, columns: int = 2) -> tuple[np.ndarray, ...]:
    return tuple(np.random.default_rng(seed).normal(size=(columns, len(T))))


WINDING = np.cumsum(np.random.default_rng(7).normal(size=len(T)))
CASES = {
    "a point": (orbit(np.array(1.0), np.array(0.0)), "at rest"),
    "a circle, well resolved": (orbit(*turning(11.3)), "repeats"),
    "a circle, hardly resolved": (orbit(*turning(100.7 * GOLDEN)), "repeats"),
    "a circle, seen once a turn": (orbit(*turning(256.0 * (1.0 + 0.001))), "too short"),
    "a torus": (orbit(*turning(31.0), *turning(31.0 * GOLDEN)), "repeats"),
    "pulses": (orbit(np.cosh(np.sin(math.pi * 12.2 * T) * 20.0) ** -0.5), "repeats"),
    "noise": (orbit(*noise(1)), "wanders"),
    "an angle that turns at random": (orbit(WINDING, *noise(4)), "wanders"),
    "rare bursts": (orbit(noise(5)[0], np.exp(2.0 * noise(6)[0])), "wanders"),
    "an exponential": (orbit(np.exp(20.0 * T)), "leaves"),
    "a spiral away from a point": (orbit(*(np.exp(14.0 * (T - 1.0)) * x for x in turning(50.3))), "leaves"),
    "one and a half turns": (orbit(*turning(1.5)), "too short"),
}


@pytest.mark.parametrize("name", CASES)
def test_orbits_of_a_known_kind(name: str) -> None:
    states, kind = CASES[name]
    assert recurrence_of(states) == kind
    assert at_rest(states[:, None]).tolist() == [kind == "at rest"]


@pytest.mark.parametrize(("turns", "kind"), [(5.0, "too short"), (9.0, "wanders")])
def test_three_oscillations_in_the_middle_are_needed(turns: float, kind: str) -> None:
    """Six passages between the levels; the slow component is not periodic, so that the orbit does not repeat."""
    assert PASSAGES == 6
    slow = np.cos(2.0 * math.pi * turns * T + 0.9 * np.sin(13.0 * T**2))
    assert recurrence_of(orbit(slow, *noise(10))) == kind


@pytest.mark.parametrize(("factor", "kind"), [(0.8 * LEFT, "too short"), (1.3 * LEFT, "leaves")])
def test_an_orbit_leaves_if_it_moves_faster_than_before(factor: float, kind: str) -> None:
    """And not where it was; the changes are random numbers from -1 to 1 in the middle."""
    changes = np.random.default_rng(4).uniform(-1.0, 1.0, 256)
    changes[192:] = factor * (3.0 + changes[192:])
    assert recurrence_of(orbit(np.append(0.0, np.cumsum(changes)))) == kind


def test_a_component_moves_from_a_billionth_of_its_unit_on() -> None:
    for size, kind in ((0.4 * STILL, "at rest"), (4.0 * STILL, "wanders")):
        x, y = np.random.default_rng(5).uniform(-0.5, 0.5, size=(2, len(T)))
        assert recurrence_of(1.0 + size * orbit(x, y)) == kind


def test_a_time_at_uneven_steps_does_not_move() -> None:
    """Steps of two sizes next to each other, by rounding: a component that runs evenly has no changes to come back."""
    n = np.round(np.linspace(0.0, 1700.0, 257)).astype(int)
    x = np.random.default_rng(6).normal(size=len(n))
    assert recurrence.recurrence_of(np.stack([x, n / 900.0], axis=1), n) == "wanders"
