"""The page of ``topcli report``: what it shows is what is stored; damaged and unfinished results are refused."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import topcli
from reading_html import Element, read_html
from resuming import after
from stored_results import BASE, experiment, store_comparison, store_ensemble, store_run, store_sweep
from topcli.cli.reports import rows_table, stored_record
from topcli.config.load import load_experiment
from topcli.contracts import stopping_when
from topcli.errors import TopcliError, UsageError
from topcli.figures.stored import draw_series, panels_of
from topcli.runs.report import report_tables
from topcli.runs.run import run_experiment
from topcli.store.files import SEAL
from topcli.studies.page import lines_html, page_of
from topcli.studies.report import Report, Table
from topcli.table import Cells

HOSTILE = "<script>alert('x')</script><img src=http://127.0.0.1/x onerror=y>&amp;\"'\x1b\ud800"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of every kind."""
    out = tmp_path_factory.mktemp("results")
    store_run(out, "one")
    store_ensemble(out)
    store_sweep(out)
    store_comparison(out / "compared.json")
    return out


@pytest.fixture
def copied(results: Path, tmp_path: Path) -> Path:
    """Results that a test may damage."""
    shutil.copytree(results, tmp_path / "results")
    return tmp_path / "results"


def page_on(results: Path, *places: str) -> Element:
    return read_html(page_of([stored_record(results / place) for place in places]))


def tables(part: Element) -> list[list[list[str]]]:
    return [table.cells() for table in part.all("table")]


def cells_of(cells: Cells) -> list[list[str]]:
    return [list(cells.header), *map(list, cells.lines)]


@pytest.mark.slow
def test_a_run_shows_its_verdicts_tables_picture_and_origin(results: Path) -> None:
    manifest, report = (json.loads((results / "one" / f"{name}.json").read_text()) for name in ("manifest", "report"))
    page = page_on(results, "one")
    assert ([each.text for each in page.all("h1")], page.all("h2")) == (["one"], [])
    conservation, origin = tables(page)
    assert conservation == cells_of(report_tables(report)[0].cells())
    about, *sentences = (item.text for item in page.all("li"))
    assert about.startswith("Kowalevski top")
    assert sentences == [f"{row['symbol']}: {row['statement']}" for row in report["invariants"]]
    assert page.with_class("good")[0].text == report["message"]
    assert len(page.all("img")) == 1
    config, bibtex = (block.text for block in page.all("pre"))
    assert config + "\n" == (results / "one" / "config.yaml").read_text()
    assert re.findall(r"@\w+\{(\w+),", bibtex)[:3] == ["topcli", "sogo", "kowalevski1889"]
    assert "hirota2000" in bibtex
    facts = dict(origin)
    assert (facts["digest"], facts["started"]) == (manifest["digest"], manifest["started"])
    assert facts["numba"] == manifest["environment"]["numba"]


@pytest.mark.slow
def test_each_kind_of_result_shows_its_tables_and_pictures(results: Path) -> None:
    many, sweep, compared = page_on(results, "many", "sweep/rows.parquet", "compared.json").all("section")
    assert [len(part.all("img")) for part in (many, sweep, compared)] == [0, 1, 1]
    assert [part.all("h2")[0].text.partition(":")[0] for part in (many, sweep, compared)] == [
        "many",
        "sweep",
        "compared",
    ]
    report = json.loads((results / "many" / "report.json").read_text())
    assert tables(many)[0] == cells_of(report_tables(report)[0].cells())
    assert "within round-off" in many.all("li")[1].text
    assert tables(sweep)[0][0] == ["row", "h", "scheme", "outcome", "max_deviation.energy", "max_error"]
    stored = json.loads((results / "compared.json").read_text())["tables"]
    assert tables(compared)[:-1] == [[each["cells"]["header"], *each["cells"]["lines"]] for each in stored]


def cited(page: Element) -> set[str]:
    return set(re.findall(r"@\w+\{(\w+),", page.all("pre")[-1].text)) - {"topcli", "sogo"}


