"""A picture is data: the lines of every figure against the numbers behind them, and what explains the lines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import same_color, to_rgb
from matplotlib.figure import Figure

from cases import table_of
from drawn_artists import data_of, drawn, drawn_from, explained, in_sight, labelled, look, name_of, series_of
from figure_studies import (
    OURS,
    PEERS,
    SET_UP,
    TIMES,
    TITLES,
    benched,
    energies,
    figure_named,
    spacings,
)
from seen_colours import pattern
from topcli.figures.catalogue import FIGURES
from topcli.figures.comparison import loaded_analysis, loaded_comparison
from topcli.figures.growth import loaded_roundoff
from topcli.figures.outcomes import loaded_stress
from topcli.figures.picture import number_text
from topcli.figures.style import styled
from topcli.studies.study import Result

Points = tuple[Any, Any]


@dataclass
class Shown:
    """Axes as a reader should find them: labels, scales, and the points of each line by its label."""

    labels: tuple[str, str]
    scales: tuple[str, str]
    lines: dict[str, Points]


LINEAR, LOG = ("linear", "linear"), ("log", "log")
SCENES = {
    "fig1": "kowalevski_hk",
    "fig2": "kowalevski_bohlin_a",
    "fig3": "kowalevski_bohlin_a",
    "fig4": "kowalevski_hybrid",
    "modified": "euler_hk",
}
"""Figures of the columns of one run."""
ENERGIES = {
    "kowalevski_generic_hk": ["splitting", "dmv", "hk", "midpoint", "rk4"],
    "euler_hk": ["splitting", "dmv", "hk", "midpoint", "rk4"],
}


def law(eps: Any) -> Any:
    return 2.0 * math.sqrt(2.0) * np.log(8.0 * math.sqrt(7.0) / np.asarray(eps))


def of_run(name: str, series: dict[str, np.ndarray]) -> list[Shown]:
    """Axes of a figure of one run."""
    t = series["t"]
    if name == "fig3":
        moved = {
            "$E$": (t, series["energy"] - series["energy"][0]),
            r"$2\ell$": (t, series["two_l"] - series["two_l"][0]),
        }
        return [Shown(("time $t$", "change since $t = 0$"), LINEAR, moved)]
    if name == "modified":
        symbols = {
            r"$\boldsymbol{m}^2$": "m_sq",
            r"$\boldsymbol{m}^2/K$": "modified_m_sq",
            r"$\kappa_{12}$": "modified_k12",
        }
        off = {
            label: np.maximum.accumulate(np.abs(series[column] / series[column][0] - 1.0))
            for label, column in symbols.items()
        }
        own = {label: (t, series[column]) for label, column in list(symbols.items())[:2]}
        right = {label: (t, np.where(values > 0.0, values, np.nan)) for label, values in off.items()}
        return [
            Shown(("time $t$", ", ".join(own)), LINEAR, own),
            Shown(("time $t$", "largest relative deviation so far"), ("linear", "log"), right),
        ]
    return [
        Shown(
            ("time $t$", rf"{word} $\boldsymbol{{\{vector}}}$"),
            LINEAR,
            {rf"$\{vector}_{i}$": (t, series[f"{vector}{i}"]) for i in (1, 2, 3)},
        )
        for vector, word in (("gamma", "vertical"), ("omega", "angular velocity"))
    ]


STUDIES: dict[str, list[Shown]] = {
    "long-energy": [
        Shown(
            ("time $t$", "largest relative energy error so far"),
            LOG,
            {name: (TIMES, energies(scene, name)) for name in names},
        )
        for scene, names in ENERGIES.items()
    ],
    "work-precision": [
        Shown(
            ("largest error over the run; more accurate →", "CPU time per unit of time, µs"),
            LOG,
            {
                name + " (after its set-up)" * (name == SET_UP): tuple(np.array(benched(name)).T * [[1.0], [1e6]])
                for name in (*PEERS, *OURS)
            },
        )
        for _ in TITLES
    ],
}  # fmt: skip


def assert_shown(drawn_axes: list[Axes], expected: list[Shown]) -> None:
    """All lines in sight, alike in all axes, different from each other, and as their legend shows them."""
    key = {text: look(line) for text, line in explained(drawn_axes[0].figure).items()}
    for axes, shown in zip(drawn_axes, expected, strict=True):
        assert (axes.get_xlabel(), axes.get_ylabel()) == shown.labels
        assert (axes.get_xscale(), axes.get_yscale()) == shown.scales
        lines = labelled(axes)
        assert set(lines) == set(shown.lines)
        for label, points in shown.lines.items():
            found, wanted = data_of(lines[label]), np.column_stack(points)
            wanted = wanted[np.argsort(wanted[:, 0])] if len(found) and np.all(np.diff(found[:, 0]) > 0.0) else wanted
            np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=3e-16)
            assert in_sight(axes, lines[label])
            (explanation,) = {
                shown_look for text, shown_look in key.items() if name_of(text.partition(": ")[0]) == label
            }
            assert explanation[0] == to_rgb(lines[label].get_color())
            assert explanation[2:] == look(lines[label])[2:]
        assert len({(to_rgb(line.get_color()), pattern(line)) for line in lines.values()}) == len(lines)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SCENES, *STUDIES])
def test_lines_are_the_numbers_that_they_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in SCENES:
        figure = drawn_from(name, tmp_path)
        expected = of_run(name, series_of(tmp_path, SCENES[name]))
    else:
        figure = figure_named(name, tmp_path, monkeypatch)
        expected = STUDIES[name]
    assert_shown(figure.axes, expected)


def test_every_figure_of_the_catalogue_is_inspected() -> None:
    spatial = {"polhodes", "body", "traces"}
    motions = {"period", "chaos", "bifurcation", "torus-points"}
    assert set(FIGURES) == {*SCENES, *STUDIES, *spatial, *motions}


def test_changes_of_the_integrals_have_an_inset_of_their_values(tmp_path: Path) -> None:
    figure = drawn_from("fig3", tmp_path)
    series = series_of(tmp_path, "kowalevski_bohlin_a")
    (inset,) = figure.axes[0].child_axes
    assert inset.get_ylim() == (0.0, 6.0)
    for line, outside, column in zip(inset.lines, figure.axes[0].lines, ("energy", "two_l"), strict=True):
        np.testing.assert_array_equal(data_of(line), np.column_stack([series["t"], series[column]]))
        assert look(line) == look(outside)


@pytest.mark.parametrize(
    ("value", "text"),
    table_of(r"""
