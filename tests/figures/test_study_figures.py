"""Figures of studies: errors and times, points on a torus, period, energies, and views of packaged sweeps."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import topcli
from drawn_artists import SHOWN, data_of, drawn, explained, labelled, seen_from
from sweep_rows import write_rows
from topcli.figures import errors, growth, period, torus
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, Request, make_figure
from topcli.figures.picture import Grid, draw
from topcli.figures.style import looks
from topcli.figures.sweep import Choice, View, sweep_views
from topcli.figures.torus import TorusSection, TorusView
from topcli.runs.identity import method_fingerprint
from topcli.schemes.registry import find_scheme


def test_exact_nodes_are_compared_as_a_scheme_of_their_own() -> None:
    """The last one compared is `backlund` with the option, in a style of its own."""
    backlund, top = find_scheme("backlund", "kowalevski"), errors.problem().top
    compared = errors.compared_schemes()
    assert [one.name for one in compared] == [*errors.OTHERS, *errors.FAMILY, errors.NODES]
    exact = backlund.build(top, backlund.options.model_validate({"nodes": "exact"}))
    built = method_fingerprint(compared[-1].build(top, compared[-1].options()))
    assert built == method_fingerprint(exact) != method_fingerprint(backlund.build(top, backlund.options()))
    styles = [(look["color"], look["marker"]) for look in looks([one.name for one in compared], markers=True).values()]
    assert len(set(styles)) == len(compared)


@pytest.mark.slow
def test_errors_of_the_study_are_those_of_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(errors, "OTHERS", ("hk",))
    monkeypatch.setattr(errors, "FAMILY", ("backlund", "backlund+suzuki4"))
    monkeypatch.setattr(errors, "EFFORT", errors.Effort(budget=0.001, repetitions=3))
    path = tmp_path / errors.FILE
    FIGURES["error-and-cost"].load(Request(tmp_path))
    points = {row["scheme"]: row["points"] for row in json.loads(path.read_text())["schemes"]}
    point = next(one for one in points["hk"] if one["h"] < 0.2)
    count = round(5.0 / point["h"])
    kwargs: dict[str, Any] = {"h": 5.0 / count, "N": 20 * count}
    hk_run = topcli.simulate("kowalevski_generic_hk", **kwargs).states[::count]
    truth = topcli.simulate("kowalevski_generic_hk", scheme="taylor", h=5.0, N=20).states
    assert point["error"] == pytest.approx(float(np.linalg.norm(hk_run - truth, axis=1).max()), rel=1e-9)
    assert all(one["seconds"] > 0.0 for row in points.values() for one in row)
    for name, order in (("backlund", 2.0), ("backlund+suzuki4", 4.0)):
        first, *_, last = [one for one in points[name] if one["error"] < 0.05]
        slope = math.log(first["error"] / last["error"]) / math.log(first["h"] / last["h"])
        assert slope == pytest.approx(order, abs=0.4)
    before = path.stat().st_mtime_ns
    FIGURES["error-and-cost"].load(Request(tmp_path))
    assert path.stat().st_mtime_ns == before
    monkeypatch.setattr(errors, "DURATION", 50.0)
    FIGURES["error-and-cost"].load(Request(tmp_path))
    assert json.loads(path.read_text())["duration"] == 50.0


def test_crossings_lie_on_the_section() -> None:
    """Of a motion in circles, whose cubic through samples 0.1 apart is off by 1e-6."""
    t = np.arange(0.0, 20.0, 0.1)
    zero = np.zeros_like(t)
    states = np.column_stack([np.cos(t), np.sin(t), t, zero, zero, zero])
    rates = np.column_stack([-np.sin(t), np.cos(t), np.ones_like(t), zero, zero, zero])
    found = torus.crossings(states, rates, 0.1)
    expected = np.pi * (np.arange(6) + 0.5)
    np.testing.assert_allclose(found[:, 2], expected, atol=1e-5)
    np.testing.assert_allclose(found[:, :2], np.column_stack([0.0 * expected, np.sin(expected)]), atol=1e-5)


@pytest.mark.slow
def test_points_of_the_map_lie_on_the_torus_and_those_of_hk_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torus, "MAP_POINTS", 30_000)
    monkeypatch.setattr(torus, "FLOW_STEPS", 100_000)
    columns = torus.torus_columns()
    states = topcli.simulate("kowalevski_generic_backlund", N=29_999).states
    np.testing.assert_array_equal(columns["backlund:z"], states[:, 5].astype(np.float32))
    near = states[np.abs(states[:, 0]) < 0.01]
    np.testing.assert_array_equal(columns["backlund:v"], near[:, 4].astype(np.float32))
    assert len(columns["hk:x"]) == 21_499  # then it leaves its energy surface
    flow = np.column_stack([columns["flow:u"], columns["flow:v"]])

    def distances(scheme: str) -> np.ndarray:
        points = np.column_stack([columns[f"{scheme}:u"], columns[f"{scheme}:v"]])
        return np.array([np.min(np.hypot(*(flow - one).T)) for one in points])

    assert distances("backlund").max() < 0.03  # the thickness of the section, and the gaps of the flow's points
    assert np.median(distances("hk")) > 0.2


def test_points_are_drawn_as_they_are_seen() -> None:
    """Far ones first, so that near ones hide them; a map that has left its energy surface says so.

    The last point is hidden by the first, 0.1 nearer to the viewer.
    """
    points = np.array([[0.1, 0.05, 0.02], [1.0, 1.0, 0.5], [-0.5, 1.2, -1.0], [np.nan, 0.0, 0.0]])
    e, a = math.radians(torus.ELEVATION), math.radians(torus.AZIMUTH)
    towards = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    points = np.vstack([points, points[0] - 0.05 * towards * [3.4, 3.8, 3.6]])
    data = {f"backlund:{axis}": column for axis, column in zip("xyz", points.T, strict=True)}
    data |= {"backlund:u": np.array([0.5]), "backlund:v": np.array([0.25])}
    data |= {"flow:u": np.array([1.0, -1.0]), "flow:v": np.array([0.0, 0.5])}
    view, section = draw((TorusView("backlund", "a", 5), TorusSection("backlund", "c")), data).axes
    (spots,) = view.collections
    scaled = (points[:3] + np.array([1.7, 1.9, 1.8])) / [1.7, 1.9, 1.8] - 1.0
    seen = sorted(seen_from(torus.ELEVATION, torus.AZIMUTH, scaled).tolist(), key=lambda point: point[2])
    np.testing.assert_allclose(np.asarray(spots.get_offsets()), np.array(seen)[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.asarray(spots.get_array()), np.array(seen)[:, 2], atol=1e-12)
    darkness = 3.0 - spots.to_rgba(spots.get_array())[:, :3].sum(axis=1)
    assert (np.diff(darkness) > 0.0).all()  # the nearer, the darker
    assert view.get_title(loc="left") == "a, 4 points, then lost"
    assert [data_of(line).tolist() for line in section.lines] == [[[1.0, 0.0], [-1.0, 0.5]], [[0.5, 0.25]]]
    assert all(artist.get_rasterized() for artist in (spots, *section.lines))


@pytest.mark.slow
def test_columns_of_the_period_are_those_of_the_runs() -> None:
    """With few steps: gamma_1 of the rows, the swings of the motion, spacings with the right limits and slope."""
    short = [replace(scheme, exponents=(-2.0, -3.0)) for scheme in period.SCHEMES]
    shown = (("exact", 1e-3), ("bohlin-a", 1e-3))
    progress: list[tuple[int, int]] = []
    columns = period.period_columns(lambda done, total: progress.append((done, total)), short, shown)
    assert progress[-1] == (50_000 + 5 * 55_000, 50_000 + 5 * 55_000)
    assert columns["swings"] == pytest.approx([14.0858, 42.2571], abs=1e-3)
    run = topcli.simulate("kowalevski_bohlin_a")
    np.testing.assert_allclose(columns["gamma1:bohlin-a:0.001"], run["gamma1"][::10], atol=1e-9)
    assert columns["h:hk"].tolist() == [1e-2, 1e-3]
    for name, spacing in (("hk", 28.1722), ("rk2", 28.1699), ("rk4", 28.1714), ("hybrid", 28.1676)):
        assert columns[f"spacing:{name}"][1] == pytest.approx(spacing, abs=2e-4)
    coarse, fine = columns["spacing:bohlin-a"]
    assert fine == pytest.approx(15.2967, abs=1e-3)
    assert fine - coarse == pytest.approx(math.sqrt(2.0) * math.log(10.0), rel=0.01)


def test_energies_are_the_largest_deviations_of_the_runs_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the formula of the energy, for one scheme of each scene; the control drifts."""
    monkeypatch.setattr(growth, "ENERGY_STEPS", 1 << 10)
    columns = growth.energy_columns()
    y = topcli.simulate("kowalevski_generic_hk", scheme="splitting", h=0.05, N=1024).states
    energy = y[:, 0] ** 2 + y[:, 1] ** 2 + 0.5 * y[:, 2] ** 2 + y[:, 3]
    off = np.abs(energy - energy[0]) / (0.49 + 0.16 + 0.5 * 1.69 + 0.6)
    steps = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 16, 18, 20, 23, 25, 29, 32]
    assert (columns["t:euler_hk"] / 0.05)[:20] == pytest.approx(steps, rel=1e-12)
    assert columns["t:euler_hk"][-1] == pytest.approx(0.05 * 1024, rel=1e-12)
    largest = [off[: round(t / 0.05) + 1].max() for t in columns["t:kowalevski_generic_hk"]]
    np.testing.assert_allclose(columns["kowalevski_generic_hk:splitting"], largest, rtol=1e-9)
    assert np.nanmax(columns["euler_hk:dmv"]) < 1e-13
    assert columns["euler_hk:splitting"].max() > 1e-5
    assert columns["euler_hk:rk4"][-1] > 2.0 * columns["euler_hk:rk4"][-13]


