"""Options of ``topcli plot``: styles, overrides, the exact motion behind a run, SVG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.figure import Figure

from cases import table_of
from conftest import ROOT
from drawn_artists import columns_of, data_of
from topcli.config.load import load_experiment
from topcli.errors import UsageError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Request, make_figure
from topcli.figures.picture import draw
from topcli.figures.style import read_style, styled
from topcli.runs.references import overlay_columns
from topcli.tops.heavy import Heavy

GREY = "0.8"


def figure_of(name: str, tmp_path: Path, **options: Any) -> Figure:
    loaded = FIGURES[name].load(Request(tmp_path, ROOT / "configs", **options))
    return draw(loaded.panels, loaded.data(), loaded.layout, options.get("style"))


@pytest.mark.slow
def test_overrides_change_the_run_and_keep_the_figure_of_the_scene(cli: Callable[..., Any]) -> None:
    """The other run has a folder of its own and the other figure a file of its own, with the digits of its digest."""
    first = cli("plot", "fig1", "--set", "N=300", "--format", "png", "--json").json()["figures"][0]
    digits = load_experiment("kowalevski_hk", ["N=300"]).digest[:6]
    assert first["name"] == f"fig1-{digits}"
    assert first["files"] == [f"results/figures/fig1-{digits}.{suffix}" for suffix in ("png", "parquet")]
    assert Path(f"results/kowalevski_hk-{digits}/manifest.json").is_file()
    assert len(columns_of(Path(first["files"][1]))["t"]) == 301
    again = cli("plot", "fig1", "--set", "N=300", "--format", "png", "--json").json()["figures"][0]
    assert again["status"] == "up to date"
    own = cli("plot", "fig1", "--set", "h=0.001", "--json").json()["figures"][0]
    assert [Path(path).suffix for path in own["files"]] == [".png", ".pdf", ".parquet"]  # by default
    assert (own["name"], own["status"]) == ("fig1", "drawn")  # the scene's own value changes nothing
    assert Path("results/kowalevski_hk/manifest.json").is_file()


def test_overrides_reach_every_scene_of_a_figure_and_comparisons(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = FIGURES["nutation"].load(Request(tmp_path, ROOT / "configs", overrides=("N=50",)))
    data = loaded.data()
    draw(loaded.panels, data, loaded.layout)
    assert {len(values) for values in data.values()} == {51}
    assert loaded.variant == load_experiment("lagrange_cusps", ["N=50"]).digest[:6]
    compared = []
    monkeypatch.setattr(
        "topcli.figures.comparison.compare_schemes", lambda experiment, names: compared.append(experiment)
    )
    loaded = FIGURES["compare"].load(Request(tmp_path, ROOT / "configs", overrides=("h=0.02", "N=10")))
    with pytest.raises(AttributeError):
        loaded.data()
    assert (compared[0].h, compared[0].N) == (0.02, 10)
    assert loaded.layout.heading == "Kowalevski top, $h = 0.02$"
    assert loaded.variant


@pytest.mark.parametrize(
    ("arguments", "message"),
    table_of("""
