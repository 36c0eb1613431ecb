"""A headless Chromium for the tests of pages; the tests are skipped with a reason where there is none."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")


def browser_path() -> str:
    """Path of a Chromium, or of what ``TOPCLI_BROWSER`` names; skips the test without one."""
    found = next(
        (path for name in (os.environ.get("TOPCLI_BROWSER"), *NAMES) if name and (path := shutil.which(name))), ""
    )
    if not found:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} on the path; TOPCLI_BROWSER may name one")
    return found


@dataclass
class Visit:
    """A page that a browser shows: its console, its requests beside that of the page itself, and errors of scripts."""

    page: Any
    console: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    @property
    def overflow(self) -> int:
        """Pixels by which the page is wider than the window."""
        return self.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")

    def colour(self, selector: str, what: str = "color") -> tuple[int, ...]:
        """Computed colour of an element, as red, green and blue."""
        text = self.page.evaluate(f"getComputedStyle(document.querySelector({selector!r})).{what}")
        return tuple(int(part) for part in text[text.index("(") + 1 : -1].split(",")[:3])


@dataclass
class Browser:
    """A running browser."""

    browser: Any

    @contextmanager
    def visit(self, path: Path, width: int, scheme: str = "light", media: str = "screen") -> Iterator[Visit]:
        """Show a file in a window of this width."""
        context = self.browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
        page = context.new_page()
        page.emulate_media(media=media, color_scheme=scheme)
        visit = Visit(page)
        address = path.resolve().as_uri()
        page.on("console", lambda message: visit.console.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: visit.errors.append(str(error)))
        page.on("request", lambda request: None if request.url == address else visit.requests.append(request.url))
        try:
            page.goto(address)
            yield visit
        finally:
            context.close()


@contextmanager
def running_browser() -> Iterator[Browser]:
    """Start a headless browser; skips the test if there is none or it cannot be driven."""
    path = browser_path()
    driver = pytest.importorskip("playwright.sync_api", reason="no driver of a browser: pip install 'topcli[dev]'")
    with driver.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield Browser(browser)
        finally:
            browser.close()
