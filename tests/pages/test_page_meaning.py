"""Meaning of a page: colours against outcomes, medians against the rows, errors and tables against the study."""

from __future__ import annotations

import colorsys
import itertools
import json
import re
import statistics
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import topcli
from reading_html import Element, read_html, section_of
from shown import STRESS_TRIALS, shows
from stored_results import store_order, store_run
from sweep_rows import write_rows
from topcli.config.load import load_experiment
from topcli.figures.picture import draw
from topcli.pages.contents import Chapter, Notes, Pictures, local_time
from topcli.pages.page import all_chapters, rendered, report_page
from topcli.pages.pictures import element
from topcli.pages.results import outcome_notes, rows_table, run_chapter, sweep_choices, sweep_pictures
from topcli.pages.studies import bench_chapter, study_chapter
from topcli.store.manifest import stored_run
from topcli.studies import find_study
from topcli.studies.stress.study import STRESS
from topcli.studies.study import Result, stored_result
from topcli.sweeps.rows import read_rows

GREEN, AMBER, RED = "green", "amber", "red"


def colour_names(page: Element) -> dict[str, dict[str, str]]:
    """For each colour scheme of the page the name of the colour of each class, by its hue."""
    css = "".join(page.all("style")[0].text)
    rules = dict(re.findall(r"\.(good|bad|middling) \{ color: var\(--(\w+)\)", css))
    found = {}
    for mode, block in zip(("light", "dark", "print"), re.findall(r":root \{([^}]*)\}", css), strict=True):
        colours = dict(re.findall(r"--(\w+): #([0-9a-f]{6})", block))
        hues = {
            kind: 360.0 * colorsys.rgb_to_hls(*(int(colours[name][i : i + 2], 16) / 255.0 for i in (0, 2, 4)))[0]
            for kind, name in rules.items()
        }
        assert all(abs(one - other) > 10.0 for one, other in itertools.combinations(hues.values(), 2)), mode
        found[mode] = {
            kind: GREEN if 140.0 < hue < 175.0 else RED if hue < 25.0 else AMBER if 35.0 < hue < 50.0 else f"{hue:.0f}"
            for kind, hue in hues.items()
        }
    return found


def colours_of(table: Element, colours: dict[str, str]) -> list[list[str]]:
    """Colour of each cell of a table, row by row; empty for the colour of text."""
    rows = [[one for one in row.all() if one.name in ("th", "td")] for row in table.all("tr")]
    return [[colours.get(cell.attributes.get("class", ""), "") for cell in row] for row in rows]


def shown(chapter: Chapter) -> Element:
    return read_html(rendered([chapter], "t"))


@pytest.mark.parametrize("mode", ["light", "dark", "print"])
def test_outcomes_of_hard_cases_have_their_signs_and_colours(mode: str) -> None:
    """Held is green, degraded amber, broke red; what was not tried has the colour of text."""
    page = shown(study_chapter(STRESS, Result(STRESS_TRIALS), None))
    (grid, failures, _) = page.all("table")
    seen = colour_names(page)[mode]
    meaning = {"·": GREEN, "o": AMBER, "X": RED, "–": ""}
    colours = {"held": GREEN, "degraded": AMBER, "broke": RED}
    for cells, row in zip(grid.cells()[1:], colours_of(grid, seen)[1:], strict=True):
        assert row[1:] == [meaning[cell] for cell in cells[1:]]
    column = failures.cells()[0].index("outcome")
    for cells, row in zip(failures.cells()[1:], colours_of(failures, seen)[1:], strict=True):
        assert row[column] == colours[cells[column]]


@pytest.mark.parametrize(
    ("verdict", "state", "kind"),
    [
        ("limit", "as declared", "good"),
        ("unexplained", "1 not as declared", "bad"),
        ("outlived limit", "1 not as declared", "bad"),
    ],
)
def test_a_study_is_as_declared_unless_a_trial_contradicts_its_limit(verdict: str, state: str, kind: str) -> None:
    kept = [one for one in STRESS_TRIALS["trials"] if one["verdict"] in ("ok", "limit", verdict)]
    page = shown(study_chapter(STRESS, Result({**STRESS_TRIALS, "trials": kept}), None))
    (outcome,) = page.with_class("outcome")
    assert (outcome.text, kind in outcome.attributes["class"].split()) == (state, True)
    assert "3 held, 2 degraded, 2 broke, 1 not tried" in page.text


