"""The documentation as a site: no warning, its examples run, all links lead somewhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest
import typer
from lxml import html

from congelation.cli import app
from tests.report.browser import WIDTHS, chromium, needs_browser
from tests.scenarios import ROOT


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-E", "docs", folder / "html"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return folder / "html"


@pytest.mark.slow
def test_links(site: Path) -> None:
    trees = {page.resolve(): html.parse(page) for page in site.rglob("*.html")}
    anchors = {page: set(tree.xpath("//@id | //a/@name")) for page, tree in trees.items()}
    broken = []
    for page, tree in trees.items():
        for link in tree.xpath("//a/@href | //img/@src"):
            address, anchor = urldefrag(unquote(link))
            if "://" in address or address.startswith(("mailto:", "data:")):
                continue
            target = (page.parent / address).resolve() if address else page
            if not target.exists() or (
                target in anchors and anchor and anchor not in anchors[target]
            ):
                broken.append(f"{page.relative_to(site.resolve())}: {link}")
    assert not broken


@pytest.mark.slow
def test_no_page_fetches_anything_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        sources = html.parse(page).xpath("//script/@src | //link[@rel='stylesheet']/@href")
        assert not [source for source in sources if "://" in source], page


@pytest.mark.slow
def test_figures_and_equations_are_in_the_pages(site: Path) -> None:
    """Figures that code cells draw, and what each FMU is, from its own page."""
    for name in ("start", "tutorials/own_plant"):
        assert html.parse(site / f"{name}.html").xpath("//*[contains(@class, 'cell_output')]//img")
    for page in (site / "generated/fmus").glob("*.html"):
        assert len(html.parse(page).xpath("//article//h1/following-sibling::p")) > 1, page


@pytest.mark.slow
@needs_browser
def test_no_page_is_wider_than_its_window(site: Path) -> None:
    """Tables, code and long formulas scroll, or are broken into lines, in boxes of their own."""
    pages = [*site.glob("*.html"), *site.glob("*/*.html"), site / "generated/fmus/Delay.html"]
    too_wide = []
    with chromium() as browser:
        window = browser.new_page()
        for page in pages:
            window.goto(page.absolute().as_uri(), wait_until="domcontentloaded")
            for width in (*WIDTHS, 1400):  # from 1400 on there is room for both side bars
                window.set_viewport_size({"width": width, "height": 900})
                if window.evaluate("document.documentElement.scrollWidth > innerWidth"):
                    too_wide.append((page.name, width))
    assert not too_wide


COLUMNS = 100  # of code

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("*/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_fits_beside_the_navigation(page: Path) -> None:
    """As many characters as the page is wide on a screen of 1400 pixels."""
    fence = None  # what a block between ``` is, while in one
    for line in page.read_text("utf-8").splitlines():
        if line.strip().startswith("```"):
            fence = line.strip()[3:] if fence is None else None
        elif line.startswith("    ") if fence is None else fence != "math":
            assert len(line.removeprefix("    ")) <= COLUMNS, line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_in_pages_exist_with_their_options(page: Path) -> None:
    """Indented lines ``congelation COMMAND --option``; comments after # are left out."""
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for line in page.read_text("utf-8").splitlines():
        if not line.startswith("    congelation ") or "generated" in page.parts:
            continue
        _, name, *words = line.partition(" #")[0].replace("[", " ").replace("]", " ").split()
        if name in ("COMMAND", "--version", "--help") or name.endswith(":"):
            continue
        options = {option for p in known[name].params for option in (*p.opts, *p.secondary_opts)}
        given = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert given <= options | {"--help"}, line
