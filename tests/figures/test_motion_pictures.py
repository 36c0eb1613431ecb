"""Pictures of ``topcli.motion``: place in the bifurcation diagram, polhode, trace, components."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import topcli
from topcli.analysis.reference import reference_states

TILTED = [0.6, 0.0, 0.8]


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 2.0])
def test_kowalevski_motion_is_a_place_in_its_diagram(unit: float) -> None:
    """With c0 four times as large and omega twice as large, the motion is the same in units of gravity."""
    omega, gamma = [0.7 * unit, -0.4 * unit, 1.3 * unit], [0.6, 0.48, 0.64]
    motion = topcli.motion({"top": {"kind": "kowalevski", "c0": unit**2}, "initial": {"omega": omega, "gamma": gamma}})
    axes = motion.plot(Figure().add_subplot())
    (point,) = [line for line in axes.get_lines() if line.get_marker() == "o"]
    assert point.get_xdata()[0] == pytest.approx(motion["energy"] / unit**2, rel=1e-14)
    assert point.get_ydata()[0] == pytest.approx(motion["k_sq"] / unit**4, rel=1e-14)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < point.get_xdata()[0] < right
    assert bottom < point.get_ydata()[0] < top
    assert f"= {motion['two_l'] / unit:.6g}$" in axes.get_title(loc="left")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "vector", "period"),
    [
        ("euler_hk", "omega", "period"),
        ("lagrange_cusps", "a", "period.nutation"),
        ("lagrange_loops", "a", "period.nutation"),
    ],
)
def test_curves_are_those_of_the_reference(config: str, vector: str, period: str) -> None:
    """By their directions: a polhode is scaled to the ellipsoid."""
    motion = topcli.motion(config)
    axes: Any = motion.plot(Figure().add_subplot())
    top, times = motion.experiment.top, np.linspace(0.0, motion[period], 5)
    points = reference_states(top, motion.experiment.y0, times)[:, slice(*top.vectors[vector])]
    curves = [np.column_stack(line.get_data_3d()) for line in axes.lines if line.get_gid() == "motion"]
    drawn = np.vstack([curve[np.isfinite(curve[:, 0])] for curve in curves])
    drawn, points = (rows / np.linalg.norm(rows, axis=1)[:, None] for rows in (drawn, points))
    apart = np.linalg.norm(drawn[:, None] - points, axis=2)
    assert apart.min(axis=0).max() < 1e-9


@pytest.mark.parametrize(
    ("top", "omega", "gamma"),
    [
        ({"kind": "lagrange"}, [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]),
        ({"kind": "lagrange"}, [0.0, 0.0, 0.0], [0.0, 0.0, -1.0]),
        ({"kind": "lagrange", "mu": -2.0, "C": 1.5}, [0.7, -0.4, 1.3], TILTED),
        ({"kind": "heavy"}, [0.7, -0.4, 1.3], TILTED),
        ({"kind": "euler", "A": 1.0, "B": 1.0, "C": 2.0}, [0.7, -0.4, 1.3], None),
    ],
)
def test_every_motion_has_a_picture(top: Any, omega: list[float], gamma: list[float] | None) -> None:
    initial = {"omega": omega} | ({"gamma": gamma} if gamma else {})
    axes = topcli.motion({"top": top, "initial": initial}).plot(Figure().add_subplot())
    assert axes.has_data()
