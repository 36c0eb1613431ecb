"""Every figure at its printed size: no text is too small, leaves the page or covers other text.

Pictures of the documentation show what the current code draws.
"""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from conftest import ROOT
from declared import SCHEMES
from drawn_artists import drawn
from figure_studies import PREPARE, loaded_named
from layout import drawn_texts, layout_faults, smallest_size
from seen_colours import lines_alike
from sweep_rows import write_rows
from topcli.figures.catalogue import FIGURES
from topcli.figures.comparison import loaded_analysis, loaded_comparison
from topcli.figures.figure import Loaded, Request
from topcli.figures.growth import loaded_roundoff
from topcli.figures.picture import Grid, Line, Panel, draw
from topcli.figures.style import styled
from topcli.figures.sweep import Choice, sweep_figure
from topcli.store.series import write_parquet
from topcli.studies.stress.trials import chosen
from topcli.studies.study import Result
from topcli.sweeps.rows import read_rows
from topcli.tops.kowalevski import Kowalevski

IMAGES = ROOT / "docs" / "images"


def docs() -> ModuleType:
    """The program that draws the pictures of the documentation."""
    spec = importlib.util.spec_from_file_location("draw_images", ROOT / "docs" / "draw_images.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


images = docs()
STORED: dict[str, dict] = json.loads((IMAGES / "data.json").read_text(encoding="utf-8"))
"""For each picture of the documentation the size of its columns when it was drawn."""


def assert_stored(name: str, data: dict[str, np.ndarray], folder: Path) -> None:
    """The data are those behind the picture of the documentation."""
    rows = max(map(len, data.values()))
    same = {column: np.append(values, np.full(rows - len(values), np.nan)) for column, values in data.items()}
    write_parquet(folder / "data.parquet", same, {})
    found = images.summary(folder / "data.parquet")
    assert found == {column: pytest.approx(row, rel=1e-5) for column, row in STORED[name].items()}, (
        "run make docs-images"
    )


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_texts_are_legible_and_apart_and_lines_differ_without_colour(
    name: str, results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = loaded_named(name, results, monkeypatch)
    data = loaded.data()
    figure = draw(loaded.panels, data, loaded.layout)
    assert layout_faults(figure) == []
    assert lines_alike(figure) == []
    if name in STORED and name not in PREPARE:
        assert_stored(name, data, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in STORED if name in PREPARE])
def test_studies_behind_pictures_are_those_of_the_code(name: str, tmp_path: Path) -> None:
    assert_stored(name, FIGURES[name].load(Request(tmp_path)).data(), tmp_path)


def test_every_picture_is_drawn_by_the_target_and_shown_on_a_page() -> None:
    pictures = {path.stem for path in IMAGES.glob("*.png")}
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    text = "".join(path.read_text(encoding="utf-8") for path in pages)
    assert pictures == set(images.PICTURES) == {name for name in pictures if f"images/{name}.png)" in text}
    assert set(STORED) == pictures - {images.TIMES}


def test_the_picture_of_hard_cases_shows_the_declared_limits() -> None:
    """Each scheme that there is, and the cases that it declares to break."""
    schemes, cases = chosen((), (), None)
    names = {(case.form, case.name) for case in cases}
    declared = {
        f"{scheme.name} ({scheme.top})": sorted(case for case in scheme.limits if (scheme.top, case) in names)
        for scheme in schemes
    }
    assert len(schemes) == len(SCHEMES)
    assert {name: sorted(broke) for name, broke in STORED["stress"].items()} == declared, "run make docs-images"


@pytest.mark.slow
def test_the_target_draws_a_picture_and_keeps_what_is_known_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(images, "IMAGES", tmp_path)
    monkeypatch.setattr(images, "SUMMARY", tmp_path / "data.json")
    known = {name: rows for name, rows in STORED.items() if name != "fig1"}
    (tmp_path / "data.json").write_text(json.dumps(known), encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["draw_images.py", "fig1", "--folder", str(tmp_path)])
    images.main()
    assert (tmp_path / "data.json").read_text(encoding="utf-8") == (IMAGES / "data.json").read_text(encoding="utf-8")
    assert (tmp_path / "fig1.png").read_bytes()[:4] == b"\x89PNG"
    assert capsys.readouterr().out.strip() == str(tmp_path / "fig1.png")


def test_a_summary_says_when_data_differ(tmp_path: Path) -> None:
    t = np.linspace(0.0, 1.0, 11)
    write_parquet(tmp_path / "a.parquet", {"t": t, "y": np.append(t[1:] ** 2, np.nan)}, {})
    assert images.summary(tmp_path / "a.parquet") == {
        "t": [11, 1.0, pytest.approx(np.sqrt(0.35), rel=1e-4)],
        "y": [10, 1.0, pytest.approx(np.sqrt(2.5333 / 10), rel=1e-4)],
    }


def compared(folder: Path, count: int) -> Loaded:
    """A comparison of many schemes."""
    t = np.linspace(0.0, 40.0, 900)
    series = {"t": t, "swing:reference": np.cos(t)}
    labels = [f"scheme-{i:02}:h=0.001" for i in range(count)]
    for i, label in enumerate(labels):
        series |= {f"error:{label}": 10.0 ** (-i) * t, f"swing:{label}": np.cos(t + 0.1 * i)}
    figures = {
        "config": {"name": "kowalevski_hk", "h": 0.001},
        "schemes": [{"label": one} for one in labels],
        "reference": {"swing": "gamma1"},
    }
    return loaded_comparison(Result(figures, series))


def grown(folder: Path, forms: tuple[str, ...], size: float) -> Loaded:
    """Growth of six invariants, whose curves end at one place or apart."""
    steps = [2.0**k for k in range(9, 18)]
    rms = [[1e-16 * (1.0 + size * i) * n**0.5 for n in steps] for i in range(6)]
    found = [{"name": f"i{i}", "symbol": f"i{i}", "steps": steps, "rms": values} for i, values in enumerate(rms)]
    measured = [{"form": form, "scheme": "hk", "outcome": "completed", "invariants": found} for form in forms]
    return loaded_roundoff(Result({"config": {}, "steps": 1, "copies": 8, "h": 0.01, "forms": measured}))


def analysed(folder: Path, reference: bool) -> Loaded:
    t = np.linspace(0.0, 50.0, 300)
    series = {"t": t, "swing": np.cos(t)} | ({"error": 1e-9 * t, "swing:reference": np.cos(t)} if reference else {})
    series |= {f"deviation:{one.name}": 10.0 ** (-3.0 * i) * t for i, one in enumerate(Kowalevski().invariants())}
    start = {"omega": [1, 0, 0], "gamma": ["auto", 0, 0.1]}
    config = {"top": "kowalevski", "initial": start, "scheme": "hk", "h": 0.1, "N": 1}
    return loaded_analysis(Result({"config": config, "file": "x.csv", "sha256": ""}, series))


def swept(folder: Path, choice: Choice) -> Loaded:
    grid = [(f"scheme-{i}", h, eps) for i in range(22) for h in (0.1, 0.05, 0.02, 1e-3) for eps in (1e-1, 1e-8, 1e-3)]
    keys = {name: [row[i] for row in grid] for i, name in enumerate(("scheme", "h", "initial.gamma3"))}
    values = [1e-9 * (i + 1.0) * row[1] ** 2 for i, row in enumerate(grid)]
    folder = write_rows(folder / "kowalevski_errors", keys, {"max_error": values})
    return sweep_figure(read_rows(folder), choice).load(Request(folder))


MADE_UP = [
    *(partial(compared, count=count) for count in (2, 9, 22)),
    *(
        partial(grown, forms=forms, size=size)
        for forms in (("plain",), ("plain", "compensated"))
        for size in (1e-12, 1.0)
    ),
    *(partial(analysed, reference=reference) for reference in (True, False)),
    partial(swept, choice=Choice("h", "max_error", "scheme", aggregate="median")),
    partial(swept, choice=Choice("scheme", "max_error", aggregate="median")),
    partial(swept, choice=Choice("h", "initial.gamma3", colour="max_error", aggregate="max")),
    partial(swept, choice=Choice("scheme", "h", colour="max_error", aggregate="max")),
]


@pytest.mark.slow
@pytest.mark.parametrize("made_up", MADE_UP)
def test_texts_are_apart_whatever_the_result(made_up: Callable[[Path], Loaded], tmp_path: Path) -> None:
    """Of comparisons of any number of schemes, series and sweeps; labels at the ends of curves are all on the page."""
    loaded = made_up(tmp_path)
    figure = drawn(loaded)
    assert layout_faults(figure) == []
    if made_up in MADE_UP[3:7]:
        shown = [text.get_text() for text in drawn_texts(figure)]
        assert sum(text.startswith("i") for text in shown) == len(loaded.data()) - 1


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


@pytest.mark.slow
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
