"""The page of ``topcli report`` and the documentation in a real browser: on a phone, a screen and paper.

``TOPCLI_SITE`` names another folder of the site than ``docs/_build/html``; its test is skipped if it is not built.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from browser import Browser, Visit, running_browser
from conftest import ROOT
from stored_results import store_comparison, store_ensemble, store_order, store_run, store_stress, store_sweep
from topcli.pages.contents import Cells, Chapter, Facts, Notes, Text
from topcli.pages.page import rendered, report_page

pytestmark = pytest.mark.slow

LONG = "a_name_without_any_place_to_break_" * 12
PAPER = 673
"""Pixels between the margins of A4."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as started:
        yield started


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page on results of every kind."""
    out = tmp_path_factory.mktemp("results")
    places = [store_run(out, "one"), store_run(out, "other", "hybrid"), store_ensemble(out), store_sweep(out)]
    places += [store_comparison(out / "compared.json"), store_order(out / "order.json"), store_stress(out / "s.json")]
    path = out / "page.html"
    path.write_text(report_page([str(place) for place in places]).text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def extreme(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page of long names and wide tables."""
    chapter = Chapter(LONG, "run", LONG, LONG, False, LONG)
    cells = [["1.234567890e-12"] * 40] * 3
    chapter.blocks += [
        Facts(LONG, [(LONG, LONG), ("h", "0.1")]),
        Cells("wide", [f"column {i}" for i in range(40)], cells),
        Cells("long", ["a", "b"], [[LONG, LONG]], LONG),
        Text("config", [LONG, *(f"line {i}" for i in range(100))]),
        Notes("notes", [LONG]),
    ]
    path = tmp_path_factory.mktemp("extreme") / "page.html"
    path.write_text(rendered([chapter, chapter], LONG), encoding="utf-8")
    return path


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 1280])
@pytest.mark.parametrize("name", ["page", "extreme"])
def test_page_fits_the_window_and_is_silent(
    browser: Browser, request: pytest.FixtureRequest, name: str, width: int, scheme: str
) -> None:
    with browser.visit(request.getfixturevalue(name), width, scheme) as seen:
        assert seen.page.locator("h2").count() >= 2
        assert seen.overflow == 0
        assert (seen.console, seen.requests, seen.errors) == ([], [], [])


def test_a_bad_page_would_be_noticed(browser: Browser, page: Path, tmp_path: Path) -> None:
    """Control: an element wider than the window, a picture from elsewhere, a script that fails."""
    bad = tmp_path / "bad.html"
    added = "<p style='width: 700px'>x</p><img src='http://127.0.0.1:9/x.png'><script>nothing()</script></body>"
    bad.write_text(page.read_text(encoding="utf-8").replace("</body>", added), encoding="utf-8")
    with browser.visit(bad, 360) as seen:
        assert seen.overflow > 300
        assert any("127.0.0.1:9" in line and "Content Security Policy" in line for line in seen.console)
        assert seen.requests == ["http://127.0.0.1:9/x.png"]
        assert any("script" in line for line in seen.console), "the policy of the page allows no script"


def test_dark_and_light_are_dark_and_light(browser: Browser, page: Path) -> None:
    def seen(scheme: str, media: str = "screen") -> tuple[int, int]:
        with browser.visit(page, 1280, scheme, media) as visit:
            ink, paper = visit.colour("body"), visit.colour("body", "backgroundColor")
        return sum(ink), sum(paper)

    light, dark, paper = seen("light"), seen("dark"), seen("dark", "print")
    assert light[0] < 150 < 600 < light[1]
    assert dark[1] < 150 < 600 < dark[0]
    assert paper[0] == 0
    assert paper[1] == 765, "paper is white in dark mode too"


def test_labels_of_pictures_have_the_colour_of_text(browser: Browser, page: Path) -> None:
    with browser.visit(page, 1280, "dark") as seen:
        glyph = seen.page.evaluate("getComputedStyle(document.querySelector('svg use')).fill")
        assert glyph == seen.page.evaluate("getComputedStyle(document.body).color")


