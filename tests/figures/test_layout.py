"""Every figure at its printed size: no text is too small, leaves the page or covers other text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from figure_studies import figure_named
from layout import drawn_texts, layout_faults, smallest_size
from seen_colours import lines_alike
from sweep_rows import write_rows
from topcli.figures.catalogue import FIGURES
from topcli.figures.comparison import loaded_analysis, loaded_comparison
from topcli.figures.figure import Request
from topcli.figures.growth import loaded_roundoff
from topcli.figures.picture import Grid, Line, Panel, draw
from topcli.figures.style import styled
from topcli.figures.sweep import Choice, sweep_figure
from topcli.studies.study import Result
from topcli.sweeps.rows import read_rows
from topcli.tops.kowalevski import Kowalevski


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_texts_are_legible_and_apart_and_lines_differ_without_colour(
    name: str, results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = figure_named(name, results, monkeypatch)
    assert layout_faults(figure) == []
    assert lines_alike(figure) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, one in FIGURES.items() if one.takes_overlay])
def test_texts_are_apart_over_the_exact_motion(name: str, results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert layout_faults(figure_named(name, results, monkeypatch, overlay=True)) == []


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 9, 22])
def test_comparisons_of_any_number_of_schemes(count: int) -> None:
    t = np.linspace(0.0, 40.0, 900)
    series = {"t": t, "swing:reference": np.cos(t)}
    labels = [f"scheme-{i:02}:h=0.001" for i in range(count)]
    for i, label in enumerate(labels):
        series |= {f"error:{label}": 10.0 ** (-i) * t, f"swing:{label}": np.cos(t + 0.1 * i)}
    figures = {"config": {"h": 0.001}, "schemes": [{"label": one} for one in labels], "reference": {"swing": "gamma1"}}
    loaded = loaded_comparison(Result(figures, series))
    assert layout_faults(draw(loaded.panels, loaded.data(), loaded.layout)) == []


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-12, 1.0])
@pytest.mark.parametrize("forms", [("plain",), ("plain", "compensated")])
def test_growth_of_many_invariants(forms: tuple[str, ...], size: float) -> None:
    """Labels of curves that end at one place are moved apart, and not off the page."""
    steps = [2.0**k for k in range(9, 18)]
    found = [
        {"name": f"i{i}", "symbol": f"i{i}", "steps": steps, "rms": [1e-16 * (1.0 + size * i) * n**0.5 for n in steps]}
        for i in range(6)
    ]
    measured = [{"form": form, "scheme": "hk", "outcome": "completed", "invariants": found} for form in forms]
    study = {"config": {}, "steps": 1, "copies": 8, "h": 0.01, "forms": measured}
    loaded = loaded_roundoff(Result(study))
    figure = draw(loaded.panels, loaded.data(), loaded.layout)
    assert layout_faults(figure) == []
    shown = [text.get_text() for text in drawn_texts(figure)]
    assert sum(text.startswith("i") for text in shown) == 6 * len(forms)


@pytest.mark.slow
@pytest.mark.parametrize(
    "choice",
    [
        Choice("h", "error.max", "scheme", aggregate="median"),
        Choice("scheme", "error.max", aggregate="median"),
        Choice("h", "initial.gamma3", colour="error.max", aggregate="max"),
        Choice("scheme", "h", colour="error.max", aggregate="max"),
    ],
)
def test_figures_of_sweeps(choice: Choice, tmp_path: Path) -> None:
    grid = [(f"scheme-{i}", h, eps) for i in range(18) for h in (0.1, 0.05, 0.02, 1e-3) for eps in (1e-1, 1e-8, 1e-3)]
    keys = {name: [row[i] for row in grid] for i, name in enumerate(("scheme", "h", "initial.gamma3"))}
    values = [1e-9 * (i + 1.0) * row[1] ** 2 for i, row in enumerate(grid)]
    folder = write_rows(tmp_path / "kowalevski_errors", keys, {"error.max": values})
    loaded = sweep_figure(read_rows(folder), choice).load(Request(tmp_path))
    assert layout_faults(draw(loaded.panels, loaded.data(), loaded.layout)) == []


def _figure() -> Figure:
    figure = Figure(figsize=(4.0, 2.0))
    FigureCanvasAgg(figure)
    return figure


def test_faults_are_found_with_their_size() -> None:
    """Two texts on top of each other, one off the page, one too small in its exponent alone, a figure too wide."""
    with styled():
        figure = _figure()
        figure.text(0.1, 0.5, "one", fontsize=10)
        figure.text(0.13, 0.5, "two", fontsize=10)
        figure.text(0.97, 0.8, "outside", fontsize=10)
        figure.text(0.5, 0.2, "$10^{-3}$", fontsize=8)
        figure.text(0.5, 0.5, "small", fontsize=5.5)
        figure.text(0.7, 0.5, "apart", fontsize=6)
    faults = layout_faults(figure)
    assert [fault.rpartition(":")[0] for fault in faults] == [
        "'outside' leaves the page",
        "'$10^{-3}$' is small",
        "'small' is small",
        "'one' and 'two' overlap",
    ]
    assert faults[1].endswith(": 5.6 points")
    assert faults[2].endswith(": 5.5 points")
    assert smallest_size(figure.texts[0]) == 10.0
    figure.set_size_inches(7.1, 2.0)
    assert layout_faults(figure)[0] == "a figure of 7.1 x 2 inches"


def test_a_legend_on_a_text_is_found() -> None:
    with styled():
        figure = _figure()
        axes = figure.subplots()
        axes.plot([0.0, 1.0], label="a line")
        axes.set_title("(a)", loc="left")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0))
    assert [fault.partition(":")[0] for fault in layout_faults(figure)][-1] == "a legend covers '(a)'"


def test_a_heading_and_a_shared_legend_are_apart() -> None:
    t = np.linspace(0.0, 1.0, 9)
    names = ["a", "b", "c", "d", "e"]
    panel = Panel(tuple(Line(name, name) for name in names))
    figure = draw(
        [panel], {"t": t} | {name: i * t for i, name in enumerate(names)}, Grid(heading="a long heading " * 4)
    )
    assert layout_faults(figure) == []
    (legend,) = figure.legends
    assert len(legend.get_texts()) == 5


@pytest.mark.slow
@pytest.mark.parametrize("reference", [True, False])
def test_the_figure_of_a_series(reference: bool) -> None:
    top = Kowalevski()
    t = np.linspace(0.0, 50.0, 300)
    series = {"t": t, "swing": np.cos(t)} | ({"error": 1e-9 * t, "swing:reference": np.cos(t)} if reference else {})
    series |= {f"deviation:{one.name}": 10.0 ** (-3.0 * i) * t for i, one in enumerate(top.invariants())}
    loaded = loaded_analysis(
        Result(
            {
                "config": {
                    "top": "kowalevski",
                    "initial": {"omega": [1, 0, 0], "gamma": ["auto", 0, 0.1]},
                    "scheme": "hk",
                    "h": 0.1,
                    "N": 1,
                },
                "file": "x.csv",
                "sha256": "",
            },
            series,
        )
    )
    figure = draw(loaded.panels, loaded.data(), loaded.layout)
    assert layout_faults(figure) == []
    assert lines_alike(figure) == []
