"""A picture is data: the artists of every figure, against the named columns of the run and formulas of the test."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import same_color, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from test_figures import drawn_from
from topcli.figures.analysis import loaded_analysis
from topcli.figures.catalogue import FIGURES
from topcli.figures.comparison import loaded_comparison
from topcli.figures.contract import Loaded, Request
from topcli.figures.make import make_figure, write_figure
from topcli.figures.picture import draw
from topcli.studies.analyse import Analysis
from topcli.studies.compare import Comparison
from topcli.tops.euler import Euler

GAMMA = [("gamma1", r"$\gamma_1$"), ("gamma2", r"$\gamma_2$"), ("gamma3", r"$\gamma_3$")]
OMEGA = [("omega1", r"$\omega_1$"), ("omega2", r"$\omega_2$"), ("omega3", r"$\omega_3$")]
ENERGY, TWO_L = ("energy", "$E$"), ("two_l", r"$2\ell$")
PANELS: dict[str, list[tuple[str, list[tuple[str, Any]]]]] = {
    "fig1": [(r"$\boldsymbol{\gamma}$", GAMMA), (r"$\boldsymbol{\omega}$", OMEGA)],
    "fig2": [(r"$\boldsymbol{\gamma}$", GAMMA), (r"$\boldsymbol{\omega}$", OMEGA)],
    "fig3": [(r"$E$, $2\ell$", [ENERGY, TWO_L]), ("$E$", [ENERGY])],
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


def drawn(loaded: Loaded) -> Figure:
    """The figure of what a figure of the catalogue loads."""
    return draw(loaded.panels, loaded.data(), loaded.layout)


def series_of(folder: Path, scene: str) -> dict[str, np.ndarray]:
    """The columns of a run, read without the help of topcli."""
    table = pq.read_table(folder / "r" / scene / "series.parquet")
    return {name: table.column(name).to_numpy() for name in table.column_names}


def data_of(line: Line2D) -> np.ndarray:
    """The points (m, 2) of a line."""
    return np.column_stack([np.asarray(line.get_xdata(), dtype=float), np.asarray(line.get_ydata(), dtype=float)])


def look(line: Line2D) -> tuple[Any, ...]:
    """Features by which a reader identifies a line."""
    return to_rgb(line.get_color()), line.get_linestyle()


def in_sight(axes: Axes, line: Line2D) -> bool:
    """True if no point of the line lies outside the axes' limits."""
    points = data_of(line)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = sorted(axes.get_xlim()), sorted(axes.get_ylim())
    inside = [(points[:, i] >= limit[0]) & (points[:, i] <= limit[1]) for i, limit in enumerate((low, high))]
    return bool(len(points) and np.all(inside))


def keys_are_true(axes: Axes) -> bool:
    """True if the legend explains each line by a line that looks like it, and no two lines look alike."""
    legend = axes.get_legend()
    assert legend is not None
    shown = {text.get_text(): look(handle) for text, handle in zip(legend.get_texts(), legend.get_lines(), strict=True)}
    assert shown == {str(line.get_label()): look(line) for line in axes.lines}
    return len(set(shown.values())) == len(shown)


@pytest.mark.parametrize("name", PANELS)
def test_lines_are_the_named_columns(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = drawn_from(name, tmp_path, monkeypatch, ["N=900"])
    series = series_of(tmp_path, SCENES[name])
    for axes, (ylabel, lines) in zip(figure.axes, PANELS[name], strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("$t$", ylabel)
        assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "linear")
        assert axes.get_xlim() == (0.0, series["t"][-1])
        assert keys_are_true(axes)
        for line, (column, label) in zip(axes.lines, lines, strict=True):
            assert line.get_label() == label
            np.testing.assert_array_equal(data_of(line), np.column_stack([series["t"], series[column]]))
            assert in_sight(axes, line)
    if name == "fig3":
        low, high = figure.axes[0].get_ylim()
        assert (low, high) == (0.0, 6.0)


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
        ("kowalevski_hybrid", "gamma", 48.0, -35.0, r"$\boldsymbol{e_3}$", False),
        ("kowalevski_generic_hk", "gamma", 48.0, -35.0, r"$\boldsymbol{e_3}$", False),
    ],
    "nutation": [
        (f"lagrange_{name}", "a", 50.0, 0.0, r"$\boldsymbol{p}$", True) for name in ("cusps", "loops", "waves")
    ],
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
    """The trace in front and behind, the dot at its start, the arrow outwards from the pole, the band it fills."""
    figure = drawn_from(name, tmp_path, monkeypatch, ["N=700"])
    for axes, (scene, vector, elevation, azimuth, axis, band) in zip(figure.axes, SPHERES[name], strict=True):
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
        ((foot, head),) = arrows(axes)
        pole = seen_from(elevation, azimuth, np.array([[0.0, 0.0, 1.0]]))[0, :2]
        np.testing.assert_allclose(foot, pole, atol=1e-14)
        np.testing.assert_allclose(head / np.linalg.norm(head), pole / np.linalg.norm(pole), atol=1e-14)
        assert np.linalg.norm(head) > 1.3 * np.linalg.norm(pole)
        assert [text.get_text() for text in axes.texts if text.get_text()] == [axis]
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


