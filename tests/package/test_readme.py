"""The lines of Python in README, as a script without a guard and from standard input."""

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


@pytest.mark.parametrize("standard_input", [False, True])
def test_lines_of_the_readme(tmp_path: Path, standard_input: bool) -> None:
    (tmp_path / "specs").mkdir()
    shutil.copy(ROOT / "specs" / "f16_pitch.toml", tmp_path / "specs")
    (tmp_path / "lines.py").write_text(LINES, "utf-8")
    done = subprocess.run(
        [sys.executable, "-" if standard_input else "lines.py"],
        input=LINES if standard_input else None,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    for name in ("Controller 1", "Controller 2"):
        assert name in done.stdout
    assert (tmp_path / "f16.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "results" / "f16" / "runs.parquet").is_file()