@pytest.mark.slow
def test_the_works_of_the_schemes_and_tops_that_took_part_are_cited(copied: Path) -> None:
    """And no others: the scheme of the config, which was not compared, is not; nor one that is not registered here."""
    four = ("hk", "hk:h=0.02", "hybrid:branch=sign", "hk+suzuki4")
    topcli.compare(*four, config={**BASE, "N": 20, "scheme": "dop853"}).save(copied / "four.json")
    works = cited(page_on(copied, "four.json"))
    assert works >= {"kowalevski1889", "hirota2000", "suzuki1990"}
    assert not {key for key in works if "dormand" in key or "prince" in key}
    assert cited(page_on(copied, "sweep")) >= {"kowalevski1889", "hirota2000"}
    text = re.sub(rf',\s*"{SEAL}": "\w+"', "", (copied / "four.json").read_text())
    (copied / "four.json").write_text(text.replace('"scheme": "hk+suzuki4"', '"scheme": "elsewhere"'))
    assert cited(page_on(copied, "four.json")) == works - {"suzuki1990"}


def test_deviations_are_from_the_first_value_and_leave_out_constants() -> None:
    data = {"t": np.arange(4.0), "energy": np.array([2.0, 2.0, 1.5, 2.25]), "m_sq": np.ones(4)}
    experiment, axes = load_experiment("euler_hk"), Figure().subplots()
    ((names, deviation),) = panels_of(data, experiment)
    draw_series(axes, data, names, experiment, deviation)
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [np.nan, np.nan, 0.5, 0.25])
    assert axes.get_title(loc="left") == ""


def test_motion_is_drawn_up_to_its_explosion() -> None:
    data = {"t": np.arange(5.0), "omega1": np.array([2.0, 3.0, 1999.0, 2001.0, np.nan])}
    axes = Figure().subplots()
    draw_series(axes, data, ["omega1"], load_experiment("euler_hk"))
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [2.0, 3.0, 1999.0, np.nan, np.nan])
    assert axes.get_title(loc="left") == "not shown: values beyond 2000"


def test_counts_of_a_sweep_are_whole_and_absent_values_empty() -> None:
    rows = pd.DataFrame({"row": [0, 1], "h": [0.1, 0.2], "outcome": ["completed", "blew_up"]})
    rows = rows.assign(steps=[123456.0, np.nan], swings=[0.0, 2.0], error=[1.0 / 3.0, np.nan], huge=[1e20, 2.0])
    rows.attrs = {"keys": ["h"], "measures": ["steps", "swings", "error", "huge"]}
    cells = rows_table(rows).cells()
    assert cells.lines[0] == ["0", "0.1", "completed", "123456", "0", "0.3333", "1.000e+20"]
    assert cells.lines[1] == ["1", "0.2", "blew_up", "–", "2", "–", "2"]
    assert cells.marks == {"blew_up": "bad"}


def test_everything_is_escaped_and_nothing_comes_from_elsewhere() -> None:
    table = Table(HOSTILE, [{HOSTILE: HOSTILE}], caption=HOSTILE, marks={HOSTILE: "good"})
    record = Report(HOSTILE, HOSTILE, HOSTILE, [table], [HOSTILE], config={"name": HOSTILE}).record()
    record |= {"picture": "<svg/>", "environment": {HOSTILE: HOSTILE}}
    text = page_of([record])
    text.encode("utf-8")
    assert lines_html("x\n" * 402).endswith("x\nx\n... and 2 more lines</pre>")
    page, several = read_html(text), read_html(page_of([record, record]))
    visible = HOSTILE.replace("\x1b", r"\x1b").replace("\ud800", r"\ud800")
    for name in ("title", "h1", "h3", "p", "li", "th", "td"):
        assert any(visible in each.text for each in page.all(name)), name
    assert visible in several.all("h2")[0].text
    assert not {"script", "iframe", "object", "embed", "base", "form", "link"} & {each.name for each in page.all()}
    for each in page.all():
        assert not any(name.startswith("on") for name in each.attributes)
        assert each.attributes.get("src", "data:image/svg+xml;base64,").startswith("data:image/svg+xml;base64,")
    assert not re.search(r"@import|url\(", text)
    policy = next(each.attributes["content"] for each in page.all("meta") if "http-equiv" in each.attributes)
    assert policy.startswith("default-src 'none';")
    assert "width=device-width" in text


