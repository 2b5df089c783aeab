"""``congelation sweep`` with real processes that die, are killed, interrupted and resumed."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from congelation.results.store import Store
from tests.scenarios import ROOT, SCALAR, write

COMMAND = [sys.executable, "-W", "error", "-m", "congelation", "sweep"]
pytestmark = pytest.mark.slow

POINTS = 12
LONG = ("stop_time = 1.0", "stop_time = 15.0")  # a run takes a few tenths of a second

SWEEP = f"""
[sweep]
samples = {POINTS}
sampling = "latin_hypercube"
[[sweep.axes]]
set = "controller.epsilon"
log_uniform = [0.2, 1.0]
"""


def environment(*folders: Path) -> dict[str, str]:
    path = os.pathsep.join(map(str, (ROOT, *folders)))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "100"}


def sweep(
    file: Path, out: Path, *arguments: str, **options: Any
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, str(file), "--out", str(out), *arguments],
        capture_output=True,
        text=True,
        check=False,
        **{"timeout": 120, "env": environment(), **options},
    )


def start(file: Path, out: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, str(file), "--out", str(out), *arguments],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C reaches the whole group of a terminal
    )


def rows(out: Path) -> list[dict[str, Any]]:
    return [{**row, "wall_time": None} for row in Store(out).read().rows]


def until(condition: Callable[[], bool], limit: float = 60.0) -> None:
    end = time.monotonic() + limit
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.02)


def children(pid: int) -> list[int]:
    """Worker processes of `pid` (its resource tracker is not one)."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            command = (process / "cmdline").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue  # it ended in the meantime
        if parent == pid and "spawn_main" in command:
            found.append(int(process.name))
    return found


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The rows of the long sweep, done by one worker without disturbance."""
    folder = tmp_path_factory.mktemp("reference")
    done = sweep(write(folder, SCALAR + SWEEP, LONG), folder / "out")
    assert done.returncode == 0, done.stderr
    assert f"{2 * POINTS} runs, {2 * POINTS} of them to do" in done.stdout
    assert f"{2 * POINTS} of {2 * POINTS} runs, 0 failed" in done.stderr
    return rows(folder / "out")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write(tmp_path, SCALAR + SWEEP, LONG)


@pytest.fixture
def running(file: Path, tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """The long sweep on two workers, some runs done and some to do."""
    process = start(file, tmp_path / "out", "--workers", "2")
    try:
        until(lambda: len(Store(tmp_path / "out").finished()) >= 3)
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_sweep_has_one_row_per_run(reference: list[dict[str, Any]]) -> None:
    assert len(reference) == 2 * POINTS
    assert len({row["run_id"] for row in reference}) == 2 * POINTS
    assert {row["status"] for row in reference} == {"COMPLETED"}
    assert {row["seed"] for row in reference} == {0}
    pairs = [(row["controller.epsilon"], row["controller.damping"]) for row in reference]
    assert len(set(pairs)) == 2 * POINTS


def test_two_workers_give_the_same_rows(
    file: Path, tmp_path: Path, reference: list[dict[str, Any]]
) -> None:
    assert sweep(file, tmp_path / "out", "--workers", "2").returncode == 0
    assert rows(tmp_path / "out") == reference
    assert not list((tmp_path / "out" / "trajectories").iterdir())


def test_a_killed_worker_costs_nothing(
    running: subprocess.Popen[str], tmp_path: Path, reference: list[dict[str, Any]]
) -> None:
    os.kill(children(running.pid)[0], signal.SIGKILL)
    _, errors = running.communicate(timeout=120)
    assert running.returncode == 0, errors
    assert "0 failed" in errors
    assert rows(tmp_path / "out") == reference


def test_a_killed_parent_takes_its_workers_along_and_is_resumed(
    running: subprocess.Popen[str], file: Path, tmp_path: Path, reference: list[dict[str, Any]]
) -> None:
    out = tmp_path / "out"
    workers = children(running.pid)
    assert len(workers) == 2
    running.kill()
    until(lambda: not any(map(is_alive, workers)), 10.0)
    parts = {part: part.stat().st_mtime_ns for part in (out / "parts").glob("[!.]*.parquet")}
    assert 3 <= len(parts) < 2 * POINTS
    assert sweep(file, out).returncode == 2
    assert f"{2 * POINTS - len(parts)} of them to do" in sweep(file, out, "--dry-run").stdout
    assert sweep(file, out, "--resume").returncode == 0
    assert {part: part.stat().st_mtime_ns for part in parts} == parts
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


DEADLY = """
import os, signal
from congelation.scenario.metrics import Metric

