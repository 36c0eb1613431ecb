"""A picture is data: the artists of every figure, against the named columns of the run and formulas of the test."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import same_color

from drawn_artists import data_of, in_sight, keys_are_true, look, series_of
from test_figures import drawn_from
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, Loaded, Request, make_figure
from topcli.figures.picture import Grid, Line, Panel, number_text
from topcli.figures.scenes import scene_figure

GAMMA = [("gamma1", r"$\gamma_1$"), ("gamma2", r"$\gamma_2$"), ("gamma3", r"$\gamma_3$")]
OMEGA = [("omega1", r"$\omega_1$"), ("omega2", r"$\omega_2$"), ("omega3", r"$\omega_3$")]
ENERGY, TWO_L = ("energy", "$E$"), ("two_l", r"$2\ell$")
PANELS: dict[str, list[tuple[str, list[tuple[str, Any]]]]] = {
    "fig1": [(r"$\boldsymbol{\gamma}$", GAMMA), (r"$\boldsymbol{\omega}$", OMEGA)],
    "fig2": [(r"$\boldsymbol{\gamma}$", GAMMA), (r"$\boldsymbol{\omega}$", OMEGA)],
    "fig3": [(r"$E$ − $E$$(0)$, $2\ell$ − $2\ell$$(0)$", [ENERGY, TWO_L])],
    "fig4": [(r"$\boldsymbol{\gamma}$", GAMMA), (r"$\boldsymbol{\omega}$", OMEGA)],
}
"""For each panel of a figure of lines, the label of its vertical axis, and the columns with their labels in order."""
SCENES = {
    "fig1": "kowalevski_hk",
    "fig2": "kowalevski_bohlin_a",
    "fig3": "kowalevski_bohlin_a",
    "fig4": "kowalevski_hybrid",
    "modified": "euler_modified",
}


@pytest.mark.parametrize("name", PANELS)
def test_lines_are_the_named_columns(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the run and, under the same names and in the order of the panels, of the data file beside the picture."""
    figure = drawn_from(name, tmp_path, monkeypatch, ["N=900"])
    series = series_of(tmp_path, SCENES[name])
    beside = pq.read_table(tmp_path / f"{name}.parquet")
    assert beside.column_names == ["t", *(column for _, lines in PANELS[name] for column, _ in lines)]
    for column in beside.column_names:
        np.testing.assert_array_equal(beside.column(column).to_numpy(), series[column])
    for axes, (ylabel, lines) in zip(figure.axes, PANELS[name], strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("$t$", ylabel)
        assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "linear")
        assert axes.get_xlim() == (0.0, series["t"][-1])
        assert keys_are_true(axes)
        for line, (column, label) in zip(axes.lines, lines, strict=True):
            assert line.get_label() == label
            first = series[column][0] if name == "fig3" else 0.0
            np.testing.assert_array_equal(data_of(line), np.column_stack([series["t"], series[column] - first]))
            assert in_sight(axes, line)
    if name == "fig3":
        (inset,) = figure.axes[0].child_axes
        assert inset.get_ylim() == (0.0, 6.0)
        for line, outside, (column, _) in zip(inset.lines, figure.axes[0].lines, lines, strict=True):
            np.testing.assert_array_equal(data_of(line), np.column_stack([series["t"], series[column]]))
            assert look(line) == look(outside)


def test_figures_of_the_paper_say_scheme_step_and_distance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the values of the run that is drawn, also if it is not the paper's."""
    changes = ["N=40", "h=0.025", "scheme=rk4", "initial.gamma=[auto, 0, 2e-7]"]
    for name in ("fig1", "fig3"):
        (tmp_path / name).mkdir()
        figure = drawn_from(name, tmp_path / name, monkeypatch, changes)
        assert figure.get_suptitle() == r"rk4, $h = 0.025$, $\epsilon = \gamma_3(0) = 2\times 10^{-7}$"


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.001, "10^{-3}"), (0.01, "0.01"), (-1e-8, "-10^{-8}"), (2.5e-4, r"2.5\times 10^{-4}"), (3.0, "3"),
     (99999.0, "99999"), (1e5, "10^{5}"), (0.0, "0")],
)  # fmt: skip
def test_numbers_are_written_as_powers_of_ten(value: float, text: str) -> None:
    assert number_text(value) == text