swings --set h=1              --set: swings is not drawn from runs of one config; use it with fig1, fig2
fig1 stress --overlay exact   --overlay exact: stress is not drawn from runs of one config
fig1 --overlay reference      --overlay reference: unknown overlay; use exact
fig1 --format gif             --format 'gif': unknown format; use png, pdf or svg
fig1 --set hh=1               did you mean 'h'
fig1 --style none.mplstyle    --style none.mplstyle: No such file
"""),
)
def test_options_that_do_not_fit_are_refused_before_anything_is_run(
    cli: Callable[..., Any], arguments: str, message: str
) -> None:
    said = cli("plot", *arguments.split())
    assert (said.code, said.out) == (2, "")
    assert message in said.err
    assert not Path("results/figures").exists() or not list(Path("results/figures").iterdir())


def test_the_exact_motion_is_drawn_in_grey_behind_the_run(tmp_path: Path) -> None:
    """Bohlin A at a long step leaves the exact motion, here of RK4 at a tenth of the step; integrals stay constant."""
    overrides = ("N=600", "h=0.02")
    figure = figure_of("fig2", tmp_path, overrides=overrides, overlay=True)
    assert figure.get_suptitle().endswith("; exact motion in grey")
    short = ("N=6000", "h=0.002", "output.every=10", "scheme=rk4")
    requests = (Request(tmp_path, ROOT / "configs", overrides=changes) for changes in (short, overrides))
    fine, run = (FIGURES["fig2"].load(request).data() for request in requests)
    apart = 0.0
    for axes, vector in zip(figure.axes, ("gamma", "omega"), strict=True):
        grey = [line for line in axes.lines if same_color(line.get_color(), GREY)]
        coloured = [line for line in axes.lines if line not in grey]
        assert len(grey) == len(coloured) == 3
        for i, (behind, line) in enumerate(zip(grey, coloured, strict=True), 1):
            np.testing.assert_allclose(data_of(behind)[:, 1], fine[f"{vector}{i}"], atol=2e-7)
            np.testing.assert_array_equal(data_of(line)[:, 1], run[f"{vector}{i}"])
            assert behind.get_zorder() < line.get_zorder()
            apart = max(apart, float(np.abs(data_of(behind) - data_of(line)).max()))
        assert [text.get_text() for text in axes.get_legend().get_texts()] == [rf"$\{vector}_{i}$" for i in (1, 2, 3)]
    assert apart > 1e-3
    (axes,) = figure_of("fig3", tmp_path, overrides=overrides, overlay=True).axes
    grey = [line for line in axes.lines if same_color(line.get_color(), GREY)]
    assert [set(data_of(line)[:, 1]) for line in grey] == [{0.0}, {0.0}]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scene", "vector"), [("nutation", "lagrange_cusps", "a"), ("polhodes", "", "omega")])
def test_the_exact_trace_is_drawn_on_spheres_and_the_ellipsoid(
    name: str, scene: str, vector: str, tmp_path: Path
) -> None:
    """Of the Lagrange top by its closed form, as its state is not one of the reference."""
    loaded = FIGURES[name].load(Request(tmp_path, ROOT / "configs", overrides=("N=400",), overlay=True))
    data = loaded.data()
    prefix = f"{scene}:" if scene else ""
    names = [f"{prefix}{vector}{i}" for i in (1, 2, 3)]
    exact = np.column_stack([data[f"exact:{one}"] for one in names])
    run = np.column_stack([data[one] for one in names])
    assert 0.0 < np.abs(exact - run).max() < 1e-2
    assert np.abs(exact[0] - run[0]).max() < 1e-15
    figure = draw(loaded.panels, data, loaded.layout)
    traced = [line for line in figure.axes[0].lines if same_color(line.get_color(), GREY)]
    assert [len(data_of(line)) for line in traced] == [401, 401]  # in front and behind
    assert loaded.layout.heading.split("; ")[-1] == "exact motion in grey"


def test_a_motion_without_exact_solution_is_refused() -> None:
    class Rough(Heavy):
        field = staticmethod(lambda y, p: (abs(y[0]), *Heavy.field(y, p)[1:]))

    experiment = load_experiment("heavy_hk").model_copy(update={"top": Rough()})
    with pytest.raises(UsageError, match=r"heavy_hk: no exact motion: .*polynomial.*, and there is no closed form"):
        overlay_columns(experiment)


@pytest.mark.slow
def test_a_style_replaces_the_print_style_and_the_figure_is_drawn_again(tmp_path: Path) -> None:
    path = tmp_path / "mine.mplstyle"
    path.write_text("# mine\nfont.size : 13  # larger\nfigure.figsize: 5, 2.5\nlines.linewidth: 3\n", encoding="utf-8")
    style = read_style(path)
    assert style == {"font.size": 13.0, "figure.figsize": [5.0, 2.5], "lines.linewidth": 3.0}
    request: dict[str, Any] = {"results": tmp_path, "configs": ROOT / "configs", "overrides": ("N=20",)}
    plain = figure_of("fig1", tmp_path, overrides=("N=20",))
    own = figure_of("fig1", tmp_path, overrides=("N=20",), style=style)
    assert tuple(plain.get_size_inches()) == (7.0, 2.9)
    assert tuple(own.get_size_inches()) == (5.0, 2.5)
    assert {line.get_linewidth() for axes in own.axes for line in axes.lines} == {3.0}
    assert own.axes[0].title.get_fontsize() == plain.axes[0].title.get_fontsize()  # what it does not name remains
    assert own._suptitle.get_fontsize() == 13.0  # type: ignore[attr-defined]
    statuses = [
        make_figure(FIGURES["fig1"], Request(**request, style=used), tmp_path / "out", ["png"]).status
        for used in ({}, style, style, {})
    ]
    assert statuses == ["drawn", "drawn", "up to date", "drawn"]
    before = dict(mpl.rcParams)
    with styled(style):
        pass
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(
    ("text", "message"),
    table_of(r"""
