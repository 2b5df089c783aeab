"""The pages in a real browser: no error, no request, controls that work, nothing cut off."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from congelation.report.comparison_page import write_comparison
from congelation.report.run_page import write_html
from tests.report.browser import WIDTHS, chromium, fits, keep, needs_browser, opened
from tests.report.stored import record, results, stored, stored_study, trajectory

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


@pytest.fixture(scope="module")
def study_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    file = folder / "report.html"
    write_html(stored_study(folder), file)
    return file


@pytest.fixture(scope="module")
def comparison_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("comparison")
    entries = [(record("r1", 1), trajectory(900.0)), (record("r2", 2), trajectory(1.0))]
    new = results(folder / "new", entries, scenario='title = "Other"\n')
    file = folder / "comparison.html"
    write_comparison([stored(folder / "old"), new], file)
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


def test_paper_is_light(browser: Browser, run_page: Path) -> None:
    """Colours of the first curve and of its ground, as they are drawn when a browser prints."""
    drawn = """(event) => {
      window.dispatchEvent(new Event(event));
      const plot = Object.values(Bokeh.index)[0];
      const drawn = [...plot.renderer_views.values()];
      const curve = drawn.find((v) => v.model.tags.includes("variant 0"));
      return [plot.model.background_fill_color, String(curve.glyph.line_color.value)];
    }"""
    with opened(browser, run_page, scheme="dark") as page:
        assert page.evaluate(drawn, "beforeprint") == ["#ffffff", "#0072b2"]
        assert page.evaluate(drawn, "afterprint") == ["#14171a", "#56a8e0"]


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_of_a_comparison_is_cut(
    browser: Browser, comparison_page: Path, width: int
) -> None:
    with opened(browser, comparison_page, width, "dark" if width == WIDTHS[0] else "light") as page:
        assert fits(page)
        keep(page, f"comparison-{width}")


def test_a_comparison_overlays_its_directories(browser: Browser, comparison_page: Path) -> None:
    """u was 1000 exp(-t) and is 900 exp(-t); exp(-t) of Controller 2 is one curve of both."""
    with opened(browser, comparison_page) as page:
        page.get_by_label("Cursor").fill("0")
        row = page.locator("section", has_text="controller.u").locator("tbody tr")
        at_start = [float(cell) for cell in row.locator("td[data-curve]").all_text_contents()]
        assert at_start == [1000.0, 900.0, 1.0]
        shared = "Controller 2, old; Controller 2, new"
        assert row.locator("small").all_text_contents() == [
            "Controller 1, old",
            "Controller 1, new",
            shared,
        ]
        drawn = "[...congelation.bokeh()._all_models.values()].filter((m) => m.visible && m.tags"
        drawn += ".join() === 'variant 2,variant 3').length"
        for label, rows in (("1, old", 2), ("2, old", 2), ("2, new", 1)):
            page.get_by_label(f"Controller {label}").uncheck()
            assert row.locator("small:visible").count() == rows
            assert (page.evaluate(drawn) > 0) == (rows > 1)
        page.get_by_label("Controller 2, old").check()
        assert row.locator("small:visible").all_text_contents() == ["Controller 1, new", shared]


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_of_a_study_is_cut(browser: Browser, study_page: Path, width: int) -> None:
    with opened(browser, study_page, width) as page:
        assert fits(page)
        keep(page, f"study-{width}")


def test_paper_has_all_of_a_study(browser: Browser, study_page: Path) -> None:
    """On A4 no table is wider than the paper, and the tools and cursors of plots are left out."""
    with opened(browser, study_page, 718) as page:
        page.emulate_media(media="print")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        tables = """[...document.querySelectorAll("table")].filter((t) =>
            t.getBoundingClientRect().right > innerWidth).map((t) => t.innerText.slice(0, 60))"""
        assert page.evaluate(tables) == []
        tools = """(() => {
          const under = (root) => [...root.querySelectorAll("*")].flatMap((e) =>
            [e, ...(e.shadowRoot ? under(e.shadowRoot) : [])]);
          return under(document).filter((e) => e.matches(".bk-Toolbar, .at")
            && e.getBoundingClientRect().width > 0).length;
        })()"""
        assert page.evaluate(tools) == 0
        page.emulate_media(media="screen")
        assert page.evaluate(tools) > 0


def test_selectors_change_the_plot_of_a_study(browser: Browser, study_page: Path) -> None:
    """Medians of Controller 1: settling times 1 and 2, peaks of u 50 and 100."""
    medians = "[...congelation.model('metric.line.0').data.median]"
    with opened(browser, study_page) as page:
        assert page.evaluate(medians) == [1.5, 1.5, 1.5, 1.5]
        page.locator("#metric-axis").select_option("plant.a")
        assert page.evaluate(medians) == [1, 2]
        page.locator("#metric-metric").select_option("peak_u")
        page.locator("#metric-scale").select_option("linear")
        assert page.evaluate(medians) == [50, 100]
        numbers = page.locator("#metric-numbers tbody tr").first.locator("td, th")
        assert numbers.all_text_contents()[:2] == ["Controller 1", "1"]


def test_what_never_settles_is_drawn_above_all_else(browser: Browser, study_page: Path) -> None:
    with opened(browser, study_page) as page:
        ceiling = page.evaluate("congelation.scales['metric.y'].ceiling")
        line = page.evaluate("[...congelation.model('metric.line.1').data.median]")
        assert line[:2] == [3, 3]
        assert line[2:] == [ceiling, ceiling]
        assert ceiling > 4
        assert (
            page.evaluate("congelation.tick('metric.y', congelation.scales['metric.y'].ceiling)")
            == "not settled"
        )


def test_a_point_and_a_row_open_a_run(browser: Browser, study_page: Path) -> None:
    drawn = "[...congelation.model('controller.u: controller.u').data.value].slice(0, 1)"
    with opened(browser, study_page) as page:
        assert page.locator("#trajectories").is_hidden()
        # A click where the first point of Controller 2 is drawn.
        place = page.evaluate(
            """(() => {
              const source = congelation.model("metric.points.1");
              const plot = congelation.model("metric");
              const view = Bokeh.index.find_one(plot);
              view.el.scrollIntoView({block: "center"});
              const box = view.el.getBoundingClientRect();
              const [x, y] = [source.data.x[0], source.data.y[0]];
              return [box.x + view.frame.x_scale.compute(x),
                      box.y + view.frame.y_scale.compute(y)];
            })()"""
        )
        page.mouse.click(*place)
        page.wait_for_function("document.getElementById('picked').textContent.includes('r02')")
        assert page.evaluate(drawn) == [1.0]  # u = exp(-t)
        numbers = page.locator("#trajectories section", has_text="controller.u").locator("td")
        assert numbers.first.text_content() == "1"
        assert page.locator("#trajectories").is_visible()
        keep(page, "study-run")
        row = page.locator('#runs tr[data-run="r72"]')
        row.focus()
        page.keyboard.press("Enter")
        picked = page.locator("#picked").text_content() or ""
        assert "plant: x[1] <too> large" in picked
        assert "trajectories/r72.parquet" in picked


def test_the_table_filters_and_sorts(browser: Browser, study_page: Path) -> None:
    with opened(browser, study_page) as page:
        page.locator("#filter-text").fill("omega > 10")
        assert page.evaluate("congelation.study.kept()") == ["r61", "r62", "r71", "r72"]
        page.locator("#filter-text").fill("")
        page.locator("#filter-status").select_option("DIVERGED")
        assert page.evaluate("congelation.study.kept()") == ["r72"]
        page.locator("#filter-status").select_option("")
        heading = page.get_by_role("button", name="peak_x")
        heading.click()
        heading.click()
        assert page.evaluate("congelation.study.kept()")[0] == "r71"
        assert page.locator("th[aria-sort=descending]").count() == 1
