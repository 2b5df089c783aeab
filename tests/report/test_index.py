"""The page that links several result directories."""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote

import pytest

from congelation.errors import InvalidInput
from congelation.report.index import write_index


def test_every_report_and_figure_is_linked(tmp_path: Path) -> None:
    for name in ("a study", "b"):
        (tmp_path / name / "figures").mkdir(parents=True)
        (tmp_path / name / "runs.parquet").touch()
        (tmp_path / name / "figures" / "x&y.png").touch()
    (tmp_path / "b" / "report.html").write_text(
        '<title>Of x &lt; 1</title><div class="verdict">\n<p>A settles.</p>\n</div>'
    )
    (tmp_path / "no results").mkdir()
    text = write_index(tmp_path).read_text("utf-8")
    links = {unquote(link) for link in re.findall(r'href="([^"]+)"', text)}
    assert links == {
        "a study/figures/x&y.png",
        "a study/runs.parquet",
        "b/figures/x&y.png",
        "b/report.html",
        "b/runs.parquet",
    }
    assert all((tmp_path / link).is_file() for link in links)
    assert "<h2>a study</h2>" in text
    assert re.search(r"<h2>Of x &lt; 1</h2>\s*<p>A settles\.</p>\s*<p>\s*<a", text)


def test_a_folder_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no result directory in it"):
        write_index(tmp_path)