GROWTH = [
    [("a_sq:matrix", "matrix"), ("a_sq:plain", "old + change"), ("a_sq:compensated", "compensated")],
    [("k_sq:hybrid", r"$\xi$ recomputed"), ("k_sq:hybrid-xi", r"$\xi$ carried")],
]


def test_growth_is_drawn_with_its_labels_at_the_ends() -> None:
    steps = 2.0 ** np.arange(4, 16)
    sizes = {"a_sq:matrix": 1e-15, "a_sq:plain": 3e-16, "a_sq:compensated": 2e-17}
    sizes |= {"k_sq:hybrid": 1e-14, "k_sq:hybrid-xi": 5e-16}
    data = {"steps": steps} | {name: size * steps ** (0.3 + 0.1 * i) for i, (name, size) in enumerate(sizes.items())}
    figure = draw(FIGURES["roundoff"].panels, data)  # type: ignore[attr-defined]
    for axes, lines in zip(figure.axes, GROWTH, strict=True):
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        labels = {text.get_text(): text for text in axes.texts}
        own = [line for line in axes.lines if line.get_marker() == "o"]
        assert len({to_rgb(line.get_color()) for line in own}) == len(lines)
        for line, (column, label) in zip(own, lines, strict=True):
            np.testing.assert_array_equal(data_of(line), np.column_stack([steps, data[column]]))
            assert in_sight(axes, line)
            assert same_color(labels[label].get_color(), line.get_color())
        heights = [labels[label].xy[1] for _, label in sorted(lines, key=lambda one: data[one[0]][-1])]  # type: ignore[attr-defined]
        assert heights == sorted(heights)
        root, linear = (data_of(line) for line in axes.lines if line.get_marker() != "o")
        np.testing.assert_allclose(root[:, 1], 2.0**-52 * np.sqrt(steps), rtol=1e-12)
        np.testing.assert_allclose(linear[:, 1], root[0, 1] * steps / steps[0], rtol=1e-12)


def test_energies_are_drawn_logarithmically_against_time(tmp_path: Path) -> None:
    loaded = FIGURES["integrable"].load(Request(tmp_path, tmp_path))
    times = 0.1 * 2.0 ** np.arange(20)
    names = [column for panel in loaded.panels for column in panel.columns]
    data = {name: times if name.startswith("t:") else 1e-9 * (i + 1.0) * times for i, name in enumerate(names)}
    figure = draw(loaded.panels, data, loaded.layout)
    scenes = ("kowalevski_generic_hk", "euler_hk")
    drawn = {"kowalevski_generic_hk": ["splitting", "dmv", "hk", "midpoint4", "rk4"]}
    drawn["euler_hk"] = ["splitting", "dmv", "hk", "midpoint", "rk4"]
    colours: dict[str, Any] = {}
    for axes, scene in zip(figure.axes, scenes, strict=True):
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert [line.get_label() for line in axes.lines] == drawn[scene]
        for line in axes.lines:
            np.testing.assert_array_equal(data_of(line), np.column_stack([times, data[f"{scene}:{line.get_label()}"]]))
            assert in_sight(axes, line)
            assert same_color(colours.setdefault(str(line.get_label()), line.get_color()), line.get_color())
    assert len({to_rgb(colour) for colour in colours.values()}) == len(colours)


def bench_report(name: str, errors: dict[str, list[float]]) -> dict[str, Any]:
    """A result of ``topcli bench``: time 2e-6/error^(1/4) for the first competitor, 3e-6 for the next, ...

    Each has two points more that are not to be drawn: an error above 1, and a point beaten by another in both.
    """

    def point(error: float, seconds: float) -> dict[str, Any]:
        found = {"value": 0.1, "error": error, "end_error": error / 7.0, "seconds": seconds, "drift": 0.0}
        return {**found, "quartiles": [1.0, 2.0], "invariants": {}}

    return {
        "name": name,
        "title": name.title(),
        "competitors": [
            {
                "name": competitor,
                "kind": "peer" if competitor.startswith("peer") else "topcli",
                "parameter": "h",
                "points": [point(error, (2.0 + i) * 1e-6 * error**-0.25) for error in values]
                + [point(3.0, 1e-9), point(max(values) / 2.0, 1.0)],
            }
            for i, (competitor, values) in enumerate(errors.items())
        ],
    }