def test_modified_integrals_are_drawn_as_relative_deviations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = drawn_from("modified", tmp_path, monkeypatch, ["N=900"]).axes
    series = series_of(tmp_path, "euler_modified")
    assert (left.get_yscale(), right.get_yscale()) == ("linear", "log")
    assert right.get_ylabel() == "relative deviation"
    assert right.get_ylim()[0] <= 1e-17
    for line, column in zip(left.lines, ("m_sq", "modified_m_sq"), strict=True):
        np.testing.assert_array_equal(data_of(line)[:, 1], series[column])
        assert in_sight(left, line)
    for line, column in zip(right.lines, ("m_sq", "modified_m_sq", "modified_k12"), strict=True):
        first = series[column][0]
        off = np.abs(series[column] - first) / abs(first)
        drawn = data_of(line)[:, 1]
        assert np.isnan(drawn[off == 0.0]).all()
        np.testing.assert_allclose(drawn[off > 0.0], off[off > 0.0], atol=3e-16)
        assert in_sight(right, line)
    assert np.nanmax(data_of(right.lines[0])[:, 1]) > 1e3 * np.nanmax(data_of(right.lines[1])[:, 1])
    for axes in (left, right):
        assert keys_are_true(axes)


def seen_from(elevation: float, azimuth: float, points: np.ndarray) -> np.ndarray:
    """Points (m, 3) as (right, up, towards the viewer): turned about the third axis, then tilted."""
    e, a = math.radians(elevation), math.radians(azimuth)
    x, y, z = points.T
    ahead, right = math.cos(a) * x + math.sin(a) * y, -math.sin(a) * x + math.cos(a) * y
    return np.column_stack([right, math.cos(e) * z - math.sin(e) * ahead, math.sin(e) * z + math.cos(e) * ahead])


SPHERES = {
    "sphere": [
        ("kowalevski_hybrid", "gamma", -55.0, 35.0, ("e_1", "e_2", "e_3"), False),
        ("kowalevski_generic_hk", "gamma", 25.0, 35.0, ("e_1", "e_2", "e_3"), False),
    ],
    "nutation": [(f"lagrange_{name}", "a", 72.0, 0.0, ("", "", "p"), True) for name in ("cusps", "loops", "waves")],
}


def arrows(axes: Axes) -> list[tuple[np.ndarray, np.ndarray]]:
    """Foot and head of every arrow on the axes."""
    return [
        (np.asarray(text.xyann), np.asarray(text.xy))  # type: ignore[attr-defined]
        for text in axes.texts
        if getattr(text, "arrowprops", None) is not None
    ]


