"""The HTML report: one file, self-contained, well-formed, with everything that was stored."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from congelation.errors import CongelationError, InvalidInput
from congelation.report.html import write_html
from congelation.results.store import Store
from tests.report.stored import stored, stored_failures

VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Collects text, checks that every element is closed in its turn."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.sources: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.sources += [str(value) for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def page(store: Store, file: Path) -> Page:
    write_html(store, file)
    parser = Page()
    parser.feed(file.read_text(encoding="utf-8"))
    assert parser.open == []
    return parser


def test_the_report_holds_what_was_stored(tmp_path: Path) -> None:
    found = page(stored(tmp_path), tmp_path / "report.html")
    for text in (
        "Two <runs>",
        "Controller 1",
        "peak_x [m]",
        "1.235",
        "never",
        "max |v| & more",
        "Plant.fmu",
        "5e1f",
        "0.1.0+abc",
        'title = "Two <runs>"',
        "r1",
    ):
        assert text in found.text, text


def test_the_report_needs_no_other_file(tmp_path: Path) -> None:
    found = page(stored(tmp_path), tmp_path / "report.html")
    assert len(found.sources) == 2
    for source in found.sources:
        kind, _, data = source.partition(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data, validate=True).startswith(b"\x89PNG")
    assert not re.search(r"https?://|@import|<script", (tmp_path / "report.html").read_text())


def test_failures_and_deviations_are_told(tmp_path: Path) -> None:
    failed = page(stored_failures(tmp_path / "a"), tmp_path / "a.html")
    assert "Controller 1: plant: <too> large" in failed.text
    assert "DIVERGED" in failed.text
    deviation = {"variable": "plant.x[1]", "error": 2e-5, "relative": 1.5e-5}
    verified = page(stored(tmp_path / "b", verification={"r1": [deviation]}), tmp_path / "b.html")
    assert "error of plant.x[1] / peak" in verified.text
    assert "1.5e-05" in verified.text


def test_places_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="is no result directory"):
        write_html(Store(tmp_path), tmp_path / "report.html")
    store = stored(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(CongelationError, match=r"report\.html cannot be written"):
        write_html(store, tmp_path / "file" / "report.html")
