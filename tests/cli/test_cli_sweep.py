"""``congelation sweep`` with real processes that die, are killed, interrupted and resumed."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from congelation.results.results import Results
from congelation.results.store import Store
from tests.scenarios import SCALAR, write
from tests.studies import children, command, environment, install, is_alive, process, start, until
from tests.studies import rows as stored

pytestmark = pytest.mark.slow

POINTS = 12
LONG = ("stop_time = 1.0", "stop_time = 15.0")  # a run takes a few tenths of a second

# A run that takes its time without work, in processes whose environment says so.
PACED = """
import os, time
from congelation.scenario.metrics import Metric

def paced(t, values):
    time.sleep(float(os.environ.get("SECONDS_OF_A_RUN", "0")))
    return 0.0

metric = Metric("paced", paced, "takes some time", str)
"""
PACE = {"SECONDS_OF_A_RUN": "0.25"}

SWEEP = f"""
[sweep]
samples = {POINTS}
sampling = "latin_hypercube"
[[sweep.axes]]
set = "controller.epsilon"
log_uniform = [0.2, 1.0]
"""


def sweep(file: Path, out: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return command("sweep", file, "--out", out, *arguments)


def rows(out: Path) -> list[dict[str, Any]]:
    """The records, in order of the plan."""
    return stored(out)


def write_paced(folder: Path) -> Path:
    """A scenario with a sweep, and its metric, installed in the same folder."""
    install(folder, "paced", PACED)
    metric = "[metrics]", '[metrics]\npaced = {metric = "paced", of = "plant.x"}'
    return write(folder, SCALAR + SWEEP, metric)


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The rows of the sweep, done without disturbance."""
    folder = tmp_path_factory.mktemp("reference")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        done = sweep(write_paced(folder), folder / "out")
    assert done.returncode == 0, done.stderr
    assert f"{2 * POINTS} runs, {2 * POINTS} of them to do" in done.stdout
    assert f"{2 * POINTS} of {2 * POINTS} runs, 0 failed" in done.stderr
    return rows(folder / "out")


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(tmp_path)
    return write_paced(tmp_path)


