"""The page of ``topcli report``: what it shows equals what is stored; damaged and unfinished results are refused."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import topcli
from reading_html import Element, read_html, section_of
from resuming import after
from stored_results import (
    BASE,
    experiment,
    store_comparison,
    store_ensemble,
    store_euler,
    store_order,
    store_run,
    store_stress,
    store_sweep,
)
from topcli.config.load import load_experiment
from topcli.errors import RunError, TopcliError, UsageError
from topcli.figures.run import run_pictures
from topcli.pages.contents import Cells, Chapter, Facts, Notes, Pictures, Text
from topcli.pages.page import all_chapters, rendered, report_page
from topcli.runs.report import report_tables
from topcli.runs.run import RunOptions, run_experiment
from topcli.store.files import SEAL, sealed_text

HOSTILE = "<script>alert('x')</script><img src=http://127.0.0.1/x onerror=y>&amp;\"'"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of every kind."""
    out = tmp_path_factory.mktemp("results")
    store_run(out, "one")
    store_run(out, "other", "hybrid")
    store_euler(out)
    store_ensemble(out)
    store_sweep(out)
    store_comparison(out / "compared.json")
    store_order(out / "order.json")
    store_stress(out / "stress.json")
    return out


@pytest.fixture
def copied(results: Path, tmp_path: Path) -> Path:
    """Results that a test may damage."""
    shutil.copytree(results, tmp_path / "results")
    return tmp_path / "results"


def shown(results: Path, *places: str) -> Element:
    """Page with empty pictures, which are data until a page is drawn."""
    return read_html(report_page([str(results / place) for place in places]).text)


def texts(section: Element) -> list[str]:
    return [item.text for item in section.all("li")]


def facts_of(section: Element) -> dict[str, str]:
    return {fact.all("dt")[0].text: fact.all("dd")[0].text for fact in section.all("div")}


@pytest.mark.slow
def test_a_run_shows_its_report(results: Path) -> None:
    page = shown(results, "one")
    texts_of_report = report_tables(json.loads((results / "one" / "report.json").read_text()))[0].cells()
    table = section_of(page, "Conservation laws").all("table")[0].cells()
    assert table == [list(texts_of_report.header), *map(list, texts_of_report.lines)]
    assert page.with_class("outcome")[0].text == "completed"


@pytest.mark.slow
def test_config_provenance_and_citation_are_those_of_the_manifest(results: Path) -> None:
    manifest = json.loads((results / "one" / "manifest.json").read_text())
    page = shown(results, "one")
    stored = (results / "one" / "config.yaml").read_text()
    assert section_of(page, "Resolved config").all("pre")[0].text == stored
    facts = facts_of(section_of(page, "Provenance"))
    assert facts["digest of the experiment"] == manifest["digest"]
    assert facts["numba"] == manifest["environment"]["numba"]
    assert facts["started"] == manifest["started"]
    assert re.fullmatch(r"Compiling or loading the code took \S+ s, and the run \S+ s", facts["seconds"])
    files = {row[0]: row[1:] for row in section_of(page, "Files").all("table")[0].cells()[1:]}
    assert files == {n: [str(f["size"]), f["sha256"]] for n, f in manifest["files"].items()}
    cited = " ".join(texts(section_of(page, "Citation")))
    assert f"version {manifest['environment']['topcli']}" in cited
    assert "Kowalevski 1889" in cited
    assert "Hirota, Kimura 2000" in cited


def cited(results: Path, place: str) -> list[str]:
    """Tops and schemes whose sources the page of a result gives, without the program and the paper."""
    page = shown(results, place)
    return [text.partition(":")[0] for text in texts(section_of(page, "Citation"))[2:]]


TWO_TOPS = {
    "name": "tops",
    "base": {"h": 0.1, "N": 8, "initial": {"omega": [0.3, 0.4, 1.5], "gamma": [0.6, 0, 0.8]}},
    "grid": {"top": ["kowalevski", {"kind": "heavy", "A": 1.5, "B": 1.2}], "scheme": ["rk4", {"name": "hk"}]},
    "measure": ["max_deviation.energy"],
}


@pytest.mark.slow
def test_every_scheme_and_top_that_took_part_is_cited(results: Path, tmp_path: Path) -> None:
    """And no other: the scheme of the config, which was not compared, is not."""
    config = {**BASE, "N": 20, "scheme": "rk2"}
    topcli.compare("hk", "hk:h=0.02", "hybrid:branch=sign", "hk+suzuki4", config=config).save(tmp_path / "four.json")
    assert cited(tmp_path, "four.json") == ["Kowalevski top", "HK", "hybrid", "HK + Suzuki 4"]
    topcli.sweep(TWO_TOPS, tmp_path)
    assert set(cited(tmp_path, "tops")) == {"Kowalevski top", "Heavy top", "RK4", "HK"}
    citations = texts(section_of(shown(tmp_path, "tops"), "Citation"))
    assert sum(text.startswith("HK: ") for text in citations) == 1
    assert cited(results, "order.json") == ["Euler top", "HK", "RK4"]
    assert cited(results, "many") == ["Kowalevski top", "HK"]


