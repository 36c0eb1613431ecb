"""The body that figures and animations show: its shape, its axis, the faces that are seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from topcli.contracts import Top
from topcli.figures.body import body_of, shown_faces, surface_distance, view_azimuth
from topcli.figures.scene3d import projection
from topcli.tops.euler import Euler, EulerGamma
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial


@pytest.mark.parametrize(
    ("top", "state", "axis", "label"),
    [
        (Kowalevski(), None, (1.0, 0.0, 0.0), r"$\boldsymbol{e}_1$"),
        (Kowalevski(c0=-1.0), None, (-1.0, 0.0, 0.0), r"$-\boldsymbol{e}_1$"),
        (Lagrange(), None, (0.0, 0.0, 1.0), r"$\boldsymbol{e}_3$"),
        (LagrangeInertial(), None, (0.0, 0.0, 1.0), r"$\boldsymbol{a}$"),
        (Heavy(x0=0.0, y0=3.0, z0=4.0), None, (0.0, 0.6, 0.8), r"$\boldsymbol{s}$"),
        (Euler(), (0.1, 2.0, 0.2), (0.0, 1.0, 0.0), r"$\boldsymbol{e}_2$"),
        (EulerGamma(A=1.0, B=2.0, C=2.5), (3.0, 1.0, 0.1, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0), r"$\boldsymbol{e}_1$"),
    ],
)
def test_axis_passes_through_the_centre_of_gravity(top: Top, state: Any, axis: Any, label: str) -> None:
    body = body_of(top, state)
    assert body.axis == pytest.approx(axis)
    assert body.label == label
    outwards = ((body.faces.mean(axis=1) - body.faces.reshape(-1, 3).mean(axis=0)) * body.normals).sum(axis=1)
    assert outwards.min() > 0.0
    assert np.linalg.norm(body.faces, axis=2).max() < 1.0  # within the sphere of the trace


@pytest.mark.parametrize("top", [Heavy(), Heavy(x0=0.0, y0=3.0, z0=4.0), Kowalevski()])
def test_axis_leaves_the_body_at_its_surface(top: Top) -> None:
    body = body_of(top, None)
    semi = np.abs(body.faces).max(axis=(0, 1))
    assert surface_distance(body) == pytest.approx(1.0 / math.sqrt(((body.axis / semi) ** 2).sum()), rel=0.03)


def test_spinning_top_ends_where_its_axis_leaves_it() -> None:
    body = body_of(Lagrange(), None)
    assert surface_distance(body) == pytest.approx(body.faces[:, :, 2].max(), rel=1e-12)
    assert body.faces[:, :, 2].min() == 0.0  # the tip is in the fixed point


def test_body_is_the_ellipsoid_of_the_moments() -> None:
    """A : B : C = b² + c² : c² + a² : a² + b² of the semi-axes."""
    size = np.abs(body_of(Heavy(A=2.0, B=1.5, C=1.0, x0=1.0, y0=0.0, z0=0.0), None).faces).max(axis=(0, 1))
    squares = size**2
    found = np.array([squares[1] + squares[2], squares[2] + squares[0], squares[0] + squares[1]])
    assert found / found[2] == pytest.approx([2.0, 1.5, 1.0], rel=0.02)


def test_only_faces_turned_to_the_viewer_are_drawn() -> None:
    body, view = body_of(Kowalevski(), None), projection(22.0, 35.0)
    rotation = Rotation.from_euler("ZXZ", [0.4, 1.1, -2.0]).as_matrix()
    corners, colours = shown_faces(body, view, rotation)
    towards = (body.normals @ (view @ rotation).T)[:, 2]
    assert len(corners) == len(colours) == (towards > 0.0).sum()
    first = int(np.argmax(towards > 0.0))
    np.testing.assert_allclose(corners[0], (body.faces[first] @ rotation.T @ view.T)[:, :2], atol=1e-14)
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0


def test_the_start_of_the_axis_is_seen_from_the_side() -> None:
    assert view_azimuth(np.array([0.0, 0.0, 1.0])) == 35.0
    for axis in ([1.0, 0.0, 0.2], [-0.3, 0.5, -0.4]):
        right, _, _ = projection(22.0, view_azimuth(np.array(axis))) @ np.array(axis)
        assert right < -0.8 * np.hypot(axis[0], axis[1])