@pytest.mark.parametrize("study", ["stress", "order"])
def test_the_page_of_a_study_has_its_tables(study: str, tmp_path: Path) -> None:
    """Whose cells are those of the data."""
    data = STRESS_TRIALS if study == "stress" else json.loads(store_order(tmp_path / "order.json").read_text())
    declared = find_study(study)
    page = shown(study_chapter(declared, Result(data), None))
    tables = [table.cells(data) for table in declared.tables_of(data)]
    assert [table.cells() for table in page.all("table")] == [[[*one.header], *map(list, one.lines)] for one in tables]


VERDICTS = {"exact": GREEN, "no drift seen": "", "drifting": AMBER, "lost": RED, "unjudged": ""}


@pytest.mark.slow
def test_verdicts_on_invariants_have_their_colours(tmp_path: Path) -> None:
    folder = store_run(tmp_path, "one")
    run = stored_run(folder)
    assert run is not None
    report = run.report()
    first = report["invariants"][0]
    report["invariants"] = [{**first, "symbol": verdict, "verdict": verdict} for verdict in VERDICTS]
    (folder / "report.json").write_text(json.dumps(report))
    page = shown(run_chapter(run, None))
    table = section_of(page, "Conservation laws").all("table")[0]
    (at,) = [i for i, row in enumerate(table.cells()) if row[0] == "verdict"]
    assert dict(zip(table.cells()[at][1:], colours_of(table, colour_names(page)["light"])[at][1:], strict=True)) == (
        VERDICTS
    )


def sweep_of_several(folder: Path) -> tuple[Path, dict[tuple[str, float], list[float]]]:
    """Rows of two schemes and three steps with five seeds, whose mean, median, maximum and minimum differ."""
    rows = list(itertools.product(("hk", "rk4"), (0.1, 0.05, 0.025), range(5)))
    values = [(1.0 + 3.0 * (scheme == "rk4")) * h * (1.0 + seed**3) for scheme, h, seed in rows]
    keys = {name: [row[i] for row in rows] for i, name in enumerate(("scheme", "h", "seed"))}
    found: dict[tuple[str, float], list[float]] = {}
    for (scheme, h, _), value in zip(rows, values, strict=True):
        found.setdefault((scheme, h), []).append(value)
    return write_rows(folder, keys, {"max_error": values}, log=["h"]), found


def test_the_pictures_of_a_sweep_draw_medians_and_say_so(tmp_path: Path) -> None:
    folder, values = sweep_of_several(tmp_path / "several")
    rows = read_rows(folder)
    (choice,) = sweep_choices(rows)
    assert (choice.x, choice.y, choice.by) == ("seed", "max_error", "scheme"), "no median is over schemes"
    (picture,) = sweep_pictures(rows, "x").pictures
    panel, data = picture.panel, picture.data
    assert picture.caption == "max error against seed for each scheme, median over the rows"
    assert panel.ylabel == "max error (median and quartiles)"
    assert panel.labels == ("hk", "rk4")
    for scheme in panel.labels:
        for seed, middle in zip(data[f"{scheme}:x"], data[f"{scheme}:y"], strict=True):
            three = [values[scheme, h][int(seed)] for h in (0.1, 0.05, 0.025)]
            assert middle == pytest.approx(statistics.median(three), rel=1e-14)
            assert middle < 0.7 * max(three)


def test_rows_of_a_sweep_are_listed_with_their_values_and_outcomes(tmp_path: Path) -> None:
    columns = {"scheme": ["hk", "rk4", "hk"], "h": [0.1, 0.05, 0.025]}
    values = {"a": [1.25, 2.5, 3.75], "b": [4.0, 5.0, 6.0]}
    outcomes = ["completed", "blew_up", "left_motion"]
    in_words = ["completed", "blew up", "left its energy surface"]
    stored = read_rows(write_rows(tmp_path / "s", columns, values, outcome=outcomes))
    assert [choice.aggregate for choice in sweep_choices(stored)] == [None, None], "each row is a point of its own"
    chapter = Chapter("s", "sweep")
    chapter.blocks.append(rows_table(stored))
    table = shown(chapter).all("table")[0]
    header, *rows = table.cells()
    assert header == ["row", "scheme", "h", "outcome", "a", "b"]
    listed = zip(*columns.values(), in_words, *values.values(), strict=True)
    for i, (row, (scheme, h, outcome, a, b)) in enumerate(zip(rows, listed, strict=True)):
        assert [row[0], row[1], row[3]] == [str(i), scheme, outcome]
        assert [float(row[j]) for j in (2, 4, 5)] == [h, a, b]
    colours = [row[3] for row in colours_of(table, colour_names(shown(chapter))["light"])[1:]]
    assert colours == ["", RED, RED]


