"""The figure ``chaos``: shares with their errors, and random orbits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from orbits import curves
from topcli.analysis.lyapunov import Growth
from topcli.figures import chaos

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


def test_random_orbits() -> None:
    y = chaos.random_orbits(20_000)
    assert np.linalg.norm(y[:, 3:], axis=1) == pytest.approx(1.0)
    assert y[:, :3].std(axis=0) == pytest.approx([1.5] * 3, rel=0.03)