@pytest.fixture
def running(file: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The sweep on two workers, some runs done and some to do."""
    out = tmp_path / "out"
    env = environment(tmp_path) | PACE
    running = start("sweep", file, "--out", out, "--workers", "2", env=env)
    try:
        until(lambda: out.is_dir() and Store(out).database.is_file() and Store(out).count() >= 3)
        yield running
    finally:
        running.kill()
        running.communicate()


def test_a_sweep_has_one_row_per_run(reference: list[dict[str, Any]]) -> None:
    assert len(reference) == 2 * POINTS
    assert len({row["run_id"] for row in reference}) == 2 * POINTS
    assert {row["status"] for row in reference} == {"COMPLETED"}
    assert {row["seed"] for row in reference} == {0}
    pairs = [(row["set.controller.epsilon"], row["set.controller.damping"]) for row in reference]
    assert len(set(pairs)) == 2 * POINTS


def test_a_killed_worker_costs_nothing(
    running: subprocess.Popen[str], tmp_path: Path, reference: list[dict[str, Any]]
) -> None:
    os.kill(children(running.pid)[0], signal.SIGKILL)
    _, errors = running.communicate(timeout=120)
    assert running.returncode == 0, errors
    assert "0 failed" in errors
    assert rows(tmp_path / "out") == reference
    assert not list((tmp_path / "out" / "trajectories").iterdir())


def test_a_killed_parent_takes_its_workers_along_and_is_resumed(
    running: subprocess.Popen[str], file: Path, tmp_path: Path, reference: list[dict[str, Any]]
) -> None:
    out = tmp_path / "out"
    workers = children(running.pid)
    assert len(workers) == 2
    running.kill()
    until(lambda: not any(map(is_alive, workers)), 10.0)
    before = Store(out).count()
    times = {run.run_id: run.wall_time for run in Results(out).runs}
    assert 3 <= before < 2 * POINTS
    assert sweep(file, out).returncode == 2
    assert f"{2 * POINTS - before} of them to do" in sweep(file, out, "--dry-run").stdout
    assert sweep(file, out, "--resume").returncode == 0
    again = {run.run_id: run.wall_time for run in Results(out).runs}
    assert {run_id: again[run_id] for run_id in times} == times
    assert rows(out) == reference


def test_an_interrupted_sweep_says_how_to_go_on(
    running: subprocess.Popen[str], file: Path, tmp_path: Path, reference: list[dict[str, Any]]
) -> None:
    out = tmp_path / "out"
    os.killpg(running.pid, signal.SIGINT)
    _, errors = running.communicate(timeout=30)
    assert running.returncode == 130
    assert "Traceback" not in errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith("congelation: interrupted after ")
    assert last.endswith(f" of {2 * POINTS} runs; go on with --resume")
    assert {row["status"] for row in rows(out)} == {"COMPLETED"}
    assert sweep(file, out, "--resume", "--workers", "2").returncode == 0
    assert rows(out) == reference


def test_runs_that_cannot_begin_are_rows(tmp_path: Path) -> None:
    axis = '[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [-1, 0.5]\n'
    done = sweep(write(tmp_path, SCALAR + axis), tmp_path / "out")
    assert done.returncode == 1, done.stderr
    found = {(row["set.controller.epsilon"], row["status"]) for row in rows(tmp_path / "out")}
    assert found == {(-1.0, "SLAVE_FAILED"), (0.5, "COMPLETED")}


def test_a_full_disk_is_one_line_and_no_finished_run_is_lost(tmp_path: Path) -> None:
    """The largest file of an FMU has 0.35 MB, the trajectories have more."""
    dense = ("step = 0.01", "step = 1e-3")
    axis = SWEEP.replace("[sweep]", "[sweep]\ntrajectories = true").replace("12", "2")
    file, out = write(tmp_path, SCALAR + axis, dense, LONG), tmp_path / "out"

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, 400_000))

    done = process("sweep", file, "--out", out, preexec_fn=limit)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "cannot be written: " in done.stderr.strip().splitlines()[-1]
    assert sweep(file, out, "--resume").returncode == 0
    assert len(rows(out)) == 4
    assert len(list((out / "trajectories").iterdir())) == 4


def test_two_sweeps_share_a_directory(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    files = [
        write(tmp_path / "a", SCALAR + SWEEP),
        write(tmp_path / "b", SCALAR + SWEEP.replace("[0.2, 1.0]", "[0.3, 0.9]")),
    ]
    both = [start("sweep", file, "--out", out, "--resume") for file in files]
    for running in both:
        _, errors = running.communicate(timeout=120)
        assert running.returncode == 0, errors
    for file in files:
        done = sweep(file, out, "--resume")
        assert (done.returncode, " 0 of them to do" in done.stdout) == (0, True)
    found = rows(out)
    assert len({row["run_id"] for row in found}) == len(found) == 4 * POINTS
    assert len({row["study"] for row in found}) == 2
    lines = command("ls", out).stdout.splitlines()
    assert len(lines) == 1 + 4 * POINTS
    assert "controller.epsilon" in lines[0]


def test_bad_input_is_one_line_and_exit_code_2(tmp_path: Path) -> None:
    file, out = write(tmp_path, SCALAR), tmp_path / "out"
    done = sweep(file, out)
    assert done.returncode == 2
    assert done.stderr.strip().endswith("no [sweep]; give its axes, or use: congelation run")
    file = write(tmp_path, SCALAR + SWEEP)
    assert sweep(file, out).returncode == 0
    done = sweep(file, out)
    assert done.returncode == 2
    assert f"holds {2 * POINTS} finished runs; give --resume" in done.stderr
    done = sweep(file, out, "--workers", "0")
    assert done.returncode == 2
    done = command("run", file, "--out", out)
    assert done.returncode == 2
    assert "holds a sweep; give another --out" in done.stderr
