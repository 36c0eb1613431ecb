"""The figure ``chaos``: shares with their errors, the map of exponents, and what the panels draw of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orbits import curves
from topcli.analysis.lyapunov import Growth
from topcli.figures import chaos
from topcli.figures.picture import Grid, draw

GROWTH = {"chaotic": 110.0, "regular": 8.5, "undecided": 12.0, "broke_off": math.nan}
"""Growth at the end of a curve that is a straight line."""


def growth(**counts: int) -> Growth:
    ends = [GROWTH[kind] for kind, count in counts.items() for _ in range(count)]
    return curves(*(lambda u, end=end: end * u for end in ends))


def test_share_of_chaotic_orbits_and_its_error() -> None:
    """Among those with a verdict; the error is that of a binomial distribution, half an orbit at least."""
    share, error = chaos.chaotic_share(growth(chaotic=30, regular=90, undecided=7, broke_off=3))
    assert share == 0.25
    assert error == pytest.approx(math.sqrt(0.25 * 0.75 / 120))
    assert chaos.chaotic_share(growth(regular=50)) == (0.0, 0.01)
    assert chaos.chaotic_share(growth(broke_off=5))[0] == 0.0


def test_panels_draw_their_columns() -> None:
    size = chaos.MAP_SIZE
    h, omega = np.linspace(0.1, 0.2, size), np.linspace(1.0, 2.0, size)
    exponent = np.random.default_rng(1).uniform(0.1, 0.2, size * size)
    exponent[:size], exponent[size : 2 * size] = 0.0, np.nan
    columns = {
        "map:h": np.repeat(h, size),
        "map:omega": np.tile(omega, size),
        "map:exponent": exponent,
        "h": np.append([0.1, 0.3, 0.6], np.full(9, np.nan)),
    }
    for label in (label for _, _, label in chaos.MAPS):
        columns |= {f"share:{label}": np.array([0.0, 0.2, 0.1]), f"error:{label}": np.array([0.01, 0.02, 0.03])}
    panels = (chaos.ChaosMap("map"), chaos.SharePanel("shares"))
    figure = draw(panels, columns, Grid(figsize=(7.0, 3.0)))
    plane, shares = figure.axes[:2]
    chaotic, regular = (mesh.get_array().filled(np.nan).ravel() for mesh in plane.collections)
    assert np.array_equal(np.isfinite(chaotic), exponent > 0.0)
    assert np.array_equal(chaotic[np.isfinite(chaotic)], exponent[exponent > 0.0])
    assert np.array_equal(np.isfinite(regular), exponent == 0.0)
    assert len(shares.containers) == 3
    for line, _, (bars,) in shares.containers:
        assert line.get_xydata().tolist() == [[0.1, 0.0], [0.3, 20.0], [0.6, 10.0]]
        assert [path.vertices[:, 1].tolist() for path in bars.get_paths()] == [[-1.0, 1.0], [18.0, 22.0], [7.0, 13.0]]


def test_random_orbits() -> None:
    y = chaos.random_orbits(20_000)
    assert np.linalg.norm(y[:, 3:], axis=1) == pytest.approx(1.0)
    assert y[:, :3].std(axis=0) == pytest.approx([1.5] * 3, rel=0.03)