def test_work_and_precision_are_drawn_in_microseconds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A curve of each competitor with its name at the end, in its colour; a scheme has one colour in all panels."""
    errors = {"hk": [1e-1, 1e-3, 1e-5], "rk4": [1e-2, 1e-6, 1e-9], "peer one": [3e-2, 1e-7]}
    reports = [bench_report("euler", errors), bench_report("lagrange", dict(reversed(errors.items())))]

    class Run:
        manifest: dict[str, str] = dict.fromkeys(("name", "digest", "code", "ended"), "")

    monkeypatch.setattr("topcli.studies.bench.stored.stored_benches", lambda out: [(Run, one) for one in reports])
    figure = drawn(FIGURES["work-precision"].load(Request(tmp_path)))
    colours: dict[str, Any] = {}
    for axes in figure.axes:
        report = next(one for one in reports if one["title"] == axes.get_title(loc="left"))
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert axes.get_xlim()[0] > axes.get_xlim()[1]  # better to the right
        assert "µs" in axes.get_ylabel()
        by_end = {tuple(data_of(line)[-1]): line for line in axes.lines}
        for competitor in report["competitors"]:
            points = [(point["error"], 1e6 * point["seconds"]) for point in competitor["points"][:-2]]
            line = next(line for end, line in by_end.items() if end == pytest.approx(points[-1], rel=1e-12))
            np.testing.assert_allclose(data_of(line), points, rtol=1e-12)
            assert in_sight(axes, line)
            text = next(text for text in axes.texts if text.get_text() == competitor["name"])
            assert text.xy[0] == pytest.approx(points[-1][0])  # type: ignore[attr-defined]
            if competitor["kind"] == "topcli":
                assert same_color(text.get_color(), line.get_color())
                assert colours.setdefault(competitor["name"], line.get_color()) == line.get_color()
            else:
                assert to_rgb(line.get_color())[0] == to_rgb(line.get_color())[2]  # grey
    assert len(set(colours.values())) == len(colours) == 2


def test_a_comparison_draws_errors_and_swings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Figure] = []

    def capture(figure: Figure, path: Path) -> None:
        seen.append(figure)
        path.touch()

    monkeypatch.setattr("topcli.figures.make.save", capture)
    t = np.linspace(0.0, 7.0, 50)
    series = {"t": t, "swing:reference": np.cos(t)}
    for i, name in enumerate(("hk", "rk4", "bs")):
        series[f"error:{name}"] = 10.0 ** (-i) * t
        series[f"swing:{name}"] = np.cos(t + i)
    figures = {"schemes": [{"label": name} for name in ("hk", "rk4", "bs")], "reference": {"swing": "gamma1"}}
    write_figure("compare", loaded_comparison(Comparison({**figures, "config": {}}, series)), tmp_path)
    left, right = seen[0].axes
    assert (left.get_yscale(), right.get_yscale()) == ("log", "linear")
    assert (left.get_ylabel(), right.get_ylabel()) == ("error of the state", r"$\gamma_1$")
    for axes, kind, names in ((left, "error", ("hk", "rk4", "bs")), (right, "swing", ("reference", "hk", "rk4", "bs"))):
        for line, name in zip(axes.lines, names, strict=True):
            assert line.get_label() == name
            expected = series[f"{kind}:{name}"]
            drawn = data_of(line)[:, 1]
            assert np.isnan(drawn[expected == 0.0]).all()
            np.testing.assert_array_equal(drawn[expected != 0.0], expected[expected != 0.0])
            assert in_sight(axes, line)
    (legend,) = seen[0].legends
    shown = {text.get_text(): look(line) for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)}
    assert shown == {str(line.get_label()): look(line) for line in right.lines}
    assert all(look(line) == shown[str(line.get_label())] for line in left.lines)
    assert len(set(shown.values())) == 4


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_an_analysis_draws_errors_swings_and_deviations(reference: bool, direction: float) -> None:
    """m² never moves here, and a logarithmic axis has no zero: it has no line."""
    t = direction * np.linspace(3.0, 7.0, 50)
    series = {"t": t, "swing": np.cos(t), "deviation:m_sq": np.zeros(50), "deviation:m_omega": 1e-6 * np.abs(t - t[0])}
    if reference:
        series |= {"error": 1e-4 * np.abs(t - t[0]), "swing:reference": np.cos(1.01 * t)}
    figure = drawn(loaded_analysis(Analysis({"config": {}, "file": "x.csv", "sha256": ""}, series), Euler()))
    error = [("error of the state", "log", [("error", "series")])]
    swing = [("swing:reference", "reference")] if reference else []
    panels = [
        *(error if reference else []),
        (r"$\omega_2$", "linear", [*swing, ("swing", "series")]),
        ("deviation of the invariants", "log", [("deviation:m_omega", r"$\boldsymbol{m}\cdot\boldsymbol{\omega}$")]),
    ]
    looks = {}
    for axes, (ylabel, scale, lines) in zip(figure.axes, panels, strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_yscale()) == ("$t$", ylabel, scale)
        assert axes.get_xlim() == (t.min(), t.max())
        for line, (column, label) in zip(axes.lines, lines, strict=True):
            assert line.get_label() == label
            looks.setdefault(label, look(line))
            assert looks[label] == look(line)
            expected = series[column] if scale == "linear" else np.where(series[column] > 0.0, series[column], np.nan)
            np.testing.assert_array_equal(data_of(line), np.column_stack([t, expected]))
            assert in_sight(axes, line)
        if not reference:
            assert keys_are_true(axes)
    if reference:
        (legend,) = figure.legends
        shown = {text.get_text(): look(one) for text, one in zip(legend.get_texts(), legend.get_lines(), strict=True)}
        assert shown == looks
        assert len(set(looks.values())) == len(looks)


def test_the_grid_of_hard_cases_has_each_outcome_in_its_cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes = {
        ("hk", "a"): ("held", None, "ok"),
        ("hk", "b"): ("degraded", None, "ok"),
        ("rk4", "a"): ("broke", 37, "limit"),
        ("rk4", "b"): ("broke", 40_000, "unexplained"),
        ("bs", "a"): ("broke", 25_000, "limit"),
        ("bs", "b"): ("not tried", None, "ok"),
    }
    trials = [
        {"top": "euler", "scheme": scheme, "case": case, "outcome": outcome, "step": step, "verdict": verdict}
        for (scheme, case), (outcome, step, verdict) in outcomes.items()
    ]
    monkeypatch.setattr("topcli.figures.stress._study", lambda request: ({"trials": trials}, ""))
    figure = drawn(FIGURES["stress"].load(Request(tmp_path)))
    (axes,) = figure.axes
    assert axes.get_xlabel() == "euler"
    schemes = [tick.get_text() for tick in axes.get_xticklabels()]
    cases = [tick.get_text() for tick in axes.get_yticklabels()]
    (image,) = axes.images
    shades = image.cmap(image.norm(np.asarray(image.get_array())))
    (legend,) = figure.legends
    meaning = {text.get_text().split(" ")[0].rstrip(":,"): patch for text, patch in
               zip(legend.get_texts(), legend.get_patches(), strict=True)}  # fmt: skip
    keys = {"held": "held", "degraded": "degraded", "broke": "broke", "not tried": "not"}
    texts = {(round(x), round(y)): text.get_text() for text in axes.texts for x, y in [text.get_position()]}
    for (scheme, case), (outcome, _, _) in outcomes.items():
        column, row = schemes.index(scheme), cases.index(case)
        assert same_color(tuple(shades[row, column]), meaning[keys[outcome]].get_facecolor())
        assert ((column, row) in texts) == (outcome == "broke")
    order = ("not", "held", "degraded", "broke")
    darkness = [3.0 - sum(meaning[name].get_facecolor()[:3]) for name in order]
    assert darkness == sorted(darkness)
    assert texts[schemes.index("rk4"), cases.index("a")] == "37"
    assert texts[schemes.index("rk4"), cases.index("b")] == "!"
    assert texts[schemes.index("bs"), cases.index("a")] == "$10^{4}$"


def test_every_figure_of_the_catalogue_is_inspected() -> None:
    assert set(FIGURES) == {
        *PANELS,
        *SPHERES,
        "modified",
        "polhodes",
        "integrable",
        "roundoff",
        "work-precision",
        "compare",
        "stress",
        "order",  # in test_sweep_figures.py
        *("body", "traces"),  # in test_traces.py
        *("swings", "errors", "heavy-drift"),  # in test_sweep_studies.py
    }


def test_another_panel_is_drawn_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A change of its panels or of the code of its study redraws a figure."""
    from dataclasses import replace

    monkeypatch.setattr("topcli.figures.make.save", lambda figure, path: path.touch())
    options: tuple[Any, ...] = (Request(tmp_path / "r", tmp_path), tmp_path, ["png"])
    spec: Any = FIGURES["fig3"]
    first, second = spec.panels
    states = [make_figure(one, *options).status for one in (spec, spec, replace(spec, panels=(second, first)))]
    assert states == ["drawn", "up to date", "drawn"]
    spec = FIGURES["roundoff"]
    code = ["a"]
    columns = {name: np.arange(1.0, 9.0) for panel in spec.panels for name in panel.columns}
    monkeypatch.setattr("topcli.studies.growth.growth_columns", lambda: columns)
    monkeypatch.setattr("topcli.studies.growth.growth_code", lambda: code[0])
    assert [make_figure(spec, *options).status for _ in range(2)] == ["drawn", "up to date"]
    code[0] = "b"
    assert make_figure(spec, *options).status == "drawn"


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
