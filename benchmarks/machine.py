"""What the numbers were measured on; no names of hosts or users."""

from __future__ import annotations

import datetime
import importlib.metadata
import os
import platform
import re
from pathlib import Path

__all__ = ["description"]

PACKAGES = ("fmpy", "pythonfmu", "numpy", "scipy", "casadi", "libcosimpy", "ecospy")
COFMUPY = Path(__file__).absolute().parent.parent / "requirements-cofmupy.lock"


def description(command: str) -> list[str]:
    """Lines of Markdown: date, processor, system, versions, and the command of the run."""
    today = datetime.datetime.now(tz=datetime.UTC).date().isoformat()
    versions = [f"{name} {importlib.metadata.version(name)}" for name in PACKAGES]
    locked = re.search(r"^cofmupy==(\S+)", COFMUPY.read_text("utf-8"), re.MULTILINE)
    if locked is not None:
        versions.append(f"cofmupy {locked[1]}")
    return [
        f"- {today}, `{command}`",
        f"- {_processor()}, {os.cpu_count()} logical processors, "
        f"{platform.system()} {platform.release().split('-')[0]} {platform.machine()}",
        f"- {platform.python_implementation()} {platform.python_version()}; " + ", ".join(versions),
    ]


def _processor() -> str:
    """The model's name where the system tells it."""
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()
