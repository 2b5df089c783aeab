"""`congelation open` in a fresh process, with a browser of our own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.report.stored import stored


def open_with(browser: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `congelation open folder` where `browser` is the only one."""
    own = {"BROWSER": browser, "PATH": ""}
    elsewhere = ("DISPLAY", "WAYLAND_DISPLAY", "TERM")  # no browser is looked for without these
    environment = {k: v for k, v in os.environ.items() if k not in elsewhere} | own
    return subprocess.run(
        [sys.executable, "-m", "congelation", "open", str(folder)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "two runs"
    stored(place)
    return place


def test_the_page_is_written_and_given_to_the_browser(folder: Path, tmp_path: Path) -> None:
    browser, seen = tmp_path / "browser", tmp_path / "seen"
    browser.write_text(f'#!/bin/sh\nprintf "%s\\n" "$@" > "{seen}"\n')
    browser.chmod(0o755)
    done = open_with(f"{browser} %s", folder)
    page = folder / "report.html"
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{page}\n", "")
    assert seen.read_text() == f"{page.as_uri()}\n"
    assert "Two &lt;runs&gt;" in page.read_text("utf-8")


def test_without_a_browser_the_page_is_named(folder: Path, tmp_path: Path) -> None:
    done = open_with(str(tmp_path / "absent"), folder)
    page = folder / "report.html"
    assert done.stdout == f"{page}\n"
    assert "there is no browser to show it in" in done.stderr
    assert str(page) in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 0
    assert page.is_file()
