"""Pictures of ``topcli.motion``: place in the bifurcation diagram, polhode, trace of the axis, components."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.figure import Figure

import topcli
from topcli.analysis.reference import reference_states
from topcli.figures.motion import MOST_NUTATIONS
from topcli.show.report import MotionReport
from topcli.tops.lagrange import LagrangeInertial

TILTED = [0.6, 0.0, 0.8]


def drawn(found: MotionReport, colours: tuple[str, str]) -> np.ndarray:
    """Points (m, 3) of a curve that is drawn in one colour in front and in another behind, or thinner."""
    axes: Any = found.plot(Figure().add_subplot())
    front, behind = (
        np.column_stack(next(line for line in lines if same_color(line.get_color(), colour)).get_data_3d())
        for lines, colour in zip((axes.lines, axes.lines[::-1]), colours, strict=True)
    )
    return np.where(np.isnan(front), behind, front)


def trace(found: MotionReport) -> np.ndarray:
    """Points (m, 3) of the axis."""
    return drawn(found, ("#0072B2", "#74ABD1"))


def lagrange(omega: list[float], gamma: list[float], **top: float) -> MotionReport:
    return topcli.motion({"top": {"kind": "lagrange", **top}, "initial": {"omega": omega, "gamma": gamma}})


@pytest.mark.slow
@pytest.mark.parametrize("unit", [1.0, 2.0])
def test_kowalevski_motion_is_a_place_in_its_diagram(unit: float) -> None:
    """With c0 four times as large and omega twice as large, the motion is the same in units of gravity."""
    omega, gamma = [0.7 * unit, -0.4 * unit, 1.3 * unit], [0.6, 0.48, 0.64]
    found = topcli.motion({"top": {"kind": "kowalevski", "c0": unit**2}, "initial": {"omega": omega, "gamma": gamma}})
    axes = found.plot(Figure().add_subplot())
    (point,) = [line for line in axes.get_lines() if line.get_marker() == "o" and len(line.get_xdata())]
    assert point.get_xdata()[0] == pytest.approx(found["energy"] / unit**2, rel=1e-14)
    assert point.get_ydata()[0] == pytest.approx(found["k_sq"] / unit**4, rel=1e-14)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < point.get_xdata()[0] < right
    assert bottom < point.get_ydata()[0] < top
    assert f"= {found['two_l'] / unit:.6g}$" in axes.get_title(loc="left")


@pytest.mark.slow
def test_polhode_is_closed_after_its_period() -> None:
    curve = drawn(topcli.motion("euler_hk"), ("#B2182B", "#B2182B"))
    np.testing.assert_allclose(curve[-1], curve[0], atol=1e-13)
    assert np.linalg.norm(curve[len(curve) // 2] - curve[0]) > 0.3


@pytest.mark.slow
def test_trace_of_the_axis_is_that_of_the_inertial_frame() -> None:
    found = topcli.motion("lagrange_cusps")
    axis = trace(found)
    end = math.ceil(1.0 / found["precession.per_nutation"] - 1e-3) * found["period.nutation"]
    states = reference_states(LagrangeInertial(), found.state, np.array([0.0, end]))
    np.testing.assert_allclose(axis[[0, -1]], states[:, 3:], atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("mu", "C"), [(1.0, 0.5), (-2.0, 1.5)])
def test_trace_of_a_body_frame_has_its_heights_and_precession(mu: float, C: float) -> None:
    """The height is gamma3 of the body frame; the angle of precession in a nutation is the elliptic integral."""
    found = lagrange([0.7, -0.4, 1.3], TILTED, mu=mu, C=C, A=2.0)
    axis = trace(found)
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0, atol=1e-15)
    count = min(max(math.ceil(0.999 / abs(found["precession.per_nutation"])), 2), MOST_NUTATIONS)
    times = np.linspace(0.0, count * found["period.nutation"], len(axis))
    body = reference_states(found.experiment.top, found.state, times)
    np.testing.assert_allclose(axis[:, 2], body[:, 5], atol=1e-12)
    angle = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
    turned = (angle[-1] - angle[0]) / (2.0 * math.pi * count)
    assert turned == pytest.approx(found["precession.per_nutation"], abs=1e-10)


def test_axis_without_gravity_circles_about_the_momentum() -> None:
    axis = trace(lagrange([1.0, 0.0, 2.0], TILTED, mu=0.0))
    centre = axis - axis.mean(axis=0)
    normal = np.cross(centre[1] - centre[0], centre[len(centre) // 5] - centre[0])
    tilt = 1.0 / math.sqrt(2.0)  # of the momentum (1, 0, 0.5 * 2) to the axis
    np.testing.assert_allclose(np.abs(axis @ normal) / np.linalg.norm(normal), tilt, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("omega", "gamma"),
    [([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]), ([0.0, 0.0, 0.0], [0.0, 0.0, -1.0]), ([0.0, 0.0, 2.0], TILTED)],
)
def test_every_motion_of_the_lagrange_top_can_be_drawn(omega: list[float], gamma: list[float]) -> None:
    found = lagrange(omega, gamma)
    assert found.plot(Figure().add_subplot()).has_data()
    assert np.isfinite(trace(found)).all()
