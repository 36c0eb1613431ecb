"""Pages of several results: the outcome of each, damaged ones among them; and times where a run records none."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from reading_html import Element, read_html, section_of
from resuming import after
from stored_results import experiment, store_comparison, store_run, store_sweep
from topcli.pages.contents import Pictures
from topcli.pages.find import all_chapters, report_page
from topcli.runs.plan import RunOptions
from topcli.runs.run import run_experiment


def undrawn(places: list[str]) -> Element:
    """Page with empty pictures."""
    return read_html(report_page(places, draw=lambda picture: "<svg></svg>").text)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results")
    for name, scheme in (("one", "hk"), ("two", "hybrid"), ("three", "rk4")):
        store_run(out, name, scheme)
    return out


@pytest.fixture
def results(whole: Path, tmp_path: Path) -> Path:
    """Three finished runs that a test may damage."""
    return Path(shutil.copytree(whole, tmp_path / "results"))


def flipped(path: Path) -> None:
    """Flip a bit in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def edited(path: Path) -> None:
    """Make the report of a run a better one, of the same size."""
    path.write_text(path.read_text().replace("exact", "EXACT").replace("bounded", "BOUNDED"))


def marked(outcome: Element) -> str:
    """An outcome and whether its colour is that of good ones."""
    return f"{outcome.text} {'good' if 'good' in outcome.attributes['class'] else 'bad'}"


def outcomes(page: Element, title: str) -> tuple[list[str], list[str]]:
    """Outcomes of the runs as the page shows them: at their headings, and in the comparison."""
    shown = [marked(one.with_class("outcome")[0]) for one in page.all("section") if one.all("h2")]
    rows = {row[0]: row[1:] for row in section_of(page, title).all("table")[0].cells()}
    return shown, rows["outcome"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "damage"),
    [("series.parquet", flipped), ("report.json", edited), ("config.yaml", flipped), ("series.parquet", Path.unlink)],
)
def test_a_damaged_run_is_damaged_everywhere_on_a_page_of_several(
    results: Path, file: str, damage: Callable[[Path], object]
) -> None:
    damage(results / "two" / file)
    page = undrawn([str(results / name) for name in ("one", "two", "three")])
    headings, compared = outcomes(page, "Comparison")
    assert compared == ["completed", "damaged", "completed"]
    assert headings == ["3 runs bad", "completed good", "damaged bad", "completed good"]
    listed = [
        f"{one.text} {'good' if 'good' in one.attributes['class'] else 'bad'}" for one in page.with_class("outcome")
    ]
    assert listed.count("damaged bad") == 2, "in the list at the top, too"
    assert not any(line in ("damaged good", "3 runs good") for line in listed)


@pytest.mark.slow
def test_an_interrupted_run_and_one_that_blew_up_keep_their_outcomes(results: Path) -> None:
    run_experiment(experiment("stopped"), results, RunOptions(stop=after(0)))
    store_run(results, "wild", "rk4", h=5.0)
    places = [str(results / name) for name in ("one", "stopped", "wild")]
    headings, compared = outcomes(undrawn(places), "Comparison")
    outcome = json.loads((results / "wild" / "report.json").read_text())["outcome"]
    assert outcome not in ("completed", "interrupted")
    assert compared == ["completed", "interrupted", outcome]
    assert headings == ["3 runs bad", "completed good", "interrupted bad", f"{outcome} bad"]
    headings, _ = outcomes(undrawn([str(results / name) for name in ("one", "two")]), "Comparison")
    assert headings == ["2 runs good", "completed good", "completed good"]


@pytest.mark.slow
def test_a_damaged_sweep_and_comparison_are_not_shown_as_whole(results: Path) -> None:
    folder = store_sweep(results)
    with_sweep = undrawn([str(folder)]).with_class("outcome")[0]
    assert "good" in with_sweep.attributes["class"]
    flipped(folder / "rows.parquet")
    shown = undrawn([str(folder)]).with_class("outcome")[0]
    assert "bad" in shown.attributes["class"]
    path = store_comparison(results / "compared.json")
    data = json.loads(path.read_text())
    data["schemes"][1]["outcome"] = "blew_up"
    path.write_text(json.dumps(data))
    shown = undrawn([str(path)]).with_class("outcome")[0]
    assert "bad" in shown.attributes["class"]


@pytest.mark.slow
@pytest.mark.parametrize("h", [0.01, -0.02])
def test_pictures_of_a_run_without_times_are_over_those_of_its_steps(tmp_path: Path, h: float) -> None:
    output = {"columns": ["n", "gamma1", "gamma2", "gamma3", "energy"], "every": 4}
    folder = store_run(tmp_path, "timeless", h=h, output=output)
    (chapter,) = all_chapters([str(folder)], tmp_path)
    (pictures,) = [block.pictures for block in chapter.blocks if isinstance(block, Pictures)]
    assert [picture.name for picture in pictures] == ["part1-gamma", "part1-deviations"]
    for picture in pictures:
        np.testing.assert_allclose(picture.data["t"], np.linspace(0.0, 400 * h, 101), rtol=1e-13)
