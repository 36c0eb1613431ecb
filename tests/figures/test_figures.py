"""Figures as files: what they are made from and when they are drawn again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import topcli
from drawn_artists import columns_of
from sweep_rows import write_rows
from topcli.cli.options import complete_figure
from topcli.config.load import load_experiment
from topcli.errors import RunError, UsageError
from topcli.figures.catalogue import FIGURES
from topcli.figures.figure import Figure, Loaded, NothingMeasuredError, Request, _source, make_figure
from topcli.figures.picture import Grid, Line, Panel
from topcli.figures.scenes import scene_figure
from topcli.figures.sweep import Choice, sweep_figure
from topcli.runs.run import run_experiment
from topcli.sweeps.rows import read_rows


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two of the paper's figures, made from the configs of the repository."""
    folder = tmp_path_factory.mktemp("figures")
    for name in ("fig1", "fig3"):
        make_figure(FIGURES[name], Request(folder), folder / "figures")
    return folder


BACKENDS = ("", "svg", "nonsense", "QtAgg", "module://matplotlib_inline.backend_inline", "module://nowhere.backend")
DRAW = "import sys; from topcli.__main__ import main; sys.argv = ['topcli', 'plot', 'fig3', '--out', 'drawn']; main()"


@pytest.mark.slow
def test_figures_do_not_depend_on_the_backend(in_tmp: Path) -> None:
    """That of a notebook is in the environment of the commands that it runs."""
    pictures = set()
    for backend in BACKENDS:
        environment = os.environ | {"MPLBACKEND": backend}
        subprocess.run([sys.executable, "-c", DRAW], env=environment, check=True, capture_output=True)
        pictures.add((in_tmp / "drawn" / "fig3.png").read_bytes())
        (in_tmp / "drawn" / "fig3.png").unlink()
    assert len(pictures) == 1


@pytest.mark.slow
def test_the_figures_of_the_paper_show_what_they_should(made: Path) -> None:
    """E runs from 4.99968 to 5.00416 over t in [0, 50]: not "almost constant"."""
    request = Request(made)
    hk, bohlin, secular, hybrid = (FIGURES[f"fig{i}"].load(request).data() for i in (1, 2, 3, 4))
    assert np.abs(hk["gamma1"] - hybrid["gamma1"]).max() < 0.01
    assert np.abs(hk["gamma1"] - bohlin["gamma1"]).max() > 1.5
    assert secular["energy"].min() == pytest.approx(4.99968, abs=1e-5)
    assert secular["energy"].max() == pytest.approx(5.00416, abs=1e-5)


@pytest.mark.slow
def test_a_different_run_in_the_way_is_refused_unless_forced(made: Path, tmp_path: Path) -> None:
    messages: list[str] = []

    def drawn(N: int, force: bool = False) -> str:
        lines = (Line("gamma1", "gamma1"),)
        figure = scene_figure("x", "X", "kowalevski_hk", (Panel(lines, "gamma1"),), Grid(), overrides=(f"N={N}",))
        request = Request(tmp_path / "results", force, on_message=messages.append)
        return make_figure(figure, request, tmp_path, ["png"]).status

    assert [drawn(400), drawn(400)] == ["drawn", "up to date"]
    with pytest.raises(UsageError, match="holds a different experiment"):
        drawn(500)
    assert pq.read_metadata(tmp_path / "x.parquet").num_rows == 401
    assert drawn(500, force=True) == "drawn"
    assert pq.read_metadata(tmp_path / "x.parquet").num_rows == 501
    assert len(messages) == 1
    assert "renamed the earlier result to" in messages[0]
    assert not (tmp_path / "x.pdf").exists()


@pytest.mark.slow
def test_columns_beside_the_picture_are_those_of_the_scene(made: Path, tmp_path: Path) -> None:
    """In the order of the panels."""
    drawn = make_figure(FIGURES["fig3"], Request(made), tmp_path, ["png"]).files[-1]
    run, columns = topcli.simulate("kowalevski_bohlin_a"), columns_of(drawn)
    assert list(columns) == ["t", "energy", "two_l"]
    for name, values in columns.items():
        np.testing.assert_array_equal(values, run[name])
    components = [f"{vector}{i}" for vector in ("gamma", "omega") for i in (1, 2, 3)]
    assert list(columns_of(made / "figures" / "fig1.parquet")) == ["t", *components]