@pytest.mark.parametrize("name", SPHERES)
def test_traces_on_the_sphere(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The trace in front and behind, the dot at its start, axes outwards with their names, the band that it fills."""
    figure = drawn_from(name, tmp_path, monkeypatch, ["N=700"])
    for axes, (scene, vector, elevation, azimuth, directions, band) in zip(figure.axes, SPHERES[name], strict=True):
        series = series_of(tmp_path, scene)
        trace = np.column_stack([series[f"{vector}{i}"] for i in (1, 2, 3)])
        flat = seen_from(elevation, azimuth, trace)
        far, near = (line for line in axes.lines if len(np.asarray(line.get_xdata())) == len(trace))
        assert (near.get_zorder() > far.get_zorder(), near.get_linewidth() > far.get_linewidth()) == (True, True)
        front = flat[:, 2] >= 0.0
        assert front.any()
        for line, mask in ((near, front), (far, ~front)):
            np.testing.assert_allclose(data_of(line)[mask], flat[mask, :2], atol=1e-14)
            assert np.isnan(data_of(line)[~mask]).all()
        (dot,) = (line for line in axes.lines if line.get_marker() == "o")
        np.testing.assert_allclose(data_of(dot)[0], flat[0, :2], atol=1e-14)
        assert same_color(dot.get_color(), (near if front[0] else far).get_color())
        named = [text for text in axes.texts if text.get_text()]
        assert [text.get_text() for text in named] == [rf"$\boldsymbol{{{one}}}$" for one in directions if one]
        poles = seen_from(elevation, azimuth, np.eye(3)[[bool(one) for one in directions]])
        for (foot, head), pole, text in zip(arrows(axes), poles, named, strict=True):
            ahead = pole[:2] / np.linalg.norm(pole[:2])
            np.testing.assert_allclose(foot, pole[:2] if pole[2] > 0.0 else ahead, atol=1e-14)
            np.testing.assert_allclose(head / np.linalg.norm(head), ahead, atol=1e-14)
            np.testing.assert_allclose(text.get_position() / np.linalg.norm(text.get_position()), ahead, atol=1e-14)
            assert np.linalg.norm(text.get_position()) > np.linalg.norm(head) > np.linalg.norm(foot)
            # a name lies outside of the sphere, or inside of the band that the trace does not leave
            assert np.linalg.norm(head) > 1.1 or band
        dots = [line for line in axes.lines if line.get_marker() == "."]
        shown = sorted(tuple(point) for line in dots for point in data_of(line))
        seconds = (
            np.flatnonzero(np.abs(series["t"] - np.round(series["t"])) < 1e-9) if scene == "kowalevski_hybrid" else []
        )
        np.testing.assert_allclose(shown, sorted(map(tuple, flat[seconds, :2])), atol=1e-14)
        dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
        heights = [h for h in (trace[:, 2].min(), trace[:, 2].max()) for _ in "nf"] if band else []
        assert len(dashed) == len(heights)
        for line, height in zip(dashed, heights, strict=True):
            middle = math.cos(math.radians(elevation)) * height
            points = data_of(line)[np.isfinite(data_of(line)).all(axis=1)]
            up = (points[:, 1] - middle) / math.sin(math.radians(elevation))
            assert points[:, 0] ** 2 + up**2 == pytest.approx(np.full(len(points), 1.0 - height**2), abs=1e-12)


def test_polhodes_run_the_way_of_the_motion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The run's own curve, arrows along Euler's equations, filled dots at stable rotations and an open one between."""
    (axes,) = drawn_from("polhodes", tmp_path, monkeypatch, ["N=700"]).axes
    series = series_of(tmp_path, "euler_tennis_racket")
    omega = np.column_stack([series[f"omega{i}"] for i in (1, 2, 3)])
    moments = np.array([3.0, 2.0, 1.0])
    flat = seen_from(24.0, 52.0, omega / np.sqrt(omega[0] ** 2 @ moments))
    red = [line for line in axes.lines if same_color(line.get_color(), "#B2182B")]
    drawn = np.where(np.isnan(data_of(red[0])), data_of(red[1]), data_of(red[0]))
    np.testing.assert_allclose(drawn, flat[:, :2], rtol=2e-3, atol=2e-3)
    curves = [arrow for arrow in arrows(axes) if np.linalg.norm(arrow[1] - arrow[0]) < 0.1]
    assert len(curves) > 4
    tests = 0
    for foot, head in curves:
        at = point_on_ellipsoid(foot, moments)
        w1, w2, w3 = at
        a, b, c = moments
        rate = np.array([(b - c) / a * w2 * w3, (c - a) / b * w3 * w1, (a - b) / c * w1 * w2])
        along = seen_from(24.0, 52.0, rate[None])[0, :2]
        cosine = along @ (head - foot) / np.linalg.norm(along) / np.linalg.norm(head - foot)
        assert cosine > 0.99
        tests += 1
    assert tests == len(curves)
    dots = {tuple(np.round(data_of(line)[0], 9)): line for line in axes.lines if line.get_marker() == "o"}
    for i, moment in enumerate(moments):
        tip = np.zeros(3)
        tip[i] = 1.0 / math.sqrt(moment)
        dot = dots.pop(tuple(np.round(seen_from(24.0, 52.0, tip[None])[0, :2], 9)))
        assert same_color(dot.get_markerfacecolor(), "white") == (moment == 2.0)
    assert not dots  # the other ends of the axes are hidden


def point_on_ellipsoid(flat: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """The point of x.Ix = 1 nearest to the eye that is seen at ``flat``."""
    view = np.array([seen_from(24.0, 52.0, row[None])[0] for row in np.eye(3)])  # columns: right, up, towards
    base = view[:, 0] * flat[0] + view[:, 1] * flat[1]
    eye = view[:, 2]
    a, b, c = moments @ eye**2, moments @ (base * eye), moments @ base**2 - 1.0
    return base + (-b + math.sqrt(b * b - a * c)) / a * eye


def test_every_figure_of_the_catalogue_is_inspected() -> None:
    assert set(FIGURES) == {
        *PANELS,
        *SPHERES,
        "modified",
        "polhodes",
        "integrable",
        "period",
        "roundoff",
        "work-precision",
        "compare",
        "stress",
        *("bifurcation", "torus"),  # in test_motion_figures.py
        "order",  # in test_sweep_figures.py
        "error-and-cost",  # in test_integrable_map_figures.py
        "torus-points",
        *("body", "traces"),  # in test_traces.py
        *("swings", "errors", "heavy-drift"),  # in test_sweep_studies.py
    }


def test_another_panel_is_drawn_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of its panels or of the code of its study redraws a figure."""
    monkeypatch.setattr("topcli.figures.figure.save", lambda figure, path: path.touch())
    options: tuple[Any, ...] = (Request(tmp_path / "r", tmp_path), tmp_path, ["png"])
    panels = Panel((Line("gamma1"),)), Panel((Line("gamma2"),))
    first, other = (scene_figure("x", "X", "kowalevski_hk", order, Grid()) for order in (panels, panels[::-1]))
    assert [make_figure(each, *options).status for each in (first, first, other)] == ["drawn", "up to date", "drawn"]
    columns = {"t": np.arange(1.0, 9.0), "y": np.arange(8.0)}

    def status(code: str) -> str:
        loaded = Loaded((Panel((Line("y", "y"),)),), lambda: columns, {"study": code})
        return make_figure(Figure("y", "Y", "none", lambda request: loaded), *options).status

    assert [status(code) for code in "aab"] == ["drawn", "up to date", "drawn"]


def test_the_ellipsoid_is_lit_and_tinted_by_its_formula(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Colour of single points: white at the separatrix, blue or ochre beyond, and light from the upper left."""
    (axes,) = drawn_from("polhodes", tmp_path, monkeypatch, ["N=700"]).axes
    (picture,) = axes.images
    image, half = np.asarray(picture.get_array()), float(picture.get_extent()[1])
    moments = (3.0, 2.0, 1.0)
    eye, right, up = (seen_back(24.0, 52.0, axis) for axis in ((0, 0, 1), (1, 0, 0), (0, 1, 0)))
    towards = -0.45 * right + 0.55 * up + 0.75 * eye
    light = towards / math.sqrt(0.45**2 + 0.55**2 + 0.75**2)
    gloss = (light + eye) / np.linalg.norm(light + eye)
    pixels, compared = len(image), 0
    for row in range(40, pixels, 97):
        for column in range(40, pixels, 89):
            x, y = (2.0 * half * place / (pixels - 1) - half for place in (column, row))
            try:
                point = point_on_ellipsoid(np.array([x, y]), np.array(moments))
            except ValueError:  # beside the ellipsoid
                assert image[row, column, 3] == 0.0
                continue
            normal = point * moments
            size = math.sqrt(normal @ normal)  # m² at 2E = 1, between 1 and 3
            level = size**2 - 2.0
            tint = np.array((0.44, 0.63, 0.80) if level > 0.0 else (0.93, 0.72, 0.42))
            colour = np.array((0.985, 0.975, 0.955)) * (1.0 - abs(level)) + abs(level) * tint
            unit = normal / size
            lit = colour * (0.70 + 0.31 * max(unit @ light, 0.0)) + 0.07 * max(unit @ gloss, 0.0) ** 24
            np.testing.assert_allclose(image[row, column, :3], np.minimum(lit, 1.0), atol=1e-9)
            compared += 1
    assert compared > 20


def seen_back(elevation: float, azimuth: float, screen: tuple[int, int, int]) -> np.ndarray:
    """Direction in space of an axis of the screen (right, up, towards the viewer)."""
    columns = np.array([seen_from(elevation, azimuth, axis[None])[0] for axis in np.eye(3)])
    return columns @ np.array(screen, dtype=float)