def deadly(time, values):
    if values[0, 0] > 1.5:
        os.kill(os.getpid(), signal.SIGKILL)
    return 0.0

metric = Metric("deadly", deadly, "kills its process where x(0) > 1.5", str)
"""


def install(folder: Path, name: str, source: str) -> None:
    """Put a package with the metric `name` into a folder, as pip would."""
    (folder / f"{name}.py").write_text(source)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[congelation.metrics]\n{name} = {name}:metric\n")


def test_runs_that_kill_their_worker_are_rows_and_the_rest_goes_on(tmp_path: Path) -> None:
    install(tmp_path, "deadly", DEADLY)
    axis = '[sweep]\n[[sweep.axes]]\nset = "plant.x0"\nvalues = [0, 2, 1, -1, 0.5]\n'
    metric = '[metrics]\ndead = {metric = "deadly", of = "plant.x"}'
    file = write(tmp_path, SCALAR + axis, ("[metrics]", metric))
    done = sweep(file, tmp_path / "out", "--workers", "2", env=environment(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "10 of 10 runs, 2 failed" in done.stderr
    status = {(row["plant.x0[1]"], row["variant"]): row["status"] for row in rows(tmp_path / "out")}
    assert len(status) == 10
    for (x0, _), found in status.items():
        assert found == ("WORKER_DIED" if x0 == 2 else "COMPLETED")
    assert "WORKER_DIED" in done.stdout


def test_runs_that_cannot_begin_are_rows(tmp_path: Path) -> None:
    axis = '[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [-1, 0.5]\n'
    done = sweep(write(tmp_path, SCALAR + axis), tmp_path / "out")
    assert done.returncode == 0, done.stderr
    found = {(row["controller.epsilon"], row["status"]) for row in rows(tmp_path / "out")}
    assert found == {(-1.0, "SLAVE_FAILED"), (0.5, "COMPLETED")}


def test_a_damaged_part_is_done_again(tmp_path: Path) -> None:
    file, out = write(tmp_path, SCALAR + SWEEP), tmp_path / "out"
    assert sweep(file, out).returncode == 0
    before = rows(out)
    part = Store(out).part_file(before[3]["run_id"])
    part.write_bytes(part.read_bytes()[:50])
    done = sweep(file, out, "--resume")
    assert (done.returncode, "1 of them to do" in done.stdout) == (0, True)
    assert rows(out) == before


def test_a_full_disk_is_one_line_and_no_finished_run_is_lost(tmp_path: Path) -> None:
    file, out = write(tmp_path, SCALAR + SWEEP), tmp_path / "out"
    axes = file.read_text()
    file.write_text(axes.replace("[sweep]", "[sweep]\ntrajectories = true"))

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    done = sweep(file, out, preexec_fn=limit)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "cannot be written: " in done.stderr.strip().splitlines()[-1]
    assert sweep(file, out, "--resume").returncode == 0
    assert len(rows(out)) == 2 * POINTS
    assert len(list((out / "trajectories").iterdir())) == 2 * POINTS


def test_two_sweeps_share_a_directory(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    files = [
        write(tmp_path / "a", SCALAR + SWEEP),
        write(tmp_path / "b", SCALAR + SWEEP.replace("[0.2, 1.0]", "[0.3, 0.9]")),
    ]
    both = [start(file, out, "--resume") for file in files]
    for process in both:
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 0, errors
    for file in files:
        done = sweep(file, out, "--resume")
        assert (done.returncode, " 0 of them to do" in done.stdout) == (0, True)
        assert len({row["run_id"] for row in rows(out)}) == len(rows(out)) == 2 * POINTS
    assert len(Store(out).finished()) == 4 * POINTS


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
    command = [*COMMAND[:-1], "run", str(file), "--out", str(out)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "holds a sweep; give another directory" in done.stderr
