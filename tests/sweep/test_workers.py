"""Worker processes: what they start with, how they end, where they may be started."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from congelation.errors import CongelationError
from congelation.results.record import Outcome
from congelation.scenario.load import load_scenario
from congelation.sweep.execute import Job, Task
from congelation.sweep.local import Local
from congelation.sweep.plan import plan_study
from congelation.sweep.process import WorkerProcess
from congelation.sweep.workers import Finished, Lost, Progress, Unfinished
from tests.scenarios import write
from tests.studies import is_alive

PARTS = ("scipy.linalg", "scipy.integrate", "scipy.optimize", "scipy.stats")
"""SciPy itself loads them by their first use."""

HEAVY = (*PARTS, "matplotlib", "casadi", "typer", "rich", "congelation.cli")


def test_a_worker_starts_without_what_it_may_not_need() -> None:
    code = (
        "import sys, congelation.sweep.process; "
        f"print([name for name in {HEAVY} if name in sys.modules])"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert found.stdout.strip() == "[]"


def stub(
    job: Job, task: Task, pool: object, progress: Callable[[float], None]
) -> tuple[Outcome, bytes | None]:
    """What the variant says, in place of a run."""
    if task.variant == "hang":
        time.sleep(1000)
    if task.variant == "exit":
        os._exit(0)
    if task.variant == "unsendable":
        return Outcome("COMPLETED", "", metrics={"m": lambda: 0}), None  # type: ignore[dict-item]
    if task.variant == "pid":
        return Outcome("COMPLETED", str(os.getpid())), None
    return Outcome("COMPLETED", task.variant), None


@pytest.fixture
def job(tmp_path: Path) -> Job:
    plan = plan_study(load_scenario(write(tmp_path)), tmp_path, swept=False, timeout=1, write=False)
    return plan.job


def ended(workers: Local, *names: str) -> dict[str, Finished | Lost]:
    """How stub runs end, which are submitted as one task."""
    tasks = {str(n): Task(str(n), n, name, {}) for n, name in enumerate(names)}
    workers.submit(list(tasks.values()))
    found: dict[str, Finished | Lost] = {}
    for _ in itertools.count():
        for event in workers.events():
            if isinstance(event, Unfinished):
                workers.submit([tasks[event.run_id]])
            elif not isinstance(event, Progress):
                assert event.run_id not in found
                found[event.run_id] = event
        if len(found) == len(names):
            break
    return found


@pytest.mark.parametrize(
    ("name", "status", "cause"),
    [
        ("exit", "WORKER_DIED", "exit code 0"),
        ("hang", "TIMED_OUT", "time limit"),
        ("unsendable", "ERROR", None),
    ],
)
def test_a_run_that_ends_its_worker_costs_no_neighbour(
    job: Job, name: str, status: str, cause: str | None
) -> None:
    workers = Local(1, stub)  # type: ignore[arg-type]
    with workers.running(job):
        found = ended(workers, "a", name, "b")
        assert isinstance(found["1"], Lost)
        assert (found["1"].outcome.status, found["1"].outcome.cause) == (status, cause)
        assert [found[n].outcome.message for n in "02"] == ["a", "b"]


def test_a_worker_that_is_killed_between_runs_is_replaced(job: Job) -> None:
    workers = Local(1, stub)  # type: ignore[arg-type]
    with workers.running(job):
        pid = int(ended(workers, "pid")["0"].outcome.message)
        assert workers.memory > 1e6
        os.kill(pid, signal.SIGKILL)
        assert ended(workers, "a")["0"].outcome.message == "a"
        other = int(ended(workers, "pid")["0"].outcome.message)
    assert other != pid
    assert not is_alive(other)


def test_a_worker_that_is_stopped_between_runs_is_replaced(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by SIGSTOP; the time limit ends it, and the run that it would have done is done."""
    monkeypatch.setattr(sys.modules[Local.__module__], "GRACE", 0.5)
    workers = Local(1, stub)  # type: ignore[arg-type]
    with workers.running(job):
        pid = int(ended(workers, "pid")["0"].outcome.message)
        os.kill(pid, signal.SIGSTOP)
        assert ended(workers, "a")["0"].outcome.message == "a"
    assert not is_alive(pid)


def printing(
    job: Job, task: Task, pool: object, progress: Callable[[float], None]
) -> tuple[Outcome, bytes | None]:
    """As an FMU may print: not by Python's own stream."""
    os.write(1, b"said by an FMU")
    return Outcome("COMPLETED", task.variant), None


def test_what_fmus_print_stays_out_of_the_output(
    job: Job, capfd: pytest.CaptureFixture[str]
) -> None:
    workers = Local(1, printing)  # type: ignore[arg-type]
    with workers.running(job):
        ended(workers, "a")
    out, err = capfd.readouterr()
    assert out == ""
    assert "said by an FMU" in err


def test_a_worker_that_cannot_be_started_is_one_line(
    job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(process: object) -> None:
        raise OSError(27, "File too large")

    monkeypatch.setattr(WorkerProcess, "start", refuse)
    workers = Local(1, stub)  # type: ignore[arg-type]
    with (
        pytest.raises(CongelationError, match=r"worker process cannot be started: .*too large"),
        workers.running(job),
    ):
        ended(workers, "a")
