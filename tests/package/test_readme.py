"""The lines of Python in README: a script without a guard, from standard input, in a notebook."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.scenarios import ROOT

(LINES,) = re.findall(
    r"^```python\n(.*?)^```", (ROOT / "README.md").read_text("utf-8"), re.M | re.S
)


def test_ten_lines() -> None:
    assert sum(bool(line) for line in LINES.splitlines()) == 10


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What the lines need of a checkout."""
    (tmp_path / "specs").mkdir()
    shutil.copy(ROOT / "specs" / "f16_pitch.toml", tmp_path / "specs")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("standard_input", [False, True])
def test_lines_of_the_readme(folder: Path, standard_input: bool) -> None:
    (folder / "lines.py").write_text(LINES, "utf-8")
    done = subprocess.run(
        [sys.executable, "-" if standard_input else "lines.py"],
        input=LINES if standard_input else None,
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    head, *rows = (line.split() for line in done.stdout.splitlines())
    assert head[-2:] == ["controller.damping", "settling"]
    assert [row[1:5] for row in rows] == [
        ["Controller", "1", "COMPLETED", "True"],
        ["Controller", "2", "COMPLETED", "False"],
    ]
    assert 0.0 < float(rows[0][-1]) < float(rows[1][-1]) < 10.0  # Controller 1 settles earlier
    assert (folder / "results/f16/f16.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "results" / "f16" / "runs.parquet").is_file()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the notebook's own libraries
def test_lines_of_the_readme_in_a_notebook(folder: Path) -> None:
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    cells = [nbformat.v4.new_code_cell(source) for source in (LINES, "results")]
    notebook = nbformat.v4.new_notebook(cells=cells)
    resources = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources=resources
    ).execute()
    outputs = str(notebook.cells[0].outputs)
    assert "Controller 2" in outputs
    assert "2 of 2 runs, 0 failed" in outputs
    assert "<table>" in str(notebook.cells[1].outputs)