def test_tables_and_pictures_fit_on_paper(browser: Browser, page: Path) -> None:
    with browser.visit(page, PAPER, media="print") as seen:
        assert seen.overflow == 0
        hidden = "[...document.querySelectorAll('.scroll, pre')].filter(e => e.scrollWidth > e.clientWidth + 1).length"
        assert seen.page.evaluate(hidden) == 0
        pdf = seen.page.pdf(format="A4")
    assert pdf.startswith(b"%PDF")
    assert 8 < pdf.count(b"/Type /Page\n") < 40


BROKEN = """() => {
    const found = [];
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (texts.nextNode()) {
        const node = texts.currentNode;
        if (node.parentElement.closest("svg, pre, style, .long")) continue;
        for (const word of node.data.matchAll(/[^\\s\u2013-]*[^\\s\u2013/-]/g)) {
            if (word[0].length > 30) continue;
            const range = document.createRange();
            range.setStart(node, word.index);
            range.setEnd(node, word.index + word[0].length);
            if (new Set([...range.getClientRects()].map(one => one.top)).size > 1) found.push(word[0]);
        }
    }
    return found;
}"""
"""Words and numbers that a line breaks other than after a hyphen."""


@pytest.mark.parametrize(("width", "media"), [(PAPER, "print"), (360, "screen"), (1280, "screen")])
def test_no_word_is_broken_inside(browser: Browser, page: Path, width: int, media: str) -> None:
    with browser.visit(page, width, media=media) as seen:
        assert seen.page.evaluate(BROKEN) == []
        squeezed = "document.querySelector('p.caption').style = 'width: 1em; overflow-wrap: anywhere'"
        seen.page.evaluate(squeezed)
        assert "Written" in seen.page.evaluate(BROKEN), "a broken word is found"


def test_what_is_folded_is_printed(browser: Browser, page: Path) -> None:
    visible = "document.querySelector('details pre').checkVisibility()"
    with browser.visit(page, 1280) as seen:
        assert not seen.page.evaluate(visible)
    with browser.visit(page, PAPER, media="print") as seen:
        assert seen.page.evaluate(visible)


def test_the_first_column_stays_in_sight_and_a_shadow_shows_that_there_is_more(browser: Browser, page: Path) -> None:
    place = "document.querySelector('.numbers tbody th').getBoundingClientRect().left"
    with browser.visit(page, 360) as seen:
        before = seen.page.evaluate(place)
        seen.page.evaluate("document.querySelector('.numbers').closest('.scroll').scrollLeft = 150")
        assert seen.page.evaluate("document.querySelector('.numbers').closest('.scroll').scrollLeft") > 50
        assert seen.page.evaluate(place) == before
        assert "linear-gradient" in seen.page.evaluate("getComputedStyle(document.querySelector('.scroll')).background")


def test_nothing_of_a_long_text_is_cut_off_on_paper(browser: Browser, extreme: Path) -> None:
    cut = "e => [e.scrollHeight - e.clientHeight, e.scrollWidth - e.clientWidth]"
    with browser.visit(extreme, PAPER, media="print") as seen:
        assert seen.page.locator("pre").first.evaluate(cut) == [0, 0]
    with browser.visit(extreme, PAPER) as seen:
        assert min(seen.page.locator("pre").first.evaluate(cut)) > 100, "on a screen it scrolls"


def test_a_wide_table_scrolls_within_itself_by_keyboard(browser: Browser, extreme: Path) -> None:
    with browser.visit(extreme, 360) as seen:
        table = seen.page.locator(".scroll").first
        assert table.evaluate("e => e.scrollWidth > 2 * e.clientWidth")
        table.focus()
        for _ in range(3):
            seen.page.keyboard.press("ArrowRight")
        until(seen, "document.querySelector('.scroll').scrollLeft > 0")


