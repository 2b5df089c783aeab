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


PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs").glob("*/*.md")])


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
