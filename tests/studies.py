"""Studies in the tests: the command line in this process and in others, and what they stored."""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

from congelation.cli import main
from congelation.cosim.pool import SlavePool
from congelation.cosim.session import NOTICE
from congelation.fmi.library import KEPT
from congelation.results.record import Outcome, Trajectory
from congelation.results.results import Results
from congelation.scenario.scenario import Scenario
from congelation.sweep.execute import Job, Task, execute
from congelation.sweep.local import Local
from congelation.sweep.plan import plan_study
from congelation.sweep.workers import Event, Finished, Progress, Remark, Workers
from tests.scenarios import ROOT

__all__ = [
    "COMMAND",
    "Here",
    "children",
    "command",
    "done",
    "environment",
    "install",
    "is_alive",
    "last_line",
    "process",
    "rows",
    "start",
    "until",
    "workers",
]

COMMAND = [sys.executable, "-W", "error", "-m", "congelation"]


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command line in this process; its workers are processes of their own."""
    words = ["congelation", *map(str, arguments)]
    out, errors = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", words),
        mock.patch.dict(os.environ, {"COLUMNS": "100"}),
        redirect_stdout(out),
        redirect_stderr(errors),
    ):
        try:
            main()
            code: object = 0
        except SystemExit as ended:
            code = ended.code or 0
    return subprocess.CompletedProcess(words, int(str(code)), out.getvalue(), errors.getvalue())


def environment(*folders: Path) -> dict[str, str]:
    """Of a process that finds congelation, the tests and the packages in some folders."""
    path = os.pathsep.join(map(str, (ROOT, *folders)))
    return {**os.environ, "PYTHONPATH": path, "COLUMNS": "100"}


def process(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    """The command line in a process of its own."""
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        **{"timeout": 120, "env": environment(), **options},
    )


def start(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    """The command line as a process that goes on, in a session as of a terminal."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        **{"env": environment(), **options},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def last_line(done: subprocess.CompletedProcess[str], code: int) -> str:
    """The last line on stderr, after checking that it is the program's and no traceback."""
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    line = done.stderr.strip().splitlines()[-1]
    assert line.startswith("congelation: ")
    return line


def rows(out: Path, study: str | None = None) -> list[dict[str, Any]]:
    """The stored records by column, without what differs each time."""
    return [{**row, "wall_time": None} for row in Results(out, study).runs.rows()]


def done(
    scenario: Scenario, folder: Path, place: int = 0, settings: Mapping[str, Any] | None = None
) -> tuple[Outcome, Trajectory]:
    """A run of a plan done in this process, perhaps with other settings."""
    plan = plan_study(scenario, folder, swept=scenario.sweep is not None, write=False)
    (task,) = plan.tasks([place])
    chosen = task if settings is None else replace(task, settings=settings)
    job = replace(plan.job, folder=folder, trajectories=True)
    with SlavePool() as pool:
        outcome, _ = execute(job, chosen, pool, lambda fraction: None)
    return outcome, plan.store.trajectory(task.run_id)


@dataclass
class Here(Workers):
    """In place of a worker process: does the runs in this one, and starts in no time.

    What is sent between processes is pickled here, too. A run cannot be ended from outside.
    """

    size: int = 1
    most: int = 50

    def start(self, job: Job) -> None:
        self._tasks, self._pool = deque[Task](), SlavePool()
        assert job.timeout is None, "a test of a time limit is to be marked `workers`"
        self._job: Job = pickle.loads(pickle.dumps(job))

    def submit(self, tasks: Sequence[Task]) -> None:
        self._tasks += pickle.loads(pickle.dumps(tasks))

    def events(self) -> list[Event]:
        task, found = self._tasks.popleft(), list[Event]()

        def progress(fraction: float) -> None:
            if notice := NOTICE.taken():
                found.append(Progress(task.run_id, fraction, notice))

        outcome, trajectory = execute(self._job, task, self._pool, progress)
        ended = Finished(*pickle.loads(pickle.dumps((task.run_id, outcome, trajectory))))
        return [*found, ended, *map(Remark, self._pool.terminate())]

    def stop(self) -> None:
        self._pool.close()
        KEPT.file = None


def workers(in_processes: bool, size: int = 1) -> Workers:
    """Where a test's studies run: in processes if it asks for that, or for several."""
    return Local(size) if in_processes or size > 1 else Here()


def until(condition: Callable[[], bool], limit: float = 60.0) -> None:
    """Wait for a condition.

    Raises
    ------
    TimeoutError
        If it does not come true.
    """
    end = time.monotonic() + limit
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError
        time.sleep(0.02)


def children(pid: int) -> list[int]:
    """Worker processes of `pid` (its resource tracker is not one)."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            line = (entry / "cmdline").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue  # it ended in the meantime
        if parent == pid and "spawn_main" in line:
            found.append(int(entry.name))
    return found


def is_alive(pid: int) -> bool:
    """Whether a process runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def install(folder: Path, name: str, source: str) -> None:
    """Put a package with the metric `name` into a folder, as pip would."""
    (folder / f"{name}.py").write_text(source)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[congelation.metrics]\n{name} = {name}:metric\n")