@pytest.mark.slow
def test_a_scheme_that_is_not_here_is_named_without_a_source(copied: Path) -> None:
    path = copied / "compared.json"
    data = json.loads(path.read_text().replace('"scheme": "hybrid"', '"scheme": "elsewhere"'))
    del data[SEAL]
    path.write_text(json.dumps(data))
    assert "elsewhere: source unknown" in texts(section_of(shown(copied, "compared.json"), "Citation"))


def test_deviations_are_from_the_first_value_and_leave_out_constants() -> None:
    data = {"t": np.arange(4.0), "energy": np.array([2.0, 2.0, 1.5, 2.25]), "m_sq": np.ones(4)}
    (picture,) = run_pictures(data, load_experiment("euler_hk"))
    assert picture.caption.endswith("; m_sq did not change")
    axes = Figure().subplots()
    picture.draw(axes)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [np.nan, np.nan, 0.5, 0.25])


@pytest.mark.parametrize(
    ("values", "caption"),
    [
        ([2.0, 3.0, 1999.0, 2001.0, 0.0], "angular velocity ω over time, up to t = 2 before the motion explodes"),
        ([5e3, 5e3, 5e3, 5e3, 5e3], "angular velocity ω over time"),
        ([1.0, 1.0, np.nan, 1.0, 1.0], "angular velocity ω over time, up to t = 1 before the motion explodes"),
    ],
)
def test_motion_is_drawn_up_to_its_explosion(values: list[float], caption: str) -> None:
    data = {"t": np.arange(5.0), "omega1": np.array(values), "omega2": np.zeros(5)}
    assert run_pictures(data, load_experiment("euler_hk"))[0].caption == caption


@pytest.mark.slow
def test_each_kind_of_result_shows_its_table_and_pictures(results: Path) -> None:
    page = shown(results, "many", "sweep", "compared.json", "order.json", "stress.json")
    parts = [one for one in page.all("section") if one.attributes.get("id", "").startswith("part")]
    many, sweep, _, _, stress = parts
    assert [len(one.all("img")) for one in parts] == [1, 2, 1, 1, 1]
    quantiles = report_tables(json.loads((results / "many" / "report.json").read_text()))[0].cells()
    assert many.all("table")[0].cells() == [list(quantiles.header), *map(list, quantiles.lines)]
    cells = section_of(sweep, "Rows").all("table")[0].cells()
    assert cells[0] == ["row", "h", "scheme", "outcome", "max_deviation.energy", "max_error"]
    assert [row[:4] for row in stress.all("table")[0].cells()[:2]] == [
        ["scheme", "top", "case", "outcome"],
        ["hk", "kowalevski", "delone", "held"],
    ]


def _all_blocks(text: str) -> Chapter:
    chapter = Chapter(text, "run", text, text, True, text)
    chapter.blocks += [
        Facts(text, [(text, text)]),
        Cells(text, [text, text], [[text, text]], text, marks={text: "good"}),
        Text(text, [text]),
        Notes(text, [text]),
        Pictures([(b"<svg/>", text)]),
    ]
    return chapter


def test_everything_is_escaped() -> None:
    text = rendered([_all_blocks(HOSTILE), _all_blocks("b")], HOSTILE)
    page = read_html(text)
    assert not page.all("script")
    assert all(one.attributes["src"].startswith("data:image/svg+xml;base64,") for one in page.all("img"))
    assert not [one for one in page.all() if any(name.startswith("on") for name in one.attributes)]
    for name in ("h1", "h2", "h3", "dt", "dd", "td", "th", "li", "figcaption", "title", "a"):
        assert any(HOSTILE in one.text for one in page.all(name)), name
    assert page.all("pre")[0].text == HOSTILE + "\n"
    assert any(one.attributes.get("aria-label") == HOSTILE for one in page.all("div"))


@pytest.mark.slow
def test_control_characters_and_half_pairs_are_shown_as_escapes() -> None:
    text = rendered([_all_blocks("a\x00\x1b[31m\u202eb\ud800")], "t")
    assert "a\\x00\\x1b[31m\\u202eb\\ud800" in text
    text.encode("utf-8")


@pytest.mark.slow
def test_page_needs_nothing_from_elsewhere(results: Path) -> None:
    text = report_page([str(results / name) for name in ("one", "sweep", "compared.json")]).text
    page = read_html(text)
    assert not {"script", "iframe", "object", "embed", "base", "form"} & {one.name for one in page.all()}
    for one in page.all():
        for name, value in one.attributes.items():
            if name in ("src", "href", "xlink:href", "action", "data", "srcset"):
                assert value.startswith(("#", "data:")), (one.name, name, value)
    assert not re.search(r"@import|url\((?!#)", text)
    policy = next(one.attributes["content"] for one in page.all("meta") if "http-equiv" in one.attributes)
    assert policy.startswith("default-src 'none';")
    ids = [one.attributes["id"] for one in page.all() if "id" in one.attributes]
    assert len(ids) == len(set(ids))


