"""Spatial pictures are data: traces on the sphere, polhodes, bodies and curves of vectors, against the runs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import same_color
from matplotlib.lines import Line2D
from scipy.spatial.transform import Rotation

from drawn_artists import (
    arrows,
    data_of,
    drawn_from,
    explained,
    in_two_parts,
    look,
    seen_from,
    series_of,
    texts_of,
    vector,
)
from topcli.config.load import load_experiment
from topcli.contracts import Top
from topcli.figures.body import body_of, surface_distance
from topcli.figures.picture import draw
from topcli.figures.scene3d import Polhodes, Sphere, _curves
from topcli.figures.scenes import tick_value
from topcli.tops.euler import Euler, EulerGamma, field
from topcli.tops.heavy import Heavy
from topcli.tops.kowalevski import Kowalevski
from topcli.tops.lagrange import Lagrange, LagrangeInertial

SPHERES = {
    "sphere": [
        ("kowalevski_hybrid", "gamma", -20.0, 35.0, ("e_1", "e_2", "e_3"), False),
        ("kowalevski_generic_hk", "gamma", -20.0, 35.0, ("e_1", "e_2", "e_3"), False),
    ],
    "nutation": [(f"lagrange_{name}", "a", 72.0, 0.0, ("", "", "p"), True) for name in ("cusps", "loops", "waves")],
}


def assert_curve(axes: Axes, seen: np.ndarray, near: str, far: str, dot: int = 0) -> Line2D:
    """A curve has these points in front and behind, in these colours, and a dot at one of them; the dot."""
    drawn, front = in_two_parts(axes, near, far)
    np.testing.assert_allclose(drawn, seen[:, :2], atol=1e-12)
    np.testing.assert_array_equal(front, seen[:, 2] >= 0.0)
    (mark,) = (line for line in axes.lines if line.get_marker() in "oD")
    np.testing.assert_allclose(data_of(mark)[0], seen[dot, :2], atol=1e-12)
    return mark


@pytest.mark.slow
@pytest.mark.parametrize("name", SPHERES)
def test_traces_on_the_sphere(name: str, tmp_path: Path) -> None:
    """The trace in front and behind, the dot at its start, axes outwards with their names, the band that it fills."""
    figure = drawn_from(name, tmp_path)
    for axes, (scene, column, elevation, azimuth, directions, band) in zip(figure.axes, SPHERES[name], strict=True):
        series = series_of(tmp_path, scene)
        trace = vector(series, column)
        flat = seen_from(elevation, azimuth, trace)
        dot = assert_curve(axes, flat, "#0072B2", "#74ABD1")
        assert same_color(dot.get_color(), "#D55E00" if flat[0, 2] >= 0.0 else "#DD9560")
        named = [text for text in axes.texts if text.get_text()]
        assert texts_of(axes) == [rf"$\boldsymbol{{{one}}}$" for one in directions if one]
        poles = seen_from(elevation, azimuth, np.eye(3)[[bool(one) for one in directions]])
        for (foot, head), pole, text in zip(arrows(axes), poles, named, strict=True):
            ahead, place = pole[:2] / np.linalg.norm(pole[:2]), np.array(text.get_position())
            np.testing.assert_allclose(foot, pole[:2] if pole[2] > 0.0 else ahead, atol=1e-14)
            np.testing.assert_allclose(head / np.linalg.norm(head), ahead, atol=1e-14)
            np.testing.assert_allclose(place / np.linalg.norm(place), ahead, atol=1e-14)
            assert np.linalg.norm(place) > np.linalg.norm(head) > np.linalg.norm(foot)
            # a name lies outside of the sphere, or inside of the band that the trace does not leave
            assert np.linalg.norm(head) > 1.1 or band
        dots = sorted(tuple(point) for line in axes.lines if line.get_marker() == "." for point in data_of(line))
        whole = (
            np.flatnonzero(np.abs(series["t"] - np.round(series["t"])) < 1e-9) if scene == "kowalevski_hybrid" else []
        )
        np.testing.assert_allclose(dots, sorted(map(tuple, flat[whole, :2])), atol=1e-14)
        dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
        heights = [height for height in (trace[:, 2].min(), trace[:, 2].max()) for _ in "nf"] if band else []
        for line, height in zip(dashed, heights, strict=True):
            points = data_of(line)[np.isfinite(data_of(line)).all(axis=1)]
            up = (points[:, 1] - math.cos(math.radians(elevation)) * height) / math.sin(math.radians(elevation))
            assert points[:, 0] ** 2 + up**2 == pytest.approx(np.full(len(points), 1.0 - height**2), abs=1e-12)


def test_dots_are_a_unit_of_time_apart_also_backwards() -> None:
    t = -np.linspace(0.0, 3.0, 31)
    circle = {"t": t, "x": np.cos(t), "y": np.sin(t), "z": 0.0 * t}
    axes = draw([Sphere("equator", ("x", "y", "z"), elevation=90.0, time="t")], circle).axes[0]
    shown = sorted(float(x) for line in axes.lines if line.get_marker() == "." for x in np.asarray(line.get_xdata()))
    np.testing.assert_allclose(shown, sorted(-np.sin([0.0, 1.0, 2.0, 3.0])), atol=1e-12)


MOMENTS, EYE = np.array([3.0, 2.0, 1.0]), (24.0, 52.0)
"""Of the figure ``polhodes``: moments, elevation and azimuth of the viewer."""


def point_on_ellipsoid(flat: np.ndarray) -> np.ndarray:
    """The point of x.Ix = 1 nearest to the eye that is seen at ``flat``; ValueError beside the ellipsoid."""
    right, up, eye = seen_from(*EYE, np.eye(3)).T
    base = right * flat[0] + up * flat[1]
    a, b, c = MOMENTS @ eye**2, MOMENTS @ (base * eye), MOMENTS @ base**2 - 1.0
    return base + (-b + math.sqrt(b * b - a * c)) / a * eye


@pytest.mark.slow
def test_polhodes_run_the_way_of_the_motion(tmp_path: Path) -> None:
    """The run's own curve, arrows along Euler's equations, filled dots at stable rotations and an open one between."""
    (axes,) = drawn_from("polhodes", tmp_path).axes
    omega = vector(series_of(tmp_path, "euler_tennis_racket"), "omega")
    flat = seen_from(*EYE, omega / np.sqrt(omega[0] ** 2 @ MOMENTS))
    red = [data_of(line) for line in axes.lines if same_color(line.get_color(), "#B2182B")]
    np.testing.assert_allclose(np.where(np.isnan(red[0]), red[1], red[0]), flat[:, :2], rtol=2e-3, atol=2e-3)
    curves = [arrow for arrow in arrows(axes) if np.linalg.norm(arrow[1] - arrow[0]) < 0.1]
    assert len(curves) > 4
    for foot, head in curves:
        (w1, w2, w3), (a, b, c) = point_on_ellipsoid(foot), MOMENTS
        rate = np.array([(b - c) / a * w2 * w3, (c - a) / b * w3 * w1, (a - b) / c * w1 * w2])
        along = seen_from(*EYE, rate[None])[0, :2]
        assert along @ (head - foot) > 0.99 * np.linalg.norm(along) * np.linalg.norm(head - foot)
    dots = {tuple(np.round(data_of(line)[0], 9)): line for line in axes.lines if line.get_marker() == "o"}
    tips = seen_from(*EYE, np.diag(1.0 / np.sqrt(MOMENTS)))[:, :2]
    for tip, moment in zip(tips, MOMENTS, strict=True):
        dot = dots.pop(tuple(np.round(tip, 9)))
        assert same_color(dot.get_markerfacecolor(), "white") == (moment == 2.0)
    assert not dots  # the other ends of the axes are hidden


@pytest.mark.slow
def test_the_ellipsoid_is_lit_and_tinted_by_its_formula(tmp_path: Path) -> None:
    """Colour of single points: white at the separatrix, blue or ochre beyond, and light from the upper left."""
    (picture,) = drawn_from("polhodes", tmp_path).axes[0].images
    image, half = np.asarray(picture.get_array()), float(picture.get_extent()[1])
    right, up, eye = seen_from(*EYE, np.eye(3)).T
    light = (-0.45 * right + 0.55 * up + 0.75 * eye) / math.sqrt(0.45**2 + 0.55**2 + 0.75**2)
    gloss = (light + eye) / np.linalg.norm(light + eye)
    compared = 0
    for row in range(40, len(image), 97):
        for column in range(40, len(image), 89):
            try:
                point = point_on_ellipsoid(2.0 * half * np.array([column, row]) / (len(image) - 1) - half)
            except ValueError:
                assert image[row, column, 3] == 0.0
                continue
            normal = point * MOMENTS
            level = normal @ normal - 2.0  # m² at 2E = 1 is between 1 and 3
            tint = np.array((0.44, 0.63, 0.80) if level > 0.0 else (0.93, 0.72, 0.42))
            colour = np.array((0.985, 0.975, 0.955)) * (1.0 - abs(level)) + abs(level) * tint
            normal /= np.linalg.norm(normal)
            lit = colour * (0.70 + 0.31 * max(normal @ light, 0.0)) + 0.07 * max(normal @ gloss, 0.0) ** 24
            np.testing.assert_allclose(image[row, column, :3], np.minimum(lit, 1.0), atol=1e-9)
            compared += 1
    assert compared > 20


@pytest.mark.parametrize("moments", [(3.0, 2.0, 1.0), (1.0, 2.5, 1.7), (2.0, 3.0, 2.5)])
def test_curves_are_polhodes_in_the_sense_of_the_motion(moments: tuple[float, float, float]) -> None:
    top, inertia = Euler(A=moments[0], B=moments[1], C=moments[2]), np.array(moments)
    curves = _curves(inertia, (0.2, 0.7))
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


LEGENDS = {
    "sphere": [r"vertical $\boldsymbol{\gamma}$", "on the far side", "$t = 0, 1, 2, ...$", "start"],
    "nutation": [r"axis $\boldsymbol{a}$", "on the far side", "its bounds", "start"],
    "traces": [r"$\boldsymbol{\omega}$", "its rear part", "shadow below", "start"],
    "body": ["trace of the axis", "on the far side", "the axis at the end"],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LEGENDS)
def test_the_legend_explains_every_mark(name: str, tmp_path: Path) -> None:
    """Also the colours and widths of the legend are those of the curves."""
    figure = drawn_from(name, tmp_path)
    key = explained(figure)
    assert list(key) == LEGENDS[name]
    for axes in figure.axes:
        for line in (line for line in axes.lines if str(line.get_label())[0] != "_"):
            shown = key[str(line.get_label())]
            assert look(shown) == look(line)
            assert shown.get_linewidth() == pytest.approx(line.get_linewidth()) or name == "sphere"


@pytest.mark.parametrize(
    ("size", "value"), [(1.0, 1.0), (0.999, 0.5), (1.99, 1.0), (2.0, 2.0), (4.9, 2.0), (5.0, 5.0), (0.03, 0.02)]
)
def test_ticks_are_round_numbers_within_the_longest_vector(size: float, value: float) -> None:
    assert tick_value(size) == pytest.approx(value)


def test_polhodes_explain_their_tints_by_the_moments() -> None:
    """Blue is around the axis of the largest moment, ochre around that of the smallest."""
    angle = np.linspace(0.0, 6.0, 50)
    data = {"omega1": 0.0 * angle, "omega2": 0.0 * angle + 1.0, "omega3": 0.0 * angle}
    (legend,) = [axes.get_legend() for axes in draw([Polhodes((1.0, 3.0, 2.0), pixels=40)], data).axes]
    assert legend
    tints = {text.get_text(): handle for text, handle in zip(legend.get_texts(), legend.legend_handles, strict=True)}
    assert list(tints)[:3] == ["run", "separatrix", "other polhodes"]
    assert same_color(tints[r"around $\omega_2$"].get_facecolor(), (0.44, 0.63, 0.80))  # type: ignore[union-attr]
    assert same_color(tints[r"around $\omega_1$"].get_facecolor(), (0.93, 0.72, 0.42))  # type: ignore[union-attr]


NEAR, FAR = "#0072B2", "#A6CDE6"
CURVES = [
    ("euler_attitude", "omega", False),
    ("euler_attitude", "omega", True),
]
BODIES = [
    ("euler_attitude", (1.0, 0.0, 0.0), 0.45, [r"$\boldsymbol{e}_1$", r"$\boldsymbol{m}$"]),
    ("lagrange_attitude", (0.0, 0.0, 1.0), 0.93, [r"$\boldsymbol{e}_3$", r"$\boldsymbol{p}$"]),
    ("kowalevski_attitude", (1.0, 0.0, 0.0), 0.5, [r"$\boldsymbol{e}_1$", r"$\boldsymbol{p}$"]),
]
"""Scene, axis of the body, part of the rows that is shown, and names of the axis and the vertical."""


def attitudes(series: dict[str, np.ndarray]) -> Rotation:
    return Rotation.from_quat(np.column_stack([series[f"q{i}"] for i in range(4)]), scalar_first=True)


@pytest.mark.slow
def test_traces_are_the_vectors_of_the_runs(tmp_path: Path) -> None:
    figure = drawn_from("traces", tmp_path)
    for axes, (scene, column, in_space) in zip(figure.axes, CURVES, strict=True):
        series = series_of(tmp_path, scene)
        points = vector(series, column)
        points = attitudes(series).apply(points) if in_space else points
        points = points / np.linalg.norm(points, axis=1).max()
        expected = seen_from(24.0, 32.0, points)
        assert_curve(axes, expected, NEAR, FAR)
        (shadow,) = [line for line in axes.lines if same_color(line.get_color(), "0.87")]
        floor = np.full(len(points), min(0.0, points[:, 2].min() - 0.1))
        below = seen_from(24.0, 32.0, np.column_stack([points[:, :2], floor]))[:, :2]
        np.testing.assert_allclose(data_of(shadow), below, atol=1e-12)
        names = ["$x$", "$y$", "$z$"] if in_space else [rf"$\{column}_{i}$" for i in (1, 2, 3)]
        assert texts_of(axes) == [text for name in names for text in (name, "1")]
        tips = seen_from(24.0, 32.0, np.eye(3))[:, :2] / np.linalg.norm(vector(series, column), axis=1).max()
        ticks = [data_of(line).mean(axis=0) for line in axes.lines if len(line.get_xdata()) == 2]  # at the value 1
        np.testing.assert_allclose(ticks, tips, atol=1e-12)
        ends = [head for _, head in arrows(axes)]
        np.testing.assert_allclose(ends, seen_from(24.0, 32.0, 1.18 * np.eye(3))[:, :2], atol=1e-12)
        shown = np.vstack([expected[:, :2], below, ends])
        for values, (low, high) in zip(shown.T, (axes.get_xlim(), axes.get_ylim()), strict=True):
            assert low < values.min() < values.max() < high


@pytest.mark.slow
def test_bodies_stand_as_the_runs_say(tmp_path: Path) -> None:
    """Only the faces turned to the viewer are drawn."""
    figure = drawn_from("body", tmp_path)
    for axes, (scene, axis, until, names) in zip(figure.axes, BODIES, strict=True):
        turned = attitudes(series_of(tmp_path, scene))
        last = round(until * (len(turned) - 1))
        path = turned.apply(axis)[: last + 1]
        view = 22.0, math.degrees(math.atan2(path[0, 1], path[0, 0])) + 70.0
        expected = seen_from(*view, path)
        assert_curve(axes, np.vstack([expected, expected[-1:]]), NEAR, FAR, -1)
        one = load_experiment(scene)
        body = body_of(one.top, one.y0)
        corners = np.array([seen_from(*view, turned[last].apply(face)) for face in body.faces])
        towards = seen_from(*view, turned[last].apply(body.normals))[:, 2]
        np.testing.assert_allclose(drawn_faces(axes), corners[towards > 0.0][:, :, :2], atol=1e-12)
        assert texts_of(axes) == names


def drawn_faces(axes: Axes) -> np.ndarray:
    """Corners (k, 4, 2) of the faces of the body."""
    (faces,) = [one for one in axes.collections if isinstance(one, PolyCollection)]
    return np.array([path.vertices[:4] for path in faces.get_paths()])


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
