"""The picture of the energy ellipsoid: its curves are polhodes, and run the way of the motion."""

from __future__ import annotations

import numpy as np
import pytest

from topcli.errors import RunError
from topcli.figures.picture import draw
from topcli.figures.polhodes import Polhodes, _curves
from topcli.figures.scene3d import projection
from topcli.tops.euler import Euler, field


@pytest.mark.parametrize("moments", [(3.0, 2.0, 1.0), (1.0, 2.5, 1.7), (2.0, 3.0, 2.5)])
def test_curves_are_polhodes_in_the_sense_of_the_motion(moments: tuple[float, float, float]) -> None:
    top, inertia = Euler(A=moments[0], B=moments[1], C=moments[2]), np.array(moments)
    curves = _curves(inertia, (0.2, 0.7))
    assert len(curves) == 12
    assert sum(separatrix for _, separatrix in curves) == 4
    for curve, separatrix in curves:
        assert curve**2 @ inertia == pytest.approx(np.ones(len(curve)), abs=1e-12)
        m_sq = curve**2 @ inertia**2
        assert np.ptp(m_sq) < 1e-12
        assert separatrix == (m_sq[0] == pytest.approx(sorted(moments)[1], abs=1e-12))
        if not separatrix:
            step = np.diff(curve, axis=0)
            rate = np.array([field(tuple(w), top.constants()) for w in curve[:-1]])
            cosine = (step * rate).sum(axis=1) / np.linalg.norm(step, axis=1) / np.linalg.norm(rate, axis=1)
            assert cosine.min() > 0.99


def test_the_camera_is_a_rotation() -> None:
    camera = projection(elevation=24.0, azimuth=52.0)
    assert camera @ camera.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(camera) == pytest.approx(1.0)


def test_a_run_of_another_top_is_refused() -> None:
    angle = np.linspace(0.0, 6.0, 50)
    data = {"omega1": np.cos(angle), "omega2": np.sin(angle), "omega3": 0.0 * angle}
    with pytest.raises(RunError, match="moments"):
        draw([Polhodes((3.0, 2.0, 1.0), pixels=40)], data)
    draw([Polhodes((2.0, 2.0 + 1e-9, 1.0), pixels=40)], data)