SWEEP = """
name: small
base: {top: euler, initial: {omega: [0.7, -0.4, 1.3]}, T: 2}
grid: {scheme: [hk, rk2], h: [0.2, 0.1, 0.05], top.A: [3.0, 2.5]}
measure: [max_error, max_deviation.m_sq]
"""


VIEWS = (
    View(
        "upper",
        Choice("h", "max_error", "scheme"),
        ("top.A=2.5",),
        "$h$",
        "error",
        xlog=True,
        law=np.square,
        law_label="law",
    ),
    View("lower", Choice("top.A", "max_deviation.m_sq", "scheme", aggregate="max"), ("scheme=hk",)),
    View("same", Choice("top.A", "max_deviation.m_sq", "scheme", aggregate="max"), ("scheme=hk",), xlog=True),
)


@pytest.fixture
def figure(tmp_path: Path) -> Figure:
    """Figure of a small sweep."""
    path = tmp_path / "small.yaml"
    path.write_text(SWEEP, encoding="utf-8")
    return sweep_views("small", "a small sweep", str(path), VIEWS, Grid())


def test_views_draw_their_rows(figure: Figure, tmp_path: Path) -> None:
    """And run no others; progress counts those that are run."""
    progress: list[tuple[int, int]] = []
    loaded = figure.load(Request(tmp_path / "results", on_progress=lambda *parts: progress.append(parts)))
    picture = drawn(loaded)
    rows = pq.read_table(tmp_path / "results" / "small" / "rows.parquet").to_pylist()
    for row in rows:
        seen = row["top.A"] == 2.5 or row["scheme"] == "hk"
        assert (row["outcome"] == "completed", row["max_error"] is not None) == (seen, seen)
    assert sorted(progress)[-1] == (9, 9)
    left, right, same = picture.axes
    assert (left.get_xlabel(), left.get_ylabel(), right.get_xlabel()) == ("$h$", "error", "top.A")
    assert [axes.get_title(loc="left") for axes in picture.axes] == ["(a) upper", "(b) lower", "(c) same"]
    assert [axes.get_xscale() for axes in picture.axes] == ["log", "linear", "log"]  # asked for, in the last
    shown = labelled(left)
    for scheme in ("hk", "rk2"):
        expected = {row["h"]: row["max_error"] for row in rows if row["scheme"] == scheme and row["top.A"] == 2.5}
        assert dict(data_of(shown[scheme]).tolist()) == expected
        assert len(set(expected.values())) == 3
    assert data_of(shown["law"]).tolist() == [[x, x * x] for x in (0.05, 0.1, 0.2)]
    assert data_of(labelled(same)["hk"]).tolist() == data_of(labelled(right)["hk"]).tolist()
    for A, value in data_of(labelled(right)["hk"]).tolist():
        over_h = [row["max_deviation.m_sq"] for row in rows if row["scheme"] == "hk" and row["top.A"] == A]
        assert len(over_h) == 3
        assert value == max(over_h)


