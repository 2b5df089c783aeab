"""The side of a sweep in the worker processes."""

import multiprocessing
import subprocess
import sys
from pathlib import Path

from congelation.results.store import Store
from congelation.scenario.load import load_scenario
from congelation.sweep.workers import Work, work
from tests.scenarios import write

HEAVY = ("scipy", "matplotlib", "casadi", "typer", "rich", "congelation.cli")


def test_a_worker_starts_without_what_it_may_not_need() -> None:
    """Its main module is the command's, imported anew in every worker."""
    code = (
        "import sys, congelation.__main__, congelation.sweep.workers; "
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )

    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )

    assert found.stdout.strip() == "[]"


def test_a_worker_tells_its_own_memory_not_its_parents(tmp_path: Path) -> None:
    shared = Work(load_scenario(write(tmp_path)), Store(tmp_path / "out"), (), False, 0)
    ballast = bytearray(800_000_000)
    ballast[::4096] = b"x" * len(ballast[::4096])
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        told = pool.apply(work, (shared, ())).memory

    assert 2e7 < told < 5e8
    assert len(ballast) == 800_000_000
