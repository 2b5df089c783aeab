"""``congelation sweep --scheduler --ship``: workers that reach none of the parent's files.

The parent names all of its files through /proc/self/cwd, which is another folder for each process
that has another current folder: for the workers, nothing of it is there.
"""

from __future__ import annotations

import hashlib
import shutil
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path

import pytest

from congelation.results.store import Store
from tests.cli.test_cli_cluster import cluster, processes
from tests.cli.test_cli_sweep import rows
from tests.cli.test_cli_sweep_forms import HANG
from tests.scenarios import FMUS, SCALAR, write
from tests.studies import command, install
from tests.studies import last_line as one_line

__all__ = ["cluster", "processes"]  # fixtures

pytestmark = pytest.mark.slow

HERE = "/proc/self/cwd"

AXES = """
[sweep]
trajectories = true
timeout = 60
[[sweep.axes]]
set = "controller.epsilon"
values = [0.3, 0.6, 1.0]
[[sweep.axes]]
set = "plant.profile.theta[1]"
values = [
    [{constant = -3.0}, {table = {file = "slow.csv", linear = true}}],
    [{constant = -3.0}, {table = {file = "fast.csv", linear = true}}],
]
"""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder of this process, the parent: scenario, FMUs and tables."""
    home = tmp_path / "home"
    home.mkdir()
    for name in ("ScalarPlant.fmu", "ScalarController.fmu"):
        shutil.copy(FMUS / name, home)
    (home / "slow.csv").write_text("0,0\n1,0.5\n")
    (home / "fast.csv").write_text("0,0\n0.2,0.5\n0.4,-0.5\n")
    write(home, SCALAR + AXES, (str(FMUS), HERE))
    monkeypatch.chdir(home)
    return home


def sweep(out: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return command("sweep", f"{HERE}/loop.toml", "--out", f"{HERE}/{out}", *arguments)


@pytest.mark.workers
def test_files_go_out_and_results_come_back(home: Path, tmp_path: Path, cluster: str) -> None:
    here = sweep("here")
    assert here.returncode == 0, here.stderr
    expected = rows(home / "here")
    assert {row["status"] for row in expected} == {"COMPLETED"}
    assert {row["set.plant.profile[1].table.file"] for row in expected} == {
        f"{HERE}/slow.csv",
        f"{HERE}/fast.csv",
    }

    line = one_line(sweep("unreachable", "--scheduler", cluster), 2)
    assert f"no FMU at {HERE}/ScalarPlant.fmu" in line  # so they cannot be reached

    there = sweep("there", "--scheduler", cluster, "--ship")
    assert there.returncode == 0, there.stderr
    assert "12 of 12 runs, 0 failed" in there.stderr
    assert rows(home / "there") == expected
    for row in expected:
        mine, its = (Store(home / out).trajectory_file(row["run_id"]) for out in ("here", "there"))
        assert its.read_bytes() == mine.read_bytes()
    assert {entry.name for entry in tmp_path.iterdir()} - {"home"} <= {
        "dask.log",
        "dask-scratch-space",
        "scheduler.json",
    }
    cached = list(tmp_path.glob("dask-scratch-space/*/congelation/*/*.*"))
    # A worker has what its runs need, each file once; which runs it is given is not known.
    fmus, tables = {"ScalarPlant.fmu", "ScalarController.fmu"}, {"slow.csv", "fast.csv"}
    assert {file.name for file in cached} == fmus | tables
    for worker in {file.parents[1] for file in cached}:
        names = [file.name for file in cached if file.parents[1] == worker]
        assert len(names) == len(set(names))
        assert fmus < set(names)
    for file in cached:
        assert hashlib.sha256(file.read_bytes()).hexdigest() == file.parent.name
    sent = {file: file.stat().st_mtime_ns for file in cached}

    with closing(sqlite3.connect(Store(home / "there").database)) as connection:
        connection.execute("DELETE FROM runs WHERE run_id = ?", (expected[3]["run_id"],))
        connection.commit()
    again = sweep("there", "--scheduler", cluster, "--ship", "--resume")
    assert (again.returncode, "1 of them to do" in again.stdout) == (0, True)
    assert rows(home / "there") == expected
    assert {file: file.stat().st_mtime_ns for file in cached} == sent  # sent once


def test_a_run_that_hangs_far_away_is_ended(
    home: Path, tmp_path: Path, cluster: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "hang", HANG)
    monkeypatch.syspath_prepend(tmp_path)
    axis = '[sweep]\ntimeout = 3\n[[sweep.axes]]\nset = "plant.x0"\nvalues = [0, 2, 1]\n'
    metric = '[metrics]\nh = {metric = "hang", of = "plant.x"}'
    one = ('[[variants]]\nname = "Controller 2"\nset = {"controller.damping" = false}', "")
    write(home, SCALAR + axis, ("[metrics]", metric), one, (str(FMUS), HERE))
    done = sweep("out", "--scheduler", cluster, "--ship")
    assert done.returncode == 1, done.stderr
    found = {row["set.plant.x0[1]"]: row["status"] for row in rows(home / "out")}
    assert found == {0.0: "COMPLETED", 2.0: "TIMED_OUT", 1.0: "COMPLETED"}


def test_ship_needs_a_scheduler(home: Path) -> None:
    assert "--ship needs a --scheduler" in one_line(sweep("out", "--ship"), 2)