@pytest.mark.slow
def test_a_second_request_runs_and_draws_nothing(figure: Figure, tmp_path: Path) -> None:
    request = Request(tmp_path / "results")
    assert make_figure(figure, request, tmp_path / "figures", ["png"]).status == "drawn"
    journal = (tmp_path / "results" / "small" / "journal.jsonl").read_bytes()
    assert make_figure(figure, request, tmp_path / "figures", ["png"]).status == "up to date"
    assert (tmp_path / "results" / "small" / "journal.jsonl").read_bytes() == journal


def test_the_random_tops_are_drawn_by_medians_and_quartiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the heading says, and not by means or by the largest of the hundred, which differ from them here.

    Magnitudes of drifts are drawn; the markers show the signs between their quartiles.
    """
    schemes, seeds = ("hk", "rk4", "splitting"), range(1, 6)
    rows = [(scheme, seed) for scheme in schemes for seed in seeds]
    sizes = {row: 1e-6 * 10.0 ** (2 * schemes.index(row[0])) * row[1] ** 3 for row in rows}
    sign = {"hk": lambda seed: (-1.0) ** seed, "rk4": lambda seed: 1.0, "splitting": lambda seed: -1.0}
    signed = {row: sign[row[0]](row[1]) * size for row, size in sizes.items()}
    keys = {"scheme": [scheme for scheme, _ in rows], "random": [seed for _, seed in rows]}
    measures = {"max_deviation.energy": list(sizes.values()), "drift.energy": list(signed.values())}
    folder = write_rows(tmp_path / "heavy_drift", keys, measures)
    result = SimpleNamespace(folder=folder, outcomes={"completed": len(rows)})
    monkeypatch.setattr("topcli.sweeps.run.run_sweep", lambda *arguments, **options: result)
    loaded = FIGURES["heavy-drift"].load(Request(tmp_path))
    picture = drawn(loaded)
    assert "medians and quartiles" in picture.get_suptitle()
    labels = ["deviation of the energy $E$", "|drift| of $E$ per unit of time"]
    markers = {"o": "both signs", "^": "positive", "v": "negative"}
    assert {text: line.get_marker() for text, line in explained(picture).items()} == {v: k for k, v in markers.items()}
    for axes, label in zip(picture.axes, labels, strict=True):
        assert axes.get_ylabel() == label
        assert [tick.get_text() for tick in axes.get_xticklabels()] == ["HK", "RK4", "splitting"]
        assert axes.get_xlim() == (-0.5, 2.5)
        lines = [one for one in axes.lines if one.get_marker() in markers and len(np.asarray(one.get_xdata()))]
        drawn_points = [(*point, one.get_marker()) for one in lines for point in data_of(one).tolist()]
        bars = [segment for one in axes.collections for segment in one.get_segments()]  # type: ignore[attr-defined]
        for i, scheme in enumerate(schemes):
            ordered = sorted(sizes[scheme, seed] for seed in seeds)
            (point,) = (one for one in drawn_points if one[0] == i)
            assert point[1] == pytest.approx(ordered[2], rel=1e-12)
            assert point[2] == ("o" if axes is picture.axes[0] else list(markers)[i])
            (bar,) = (bar for bar in bars if bar[0][0] == i)
            assert (bar[0][1], bar[1][1]) == pytest.approx((ordered[1], ordered[3]), rel=1e-12)


def test_names_at_the_ends_have_the_slopes_of_their_panel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of most schemes in both panels, of rk4 in the first alone, of neither for a scheme that chooses its own steps."""
    drawn_schemes = ["hk", "bohlin-a", "hybrid", "hk-projected", "splitting", "backlund", "rk4", "taylor"]
    rows = [(scheme, 0.1 * 2.0**-k) for scheme in drawn_schemes for k in range(8)]
    keys = {"scheme": [scheme for scheme, _ in rows], "h": [h for _, h in rows]}
    measures = {
        "max_error": [h**2 if scheme != "rk4" else h**3 for scheme, h in rows],
        "max_deviation.energy": [h**4 if scheme != "rk4" else 1e-15 for scheme, h in rows],
    }
    folder = write_rows(tmp_path / "kowalevski_errors", keys, measures, log=["h"])
    result = SimpleNamespace(folder=folder, outcomes={"completed": len(rows)})
    monkeypatch.setattr("topcli.sweeps.run.run_sweep", lambda *arguments, **options: result)
    picture = drawn(FIGURES["errors"].load(Request(tmp_path)))
    for axes, slope, own in zip(picture.axes, (": 2.00", ": 4.00"), (": 3.00", ""), strict=True):
        slopes = dict.fromkeys(drawn_schemes, slope) | {"rk4": own, "taylor": ""}
        assert {text.get_text() for text in axes.texts} == {f"{SHOWN.get(k, k)}{v}" for k, v in slopes.items()}
    assert list(explained(picture)) == ["round-off"]
