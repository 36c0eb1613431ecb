"""Figures: the plotted data first, then the files, then a loose look at the pictures."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure as Drawn

import topcli
from conftest import ROOT
from topcli.cli.options import complete_figure
from topcli.config.load import load_experiment
from topcli.errors import RunError, UsageError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, Loaded, NothingMeasuredError, Request, make_figure
from topcli.figures.picture import Line, Panel
from topcli.figures.polhodes import Polhodes
from topcli.runs.run import run_experiment


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's figures, made from the configs of the repository."""
    folder = tmp_path_factory.mktemp("figures")
    for name in ("fig1", "fig2", "fig3", "fig4"):
        make_figure(FIGURES[name], Request(folder, ROOT / "configs"), folder / "figures")
    return folder


def data(made: Path, name: str) -> dict[str, np.ndarray]:
    table = pq.read_table(made / "figures" / f"{name}.parquet")
    return {column: table.column(column).to_numpy() for column in table.column_names}


def test_fig3_shows_the_secular_energy(made: Path) -> None:
    """E runs from 4.99968 to 5.00416 over t in [0, 50]: not "almost constant"."""
    energy = data(made, "fig3")["energy"]
    assert energy.min() == pytest.approx(4.99968, abs=1e-5)
    assert energy.max() == pytest.approx(5.00416, abs=1e-5)


def test_fig1_and_fig4_agree_and_fig2_does_not(made: Path) -> None:
    hk, bohlin, hybrid = (data(made, name)["gamma1"] for name in ("fig1", "fig2", "fig4"))
    assert np.abs(hk - hybrid).max() < 0.01
    assert np.abs(hk - bohlin).max() > 1.5


@pytest.mark.parametrize("name", ["fig1", "fig2", "fig3", "fig4"])
def test_pictures_are_fit_for_print(made: Path, name: str) -> None:
    from PIL import Image

    pdf = (made / "figures" / f"{name}.pdf").read_bytes()
    assert pdf.startswith(b"%PDF")
    assert re.search(rb"/Subtype\s*/(Type0|TrueType|CIDFontType2)", pdf)  # fonts embedded, not Type 3 outlines
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf
    assert len(pdf) < 300_000
    with Image.open(made / "figures" / f"{name}.png") as picture:
        assert picture.size == (2100, 930 if name == "fig3" else 870)
        pixels = np.asarray(picture.convert("L"), dtype=float)
    assert 0.02 < (pixels < 200).mean() < 0.3  # neither empty nor smeared
    assert (pixels[:4] > 250).all()  # nothing runs off the page
    assert (pixels[-4:] > 250).all()
    assert (pixels[:, :4] > 250).all()
    assert (pixels[:, -4:] > 250).all()


