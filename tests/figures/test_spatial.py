"""Spatial pictures are data: traces on the sphere, polhodes and bodies, against the runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import same_color

from drawn_artists import (
    arrows,
    drawn_from,
    eye_of,
    in_two_parts,
    points_of,
    seen,
    series_of,
    texts_of,
    vector,
)
from topcli.contracts import Top
from topcli.figures.body import body_of, surface_distance
from topcli.figures.picture import draw
from topcli.figures.space import Sphere, polhodes
from topcli.tops.euler import Euler, EulerGamma, field
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

SPHERES = [
    *((f"lagrange_{name}", "a", (72.0, 0.0), ("", "", "p"), True) for name in ("cusps", "loops", "waves")),
    ("kowalevski_hybrid", "gamma", (-20.0, 35.0), ("e_1", "e_2", "e_3"), False),
    ("kowalevski_generic_hk", "gamma", (-20.0, 35.0), ("e_1", "e_2", "e_3"), False),
]
"""Scene, vector, elevation and azimuth of the viewer, names of the axes, and whether the bounds are drawn."""


def assert_curve(axes: Any, points: np.ndarray, near: str, far: str, dot: int = 0) -> Any:
    """A curve has these points in front and behind, in these colours, and a dot at one of them; the dot."""
    found, front = in_two_parts(axes, near, far)
    np.testing.assert_allclose(found, points, atol=1e-12)
    np.testing.assert_array_equal(front, points @ eye_of(axes) >= 0.0)
    (mark,) = (line for line in axes.lines if line.get_marker() in "oD")
    np.testing.assert_allclose(points_of(mark)[0], points[dot], atol=1e-12)
    return mark


@pytest.mark.slow
def test_traces_on_the_sphere(tmp_path: Path) -> None:
    """The trace in front and behind, the dot at its start, axes outwards with their names, the band that it fills."""
    figure = drawn_from("traces", tmp_path)
    for axes, (scene, column, view, directions, band) in zip(figure.axes, SPHERES, strict=True):
        series = series_of(tmp_path, scene)
        trace = vector(series, column)
        assert (axes.elev, axes.azim) == view  # type: ignore[attr-defined]
        dot = assert_curve(axes, trace, "#0072B2", "#74ABD1")
        near = trace @ eye_of(axes) >= 0.0
        assert same_color(dot.get_color(), "#D55E00" if near[0] else "#DD9560")
        named: Any = [text for text in axes.texts if text.get_text()]
        assert texts_of(axes) == [rf"$\boldsymbol{{{one}}}$" for one in directions if one]
        scale = np.linalg.norm(seen(axes, np.array([[0.0, 0.0, 1.0]])) - (origin := seen(axes, np.zeros((1, 3)))))
        scale /= math.cos(math.radians(axes.elev))  # type: ignore[attr-defined]
        poles = np.eye(3)[[bool(one) for one in directions]]
        for (foot, head), pole, text in zip(arrows(axes), poles, named, strict=True):
            flat = (seen(axes, pole[None]) - origin)[0] / scale
            ahead = flat / np.linalg.norm(flat)
            foot, head = (foot - origin[0]) / scale, (head - origin[0]) / scale
            place = (seen(axes, np.array(text.get_position_3d())[None]) - origin)[0] / scale
            np.testing.assert_allclose(foot, flat if pole @ eye_of(axes) > 0.0 else ahead, atol=1e-12)
            np.testing.assert_allclose(head / np.linalg.norm(head), ahead, atol=1e-12)
            np.testing.assert_allclose(place / np.linalg.norm(place), ahead, atol=1e-12)
            assert np.linalg.norm(place) > np.linalg.norm(head) > np.linalg.norm(foot)
            # a name lies outside of the sphere, or inside of the band that the trace does not leave
            assert np.linalg.norm(head) > 1.1 or band
        dots = [points_of(line) for line in axes.lines if line.get_marker() == "."]
        whole = np.abs(series["t"] - np.round(series["t"])) < 1e-9
        expected = [trace[whole & near], trace[whole & ~near]] if scene == "kowalevski_hybrid" else []
        for found, points in zip(dots, expected, strict=True):
            np.testing.assert_allclose(found, points, atol=1e-14)
        dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
        heights = [height for height in (trace[:, 2].min(), trace[:, 2].max()) for _ in "nf"] if band else []
        for line, height in zip(dashed, heights, strict=True):
            points = points_of(line)[np.isfinite(points_of(line)).all(axis=1)]
            np.testing.assert_allclose(points[:, 2], height, rtol=1e-14)
            np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, rtol=1e-14)


def test_dots_are_a_unit_of_time_apart_also_backwards() -> None:
    t = -np.linspace(0.0, 3.0, 31)
    circle = {"t": t, "x": np.cos(t), "y": np.sin(t), "z": 0.0 * t}
    axes = draw([Sphere("equator", ("x", "y", "z"), elevation=90.0, time="t")], circle).axes[0]
    shown = sorted(float(y) for line in axes.lines if line.get_marker() == "." for y in points_of(line)[:, 1])
    np.testing.assert_allclose(shown, sorted(-np.sin([0.0, 1.0, 2.0, 3.0])), atol=1e-12)


MOMENTS = np.array([3.0, 2.0, 1.0])
"""Of the figure ``polhodes``."""


def point_on_ellipsoid(axes: Any, place: np.ndarray) -> np.ndarray:
    """The point of x.Ix = 1 nearest to the eye that is seen at ``place``."""
    eye = eye_of(axes)
    matrix = (seen(axes, np.eye(3)) - seen(axes, np.zeros((1, 3)))).T
    base = np.linalg.lstsq(matrix, place - seen(axes, np.zeros((1, 3)))[0], rcond=None)[0]
    a, b, c = MOMENTS @ eye**2, MOMENTS @ (base * eye), MOMENTS @ base**2 - 1.0
    return base + (-b + math.sqrt(b * b - a * c)) / a * eye


@pytest.mark.slow
def test_polhodes_run_the_way_of_the_motion(tmp_path: Path) -> None:
    """The run's own curve, arrows along Euler's equations, filled dots at stable rotations and an open one between."""
    (axes,) = drawn_from("polhodes", tmp_path).axes
    omega = vector(series_of(tmp_path, "euler_tennis_racket"), "omega")
    red = [points_of(line) for line in axes.lines if same_color(line.get_color(), "#B2182B")]
    path = omega / np.sqrt(omega[0] ** 2 @ MOMENTS)
    np.testing.assert_allclose(np.where(np.isnan(red[0]), red[1], red[0]), path, atol=1e-12)
    np.testing.assert_array_equal(np.isfinite(red[0][:, 0]), (path * MOMENTS) @ eye_of(axes) >= 0.0)
    curves = arrows(axes)[:-3]  # three belong to the axes
    assert len(curves) > 4
    for foot, head in curves:
        (w1, w2, w3), (a, b, c) = point_on_ellipsoid(axes, 0.5 * (foot + head)), MOMENTS
        rate = np.array([(b - c) / a * w2 * w3, (c - a) / b * w3 * w1, (a - b) / c * w1 * w2])
        along = (seen(axes, rate[None]) - seen(axes, np.zeros((1, 3))))[0]
        assert along @ (head - foot) > 0.99 * np.linalg.norm(along) * np.linalg.norm(head - foot)
    dots = {tuple(np.round(points_of(line)[0], 9)): line for line in axes.lines if line.get_marker() == "o"}
    for i, moment in enumerate(MOMENTS):
        dot = dots.pop(tuple(np.round(np.eye(3)[i] / math.sqrt(moment), 9)))
        assert same_color(dot.get_markerfacecolor(), "white") == (moment == 2.0)
    assert not dots  # the other ends of the axes are hidden


@pytest.mark.parametrize("moments", [(3.0, 2.0, 1.0), (1.0, 2.5, 1.7), (2.0, 3.0, 2.5)])
def test_curves_are_polhodes_in_the_sense_of_the_motion(moments: tuple[float, float, float]) -> None:
    top, inertia = Euler(A=moments[0], B=moments[1], C=moments[2]), np.array(moments)
    curves = polhodes(inertia, (0.2, 0.7))
    assert (len(curves), sum(separatrix for _, separatrix in curves)) == (12, 4)
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
    """And leaves the body at its surface: the ellipsoid of its moments, or the end of the spinning top."""
    body = body_of(top, state)
    assert body.axis == pytest.approx(axis)
    assert body.label == label
    outwards = ((body.faces.mean(axis=1) - body.faces.reshape(-1, 3).mean(axis=0)) * body.normals).sum(axis=1)
    assert outwards.min() > 0.0
    assert np.linalg.norm(body.faces, axis=2).max() < 1.0  # within the sphere of the trace
    if isinstance(top, Lagrange | LagrangeInertial):
        assert surface_distance(body) == pytest.approx(body.faces[:, :, 2].max(), rel=1e-12)
        assert body.faces[:, :, 2].min() == 0.0  # the tip is in the fixed point
    else:
        semi = np.abs(body.faces).max(axis=(0, 1))
        assert surface_distance(body) == pytest.approx(1.0 / math.sqrt(((body.axis / semi) ** 2).sum()), rel=0.03)


def test_body_is_the_ellipsoid_of_the_moments() -> None:
    """A : B : C = b² + c² : c² + a² : a² + b² of the semi-axes."""
    size = np.abs(body_of(Heavy(A=2.0, B=1.5, C=1.0, x0=1.0, y0=0.0, z0=0.0), None).faces).max(axis=(0, 1))
    found = np.sum(size**2) - size**2
    assert found / found[2] == pytest.approx([2.0, 1.5, 1.0], rel=0.02)