"font.size: 9\nfont.sise: 3\n"     :2: matplotlib has no parameter 'font.sise'; did you mean 'font.size'
"\n\nlines.linewidth: broad"       :3: lines.linewidth: Could not convert 'broad' to float
qwxyz: 1                           :1: matplotlib has no parameter 'qwxyz'; see matplotlib.rcParams for all
font.size 9                        :1: 'font.size 9' is not a line KEY: VALUE, as in font.size: 9
backend: agg                       :1: backend is not part of a style; remove the line
figure.figsize: 3                  :1: figure.figsize: Expected 2 values
axes.prop_cycle: cycler('linestyle', ['-', ':'])  :1: axes.prop_cycle: a cycle without colours
font.family: DejaVu Sanz           :1: font.family: no font 'DejaVu Sanz' on this machine; did you mean 'DejaVu Sans'
axes.prop_cycle: cycler('color', [  ":1: axes.prop_cycle: "
"""),
)
def test_a_style_that_matplotlib_refuses_is_named_with_its_line(
    cli: Callable[..., Any], tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "my.mplstyle"
    path.write_text(text, encoding="utf-8")
    said = cli("plot", "fig1", "--style", str(path))
    assert (said.code, said.out) == (2, "")
    assert len(said.err.splitlines()) == 1
    assert said.err.startswith(f"error: --style {path}{message}")


@pytest.mark.parametrize(("content", "reason"), [(b"\xff\xfe\x00", "not a text file"), (None, "Is a directory")])
def test_a_style_that_cannot_be_read(tmp_path: Path, content: bytes | None, reason: str) -> None:
    path = tmp_path / "x.mplstyle"
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(UsageError, match=reason):
        read_style(path)


def test_fonts_of_a_style_that_are_missing_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "fonts.mplstyle"
    path.write_text("font.family: serif\nfont.serif: Nope, DejaVu Serif\n", encoding="utf-8")
    assert read_style(path) == {"font.family": ["serif"], "font.serif": ["DejaVu Serif"]}


@pytest.mark.slow
def test_a_style_that_fails_only_at_drawing_is_an_error_of_the_user(tmp_path: Path) -> None:
    """An image of 2e6 dots per inch; an earlier picture remains."""
    request: dict[str, Any] = {"results": tmp_path, "configs": ROOT / "configs", "overrides": ("N=20",)}
    make_figure(FIGURES["fig1"], Request(**request), tmp_path / "out", ["png"])
    (picture,) = (tmp_path / "out").glob("*.png")
    before = picture.read_bytes()
    with pytest.raises(UsageError, match="cannot be drawn with this style: Image size"):
        make_figure(FIGURES["fig1"], Request(**request, style={"savefig.dpi": 2e6}), tmp_path / "out", ["png"])
    assert picture.read_bytes() == before


@pytest.mark.slow
def test_svg_is_one_file_without_date_and_needs_no_font(tmp_path: Path) -> None:
    request = Request(tmp_path, ROOT / "configs", overrides=("N=50",))
    made = [make_figure(FIGURES["fig1"], request, tmp_path / folder, ["svg"]).files for folder in "ab"]
    assert [path.suffix for path in made[0]] == [".svg", ".parquet"]
    text, again = (files[0].read_text(encoding="utf-8") for files in made)
    assert text == again
    assert "<svg" in text
    assert "<dc:date>" not in text
    assert "<text" not in text  # letters are outlines
    assert "http" not in "".join(line for line in text.splitlines() if "href" in line)