def until(seen: Visit, condition: str) -> None:
    """Wait for a condition; the driver's own way evaluates text within the page, which its policy forbids."""
    for _ in range(600):
        if seen.page.evaluate(condition):
            return
        seen.page.wait_for_timeout(100)
    pytest.fail(f"never: {condition}")


def test_text_of_pictures_is_readable_on_a_phone(browser: Browser, page: Path) -> None:
    """Tick labels are 9 points of a picture of 4.8 inches."""
    with browser.visit(page, 360) as seen:
        shown = seen.page.evaluate("document.querySelector('svg').getBoundingClientRect().width")
    assert shown > 300
    assert 9 * shown / (4.8 * 72) > 8, "pixels of a tick label"


# the documentation site that `make docs` built

SITE = Path(os.environ.get("TOPCLI_SITE", ROOT / "docs" / "_build" / "html"))

WIDTHS = (360, 1280)

TYPESET = "document.querySelectorAll('mjx-container').length"

FORMULAS = "document.querySelectorAll('.math').length"

FAILED = "document.querySelectorAll('mjx-merror, [data-mjx-error]').length"

MISSING = "[...document.images].filter(image => !image.complete || !image.naturalWidth).map(image => image.src)"


def faults_of(visit: Visit) -> tuple[list[str], int]:
    """Faults of a page in words, after its formulas are typeset, and the number of formulas; widens the window."""
    formulas = visit.page.evaluate(FORMULAS)
    faults = []
    if formulas:
        try:
            visit.page.wait_for_function(f"{TYPESET} === {FORMULAS}", timeout=20_000)
        except Exception as error:  # of the driver, which may be missing when this file is read
            faults.append(f"{visit.page.evaluate(TYPESET)} of {formulas} formulas are typeset ({type(error).__name__})")
    for width in WIDTHS:
        visit.page.set_viewport_size({"width": width, "height": 900})
        if visit.overflow > 0:
            faults.append(f"{visit.overflow} pixels too wide for {width}")
    if wrong := visit.page.evaluate(FAILED):
        faults.append(f"{wrong} wrong formulas")
    faults += [f"missing picture {address}" for address in visit.page.evaluate(MISSING)]
    faults += [f"request {address}" for address in visit.requests if not address.startswith(("file:", "data:"))]
    faults += [text for text in visit.console if text.startswith("error")]
    return faults + visit.errors, formulas


@pytest.mark.parametrize("half", [0, 1])
def test_every_page_of_the_site(browser: Browser, half: int) -> None:
    """No page scrolls sideways, asks the network, lacks a picture or a formula, or reports an error."""
    pages = sorted(path for path in SITE.rglob("*.html") if "_static" not in path.parts)[half::2]
    if not pages:
        pytest.skip(f"no site in {SITE}: make docs builds it")
    assert len(pages) > 30
    count, found = 0, {}
    for path in pages:
        with browser.visit(path, WIDTHS[0]) as visit:
            faults, formulas = faults_of(visit)
        count += formulas
        found |= {path.name: faults} if faults else {}
    assert not found
    assert count > 250


def test_faults_of_a_page_are_found(browser: Browser, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        '<meta name="viewport" content="width=device-width"><div style="width: 400px">wide</div><img src="nowhere.png">'
        "<style>@media (min-width: 1000px) { div { min-width: 1400px } }</style>"
        '<img src="http://127.0.0.1:9/elsewhere.png"><script>console.error("broken")</script>',
        encoding="utf-8",
    )
    with browser.visit(page, 360) as visit:
        visit.page.wait_for_load_state("networkidle")
        faults = faults_of(visit)[0]
    for part in (
        "pixels too wide for 360",
        "too wide for 1280",
        "missing picture file:",
        "request http://127.0.0.1:9/",
        "error: broken",
    ):
        assert any(part in fault for fault in faults), (part, faults)
    page.write_text("plain", encoding="utf-8")
    with browser.visit(page, 360) as visit:
        assert faults_of(visit)[0] == []
