"""The figures of runs with an attitude: curves and bodies against the columns of the runs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import same_color
from scipy.spatial.transform import Rotation

from test_drawn_artists import data_of, seen_from, series_of
from test_figures import drawn_from
from topcli.config.load import load_experiment
from topcli.figures.body import body_of

SHORT = {scene: ["N=300"] for scene in ("euler_attitude", "lagrange_attitude", "kowalevski_attitude")}
CURVES = [
    ("euler_attitude", "omega", False),
    ("euler_attitude", "omega", True),
    ("kowalevski_attitude", "gamma", False),
    ("kowalevski_attitude", "omega", True),
]
AXES = {"euler_attitude": (1.0, 0.0, 0.0), "lagrange_attitude": (0.0, 0.0, 1.0), "kowalevski_attitude": (1.0, 0.0, 0.0)}
STOPS = {"euler_attitude": 0.45, "lagrange_attitude": 0.93, "kowalevski_attitude": 0.5}


def attitudes(series: dict[str, np.ndarray]) -> Rotation:
    return Rotation.from_quat(np.column_stack([series[f"q{i}"] for i in range(4)]), scalar_first=True)


def whole(axes: Axes, near: str, far: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (m, 2) of the curve that is drawn as a near and a far line, and where it is near."""
    lines = {colour: line for colour in (near, far) for line in axes.lines if same_color(line.get_color(), colour)}
    points, others = data_of(lines[near]), data_of(lines[far])
    seen = np.isfinite(points).all(axis=1)
    assert (seen ^ np.isfinite(others).all(axis=1)).all()
    assert lines[near].get_zorder() > lines[far].get_zorder()
    return np.where(seen[:, None], points, others), seen


@pytest.mark.slow
def test_traces_are_the_vectors_of_the_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = drawn_from("traces", tmp_path, monkeypatch, SHORT)
    for axes, (scene, vector, in_space) in zip(figure.axes, CURVES, strict=True):
        series = series_of(tmp_path, scene)
        points = np.column_stack([series[f"{vector}{i}"] for i in (1, 2, 3)])
        if in_space:
            points = attitudes(series).apply(points)
        points = points / np.linalg.norm(points, axis=1).max()
        expected = seen_from(24.0, 32.0, points)
        drawn, near = whole(axes, "#0072B2", "#A6CDE6")
        np.testing.assert_allclose(drawn, expected[:, :2], atol=1e-12)
        np.testing.assert_array_equal(near, expected[:, 2] >= 0.0)
        (start,) = [line for line in axes.lines if line.get_marker() == "o"]
        np.testing.assert_allclose(data_of(start)[0], expected[0, :2], atol=1e-12)
        (shadow,) = [line for line in axes.lines if same_color(line.get_color(), "0.80")]
        floor = min(0.0, points[:, 2].min() - 0.1)
        below = seen_from(24.0, 32.0, np.column_stack([points[:, :2], np.full(len(points), floor)]))
        np.testing.assert_allclose(data_of(shadow), below[:, :2], atol=1e-12)
        names = [text.get_text() for text in axes.texts if text.get_text()]
        assert names == (["$x$", "$y$", "$z$"] if in_space else [rf"$\{vector}_{i}$" for i in (1, 2, 3)])
        ends = [np.asarray(text.xy) for text in axes.texts if getattr(text, "arrowprops", None)]  # type: ignore[attr-defined]
        np.testing.assert_allclose(ends, seen_from(24.0, 32.0, 1.18 * np.eye(3))[:, :2], atol=1e-12)
        low, high = axes.get_xlim(), axes.get_ylim()
        for x, y in (*drawn, *below[:, :2], *ends):
            assert low[0] < x < low[1]
            assert high[0] < y < high[1]


def test_herpolhode_lies_in_a_plane_normal_to_the_momentum(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """omega in space: its height over m is the energy divided by |m| (Poinsot)."""
    figure = drawn_from("traces", tmp_path, monkeypatch, SHORT)
    series = series_of(tmp_path, "euler_attitude")
    omega = np.array([0.35, 0.3, 1.0])
    m = np.array([3.0, 2.0, 1.0]) * omega
    height = (m @ omega) / math.sqrt(m @ m)
    size = np.sqrt(sum(series[f"omega{i}"] ** 2 for i in (1, 2, 3)).max())
    drawn, _ = whole(figure.axes[1], "#0072B2", "#A6CDE6")
    (shadow,) = [line for line in figure.axes[1].lines if same_color(line.get_color(), "0.80")]
    up = (drawn - data_of(shadow))[:, 1] / math.cos(math.radians(24.0))
    np.testing.assert_allclose(up, height / size, atol=1e-12)


@pytest.mark.slow
def test_bodies_stand_as_the_runs_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = drawn_from("body", tmp_path, monkeypatch, SHORT)
    for axes, (scene, axis) in zip(figure.axes, AXES.items(), strict=True):
        turned = attitudes(series_of(tmp_path, scene))
        last = round(STOPS[scene] * 300)
        path = turned.apply(axis)[: last + 1]
        azimuth = math.degrees(math.atan2(path[0, 1], path[0, 0])) + 70.0
        expected = seen_from(22.0, azimuth, path)
        drawn, near = whole(axes, "#0072B2", "#A6CDE6")
        np.testing.assert_allclose(drawn, np.vstack([expected, expected[-1:]])[:, :2], atol=1e-12)
        np.testing.assert_array_equal(near[:-1], expected[:, 2] >= 0.0)
        (dot,) = [line for line in axes.lines if line.get_marker() == "o"]
        np.testing.assert_allclose(data_of(dot)[0], expected[-1, :2], atol=1e-12)
        one = load_experiment(scene)
        body = body_of(one.top, one.y0)
        corners = np.array([seen_from(22.0, azimuth, turned[last].apply(face)) for face in body.faces])
        towards = seen_from(22.0, azimuth, turned[last].apply(body.normals))[:, 2]
        np.testing.assert_allclose(drawn_faces(axes), corners[towards > 0.0][:, :, :2], atol=1e-12)
    labels = [[text.get_text() for text in axes.texts if text.get_text()] for axes in figure.axes]
    assert labels == [
        [r"$\boldsymbol{e}_1$", r"$\boldsymbol{m}$"],
        [r"$\boldsymbol{e}_3$", r"$\boldsymbol{p}$"],
        [r"$\boldsymbol{e}_1$", r"$\boldsymbol{p}$"],
    ]


def drawn_faces(axes: Axes) -> np.ndarray:
    """Corners (k, 4, 2) of the faces of the body."""
    (faces,) = [one for one in axes.collections if isinstance(one, PolyCollection)]
    return np.array([path.vertices[:4] for path in faces.get_paths()])


def test_a_changed_scene_names_its_panels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changes = {**SHORT, "lagrange_attitude": ["N=300", "top.C=0.6", "name=wide"]}
    titles = [axes.get_title() for axes in drawn_from("body", tmp_path, monkeypatch, changes).axes]
    assert titles == ["(a) Euler", "wide", "(c) Kowalevski"]