def test_up_to_date_figure_is_not_redrawn(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError("drawn again")

    monkeypatch.setattr("topcli.figures.figure.save", never)
    for name in ("fig1", "fig3"):
        again = make_figure(FIGURES[name], Request(made, ROOT / "configs"), made / "figures")
        assert again.status == "up to date"


@pytest.mark.slow
def test_a_different_run_in_the_way_is_refused_unless_forced(made: Path, tmp_path: Path) -> None:
    configs, results = tmp_path / "configs", tmp_path / "results"
    configs.mkdir()
    text = (ROOT / "configs" / "kowalevski_hk.yaml").read_text()
    messages: list[str] = []

    def drawn(N: int, force: bool = False) -> str:
        (configs / "kowalevski_hk.yaml").write_text(re.sub(r"(?m)^N: .*$", f"N: {N}", text))
        request = Request(results, configs, force, on_message=messages.append)
        return make_figure(FIGURES["fig1"], request, tmp_path, ["png"]).status

    assert [drawn(400), drawn(400)] == ["drawn", "up to date"]
    with pytest.raises(UsageError, match="holds a different experiment"):
        drawn(500)
    assert pq.read_metadata(tmp_path / "fig1.parquet").num_rows == 401
    assert drawn(500, force=True) == "drawn"
    assert pq.read_metadata(tmp_path / "fig1.parquet").num_rows == 501
    assert len(messages) == 1
    assert "renamed the earlier, different run to" in messages[0]
    assert not (tmp_path / "fig1.pdf").exists()


@pytest.mark.slow
def test_packaged_scenes_serve_where_there_are_no_configs(tmp_path: Path) -> None:
    """The drawn columns are those of the packaged scene, run here by itself."""
    made = make_figure(FIGURES["fig3"], Request(tmp_path / "r", tmp_path / "none"), tmp_path, ["png"])
    assert made.status == "drawn"
    drawn, run = pq.read_table(made.files[-1]), topcli.simulate("kowalevski_bohlin_a")
    assert drawn.column_names[0] == "t"
    for name in ("t", "energy", "two_l"):
        np.testing.assert_array_equal(drawn.column(name).to_numpy(), run[name])


def test_a_config_without_the_columns_is_refused(tmp_path: Path) -> None:
    (tmp_path / "kowalevski_hk.yaml").write_text(
        (ROOT / "configs" / "kowalevski_hk.yaml").read_text() + "\noutput:\n  columns: [t, gamma1]\n"
    )
    with pytest.raises(UsageError, match="does not record gamma2"):
        make_figure(FIGURES["fig1"], Request(tmp_path / "r", tmp_path), tmp_path)


def test_a_run_that_blew_up_is_not_drawn(tmp_path: Path) -> None:
    text = (ROOT / "configs" / "kowalevski_hk.yaml").read_text()
    text = re.sub(r"(?m)^  omega: .*$", "  omega: [1e200, 1e200, 1e200]", text)
    (tmp_path / "kowalevski_hk.yaml").write_text(text)
    with pytest.raises(RunError, match="blew up"):
        make_figure(FIGURES["fig1"], Request(tmp_path / "r", tmp_path), tmp_path)


def test_the_manifest_names_what_the_figure_was_made_from(made: Path) -> None:
    run = run_experiment(load_experiment(ROOT / "configs" / "kowalevski_hk.yaml"), made)
    source = json.loads(pq.read_schema(made / "figures" / "fig1.parquet").metadata[b"topcli.figure.source"])
    assert source["runs"] == [[run.stored.manifest["digest"], run.stored.manifest["code"]]]


def drawn_from(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, list[str]] | list[str]
) -> Drawn:
    """The matplotlib figure of the catalogue's ``name`` from configs with overrides, for each scene or for all."""
    seen: list[Drawn] = []

    def capture(figure: Drawn, path: Path) -> None:
        seen.append(figure)
        path.touch()

    monkeypatch.setattr("topcli.figures.figure.save", capture)
    for scene in FIGURES[name].needs:
        overrides = changes[scene] if isinstance(changes, dict) else changes
        (tmp_path / f"{scene}.yaml").write_text(load_experiment(scene, overrides).to_yaml())
    make_figure(FIGURES[name], Request(tmp_path / "r", tmp_path), tmp_path, ["png"])
    return seen[0]


def texts(figure: Drawn) -> list[str]:
    """All that can be read in a figure but numbers on its axes."""
    found = [figure.get_suptitle()]
    found += [axes.get_title(loc=place) for axes in figure.axes for place in ("left", "center", "right")]
    found += [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel())]
    found += [line.get_label() for axes in figure.axes for line in axes.lines if axes.get_legend()]
    return [text for text in found if text]


READS_RUNS = [name for name, figure in FIGURES.items() if figure.takes_overrides and figure.needs]
TITLED = {"fig1": "hk", "fig2": "bohlin-a", "fig3": "bohlin-a", "fig4": "hybrid", "modified": "hk"}