@pytest.mark.parametrize(("columns", "h"), [(["t", "gamma1"], 0.01), (["n", "gamma1"], 0.01), (["n", "gamma1"], -0.02)])
def test_time_is_time_without_a_column_of_times(columns: list[str], h: float, tmp_path: Path) -> None:
    """Step numbers alone are multiplied by h."""
    folder = store_run(tmp_path, "one", h=h, output={"columns": columns})
    (chapter,) = all_chapters([str(folder)], tmp_path)
    (pictures,) = [block.pictures for block in chapter.blocks if isinstance(block, Pictures)]
    np.testing.assert_allclose(pictures[0].data["t"], h * np.arange(401), rtol=1e-12, atol=1e-15)


def test_verdicts_on_claims_have_their_colours() -> None:
    keys = ("id", "statement", "source", "figure", "bound_text", "verdict")
    verdicts = {"holds": GREEN, "does not hold as stated": RED, "not tried": ""}
    claims = [dict(zip(keys, (name, "s", "p", 1.0, 2.0, name), strict=True)) for name in verdicts]
    page = shown(study_chapter(find_study("claims"), Result({"claims": claims, "controls": {}}), ""))
    table = page.all("table")[0]
    at = table.cells()[0].index("verdict")
    rows = zip(table.cells()[1:], colours_of(table, colour_names(page)["light"])[1:], strict=True)
    assert {cells[at]: colours[at] for cells, colours in rows} == verdicts


@pytest.mark.slow
def test_a_comparison_says_how_many_entries_failed_and_why() -> None:
    found = topcli.compare("rk4", "exact", config="euler_hk", h=10.0, N=200)
    chapter = found.chapter(None)
    failed = [one for one in found.figures["schemes"] if one["outcome"] != "completed"]
    assert [one["label"] for one in failed] == ["rk4"]
    assert (chapter.state, chapter.good) == ("1 failed", False)
    assert chapter.message == f"rk4: {failed[0]['message']}"


def test_failed_trajectories_are_named_with_their_steps() -> None:
    failures = [{"trajectory": 3, "outcome": "blew_up", "step": 17, "t": 0.85}]
    report = {"trajectories": 5, "outcomes": {"completed": 4, "blew_up": 1}, "failures": failures}
    assert outcome_notes({**report, "counters": {"near_singular": 9}}).lines == [
        "4 of 5 trajectories: completed",
        "1 of 5 trajectories: blew up",
        "trajectory 3: blew up at step 17",
        "counter near singular: 9",
    ]


def test_series_of_a_damaged_study_that_are_no_numbers_are_left_out() -> None:
    series = {"t": [0.0, 1.0]}
    assert stored_result({"series": series}).arrays["t"].tolist() == series["t"]
    assert stored_result({"series": series | {"error:hk": [0.0, "$<b>$"]}}).arrays == {}


def test_a_letter_that_no_font_has_is_no_warning() -> None:
    figure = Figure()
    figure.text(0.5, 0.5, "\0")
    assert element(figure, "name", "label").startswith("<svg")


