"""Runs a job in an external engine, in a process of its own: engines crash, and need their own
environment."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import files
from pathlib import Path
from typing import Any

HOSTS = Path(__file__).parent / "hosts"
COFMUPY = Path(__file__).parents[2] / ".venv-cofmupy" / "bin" / "python"


def run(
    host: str,
    job: dict[str, object],
    folder: Path,
    *,
    python: Path | str = sys.executable,
    environment: dict[str, str] | None = None,
) -> dict[str, Any]:
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
    rows: dict[str, Any] = json.loads(answer.read_text())
    return rows


def installed(package: str, name: str) -> Path:
    """A file that a package has installed."""
    return next(Path(f.locate()).resolve() for f in files(package) or () if f.name == name)


def ecos(folder: Path) -> dict[str, str]:
    """The environment that Ecos needs.

    Its library looks for libtbb.so.12, which pip puts where no loader looks, and unpacks archives
    with the command unzip, which not every machine has.
    """
    commands = folder / "commands"
    commands.mkdir(parents=True, exist_ok=True)
    unzip = commands / "unzip"  # -o ARCHIVE -d FOLDER
    unzip.write_text(
        f"#!{sys.executable}\n"
        "import sys, zipfile\n"
        "zipfile.ZipFile(sys.argv[2]).extractall(sys.argv[4])\n"
    )
    unzip.chmod(0o755)
    return {
        "LD_LIBRARY_PATH": str(installed("tbb", "libtbb.so.12").parent),
        "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
    }


def cofmupy() -> Path:
    """The interpreter of the environment that `make test` makes for CoFmuPy."""
    assert COFMUPY.exists(), "run `make .venv-cofmupy/installed`"
    return COFMUPY