0.001    10^{-3}
0.01     "0.01"
-1e-8    -10^{-8}
2.5e-4   2.5\times 10^{-4}
3.0      "3"
99999.0  "99999"
1e5      10^{5}
0.0      "0"
"""),
)
def test_numbers_are_written_as_powers_of_ten(value: float, text: str) -> None:
    assert number_text(value) == text


def leads_to(text: Any, line: Any, last: int) -> bool:
    """True if a leader in the colour of the line joins the text with its last point."""
    joined = text.xy == pytest.approx(tuple(data_of(line)[last]), rel=1e-12)
    with styled():
        return joined and same_color(text.arrow_patch.get_edgecolor(), line.get_color())


STEPS = 2.0 ** np.arange(10, 19)
POWERS = {"plain": (6e-17, 0.5), "compensated": (2e-18, 0.4)}


def test_growth_is_drawn_with_its_labels_at_the_ends() -> None:
    """Forms of one invariant differ in colour and marker; the guides grow as the square root and linearly."""
    forms = [
        {"form": form, "scheme": "bs", "outcome": "completed", "invariants": [
            {"name": "a_sq", "symbol": "a²", "steps": STEPS.tolist(), "rms": (least * STEPS**power).tolist()}]}
        for form, (least, power) in POWERS.items()
    ]  # fmt: skip
    study = {"config": {}, "steps": 1 << 18, "copies": 4, "h": 0.01, "forms": forms}
    (axes,) = drawn(loaded_roundoff(Result(study))).axes
    assert (axes.get_xscale(), axes.get_yscale()) == LOG
    own = [line for line in axes.lines if line.get_marker() in "os^"]
    named = {text.get_text(): text for text in axes.texts}
    assert len({to_rgb(line.get_color()) for line in own}) == len({line.get_marker() for line in own}) == len(POWERS)
    for line, (form, (least, power)) in zip(own, POWERS.items(), strict=True):
        np.testing.assert_allclose(data_of(line), np.column_stack([STEPS, least * STEPS**power]), rtol=1e-12)
        assert in_sight(axes, line)
        assert leads_to(named[f"a², {form}"], line, last=-1)
    assert named["a², plain"].xyann[1] > named["a², compensated"].xyann[1]  # type: ignore[attr-defined]
    root, linear = (data_of(line) for line in axes.lines if line not in own)
    np.testing.assert_allclose(root[:, 1], 2.0**-52 * np.sqrt(STEPS), rtol=1e-12)
    np.testing.assert_allclose(linear[:, 1], root[0, 1] * STEPS / STEPS[0], rtol=1e-12)


def test_the_period_is_drawn_over_the_step_and_the_motions_in_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Row i lies 2.6 i lower; the right scale is that of the law; open markers are irreversible schemes."""
    names = {"hk": "HK", "rk2": "RK2", "rk4": "RK4", "hybrid": "hybrid", "bohlin-a": "Bohlin A"}
    left, right = figure_named("period", tmp_path, monkeypatch).axes
    swings, motions = left.lines[:2], left.lines[2:]
    assert [line.get_xdata()[0] for line in swings] == [14.0, 42.0]
    t = np.linspace(0.0, 50.0, 1001)
    for i, line in enumerate(motions):
        gamma1 = 1.0 - (2.0 - 0.01 * i) / np.cosh((t - 14.0) % 28.0)
        np.testing.assert_allclose(data_of(line), np.column_stack([t, gamma1 - 2.6 * i]), atol=1e-12)
        assert in_sight(left, line)
    rows = [label.get_text().replace("\n", ", ") for label in left.get_yticklabels()]
    assert rows[1] == "HK, $h = 10^{-3}$, order 2, reversible"
    assert rows[4] == "hybrid, $h = 10^{-3}$, order 2, not reversible"
    assert rows[-1] == "Bohlin A, $h = 10^{-6}$, order 1, not reversible"
    assert (right.get_xscale(), right.get_yscale()) == ("log", "linear")
    across, *curves, paper = right.lines
    assert across.get_ydata() == pytest.approx([28.1716, 28.1716], abs=1e-4)
    assert paper.get_xdata()[0] == 1e-3
    h = 10.0 ** np.arange(-7.0, 0.0)
    for line, (name, title) in zip(curves, names.items(), strict=True):
        assert str(line.get_label()).startswith(
            f"{title}: order {rows[1 + list(names).index(name)].partition('order ')[2]}"
        )
        np.testing.assert_allclose(data_of(line), np.column_stack([h, spacings(name, h)]), rtol=1e-12)
        assert (line.get_markerfacecolor() == "white") == (name != "hk")
        shown = [one for one, row in zip(motions, rows, strict=True) if row.startswith(f"{title},")]
        assert shown
        assert all(same_color(one.get_color(), line.get_color()) for one in shown)
    (scale,) = right.child_axes
    assert scale.get_yticks() == pytest.approx(law([1e-1, 1e-2, 1e-3]))
    assert [label.get_text() for label in scale.get_yticklabels()] == ["$10^{-1}$", "$10^{-2}$", "$10^{-3}$"]


