"""A picture is data: the artists of figures of studies, comparisons and series, against the numbers of the test."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import same_color, to_rgb
from matplotlib.figure import Figure

from drawn_artists import data_of, drawn, in_sight, keys_are_true, look
from seen_colours import pattern
from topcli.figures import long_energy, roundoff
from topcli.figures.catalogue import FIGURES
from topcli.figures.comparison import loaded_analysis, loaded_comparison
from topcli.figures.figure import Request
from topcli.figures.picture import draw
from topcli.studies.study import Result

GROWTH = [
    [("a_sq:matrix", "matrix"), ("a_sq:plain", "old + change"), ("a_sq:compensated", "compensated")],
    [("k_sq:hybrid", r"$\xi$ recomputed"), ("k_sq:hybrid-xi", r"$\xi$ carried")],
]


def test_growth_is_drawn_with_its_labels_at_the_ends() -> None:
    steps = 2.0 ** np.arange(4, 16)
    sizes = {"a_sq:matrix": 1e-15, "a_sq:plain": 3e-16, "a_sq:compensated": 2e-17}
    sizes |= {"k_sq:hybrid": 1e-14, "k_sq:hybrid-xi": 5e-16}
    data = {"steps": steps} | {name: size * steps ** (0.3 + 0.1 * i) for i, (name, size) in enumerate(sizes.items())}
    figure = draw(roundoff.PANELS, data)
    for axes, lines in zip(figure.axes, GROWTH, strict=True):
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        labels = {text.get_text(): text for text in axes.texts}
        own = [line for line in axes.lines if line.get_marker() in "os^"]
        assert [line.get_marker() for line in own] == list("os^"[: len(lines)])
        assert len({to_rgb(line.get_color()) for line in own}) == len(lines)
        for line, (column, label) in zip(own, lines, strict=True):
            np.testing.assert_array_equal(data_of(line), np.column_stack([steps, data[column]]))
            assert in_sight(axes, line)
            assert same_color(labels[label].get_color(), line.get_color())
        heights = [labels[label].xy[1] for _, label in sorted(lines, key=lambda one: data[one[0]][-1])]  # type: ignore[attr-defined]
        assert heights == sorted(heights)
        root, linear = (data_of(line) for line in axes.lines if line not in own)
        np.testing.assert_allclose(root[:, 1], 2.0**-52 * np.sqrt(steps), rtol=1e-12)
        np.testing.assert_allclose(linear[:, 1], root[0, 1] * steps / steps[0], rtol=1e-12)


def test_energies_are_drawn_logarithmically_against_time(tmp_path: Path) -> None:
    loaded = FIGURES["integrable"].load(Request(tmp_path, tmp_path))
    times = 0.1 * 2.0 ** np.arange(20)
    names = [f"t:{scene}" for scene in long_energy.SCHEMES]
    names += [f"{scene}:{name}" for scene, schemes in long_energy.SCHEMES.items() for name in schemes]
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
            assert same_color(colours.setdefault(str(line.get_label()), line).get_color(), line.get_color())
    assert len({(to_rgb(line.get_color()), pattern(line)) for line in colours.values()}) == len(colours)


def test_the_period_is_drawn_over_the_step_and_the_motions_in_rows(tmp_path: Path) -> None:
    """Row i lies 2.6 i lower; the right scale is 2 sqrt 2 ln(8 sqrt 7/eps); irreversible: open markers."""
    loaded = FIGURES["period"].load(Request(tmp_path, tmp_path))
    t = np.linspace(0.0, 50.0, 101)
    data: dict[str, np.ndarray] = {"t": t, "swings": np.array([14.0, 42.0])}
    order = ["hk", "rk2", "rk4", "hybrid", "bohlin-a"]
    names, steps = ["exact", *order, "bohlin-a", "bohlin-a"], ["1e-03"] * 6 + ["1e-05", "1e-06"]
    motion_columns = [f"gamma1:{name}:{h}" for name, h in zip(names, steps, strict=True)]
    data |= {name: np.cos(t + i) for i, name in enumerate(motion_columns)}
    for i, name in enumerate(order):
        data |= {f"h:{name}": np.array([1e-7, 1e-4, 1e-1]), f"spacing:{name}": np.array([27.0, 20.0 - i, 12.0 + i])}
    figure = draw(loaded.panels, data, loaded.layout)
    left, right = figure.axes
    swings, motions = left.lines[:2], left.lines[2:]
    assert [line.get_xdata()[0] for line in swings] == [14.0, 42.0]
    for i, (line, column) in enumerate(zip(motions, motion_columns, strict=True)):
        np.testing.assert_allclose(data_of(line), np.column_stack([t, data[column] - 2.6 * i]), atol=1e-12)
        assert in_sight(left, line)
    labels = [label.get_text().replace("\n", ", ") for label in left.get_yticklabels()]
    assert labels[1] == "HK, $h = 10^{-3}$, order 2, reversible"
    assert labels[4] == "hybrid, $h = 10^{-3}$, order 2, not reversible"
    assert labels[-1] == "Bohlin A, $h = 10^{-6}$, order 1, not reversible"
    assert (right.get_xscale(), right.get_yscale()) == ("log", "linear")
    law, *curves, paper = right.lines
    assert law.get_ydata() == pytest.approx([28.1716, 28.1716], abs=1e-4)
    assert paper.get_xdata()[0] == 1e-3
    assert [str(line.get_label()).partition(":")[0] for line in curves] == ["HK", "RK2", "RK4", "hybrid", "Bohlin A"]
    for line, name in zip(curves, order, strict=True):
        expected = np.column_stack([data[f"h:{name}"], data[f"spacing:{name}"]])
        np.testing.assert_array_equal(data_of(line), expected)
        assert in_sight(right, line)
        assert (line.get_markerfacecolor() == "white") == (name != "hk")
        assert ("not reversible" in str(line.get_label())) == (name != "hk")
        same = [one for one, shown in zip(motions, names, strict=True) if shown == name]
        assert all(same_color(one.get_color(), line.get_color()) for one in same)
    (scale,) = right.child_axes
    assert scale.get_yticks() == pytest.approx(
        [2.0 * math.sqrt(2.0) * math.log(8.0 * math.sqrt(7.0) * 10.0**k) for k in (1, 2, 3)]
    )
    assert [label.get_text() for label in scale.get_yticklabels()] == ["$10^{-1}$", "$10^{-2}$", "$10^{-3}$"]


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
                "setup_seconds": 2e-3 if competitor == "nodes" else 0.0,
                "points": [point(error, (2.0 + i) * 1e-6 * error**-0.25) for error in values]
                + [point(3.0, 1e-9), point(1.5 * max(values), 1.0)],
            }
            for i, (competitor, values) in enumerate(errors.items())
        ],
    }


def test_work_and_precision_are_drawn_in_microseconds(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A curve of each competitor, alike in all panels and unlike the others: peers grey with open markers."""
    errors = {
        "hk": [1e-1, 1e-3, 1e-5],
        "nodes": [1e-9],
        "rk4": [1e-2, 1e-6],
        "peer one": [3e-2, 1e-7],
        "peer two": [2e-1, 1e-3],
    }
    reports = [bench_report("euler", errors), bench_report("lagrange", dict(reversed(errors.items())))]

    class Run:
        manifest: dict[str, str] = dict.fromkeys(("name", "digest", "code", "ended"), "")

    monkeypatch.setattr("topcli.studies.bench.result.stored_benches", lambda out: [(Run, one) for one in reports])
    figure = drawn(FIGURES["work-precision"].load(Request(tmp_path)))
    looks: dict[str, Any] = {}
    for axes in figure.axes:
        report = next(one for one in reports if one["title"] == axes.get_title(loc="left"))
        assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        assert axes.get_xlim() == pytest.approx((2.0, 1e-9 / 3.0))  # better to the right, without an empty part
        assert axes.get_xlabel() == "largest error over the run; more accurate →"
        assert "µs" in axes.get_ylabel()
        by_name = {str(line.get_label()).replace(" (after its set-up)", ""): line for line in axes.lines}
        assert set(by_name) == set(errors)
        assert by_name["nodes"].get_label() == "nodes (after its set-up)"
        for competitor in report["competitors"]:
            line = by_name[competitor["name"]]
            points = [(point["error"], 1e6 * point["seconds"]) for point in competitor["points"][:-2]]
            np.testing.assert_allclose(data_of(line), points, rtol=1e-12)
            assert in_sight(axes, line)
            open_marker = same_color(line.get_markerfacecolor(), "white")
            seen = (to_rgb(line.get_color()), line.get_marker(), open_marker)
            assert looks.setdefault(competitor["name"], seen) == seen
            assert open_marker == (competitor["kind"] == "peer")
            if open_marker:
                assert len(set(to_rgb(line.get_color()))) == 1  # grey
    assert len(set(looks.values())) == 5
    (legend,) = figure.legends
    shown = {
        text.get_text(): (to_rgb(line.get_color()), line.get_marker(), same_color(line.get_markerfacecolor(), "white"))
        for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)
    }
    assert shown == {name.replace("nodes", "nodes (after its set-up)"): look for name, look in looks.items()}
    assert list(shown)[3:] == ["peer one", "peer two"]


