"""The figures of the integrable map: errors over step and time, and points on the torus."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import topcli
from topcli.errors import UsageError
from topcli.figures import errors as error_and_cost
from topcli.figures import torus_points
from topcli.figures.catalogue import FIGURES
from topcli.figures.errors import loaded_study
from topcli.figures.figure import Request
from topcli.figures.picture import draw, looks
from topcli.figures.torus_points import TorusSection, TorusView
from topcli.runs.identity import method_fingerprint
from topcli.schemes.registry import find_scheme
from topcli.studies.entries import scheme_with

STUDY: dict[str, Any] = {
    "duration": 100.0,
    "schemes": [
        {
            "scheme": "hk",
            "points": [
                {"h": 0.5, "error": 7.0, "seconds": 1e-7},
                {"h": 0.25, "error": 0.5, "seconds": 2e-7},
                {"h": 0.125, "error": 0.125, "seconds": 4e-7},
                {"h": 0.0625, "error": None, "seconds": 8e-7},
            ],
        },
        {"scheme": "backlund", "points": [{"h": 0.5, "error": 0.25, "seconds": 3e-7}]},
        {"scheme": "midpoint4", "points": []},
    ],
}


def test_errors_are_drawn_over_step_and_time() -> None:
    loaded = loaded_study(STUDY, "source")
    left, right = draw(loaded.panels, loaded.data(), loaded.layout).axes
    for axes, expected in ((left, [[0.25, 0.5], [0.125, 0.125]]), (right, [[0.2, 0.5], [0.4, 0.125]])):
        hk, backlund = axes.lines
        np.testing.assert_allclose(np.column_stack([hk.get_xdata(), hk.get_ydata()]), expected)
        assert (hk.get_label(), backlund.get_label()) == ("hk", "backlund, order 2")
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert hk.get_color() != backlund.get_color()
    assert (left.get_xlabel(), right.get_xlabel()) == ("step $h$", "CPU time per unit of time, µs")
    assert left.get_legend() is None
    legend = right.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["hk", "backlund, order 2"]


def test_every_scheme_of_the_study_looks_different() -> None:
    names = [one.name for one in error_and_cost.compared_schemes()]
    assert names[:8] == [*error_and_cost.OTHERS, *error_and_cost.FAMILY]
    styles = [(look["color"], look["marker"]) for look in looks(names, markers=True).values()]
    assert len(set(styles)) == len(names)


def test_exact_nodes_are_compared_as_a_scheme_of_their_own() -> None:
    """The last one compared is `backlund` with the option; a scheme without the option is not given it silently."""
    backlund = find_scheme("backlund", "kowalevski")
    top = error_and_cost.problem().top
    with pytest.raises(UsageError, match="scheme 'hk' has no option 'nodes'"):
        scheme_with("hk:nodes=exact", "kowalevski")
    found = error_and_cost.compared_schemes()[-1]
    assert [one.name for one in error_and_cost.compared_schemes()].count(error_and_cost.NODES) == 1
    assert found.name == error_and_cost.NODES
    exact = backlund.build(top, backlund.options.model_validate({"nodes": "exact"}))
    built = method_fingerprint(found.build(top, found.options()))
    assert built == method_fingerprint(exact)
    assert built != method_fingerprint(backlund.build(top, backlund.options()))


@pytest.mark.slow
def test_errors_of_the_study_are_those_of_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_and_cost, "OTHERS", ("hk",))
    monkeypatch.setattr(error_and_cost, "FAMILY", ("backlund", "backlund+suzuki4"))
    monkeypatch.setattr(error_and_cost, "EFFORT", error_and_cost.Effort(budget=0.001, repetitions=3))
    FIGURES["error-and-cost"].load(Request(tmp_path))
    study = json.loads((tmp_path / error_and_cost.FILE).read_text())
    hk = next(row for row in study["schemes"] if row["scheme"] == "hk")
    point = next(one for one in hk["points"] if one["h"] < 0.2)
    count = round(5.0 / point["h"])
    kwargs: dict[str, Any] = {"h": 5.0 / count, "N": 20 * count}
    hk_run = topcli.simulate("kowalevski_generic_hk", **kwargs).states[::count]
    truth = topcli.simulate("kowalevski_generic_hk", scheme="taylor", h=5.0, N=20).states
    assert point["error"] == pytest.approx(float(np.linalg.norm(hk_run - truth, axis=1).max()), rel=1e-9)
    assert all(one["seconds"] > 0.0 for row in study["schemes"] for one in row["points"])
    for name, order in (("backlund", 2.0), ("backlund+suzuki4", 4.0)):
        points = next(row for row in study["schemes"] if row["scheme"] == name)["points"]
        usable = [one for one in points if one["error"] < 0.05]
        slope = math.log(usable[0]["error"] / usable[-1]["error"]) / math.log(usable[0]["h"] / usable[-1]["h"])
        assert slope == pytest.approx(order, abs=0.4)
    before = (tmp_path / error_and_cost.FILE).stat().st_mtime_ns
    FIGURES["error-and-cost"].load(Request(tmp_path))
    assert (tmp_path / error_and_cost.FILE).stat().st_mtime_ns == before
    monkeypatch.setattr(error_and_cost, "DURATION", 50.0)
    FIGURES["error-and-cost"].load(Request(tmp_path))
    assert json.loads((tmp_path / error_and_cost.FILE).read_text())["duration"] == 50.0


def test_crossings_lie_on_the_section() -> None:
    """Of a motion in circles, whose cubic through samples 0.1 apart is off by 1e-6."""
    t = np.arange(0.0, 20.0, 0.1)
    zero = np.zeros_like(t)
    states = np.column_stack([np.cos(t), np.sin(t), t, zero, zero, zero])
    rates = np.column_stack([-np.sin(t), np.cos(t), np.ones_like(t), zero, zero, zero])
    found = torus_points.crossings(states, rates, 0.1)
    expected = np.pi * (np.arange(len(found)) + 0.5)
    assert len(found) == 6
    np.testing.assert_allclose(found[:, 2], expected, atol=1e-5)
    np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-14)
    np.testing.assert_allclose(found[:, 1], np.sin(expected), atol=1e-5)


@pytest.mark.slow
def test_points_of_the_map_lie_on_the_torus_and_those_of_hk_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torus_points, "POINTS", 30_000)
    monkeypatch.setattr(torus_points, "FLOW_STEPS", 100_000)
    columns = torus_points.torus_columns()
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


def test_the_torus_is_drawn_as_it_is_seen() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.5], [-0.5, 1.2, -1.0], [np.nan, 0.0, 0.0]])
    data = {f"backlund:{axis}": column for axis, column in zip("xyz", points.T, strict=True)}
    data |= {"backlund:u": np.array([0.5]), "backlund:v": np.array([0.25])}
    data |= {"flow:u": np.array([1.0, -1.0]), "flow:v": np.array([0.0, 0.5])}
    view, section = draw((TorusView("backlund", "a", 4), TorusSection("backlund", "c")), data).axes
    (spots,) = view.collections
    e, a = math.radians(torus_points.ELEVATION), math.radians(torus_points.AZIMUTH)
    expected = []
    for x, y, z in points[:3]:
        x, y, z = 2 * (x + 1.2) / 2.65 - 1, 2 * (y + 1.6) / 3.2 - 1, 2 * (z + 1.1) / 2.25 - 1
        ahead = math.cos(a) * x + math.sin(a) * y
        right, up = -math.sin(a) * x + math.cos(a) * y, math.cos(e) * z - math.sin(e) * ahead
        expected.append((math.sin(e) * z + math.cos(e) * ahead, right, up))
    expected.sort()  # far points first, so that near ones hide them
    np.testing.assert_allclose(np.asarray(spots.get_offsets()), [one[1:] for one in expected], atol=1e-12)
    np.testing.assert_allclose(np.asarray(spots.get_array()), [one[0] for one in expected], atol=1e-12)
    assert spots.get_rasterized()
    assert view.get_title(loc="left") == "a, 3 points, then lost"
    grey, ours = section.lines
    assert np.column_stack([grey.get_xdata(), grey.get_ydata()]).tolist() == [[1.0, 0.0], [-1.0, 0.5]]
    assert np.column_stack([ours.get_xdata(), ours.get_ydata()]).tolist() == [[0.5, 0.25]]
    assert ours.get_rasterized()


def test_the_code_of_the_torus_names_what_it_depends_on(monkeypatch: pytest.MonkeyPatch) -> None:
    before = torus_points.torus_code()
    monkeypatch.setattr(torus_points, "THICKNESS", 0.02)
    assert torus_points.torus_code() != before