@pytest.mark.slow
@pytest.mark.parametrize("name", READS_RUNS)
def test_no_figure_names_a_scheme_that_it_does_not_draw(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With another scheme, titles name that one; nothing else in the picture changes its words."""
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    own = texts(drawn_from(name, tmp_path / "a", monkeypatch, ["N=200"]))
    if name == "modified":
        with pytest.raises(UsageError, match="modified_m_sq"):
            drawn_from(name, tmp_path / "b", monkeypatch, ["N=200", "scheme=rk4"])
        return
    other = texts(drawn_from(name, tmp_path / "b", monkeypatch, ["N=200", "scheme={name: taylor, tol: 1e-12}"]))
    headings = [text for text in own if ", $h" in text]
    assert [text.partition(",")[0] for text in headings] == ([TITLED[name]] if name in TITLED else [])
    expected = [text.replace("taylor (tol=1e-12)", TITLED.get(name, "")) for text in other]
    assert expected == own
    assert (other != own) == (name in TITLED)


def test_labels_are_the_symbols_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure = drawn_from("fig3", tmp_path, monkeypatch, ["N=200", "scheme=bohlin-c"])
    (axes,) = figure.axes
    assert [line.get_label() for line in axes.lines] == ["$E$", r"$2\ell$"]
    assert figure.get_suptitle().startswith("bohlin-c, ")


def test_fixed_axis_limits_clip_no_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same figure of a faster top: E = 20 lies far above the range of the paper's figure."""
    figure = drawn_from("fig3", tmp_path, monkeypatch, ["N=200", "initial.omega=[4.4, 0, 0]"])
    (inset,) = figure.axes[0].child_axes
    energy = np.asarray(inset.lines[0].get_ydata())
    low, high = inset.get_ylim()
    assert energy.min() > 19.0
    assert low == 0.0
    assert high == energy.max()


def test_captions_name_the_motion(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A panel that names a packaged motion takes the run's name for another one, and keeps it for others."""
    changes = {f"lagrange_{name}": ["N=200"] for name in ("cusps", "loops", "waves")}
    changes["lagrange_loops"] += ["name=mine", "initial={m: [0.3, 0, 1.9], a: [0.6, 0, 0.8]}"]
    titles = [axes.get_title() for axes in drawn_from("nutation", tmp_path, monkeypatch, changes).axes]
    assert titles == ["cusps", "mine", "waves"]


@pytest.mark.slow
def test_polhodes_have_the_moments_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    panels = []
    paint = Polhodes.paint
    monkeypatch.setattr(Polhodes, "paint", lambda panel, *given: panels.append(panel) or paint(panel, *given))
    drawn_from("polhodes", tmp_path, monkeypatch, ["N=200", "top={kind: euler, A: 1.5, B: 2.5, C: 1.2}"])
    assert panels[0].moments == (1.5, 2.5, 1.2)
    with pytest.raises(UsageError, match="has the moments 2, 2, 1; use three different ones"):
        drawn_from("polhodes", tmp_path, monkeypatch, ["N=200", "name=x", "top={kind: euler, A: 2, B: 2, C: 1}"])


def wave(name: str = "wave", version: int = 1, measured: bool = True) -> Figure:
    """A figure from elsewhere."""

    def load(request: Request) -> Loaded:
        if request.stored_only and not measured:
            raise NothingMeasuredError("nothing measured")
        x = np.linspace(0.0, 1.0, 20)
        panel = Panel((Line("x", "long"), Line("y", "short")), "x")
        return Loaded((panel,), lambda: {"t": x, "x": np.sin(x), "y": x[:5]}, {"version": version})

    return Figure(name, "A wave", "none", load)


def test_a_figure_is_one_entry_of_the_catalogue(cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists, completion and both ways to draw take it from there; its source decides if it is drawn again."""
    figures = {"wave": wave(), "slow": wave("slow", measured=False)}
    monkeypatch.setattr("topcli.figures.catalogue.FIGURES", figures)

    def status(*arguments: str) -> dict[str, str]:
        return {one["name"]: one["status"] for one in cli("plot", *arguments, "--json").json()["figures"]}

    listed = cli("list", "figures", "--json").json()["figures"]
    assert listed == [{"name": name, "title": "A wave", "scene": "none"} for name in figures]
    assert complete_figure("w") == ["wave"]
    assert status("wave") == {"wave": "drawn"}
    assert status("wave", "slow") == {"wave": "up to date", "slow": "drawn"}
    said = cli("plot", "--all", "--jobs", "1")
    assert said.out.startswith("wave: up to date: ")
    assert said.err == "slow: skipped: nothing measured\n"
    figures["wave"] = wave(version=2)
    assert status("wave") == {"wave": "drawn"}
    assert status("wave") == {"wave": "up to date"}
    Path("results/figures/wave.pdf").unlink()
    assert status("wave") == {"wave": "drawn"}
    short = pq.read_table("results/figures/wave.parquet").column("y").to_numpy()
    assert (np.isnan(short) == (np.arange(20) >= 5)).all()
