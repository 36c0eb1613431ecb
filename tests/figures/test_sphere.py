"""The panel of a trace on the sphere, and figures that read several scenes."""

from __future__ import annotations

import numpy as np
import pytest

from topcli.figures.catalogue import find_figure
from topcli.figures.picture import draw
from topcli.figures.scene3d import TRACE, TRACE_FAR, Sphere, projection


def test_projection_is_a_rotation_that_looks_from_where_it_says() -> None:
    view = projection(30.0, 70.0)
    assert view @ view.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(view) == pytest.approx(1.0)
    e, a = np.radians(30.0), np.radians(70.0)
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    assert view @ eye == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert (view @ [0.0, 0.0, 1.0])[1] > 0.0


def test_far_side_of_the_sphere_is_drawn_lighter() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    circle = {"x": np.cos(angle), "y": np.sin(angle), "z": 0.0 * angle}
    axes = draw([Sphere("equator", ("x", "y", "z"), elevation=40.0)], circle).axes[0]
    lines = {line.get_color(): np.asarray(line.get_ydata()) for line in axes.lines if len(line.get_xdata()) == 400}
    assert np.nanmax(lines[TRACE]) < 1e-12  # seen from above, the near half of the equator lies below the centre
    assert np.nanmin(lines[TRACE_FAR]) > -1e-12
    assert (np.isnan(lines[TRACE]) != np.isnan(lines[TRACE_FAR])).all()


def test_a_figure_needs_the_scenes_that_its_columns_name() -> None:
    """Other figures that need one of them are drawn by no other process at the same time."""
    assert find_figure("nutation").needs == ("lagrange_cusps", "lagrange_loops", "lagrange_waves")
    assert find_figure("fig3").needs == find_figure("fig2").needs == ("kowalevski_bohlin_a",)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_dots_are_a_unit_of_time_apart(direction: float) -> None:
    """From the start on, forwards and backwards in time."""
    t = direction * np.linspace(0.0, 3.0, 31)
    circle = {"t": t, "x": np.cos(t), "y": np.sin(t), "z": 0.0 * t}
    axes = draw([Sphere("equator", ("x", "y", "z"), elevation=90.0, time="t")], circle).axes[0]
    dots = [line for line in axes.lines if line.get_marker() == "."]
    shown = np.array(sorted(float(x) for line in dots for x in np.asarray(line.get_xdata())))
    np.testing.assert_allclose(shown, sorted(direction * np.sin([0.0, 1.0, 2.0, 3.0])), atol=1e-12)
