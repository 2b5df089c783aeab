"""``congelation sweep --scheduler`` with a real ``dask scheduler`` and real ``dask worker``s."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from congelation.results.store import Store
from tests.cli.test_cli_faults import PAIR
from tests.cli.test_cli_sweep import PACE, POINTS, SWEEP, rows, sweep, write_paced
from tests.cosim.c_fmus import plain_fmu
from tests.scenarios import SCALAR, write
from tests.studies import command, environment, until

pytestmark = pytest.mark.slow

DASK = [sys.executable, "-m", "dask"]


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[bytes]]]:
    started: list[subprocess.Popen[bytes]] = []
    yield started
    for one in reversed(started):
        os.killpg(one.pid, signal.SIGKILL)  # with what it has started itself
        one.wait()


@pytest.fixture
def cluster(tmp_path: Path, processes: list[subprocess.Popen[bytes]]) -> str:
    """The address of a scheduler with two workers, which have another current folder."""
    from distributed import Client  # a third of a second, in each process that collects the tests

    told = tmp_path / "scheduler.json"

    def start(*arguments: str) -> None:
        with (tmp_path / "dask.log").open("ab") as log:
            processes.append(
                subprocess.Popen(
                    [*DASK, *arguments, "--scheduler-file", str(told), "--no-dashboard"],
                    cwd=tmp_path,
                    env=environment(tmp_path),
                    stdout=log,
                    stderr=log,
                    start_new_session=True,
                )
            )

    start("scheduler", "--host", "127.0.0.1", "--port", "0")
    until(told.is_file)
    own = ("--local-directory", str(tmp_path))
    for _ in range(2):
        start("worker", "--nthreads", "1", "--host", "127.0.0.1", *own)
    with Client(scheduler_file=str(told), set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        return str(client.scheduler.address)


def test_a_cluster_gives_the_rows_of_one_worker(tmp_path: Path, cluster: str) -> None:
    file = write(tmp_path, SCALAR + SWEEP)
    here = sweep(file, tmp_path / "here")
    assert here.returncode == 0, here.stderr
    there = sweep(file, tmp_path / "there", "--scheduler", cluster)
    assert there.returncode == 0, there.stderr
    assert f"{2 * POINTS} of {2 * POINTS} runs, 0 failed" in there.stderr
    assert len(rows(tmp_path / "there")) == 2 * POINTS
    assert rows(tmp_path / "there") == rows(tmp_path / "here")


@pytest.fixture
def pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs take some time in the workers that are started from now on."""
    for name, value in PACE.items():
        monkeypatch.setenv(name, value)


def test_a_killed_worker_of_a_cluster_costs_nothing(
    pace: None, tmp_path: Path, cluster: str, processes: list[subprocess.Popen[bytes]]
) -> None:
    file, out = write_paced(tmp_path), tmp_path / "out"
    command = [sys.executable, "-m", "congelation", "sweep", str(file), "--out", str(out)]
    running = subprocess.Popen(
        [*command, "--scheduler", cluster],
        env=environment(tmp_path),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    until(lambda: Store(out).count() >= 3)
    os.killpg(processes[1].pid, signal.SIGKILL)
    _, errors = running.communicate(timeout=120)
    assert running.returncode == 0, errors
    found = rows(out)
    assert len({row["run_id"] for row in found}) == len(found) == 2 * POINTS
    assert {row["status"] for row in found} == {"COMPLETED"}


def test_fmus_that_kill_workers_of_a_cluster_are_rows(tmp_path: Path, cluster: str) -> None:
    for declares in (False, True):
        plain_fmu(tmp_path, declares=declares)
    axis = '[sweep]\n[[sweep.axes]]\nset = "bad.fault"\nvalues = [0, 1, 0.5]\n'
    file, out = write(tmp_path, PAIR.format(folder=tmp_path) + axis), tmp_path / "out"
    done = command("sweep", file, "--out", out, "--scheduler", cluster)
    assert done.returncode == 1, done.stderr
    status = {row["set.bad.fault"]: row["status"] for row in rows(out)}
    assert status == {0.0: "COMPLETED", 1.0: "WORKER_DIED", 0.5: "COMPLETED"}
    (dead,) = (row for row in rows(out) if row["set.bad.fault"] == 1.0)
    assert "fmi2DoStep of bad (plain_True.fmu)" in dead["message"]


def test_no_scheduler_is_one_line(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR + SWEEP)
    for address, message in (
        ("nonsense://x", "'nonsense://x' is no address of a dask scheduler; give tcp://HOST:PORT"),
        ("tcp://127.0.0.1:1", "no dask scheduler at tcp://127.0.0.1:1: Connection refused"),
    ):
        done = sweep(file, tmp_path / "out", "--scheduler", address)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert done.stderr.strip().splitlines()[-1] == f"congelation: {message}"
    done = sweep(file, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1", "--workers", "2")
    assert (done.returncode, "not both" in done.stderr) == (2, True)
