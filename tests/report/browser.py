"""A page in Debian's Chromium, without a window: what it asked for, what it complained of."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no chromium; `make system-packages` installs it"
)

WIDTHS = (390, 768, 1280)  # pixels: a phone, a tablet, a desktop

ARTEFACTS = Path(os.environ.get("CONGELATION_SCREENSHOTS", "build/screenshots"))
"""Where screenshots are kept, for people to look at."""


@contextmanager
def chromium() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as engine:
        browser = engine.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(
    browser: Browser, file: Path, width: int = 1280, scheme: str = "light"
) -> Iterator[Page]:
    """The page, ready; on leaving, it has asked nothing of the network and had no error."""
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)  # type: ignore[arg-type]
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "console",
        lambda message: (
            complaints.append(message.text) if message.type in ("error", "warning") else None
        ),
    )
    page.on(
        "request",
        lambda request: (
            None
            if request.url.startswith(("file:", "data:", "blob:"))
            else complaints.append(request.url)
        ),
    )
    page.goto(file.absolute().as_uri())
    if page.locator("#state").count():  # a page with plots
        page.wait_for_selector("html[data-ready=yes]", timeout=60_000)
        page.wait_for_function("Bokeh.documents[0].is_idle", timeout=60_000)
    try:
        yield page
        assert not complaints, complaints
    finally:
        page.close()


def keep(page: Page, name: str) -> None:
    ARTEFACTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=ARTEFACTS / f"{name}.png", full_page=True)


def fits(page: Page) -> bool:
    """Whether nothing sticks out of the window, but in boxes that scroll."""
    found = page.evaluate(
        """[...document.querySelectorAll("main *")].filter((e) => {
            if (e.closest(".scroll, .numbers, pre") && !e.matches(".scroll, .numbers, pre"))
              return false;
            const box = e.getBoundingClientRect();
            return box.width > 0 && box.right > innerWidth + 0.5;
        }).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert not found, found
    return bool(page.evaluate("document.documentElement.scrollWidth <= innerWidth"))