def _damage_series(folder: Path) -> None:
    (folder / "series.parquet").write_bytes(b"PAR1" + bytes(100))


def _damage_manifest(folder: Path) -> None:
    (folder / "manifest.json").write_text("{")


def _drop(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def _flip_report(folder: Path) -> None:
    _flip(folder / "report.json")


def _tamper(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(path.read_text().replace('"outcome": "completed"', '"outcome": "blew_up"'))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_damage_series, "series.parquet: damaged: its SHA-256 differs"),
        (_drop("series.parquet"), "series.parquet: damaged: missing"),
        (_drop("report.json"), "report.json: damaged: missing"),
        (_drop("manifest.json"), "no run is stored here (manifest.json is missing)"),
        (_damage_manifest, "manifest.json: damaged (Expecting property name"),
        (_tamper, "manifest.json: damaged (its text has changed"),
        (_flip_report, "report.json: damaged: its SHA-256 differs"),
    ],
)
def test_a_damaged_run_is_refused(copied: Path, spoil: Callable[[Path], None], message: str) -> None:
    spoil(copied / "one")
    with pytest.raises(TopcliError, match=re.escape(message)):
        shown(copied, "one", "other")


def marked(outcome: Element) -> str:
    """An outcome and whether its colour is that of good ones."""
    return f"{outcome.text} {'good' if 'good' in outcome.attributes['class'] else 'bad'}"


def outcomes(page: Element) -> tuple[list[str], list[str]]:
    """Outcomes of the runs as the page shows them: in the list at the top and at their headings, and compared."""
    rows = {row[0]: row[1:] for row in section_of(page, "Comparison").all("table")[0].cells()}
    return [marked(outcome) for outcome in page.with_class("outcome")], rows["outcome"]


def _flip(path: Path) -> None:
    """Flip a bit in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.slow
def test_an_interrupted_run_and_one_that_blew_up_keep_their_outcomes(copied: Path) -> None:
    run_experiment(experiment("stopped"), copied, RunOptions(stop=after(0)))
    store_run(copied, "wild", "rk4", h=5.0)
    states, compared = outcomes(shown(copied, "one", "stopped", "wild"))
    outcome = json.loads((copied / "wild" / "report.json").read_text())["outcome"]
    assert outcome not in ("completed", "interrupted")
    outcome = {"left_motion": "left its energy surface"}.get(outcome, outcome.replace("_", " "))
    assert compared == ["completed", "interrupted", outcome]
    assert states[4:] == ["3 runs bad", "completed good", "interrupted bad", f"{outcome} bad"]
    assert outcomes(shown(copied, "one", "other"))[0] == ["2 runs good", "completed good", "completed good"] * 2


@pytest.mark.slow
def test_a_damaged_sweep_is_refused_and_a_failed_comparison_is_not_good(copied: Path) -> None:
    assert marked(shown(copied, "sweep").with_class("outcome")[0]) == "finished good"
    _flip(copied / "sweep" / "rows.parquet")
    with pytest.raises(RunError, match=r"rows.parquet: damaged: .*; topcli sweep writes it again"):
        shown(copied, "sweep")
    (copied / "sweep" / "manifest.json").unlink()
    with pytest.raises(UsageError, match="the sweep is not finished; topcli sweep continues it"):
        shown(copied, "sweep")
    path = copied / "compared.json"
    data = json.loads(path.read_text())
    data.pop(SEAL, None)
    data["code"] = 1
    path.write_text(json.dumps(data))
    assert marked(shown(copied, "compared.json").with_class("outcome")[0]).endswith("bad")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compared.json", "order.json", "stress.json"])
def test_studies_of_another_form_are_refused(copied: Path, name: str) -> None:
    whole = json.loads((copied / name).read_text())
    whole.pop(SEAL, None)
    for key in {"tables", "trials", "cases", "command"} & whole.keys():
        (copied / name).write_text(json.dumps({**whole, key: None}))
        with pytest.raises(UsageError, match=rf"{name}: not (a result|of the form)"):
            shown(copied, name)


def test_a_changed_comparison_is_damaged_on_its_page_and_for_verify(tmp_path: Path) -> None:
    from topcli.studies.health import check_all

    path = tmp_path / "comparison.json"
    path.write_text(sealed_text({"command": "compare", "tables": [], "x": 0.375}), encoding="utf-8")
    assert not check_all(str(path), tmp_path).damage
    whole = path.read_bytes()
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        assert list(check_all(str(path), tmp_path).damage) == [path.name], place
    path.write_bytes(whole.replace(b"0.375", b"3.75E-1"))  # the same number
    assert check_all(str(path), tmp_path).damage == {path.name: "its text has changed since it was written"}
    path.write_bytes(whole.replace(b"0.375", b"0.625"))
    with pytest.raises(RunError, match=r"comparison.json: damaged: its SHA-256 differs from the one stored in it"):
        all_chapters([str(path)], tmp_path)
