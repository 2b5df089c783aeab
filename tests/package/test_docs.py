"""The documentation: its site has no warning and no broken link, and its examples run."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urldefrag

import numpy as np
import pytest
import typer
from lxml import html

import congelation as cg
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


def test_the_sections_that_messages_name_are_there() -> None:
    sources = "\n".join(file.read_text("utf-8") for file in (ROOT / "congelation").rglob("*.py"))
    joined = re.sub(r'"\s*f?"', "", sources)  # a message of more lines than one
    named = set(re.findall(r"\(docs/(\w+)\.md, '([^'{]+)'\)", joined))
    named |= {("theory", s) for s in re.findall(r'section = "([^"]+)" if .* else', sources)}
    assert len(named) > 5
    for page, section in named:
        text = (ROOT / "docs" / f"{page}.md").read_text("utf-8")
        assert re.search(rf"^#+ {re.escape(section)}\b", text, re.MULTILINE), (page, section)


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
def test_formulas_are_understood(site: Path) -> None:
    """A command that the converter does not know would stay in the formula as it is."""
    for page in site.glob("*.html"):
        for formula in html.parse(page).iter("math"):
            assert "\\" not in formula.text_content(), page


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
            for width in (WIDTHS[0], 1400):  # a phone; room for both side bars
                window.set_viewport_size({"width": width, "height": 900})
                if window.evaluate("document.documentElement.scrollWidth > innerWidth"):
                    too_wide.append((page.name, width))
    assert not too_wide


COLUMNS = 100  # of code

PAGES = [
    page
    for page in sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
    if "generated" not in page.parts  # written by the build
]


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
        if not line.startswith("    congelation "):
            continue
        _, name, *words = line.partition(" #")[0].replace("[", " ").replace("]", " ").split()
        if name in ("COMMAND", "--version", "--help") or name.endswith(":"):
            continue
        options = {option for p in known[name].params for option in (*p.opts, *p.secondary_opts)}
        given = {word.partition("=")[0] for word in words if word.startswith("--")}
        assert given <= options | {"--help"}, line


FOLDERS = ("congelation", "fmu_src", "specs", "scenarios", "tests", "benchmarks")
FILES = [f"/{file.relative_to(ROOT)}" for name in FOLDERS for file in (ROOT / name).rglob("*")]
FILES += [f"/{file.name}" for file in ROOT.iterdir()]
PACKAGES = {file.parent.name for file in (ROOT / "congelation").glob("*/__init__.py")}
PLACEHOLDER = "NAME"  # what a reader puts there


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem)
def test_modules_and_files_in_pages_exist(page: Path) -> None:
    for code in re.findall(r"(?<!`)`([\w./-]+)`(?!`)", page.read_text("utf-8")):
        name = code.rstrip("/")
        if PLACEHOLDER in name:
            continue
        in_repository = "/" in name and name.partition("/")[0] in {*FOLDERS, *PACKAGES}
        if name.endswith(".py") or (in_repository and not name.startswith("results/")):
            assert any(file.endswith(f"/{name}") for file in FILES), code
        elif name.endswith(".html"):
            continue  # a page that a command writes
        elif "." in name and name.removeprefix("congelation.").partition(".")[0] in PACKAGES:
            # A module, or what a module holds.
            found: object = cg
            path = "congelation"
            for part in name.removeprefix("congelation.").split("."):
                path = f"{path}.{part}"
                file = ROOT / path.replace(".", "/")
                is_module = file.is_dir() or file.with_suffix(".py").exists()
                found = import_module(path) if is_module else getattr(found, part)


def python_of(page: str) -> list[str]:
    """The blocks of Python in a page, as they stand there."""
    text = (ROOT / "docs" / page).read_text("utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with what the pages name, in which their blocks run."""
    (tmp_path / "fmus").symlink_to(ROOT / "fmus")
    (tmp_path / "build").mkdir()
    for name in ("Model.fmu", "build/Gearbox.fmu"):
        shutil.copy(ROOT / "fmus/ScalarPlant.fmu", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_python_of_the_master_and_of_error_bars(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The block on error bars goes on with the system of the one on the master."""
    names: dict[str, Any] = {}
    for block in (*python_of("cosim.md"), *python_of("trust.md")):
        exec(block.replace("stop_time=10.0", "stop_time=0.2"), names)
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("COMPLETED")
    assert "peak" in said[1]


def test_python_of_scenarios_and_archives(place: Path) -> None:
    names = {name: getattr(cg, name) for name in cg.__all__}
    (block,) = python_of("scenarios.md")
    exec(block, names)
    cg.export_ssp(names["scenario"], place / "fig2.ssp")
    (block,) = python_of("howto/ssp.md")
    exec(block, names)
    assert [run.status for run in names["results"].runs] == ["COMPLETED"]


def test_python_of_a_metric() -> None:
    """|v| = t/2 up to 2 has passed 0.9 of its largest value at 3.6."""
    (block,) = python_of("howto/metrics.md")
    names: dict[str, Any] = {}
    exec(block, names)
    time = np.linspace(0.0, 4.0, 41)
    assert names["rise"](time, time[:, np.newaxis] / 2) == pytest.approx(3.6, abs=0.11)
    assert names["rise_time"].unit("m") == "s"


@pytest.mark.parametrize("page", ["conformance.md", "tutorials/ci.md"])
def test_python_of_the_checker(place: Path, page: str) -> None:
    (block,) = python_of(page)
    names: dict[str, Any] = {}
    exec(block, names)
    assert names["report"].fmus[0].verdicts


def test_every_page_with_python_is_run_by_a_test() -> None:
    """Here, or by `tests/signals`; the build runs code cells, doctests the sessions."""
    here = {"cosim.md", "trust.md", "scenarios.md", "howto/metrics.md", "howto/ssp.md",
            "conformance.md", "tutorials/ci.md"}  # fmt: skip
    docs = ROOT / "docs"
    found = {str(p.relative_to(docs)) for p in PAGES if p.is_relative_to(docs)}
    assert {page for page in found if python_of(page)} == here | {"signals.md"}