BROWSER = shutil.which("chromium") or shutil.which("google-chrome") or ""
FLAGS = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync --hide-scrollbars"
WATCHED = """<!doctype html><title>-</title>{frames}<script>
onload = () => document.title = [...document.querySelectorAll("iframe")].map(frame => {{
  const page = frame.contentDocument, root = page.documentElement;
  return [root.clientWidth, root.scrollWidth, [...page.images].filter(image => image.naturalWidth).length];
}}).join(" ")
</script>"""
"""Page whose title becomes the width, the scrolled width and the number of drawn pictures of the page in each frame."""


@pytest.mark.slow
@pytest.mark.skipif(not BROWSER, reason="no browser here")
def test_a_browser_shows_a_page_within_360_pixels(results: Path, tmp_path: Path) -> None:
    """In a frame of this width; the second one is a page that is too wide."""
    page = page_of([stored_record(results / place) for place in ("one", "many", "sweep", "compared.json")])
    documents = [page, "<p style='width: 500px; margin: 0; position: absolute; left: 0'>wide</p>"]
    frame = '<iframe width="360" height="640" style="border: 0" srcdoc="{}"></iframe>'
    path = tmp_path / "watched.html"
    path.write_text(WATCHED.format(frames="".join(frame.format(escape(each)) for each in documents)))
    command = [BROWSER, *FLAGS.split(), f"--user-data-dir={tmp_path / 'browser'}", "--dump-dom", path.as_uri()]
    output = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120.0).stdout
    ours, wide = (words.split(",") for words in re.findall(r"<title>(.*?)</title>", output)[0].split())
    assert ours == ["360", "360", "3"]
    assert wide == ["360", "500", "0"]


def damage(path: Path) -> None:
    """Flip a bit in the middle of a file, or the last digit of a study."""
    content = bytearray(path.read_bytes())
    digits = [i for i, byte in enumerate(content) if byte in b"02468"] if path.suffix == ".json" else []
    content[digits[len(digits) // 2] if digits else len(content) // 2] ^= 1
    path.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("one/series.parquet", "series.parquet: damaged: its SHA-256 differs"),
        ("sweep/rows.parquet", "rows.parquet: damaged: its SHA-256 differs"),
        ("compared.json", "compared.json: damaged: its SHA-256 differs from the one stored in it"),
    ],
)
def test_a_damaged_result_is_refused(place: str, message: str, copied: Path) -> None:
    damage(copied / place)
    with pytest.raises(TopcliError, match=re.escape(message)):
        page_on(copied, place.partition("/")[0])


@pytest.mark.slow
def test_a_failure_is_not_good(copied: Path) -> None:
    with stopping_when(after(0)):
        run_experiment(experiment("stopped"), copied)
    store_run(copied, "wild", "rk4", h=5.0)
    path = copied / "compared.json"
    data = json.loads(path.read_text())
    path.write_text(json.dumps({key: value for key, value in data.items() if key != SEAL} | {"code": 1, "answer": "a"}))
    for place in ("stopped", "wild", "compared.json"):
        page = page_on(copied, place)
        assert len(page.with_class("bad")) >= 1, place
        assert page.all("p")[2].attributes["class"] == "bad", place
    path.write_text(json.dumps({name: value for name, value in data.items() if name not in ("answer", SEAL)}))
    with pytest.raises(UsageError, match=r"compared.json: not a result that this version of topcli writes \(answer is"):
        page_on(copied, "compared.json")