def compared(t: np.ndarray, shifts: dict[str, float]) -> Figure:
    """The figure of a comparison whose schemes lag behind by ``shifts``."""
    series = {"t": t, "swing:reference": np.cos(t)}
    for name, shift in shifts.items():
        series[f"error:{name}"] = shift * t
        series[f"swing:{name}"] = np.cos(t - shift)
    figures = {"schemes": [{"label": name} for name in shifts], "reference": {"swing": "gamma1"}}
    return drawn(loaded_comparison(Result({**figures, "config": {"h": 0.25}}, series)))


def test_a_comparison_draws_errors_and_swings() -> None:
    """A row for each scheme over the reference in grey; schemes whose errors coincide are one curve and one row."""
    t = np.linspace(0.0, 12.0, 240)
    figure = compared(t, {"hk": 0.9, "bohlin-a": 0.2, "bohlin-b": 0.2021, "bohlin-c": 0.2019, "rk4": 1e-3})
    names = ["hk", "bohlin-a ≈ bohlin-c", "bohlin-b", "rk4"]
    shifts = [0.9, 0.2, 0.2021, 1e-3]
    left, right = figure.axes
    assert figure.get_suptitle() == "$h = 0.25$"
    assert (left.get_yscale(), right.get_yscale()) == ("log", "linear")
    assert left.get_ylabel() == "error of the state"
    assert right.get_title(loc="left") == r"(b) $\gamma_1$, reference in grey"
    for line, name, shift in zip(left.lines, names, shifts, strict=True):
        assert line.get_label() == name
        drawn_errors = data_of(line)[:, 1]
        assert np.isnan(drawn_errors[0])  # an error of zero has no place on a logarithmic axis
        np.testing.assert_array_equal(drawn_errors[1:], shift * t[1:])
        assert in_sight(left, line)
    (legend,) = figure.legends
    shown = {text.get_text(): look(line) for text, line in zip(legend.get_texts(), legend.get_lines(), strict=True)}
    assert shown == {str(line.get_label()): look(line) for line in left.lines}
    assert len(set(shown.values())) == 4
    heights = right.get_yticks()
    assert [tick.get_text() for tick in right.get_yticklabels()] == [name.replace(" ≈", "\n≈") for name in names]
    assert list(heights) == sorted(heights, reverse=True)  # the first at the top
    middle = 0.5 * (np.cos(t).min() + np.cos(t).max())
    for i, (height, shift) in enumerate(zip(heights, shifts, strict=True)):
        reference, line = right.lines[2 * i : 2 * i + 2]
        assert same_color(reference.get_color(), "0.8")
        assert same_color(line.get_color(), left.lines[i].get_color())
        np.testing.assert_allclose(data_of(reference)[:, 1], np.cos(t) + height - middle, atol=1e-12)
        np.testing.assert_allclose(data_of(line)[:, 1], np.cos(t - shift) + height - middle, atol=1e-12)
        assert in_sight(right, line)
    (scale,) = right.child_axes
    np.testing.assert_allclose(scale.get_yticks(), [np.cos(t).min(), np.cos(t).max()])