def test_verdicts_come_first_and_can_be_quoted(tmp_path: Path) -> None:
    """Then pictures and tables; what the run was made with is folded."""
    folder = store_run(tmp_path, "one")
    page = read_html(report_page([str(folder)]).text)
    order = ["Verdicts", "Pictures", "Conservation laws", "Citation"]
    (details,) = page.all("details")
    folded = [one.text for one in details.all("h3")]
    assert folded == ["Reasons of the verdicts", "Setup", "Resolved config", "Provenance", "Files"]
    assert [one.text for one in page.all("h3")] == [*order, *folded]
    assert details.all("summary")[0].text == ", ".join(folded).capitalize()
    assert "open" not in details.attributes
    rows = json.loads((folder / "report.json").read_text())["invariants"]
    _, *cells = section_of(page, "Verdicts").all("table")[0].cells()
    assert [(row[0], row[1], row[3]) for row in cells] == [
        (row["symbol"], row["statement"], row["name"]) for row in rows
    ]
    assert all(shows(cell[2], row["max_deviation"]) for cell, row in zip(cells, rows, strict=True))


@pytest.mark.parametrize(
    ("zone", "text"), [("CET-1CEST", "2026-11-23 15:55:43 CET"), ("UTC", "2026-11-23 14:55:43 UTC")]
)
def test_times_are_local(monkeypatch: pytest.MonkeyPatch, zone: str, text: str) -> None:
    with monkeypatch.context() as patched:
        patched.setenv("TZ", zone)
        time.tzset()
        shown = local_time("2026-11-23T14:55:43.737+00:00"), local_time("2026-11-23T14:55:43.737+00:00", "minutes")
    time.tzset()
    assert shown == (text, text.replace(":43 ", " "))
    assert local_time("no time") == "no time"


def test_rows_that_a_sweep_excludes_are_not_missing(tmp_path: Path) -> None:
    base = {"top": "euler", "scheme": "hk", "initial": {"omega": [0.7, -0.4, 1.3]}, "N": 4}
    grid = {"h": [0.1, 0.05, 0.02]}
    topcli.sweep(
        {"name": "some", "base": base, "grid": grid, "exclude": [{"h": 0.05}], "measure": ["seconds"]}, tmp_path
    )
    (chapter,) = all_chapters([str(tmp_path / "some")], tmp_path)
    assert (chapter.message, chapter.good) == ("2 rows: 2 completed", True)


def test_timings_have_no_slope(tmp_path: Path) -> None:
    values = {"max_error": [1e-2, 1e-4, 1e-6, 1e-8], "seconds": [1e-2, 1e-1, 1.0, 10.0]}
    rows = read_rows(write_rows(tmp_path / "s", {"h": [1e-1, 1e-2, 1e-3, 1e-4]}, values, log=["h"]))
    drawn = {picture.caption: draw((picture.panel,), picture.data) for picture in sweep_pictures(rows, "x").pictures}
    legends = {caption: figure.axes[0].get_legend() for caption, figure in drawn.items()}
    assert [text.get_text() for text in legends["max error against h"].get_texts()] == ["max_error: 2.00"]
    assert legends["seconds against h"] is None


def test_a_benchmark_cites_the_schemes_that_it_measured(tmp_path: Path) -> None:
    """And says first in words which was the fastest; programs of others have no source here."""
    config = load_experiment("kowalevski_generic_hk").resolved()
    names = [("hk", "topcli"), ("rk4 compensated", "topcli"), ("scipy DOP853", "peer")]
    competitors = [{"name": name, "kind": kind, "parameter": "h", "points": []} for name, kind in names]
    report = {"competitors": competitors, "closed_forms": [{"name": "exact"}], "decades": [], "config": config}
    run = SimpleNamespace(
        manifest={"name": "b", "config": config, "files": {}}, folder=tmp_path, damage=dict, report=lambda: report
    )
    (citation,) = [block for block in bench_chapter(run).blocks if block.title == "Citation"]
    assert [line.partition(":")[0] for line in citation.lines[2:]] == ["Kowalevski top", "HK", "RK4", "exact"]


def test_numbers_with_exponents_are_kept_whole() -> None:
    """Browsers break lines after the minus sign of an exponent; all else is escaped as ever."""
    chapter = Chapter("t", "run", message="below 1.2e-07 & <b>")
    chapter.blocks.append(Notes("n", ["from -1e+10 to 3e-4, homoclinic-1e-3"]))
    text = rendered([chapter], "t")
    kept = ["1.2e-07", "-1e+10", "3e-4", "1e-3"]
    assert [one.text for one in read_html(text).with_class("number")] == kept
    assert 'below <span class="number">1.2e-07</span> &amp; &lt;b&gt;' in text
