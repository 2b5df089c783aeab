"""The pages in a real browser: no error, no request, controls that work, nothing cut off."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from congelation.report.html import write_html
from tests.report.browser import WIDTHS, chromium, fits, keep, needs_browser, opened
from tests.report.stored import stored

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = needs_browser

PIXELS = """(name) => {
  const plot = congelation.model(name);
  const range = plot.y_range;
  return [range.start, range.end];
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def run_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    file = folder / "report.html"
    write_html(stored(folder), file)
    return file


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_of_a_run_is_cut(browser: Browser, run_page: Path, width: int) -> None:
    with opened(browser, run_page, width) as page:
        assert fits(page)
        keep(page, f"run-{width}")


def test_the_scale_changes_the_plot(browser: Browser, run_page: Path) -> None:
    """u has peaks 1,000 and 1: symmetric logarithmic at first, linear when asked."""
    with opened(browser, run_page) as page:
        plot = page.evaluate(
            "Object.entries(congelation.scales).find(([, s]) => s.mode === 'symlog')[0]"
        )
        before = page.evaluate(PIXELS, plot)
        page.get_by_label("Scale").select_option("linear")
        page.wait_for_function(f"congelation.model('{plot}').y_range.end > 500")
        after = page.evaluate(PIXELS, plot)
    assert before[1] < 10 < 1000 < after[1]


def test_a_variant_can_be_hidden_by_the_keyboard(browser: Browser, run_page: Path) -> None:
    with opened(browser, run_page) as page:
        rows = page.locator('tr[data-variant="1"]:visible')
        assert rows.count() > 0
        page.get_by_label("Controller 2").focus()
        page.keyboard.press("Space")
        assert rows.count() == 0
        hidden = page.evaluate(
            """[...Bokeh.documents[0]._all_models.values()].filter((m) =>
               m.type === "GlyphRenderer" && m.tags.includes("variant 1") && m.visible).length"""
        )
    assert hidden == 0


def test_the_cursor_reads_all_panels(browser: Browser, run_page: Path) -> None:
    """At t = 5 of 10 s, u = exp(-5) and 1000 exp(-5)."""
    with opened(browser, run_page) as page:
        slider = page.get_by_label("Cursor")
        slider.fill("5")
        cells = page.locator("section", has_text="controller.u").locator("td[data-curve]")
        assert [float(text) for text in cells.all_text_contents()] == pytest.approx(
            [6.74, 6.74e-3], rel=1e-3
        )
        assert page.locator("output.time").first.text_content() == "t = 5 s"
        canvas = page.locator(".plot").first
        canvas.hover(position={"x": 300, "y": 120})
        page.wait_for_function("document.querySelector('output.time').textContent !== 't = 5 s'")


def test_dark_mode_and_print(browser: Browser, run_page: Path, tmp_path: Path) -> None:
    def ground() -> list[str]:
        found: list[str] = page.evaluate(
            """[getComputedStyle(document.body).backgroundColor, [...Bokeh.documents[0]
                ._all_models.values()].find((m) => m.type === "Figure").background_fill_color]"""
        )
        return found

    with opened(browser, run_page, scheme="dark") as page:
        assert ground() == ["rgb(20, 23, 26)", "#14171a"]
        keep(page, "run-dark")
    with opened(browser, run_page) as page:
        assert ground() == ["rgb(255, 255, 255)", "#ffffff"]
        page.emulate_media(color_scheme="dark")
        page.wait_for_function(
            """[...Bokeh.documents[0]._all_models.values()].find((m) =>
               m.type === "Figure").background_fill_color === "#14171a" """
        )
        page.pdf(path=tmp_path / "run.pdf", format="A4")
        assert (tmp_path / "run.pdf").read_bytes().startswith(b"%PDF")
