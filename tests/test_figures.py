"""Figures: the plotted data first, then the files, then a loose look at the pictures."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from conftest import ROOT
from topcli.config.load import load_experiment
from topcli.errors import RunError, UsageError
from topcli.figures.catalogue import FIGURES, figure_spec
from topcli.figures.make import make_figure, scene_config
from topcli.studies.run import run_experiment


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paper's figures, made from the configs of the repository."""
    folder = tmp_path_factory.mktemp("figures")
    for name in ("fig1", "fig2", "fig3", "fig4"):
        make_figure(FIGURES[name], out=folder / "figures", results=folder, configs=ROOT / "configs")
    return folder


def data(made: Path, name: str) -> dict[str, np.ndarray]:
    table = pq.read_table(made / "figures" / f"{name}.parquet")
    return {column: table.column(column).to_numpy() for column in table.column_names}


@pytest.mark.parametrize("name", ["fig1", "fig2", "fig4"])
def test_plotted_data_is_the_run(made: Path, name: str) -> None:
    plotted = data(made, name)
    scene = FIGURES[name].scene
    series = pq.read_table(made / scene / "series.parquet")
    assert list(plotted) == ["t", *(f"{v}{i}" for v in ("gamma", "omega") for i in (1, 2, 3))]
    for column, values in plotted.items():
        assert (values == series.column(column).to_numpy()).all()
    assert plotted["t"][-1] == 50.0


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
        assert picture.size == (2100, 810)
        pixels = np.asarray(picture.convert("L"), dtype=float)
    assert 0.02 < (pixels < 200).mean() < 0.3  # neither empty nor smeared
    assert (pixels[:4] > 250).all()  # nothing runs off the page
    assert (pixels[-4:] > 250).all()
    assert (pixels[:, :4] > 250).all()
    assert (pixels[:, -4:] > 250).all()


def test_nothing_is_done_twice(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError("drawn again")

    monkeypatch.setattr("topcli.figures.make.save", never)
    for name in ("fig1", "fig3"):
        again = make_figure(FIGURES[name], out=made / "figures", results=made, configs=ROOT / "configs")
        assert again.status == "up to date"


def test_a_different_run_in_the_way_is_refused_unless_forced(made: Path, tmp_path: Path) -> None:
    configs, results = tmp_path / "configs", tmp_path / "results"
    configs.mkdir()
    text = (ROOT / "configs" / "kowalevski_hk.yaml").read_text()
    talk: list[str] = []

    def drawn(N: int, force: bool = False) -> str:
        (configs / "kowalevski_hk.yaml").write_text(re.sub(r"(?m)^N: .*$", f"N: {N}", text))
        spec = FIGURES["fig1"]
        options = {"configs": configs, "formats": ["png"], "told": talk.append, "force": force}
        return make_figure(spec, out=tmp_path, results=results, **options).status

    assert [drawn(400), drawn(400)] == ["drawn", "up to date"]
    with pytest.raises(UsageError, match="holds a different experiment"):
        drawn(500)
    assert pq.read_metadata(tmp_path / "fig1.parquet").num_rows == 401
    assert drawn(500, force=True) == "drawn"
    assert pq.read_metadata(tmp_path / "fig1.parquet").num_rows == 501
    assert len(talk) == 1
    assert "kept the earlier" in talk[0]
    assert not (tmp_path / "fig1.pdf").exists()


def test_packaged_scenes_serve_where_there_are_no_configs(tmp_path: Path) -> None:
    made = make_figure(
        FIGURES["fig3"], out=tmp_path, results=tmp_path / "r", configs=tmp_path / "none", formats=["png"]
    )
    assert made.status == "drawn"


def test_a_config_without_the_columns_is_told(tmp_path: Path) -> None:
    (tmp_path / "kowalevski_hk.yaml").write_text(
        (ROOT / "configs" / "kowalevski_hk.yaml").read_text() + "\noutput:\n  columns: [t, gamma1]\n"
    )
    with pytest.raises(UsageError, match="does not record gamma2, gamma3"):
        make_figure(FIGURES["fig1"], out=tmp_path, results=tmp_path / "r", configs=tmp_path)


def test_a_run_that_blew_up_is_not_drawn(tmp_path: Path) -> None:
    text = (ROOT / "configs" / "kowalevski_hk.yaml").read_text()
    text = re.sub(r"(?m)^  omega: .*$", "  omega: [1e200, 1e200, 1e200]", text)
    (tmp_path / "kowalevski_hk.yaml").write_text(text)
    with pytest.raises(RunError, match="blew up"):
        make_figure(FIGURES["fig1"], out=tmp_path, results=tmp_path / "r", configs=tmp_path)


def test_every_figure_reads_columns_that_its_scene_records() -> None:
    for spec in FIGURES.values():
        for scene, columns in spec.sources.items():
            experiment = load_experiment(scene_config(scene, ROOT / "configs"))
            integrals = (*experiment.top.invariants(), *experiment.modified)
            assert set(columns) <= {"n", "t", *experiment.top.components, *(integral.name for integral in integrals)}
    assert figure_spec("FIG1").name == "fig1"


def test_the_manifest_names_what_the_figure_was_made_from(made: Path) -> None:
    run = run_experiment(load_experiment(ROOT / "configs" / "kowalevski_hk.yaml"), made)
    source = json.loads(pq.read_schema(made / "figures" / "fig1.parquet").metadata[b"topcli.figure.source"])
    assert source["runs"] == [[run.stored.manifest["digest"], run.stored.manifest["code"]]]
