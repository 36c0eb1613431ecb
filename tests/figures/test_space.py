"""Spatial pictures: traces in front of the sphere and behind it, polhodes, bodies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from declared import Heavy
from topcli.contracts import Top
from topcli.figures.animation import body_of
from topcli.figures.figure import canvas_of
from topcli.figures.space import SPATIAL, draw_trace, polhodes
from topcli.tops.euler import Euler, EulerGamma, euler_field
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial


def test_trace_is_strong_in_front_and_pale_behind() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 50)
    tilted = np.column_stack([np.cos(angle), 0.6 * np.sin(angle), 0.8 * np.sin(angle)])
    canvas = canvas_of(lambda canvas: draw_trace(canvas.add_subplot(projection=SPATIAL), tilted, 20.0), (4, 4))
    axes: Any = canvas.axes[0]
    e = math.radians(20.0)
    near = tilted @ [math.cos(e), 0.0, math.sin(e)] >= 0.0
    lines = [line for line in axes.lines if line.get_gid() == "motion"]
    for line, (opacity, part) in zip(lines, ((None, near), (0.45, ~near)), strict=True):
        expected = np.where(part[:, None], tilted, np.nan)
        np.testing.assert_allclose(np.column_stack(line.get_data_3d()), expected, atol=1e-12)
        assert line.get_alpha() == opacity


@pytest.mark.parametrize("moments", [(3.0, 2.0, 1.0), (1.0, 2.5, 1.7), (2.0, 3.0, 2.5)])
def test_curves_are_polhodes_in_the_sense_of_the_motion(moments: tuple[float, float, float]) -> None:
    top, inertia = Euler(A=moments[0], B=moments[1], C=moments[2]), np.array(moments)
    curves = polhodes(inertia, (0.0, 0.2, 0.7))
    assert len(curves) == 12
    for number, curve in enumerate(curves):
        assert curve**2 @ inertia == pytest.approx(np.ones(len(curve)), abs=1e-12)
        m_sq = curve**2 @ inertia**2
        assert np.ptp(m_sq) < 1e-12
        assert (number < 4) == (m_sq[0] == pytest.approx(sorted(moments)[1], abs=1e-12))
        if number >= 4:
            step = np.diff(curve, axis=0)
            rate = np.array([euler_field(tuple(w), top.constants()) for w in curve[:-1]])
            cosine = (step * rate).sum(axis=1) / np.linalg.norm(step, axis=1) / np.linalg.norm(rate, axis=1)
            assert cosine.min() > 0.99


@pytest.mark.parametrize(
    ("top", "state", "axis", "label"),
    [
        (Kowalevski(), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), r"$\boldsymbol{e}_1$"),
        (Kowalevski(c0=-1.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), r"$-\boldsymbol{e}_1$"),
        (Lagrange(), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), r"$\boldsymbol{e}_3$"),
        (LagrangeInertial(), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), r"$\boldsymbol{a}$"),
        (Heavy(x0=0.0, y0=3.0, z0=4.0), (0.0, 0.0, 1.0), (0.0, 0.6, 0.8), r"$\boldsymbol{s}$"),
        (Euler(), (0.1, 2.0, 0.2), (0.0, 1.0, 0.0), r"$\boldsymbol{e}_2$"),
        (EulerGamma(A=1.0, B=2.0, C=2.5), (3.0, 1.0, 0.1, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0), r"$\boldsymbol{e}_1$"),
    ],
)
def test_axis_passes_through_the_centre_of_gravity(top: Top, state: Any, axis: Any, label: str) -> None:
    body = body_of(top, state)
    assert body.axis == pytest.approx(axis)
    assert body.label == label
    assert np.linalg.norm(body.surface, axis=2).max() < 1.0  # within the sphere of the trace
    if max(axis) == 1.0:  # the surface begins where a principal axis leaves it
        assert body.surface[0, 0] == pytest.approx(np.linalg.norm(body.surface[0, 0]) * body.axis, abs=1e-12)


def test_body_is_the_ellipsoid_of_the_moments() -> None:
    """A : B : C = b² + c² : c² + a² : a² + b² of the semi-axes."""
    size = np.abs(body_of(Heavy(A=2.0, B=1.5, C=1.0, x0=1.0, y0=0.0, z0=0.0), (0.0, 0.0, 1.0)).surface).max(axis=(0, 1))
    moments = np.sum(size**2) - size**2
    assert moments / moments[2] == pytest.approx([2.0, 1.5, 1.0], rel=0.02)