@pytest.mark.parametrize(("swings", "start"), [(6, 0.0), (7, 8.0 * math.pi)])
def test_a_long_comparison_shows_the_last_swings(swings: int, start: float) -> None:
    """Three swings, from the middle between two, if there are more than six."""
    t = np.linspace(0.0, 2.0 * math.pi * swings, 400 * swings)
    right = compared(t, {"hk": 0.5}).axes[1]
    assert right.get_xlim() == pytest.approx((start, t[-1]), abs=1e-6)
    assert ("last 3 of 7 swings" in right.get_title(loc="left")) == (swings == 7)


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_an_analysis_draws_errors_swings_and_deviations(reference: bool, direction: float) -> None:
    """m² never moves here, and a logarithmic axis has no zero: it has no line."""
    t = direction * np.linspace(3.0, 7.0, 50)
    series = {"t": t, "swing": np.cos(t), "deviation:m_sq": np.zeros(50), "deviation:m_omega": 1e-6 * np.abs(t - t[0])}
    if reference:
        series |= {"error": 1e-4 * np.abs(t - t[0]), "swing:reference": np.cos(1.01 * t)}
    figure = drawn(
        loaded_analysis(
            Result(
                {
                    "config": {"top": "euler", "initial": {"omega": [1, 0, 0]}, "scheme": "hk", "h": 0.1, "N": 1},
                    "file": "x.csv",
                    "sha256": "",
                },
                series,
            )
        )
    )
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
    } | {(scheme, case): ("held", None, "ok") for scheme in ("hk", "rk4", "bs") for case in ("c", "d")}
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
    assert cases == ["a", "b", "2 others"]  # what all schemes hold shares a row
    (image,) = axes.images
    shades = image.cmap(image.norm(np.asarray(image.get_array())))
    (legend,) = figure.legends
    meaning = {text.get_text().split(" ")[0].rstrip(":,"): patch for text, patch in
               zip(legend.get_texts(), legend.get_patches(), strict=True)}  # fmt: skip
    keys = {"held": "held", "degraded": "degraded", "broke": "broke", "not tried": "not"}
    texts = {(round(x), round(y)): text.get_text() for text in axes.texts for x, y in [text.get_position()]}
    hatched = {patch.get_xy() for patch in axes.patches if patch.get_hatch()}
    assert {name for name, patch in meaning.items() if patch.get_hatch()} == {"not"}
    for (scheme, case), (outcome, _, _) in outcomes.items():
        column, row = schemes.index(scheme), cases.index(case if case in cases else "2 others")
        assert ((column - 0.5, row - 0.5) in hatched) == (outcome == "not tried")
        assert same_color(tuple(shades[row, column]), meaning[keys[outcome]].get_facecolor())
        assert ((column, row) in texts) == (outcome == "broke")
    order = ("not", "held", "degraded", "broke")
    darkness = [3.0 - sum(meaning[name].get_facecolor()[:3]) for name in order]
    assert darkness == sorted(darkness)
    assert texts[schemes.index("rk4"), cases.index("a")] == "37"
    assert texts[schemes.index("rk4"), cases.index("b")] == "!"
    assert texts[schemes.index("bs"), cases.index("a")] == "1e4"