def test_peers_are_grey_and_better_is_to_the_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that another beats in both, and errors above 1, are not drawn; ours come first in the legend."""
    figure = figure_named("work-precision", tmp_path, monkeypatch)
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(TITLES)
    for axes in figure.axes:
        assert axes.get_xlim() == pytest.approx((2.0, min(benched(PEERS[-1]))[0] / 3.0))
        for name, line in labelled(axes).items():
            assert same_color(line.get_markerfacecolor(), "white") == (name in PEERS)
            assert (len(set(to_rgb(line.get_color()))) == 1) >= (name in PEERS)
    assert list(explained(figure))[-len(PEERS) :] == list(PEERS)


def compared(t: np.ndarray, shifts: dict[str, float]) -> Figure:
    """The figure of a comparison whose schemes lag behind by ``shifts``."""
    series = {"t": t, "swing:reference": np.cos(t)}
    for name, shift in shifts.items():
        series |= {f"error:{name}": shift * t, f"swing:{name}": np.cos(t - shift)}
    figures = {"schemes": [{"label": name} for name in shifts], "reference": {"swing": "gamma1"}}
    return drawn(loaded_comparison(Result({**figures, "config": {"name": "a_$cene", "h": 0.25}}, series)))


def test_a_comparison_draws_errors_and_swings() -> None:
    """A row for each scheme over the reference in grey; schemes whose errors coincide are one curve and one row."""
    t = np.linspace(0.0, 12.0, 240)
    figure = compared(t, {"hk": 0.9, "bohlin-a": 0.2, "bohlin-b": 0.2021, "bohlin-c": 0.2019, "rk4": 1e-3})
    shifts = {"HK": 0.9, "Bohlin A ≈ Bohlin C": 0.2, "Bohlin B": 0.2021, "RK4": 1e-3}
    left, right = figure.axes
    assert figure.get_suptitle() == r"a_\$cene, $h = 0.25$"
    errors = {name_of(name): (t, np.where(t == 0.0, np.nan, shift * t)) for name, shift in shifts.items()}
    assert_shown([left], [Shown(("time $t$", "error of the state"), ("linear", "log"), errors)])
    assert list(labelled(left)) == list(map(name_of, shifts))
    assert right.get_yscale() == "linear"
    assert right.get_title(loc="left") == r"(b) $\gamma_1$, reference in grey"
    heights = right.get_yticks()
    assert [tick.get_text() for tick in right.get_yticklabels()] == [name.replace(" ≈", "\n≈") for name in shifts]
    assert list(heights) == sorted(heights, reverse=True)  # the first at the top
    middle = 0.5 * (np.cos(t).min() + np.cos(t).max())
    for i, (height, shift) in enumerate(zip(heights, shifts.values(), strict=True)):
        reference, line = right.lines[2 * i : 2 * i + 2]
        assert same_color(reference.get_color(), "0.8")
        assert same_color(line.get_color(), left.lines[i].get_color())
        np.testing.assert_allclose(data_of(reference)[:, 1], np.cos(t) + height - middle, atol=1e-12)
        np.testing.assert_allclose(data_of(line)[:, 1], np.cos(t - shift) + height - middle, atol=1e-12)
        assert in_sight(right, line)
    (scale,) = right.child_axes
    np.testing.assert_allclose(scale.get_yticks(), [np.cos(t).min(), np.cos(t).max()])


@pytest.mark.parametrize(("power", "clipped"), [(2, True), (1, False)])
def test_much_smaller_errors_at_the_start_are_below_the_scale(power: int, clipped: bool) -> None:
    """Errors that grow like t² begin two decades lower than after a hundredth of the rows, those like t one."""
    t = np.linspace(0.0, 10.0, 2001)
    series = {"t": t, "swing:reference": np.cos(t), "swing:hk": np.cos(t), "error:hk": 1e-3 * t**power}
    figures = {"schemes": [{"label": "hk"}], "reference": {"swing": "gamma1"}, "config": {"name": "a_$cene", "h": 0.25}}
    axes = drawn(loaded_comparison(Result(figures, series))).axes[0]
    bottom, first = axes.get_ylim()[0], 1e-3 * t[1] ** power
    if clipped:
        assert bottom == pytest.approx(0.5e-3 * t[20] ** power)
    assert (bottom > first) == clipped


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
    config = {"top": "euler", "initial": {"omega": [1, 0, 0]}, "scheme": "hk", "h": 0.1, "N": 1}
    figure = drawn(loaded_analysis(Result({"config": config, "file": "x.csv", "sha256": ""}, series)))
    moved = np.where(t == t[0], np.nan, series["deviation:m_omega"])
    expected = [
        Shown(("time $t$", r"$\omega_2$"), LINEAR, {"series": (t, series["swing"])}),
        Shown(
            ("time $t$", "deviation of the invariants"),
            ("linear", "log"),
            {r"$\boldsymbol{m}\cdot\boldsymbol{\omega}$": (t, moved)},
        ),
    ]
    if reference:
        expected[0].lines["reference"] = (t, series["swing:reference"])
        error = np.where(t == t[0], np.nan, series["error"])
        expected.insert(0, Shown(("time $t$", "error of the state"), ("linear", "log"), {"series": (t, error)}))
    assert_shown(figure.axes, expected)
    assert all(axes.get_xlim() == (t.min(), t.max()) for axes in figure.axes)
    key = {text: look(line) for text, line in explained(figure).items()}
    assert len(set(key.values())) == len(key) or not reference


@pytest.mark.slow
def test_the_grid_of_hard_cases_has_each_outcome_in_its_cell() -> None:
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
    figure = drawn(loaded_stress(Result({"trials": trials})))
    (axes,) = figure.axes
    assert axes.get_xlabel() == "euler"
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["HK", "RK4", "BS"]
    schemes = ["hk", "rk4", "bs"]
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
    rows = {("rk4", "a"): "37", ("rk4", "b"): "!", ("bs", "a"): "1e4"}
    assert {key: texts[schemes.index(key[0]), cases.index(key[1])] for key in rows} == rows
