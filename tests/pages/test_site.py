"""The documentation site that `make docs` built, in a real browser at two widths; skipped if it is not built.

``TOPCLI_SITE`` names another folder than ``docs/_build/html``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from browser import Browser, Visit, running_browser
from conftest import ROOT

pytestmark = pytest.mark.slow

SITE = Path(os.environ.get("TOPCLI_SITE", ROOT / "docs" / "_build" / "html"))
TYPESET = "document.querySelectorAll('mjx-container').length"
FORMULAS = "document.querySelectorAll('.math').length"
FAILED = "document.querySelectorAll('mjx-merror, [data-mjx-error]').length"
MISSING = "[...document.images].filter(image => !image.complete || !image.naturalWidth).map(image => image.src)"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with running_browser() as found:
        yield found


@dataclass
class Look:
    """Faults of a page, in words."""

    faults: list[str]
    formulas: int


def look(visit: Visit) -> Look:
    """Look at a page after its formulas are typeset."""
    formulas = visit.page.evaluate(FORMULAS)
    faults = []
    if formulas:
        try:
            visit.page.wait_for_function(f"{TYPESET} === {FORMULAS}", timeout=20_000)
        except Exception as error:  # of the driver, which may be missing when this file is read
            faults.append(f"{visit.page.evaluate(TYPESET)} of {formulas} formulas are typeset ({type(error).__name__})")
    if visit.overflow > 0:
        faults.append(f"{visit.overflow} pixels too wide")
    if wrong := visit.page.evaluate(FAILED):
        faults.append(f"{wrong} wrong formulas")
    faults += [f"missing picture {address}" for address in visit.page.evaluate(MISSING)]
    faults += [f"request {address}" for address in visit.requests if not address.startswith(("file:", "data:"))]
    faults += [text for text in visit.console if text.startswith("error")]
    return Look(faults + visit.errors, formulas)


@pytest.mark.parametrize("width", [360, 1280])
def test_every_page_of_the_site(browser: Browser, width: int) -> None:
    """No page scrolls sideways, asks the network, lacks a picture or a formula, or reports an error."""
    pages = sorted(path for path in SITE.rglob("*.html") if "_static" not in path.parts)
    if not pages:
        pytest.skip(f"no site in {SITE}: make docs builds it")
    assert len(pages) > 60
    formulas, faults = 0, {}
    for path in pages:
        with browser.visit(path, width) as visit:
            seen = look(visit)
        formulas += seen.formulas
        if seen.faults:
            faults[path.name] = seen.faults
    assert not faults
    assert formulas > 500


def test_faults_of_a_page_are_found(browser: Browser, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(
        '<meta name="viewport" content="width=device-width"><div style="width: 400px">wide</div><img src="nowhere.png">'
        '<img src="http://127.0.0.1:9/elsewhere.png"><script>console.error("broken")</script>',
        encoding="utf-8",
    )
    with browser.visit(page, 360) as visit:
        visit.page.wait_for_load_state("networkidle")
        faults = look(visit).faults
    for part in ("pixels too wide", "missing picture file:", "request http://127.0.0.1:9/", "error: broken"):
        assert any(part in fault for fault in faults), (part, faults)
    page.write_text("plain", encoding="utf-8")
    with browser.visit(page, 360) as visit:
        assert look(visit).faults == []