def test_the_manifest_names_what_the_figure_was_made_from(made: Path) -> None:
    run = run_experiment(load_experiment("kowalevski_hk"), made)
    source = json.loads(pq.read_schema(made / "figures" / "fig1.parquet").metadata[b"topcli.figure.source"])
    assert source["runs"] == [[run.stored.manifest["digest"], run.stored.manifest["code"]]]


def test_a_run_that_blows_up_is_refused(tmp_path: Path) -> None:
    large = ("initial.omega=[1e200, 1e200, 1e200]",)
    panel = Panel((Line("gamma1", "gamma1"),), "gamma1")
    figure = scene_figure("x", "X", "kowalevski_hk", (panel,), Grid(), overrides=large)
    with pytest.raises(RunError, match="blew up"):
        make_figure(figure, Request(tmp_path), tmp_path)


def wave(name: str = "wave", version: int = 1, measured: bool = True) -> Figure:
    """A figure from elsewhere."""

    def load(request: Request) -> Loaded:
        if not measured:
            raise NothingMeasuredError("nothing measured")
        x = np.linspace(0.0, 1.0, 20)
        panel = Panel((Line("x", "long"), Line("y", "short")), "x")
        return Loaded((panel,), lambda: {"t": x, "x": np.sin(x), "y": x[:5]}, {"version": version})

    return Figure(name, "A wave", "none", load)


@pytest.mark.slow
def test_a_figure_is_one_entry_of_the_catalogue(cli, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lists, completion and both ways to draw take it from there; its source decides if it is drawn again."""
    figures = {"wave": wave(), "slow": wave("slow", measured=False)}
    monkeypatch.setattr("topcli.figures.catalogue.FIGURES", figures)

    def status(*arguments: str) -> dict[str, str]:
        return {one["name"]: one["status"] for one in cli("plot", *arguments, "--json").json()["figures"]}

    listed = cli("list", "figures", "--json").json()["figures"]
    assert listed == [{"name": name, "title": "A wave", "scene": "none", "origin": "topcli"} for name in figures]
    assert complete_figure("w") == ["wave"]
    assert status("wave") == {"wave": "drawn"}
    assert status("wave") == {"wave": "up to date"}
    said = cli("plot", "--all")
    assert said.out.startswith("wave: up to date: ")
    assert said.err == "slow: skipped: nothing measured\n"
    figures["wave"] = wave(version=2)
    assert [status("wave") for _ in range(2)] == [{"wave": "drawn"}, {"wave": "up to date"}]
    Path("results/figures/wave.pdf").unlink()
    assert status("wave") == {"wave": "drawn"}
    short = columns_of(Path("results/figures/wave.parquet"))["y"]
    assert (np.isnan(short) == (np.arange(20) >= 5)).all()


@pytest.mark.slow
def test_a_figure_of_a_sweep_is_drawn_again_for_other_rows_choices_and_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = {"h": [0.1, 0.05, 0.1, 0.05], "seed": [1.0, 1.0, 2.0, 2.0]}
    folder = write_rows(tmp_path / "one", keys, {"v": [1.0, 2.0, 3.0, 4.0]})
    other = write_rows(tmp_path / "two" / "one", keys, {"v": [1.0, 2.0, 3.0, 5.0]})
    choice = Choice("h", "v", aggregate="median")

    def source(choice: Choice = choice, folder: Path = folder) -> str:
        return _source(sweep_figure(read_rows(folder), choice).load(Request()))

    heat = Choice("h", "seed", colour="v")
    changed = [source(), source(Choice("h", "v", aggregate="max")), source(folder=other), source(heat)]
    assert source() == changed[0]
    monkeypatch.setattr("topcli.figures.figure.package_digest", lambda: "other")
    assert len({*changed, source()}) == 5
