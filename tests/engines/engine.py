"""Runs a job in an external engine, in a process of its own: engines crash, and need their own
environment."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import files
from pathlib import Path

HOSTS = Path(__file__).parent / "hosts"
COFMUPY = Path(__file__).parents[2] / ".venv-cofmupy" / "bin" / "python"


def run(
    host: str,
    job: dict[str, object],
    folder: Path,
    *,
    python: Path | str = sys.executable,
    environment: dict[str, str] | None = None,
) -> dict[str, list[float]]:
    """The rows that hosts/<host>.py makes of a job: by column, and the labels under ``time``."""
    folder.mkdir(parents=True, exist_ok=True)
    request, answer = folder / "job.json", folder / "rows.json"
    request.write_text(json.dumps(job))
    done = subprocess.run(
        [str(python), "-I", str(HOSTS / f"{host}.py"), str(request), str(answer)],
        cwd=folder,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    rows: dict[str, list[float]] = json.loads(answer.read_text())
    return rows


def tbb() -> dict[str, str]:
    """The environment in which Ecos finds its library libtbb.so.12, which pip puts aside."""
    libraries = [f for f in files("tbb") or () if f.name == "libtbb.so.12"]
    return {"LD_LIBRARY_PATH": str(Path(libraries[0].locate()).resolve().parent)}


def cofmupy() -> Path:
    """The interpreter of the environment that `make test` makes for CoFmuPy."""
    assert COFMUPY.exists(), "run `make .venv-cofmupy/installed`"
    return COFMUPY
