"""The side of a sweep that runs in worker processes, here or on a cluster.

A worker keeps its FMU instances between runs, writes each run into the store itself, and tells
the parent only how the runs ended.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import psutil

from congelation.cosim.pool import SlavePool
from congelation.errors import CongelationError, InvalidInput
from congelation.results.records import Row, Trajectory
from congelation.results.store import Store, StoreError
from congelation.scenario.axes import Settings
from congelation.scenario.scenario import Scenario
from congelation.sweep.execute import execute, lost_row
from congelation.sweep.plan import Run, plan_run

__all__ = [
    "REFUSED",
    "TIMED_OUT",
    "Done",
    "Shipment",
    "Task",
    "TimedOut",
    "Work",
    "Worker",
    "at_work",
    "last_words",
    "stop_when",
    "work",
]

REFUSED = "REFUSED"
"""Status of a run that could not begin; its message is that of the InvalidInput."""

TIMED_OUT = "TIMED_OUT"
"""Status of a run that was ended because it took longer than the sweep allows."""

GRACE = 5.0
"""Seconds past the timeout after which a run that does not return from its FMUs is given up."""


@dataclass(frozen=True)
class Task:
    """A run to do, small enough to send: a worker makes the `Run` of it.

    `replaces` says when the row was written that this one is to replace, None if there is none.
    """

    run_id: str
    variant: str
    settings: Settings
    replicate: int | None = None
    replaces: int | None = None

    def is_done(self, store: Store) -> bool:
        """Whether the store holds the row that is to be made."""
        return store.written(self.run_id) not in (None, self.replaces)

    def run(self, shared: Work) -> Run:
        """What it stands for, planned as the parent planned it."""
        return plan_run(
            shared.scenario,
            self.variant,
            self.settings,
            shared.varied,
            shared.seed,
            self.replicate,
        )


@dataclass(frozen=True)
class Work:
    """What all tasks of a sweep share.

    Parameters
    ----------
    scenario : Scenario
        Without its sweep and its text, which no worker needs.
    store : Store
        With an absolute path: a worker may have another current folder.
    varied : tuple of str
        Names of the settings that rows show.
    trajectories : bool
        Whether they are kept.
    seed : int
        Of the sweep.
    timeout : float, optional
        Seconds that a run may take.
    """

    scenario: Scenario
    store: Store
    varied: tuple[str, ...]
    trajectories: bool
    seed: int
    timeout: float | None = None


@dataclass(frozen=True)
class Shipment:
    """A run that a worker could not store where it belongs: its row, and its trajectory's file."""

    row: Row
    trajectory: bytes | None


@dataclass(frozen=True)
class Done:
    """What a worker tells of its tasks: how each run ended, and the memory that it has now."""

    worker: str
    statuses: tuple[str, ...]
    memory: int
    shipments: tuple[Shipment, ...] = ()


class _Stopped(Exception):
    """The parent asked to stop."""


class TimedOut(CongelationError):
    """A run took longer than it may."""


class Worker:
    """What a worker process holds between tasks."""

    def __init__(self, shared: Work) -> None:
        self.shared = shared
        self.pool = SlavePool()
        self._deadline: float | None = None

    def do(self, task: Task) -> str:
        """Do and store one run; returns its status."""
        shared = self.shared
        if task.is_done(shared.store):  # by a worker that died before it could tell
            return str(shared.store.row(task.run_id)["status"])
        run = self.run(task)
        trajectory: Trajectory | None = None
        try:
            row, trajectory = self.timed(run)
        except StoreError:
            raise
        except TimedOut as error:
            row = lost_row(run, shared.scenario, TIMED_OUT, str(error))
        except CongelationError as error:
            row = lost_row(run, shared.scenario, REFUSED, str(error))
        shared.store.write(row, trajectory if shared.trajectories else None)
        return str(row["status"])

    def run(self, task: Task) -> Run:
        """The run of a task; without its trajectory, it records what is measured alone.

        Raises
        ------
        InvalidInput
            If it is another one than the parent planned.
        """
        run = task.run(self.shared)
        if run.run_id != task.run_id:
            raise InvalidInput(
                f"{_name()}: congelation or the FMUs are not those that planned the sweep; "
                "install the same version everywhere, leave both alone meanwhile, and --resume"
            )
        columns = self.shared.scenario.measured
        if self.shared.trajectories or columns is None:
            return run
        experiment = replace(run.case.experiment, record=columns)
        return replace(run, case=replace(run.case, experiment=experiment))

    def timed(self, run: Run, *, kept: bool = True) -> tuple[dict[str, object], Trajectory]:
        """Execute a run, in no more than the time that it may take.

        One that does not return from its FMUs ends this process; its row is stored before, if it
        is to be `kept`.

        Raises
        ------
        TimedOut
            If it takes longer.
        """
        limit = self.shared.timeout
        if limit is None:
            return execute(run, self.shared.scenario, self.pool, self._check)
        self._deadline = time.monotonic() + limit
        patience = min(limit + GRACE, threading.TIMEOUT_MAX)
        alarm = threading.Timer(patience, self._give_up, (run if kept else None,))
        alarm.daemon = True
        alarm.start()
        try:
            return execute(run, self.shared.scenario, self.pool, self._check)
        finally:
            alarm.cancel()
            self._deadline = None

    def _check(self, done: float) -> None:
        if _PROCESS.stopped():
            raise _Stopped
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise TimedOut(self._too_long())

    def _give_up(self, run: Run | None) -> None:
        """End this process, which an FMU does not give back."""
        try:
            if run is not None:
                row = lost_row(run, self.shared.scenario, TIMED_OUT, self._too_long())
                self.shared.store.write(row)
                _PROCESS.last_words(row)
        finally:
            os._exit(1)

    def _too_long(self) -> str:
        return f"The run took longer than {self.shared.timeout:g} s; see sweep.timeout."


class _Process:
    """The state of this worker process; dask's worker processes may have several threads."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.stopped: Callable[[], bool] = lambda: False
        self.last_words: Callable[[Row], None] = lambda row: None
        self._worker: Worker | None = None

    def worker(self, shared: Work) -> Worker:
        """The worker for a sweep; that of another sweep frees its FMUs first."""
        if self._worker is None or self._worker.shared != shared:
            if self._worker is not None:
                self._worker.pool.close()
            self._worker = Worker(shared)
        return self._worker


_PROCESS = _Process()


def stop_when(stopped: Callable[[], bool]) -> None:
    """Let this process end its runs in the middle as soon as `stopped` is true."""
    _PROCESS.stopped = stopped


def last_words(told: Callable[[Row], None]) -> None:
    """Let this process tell the row of the run that it ends itself for, besides storing it."""
    _PROCESS.last_words = told


@contextmanager
def at_work(shared: Work) -> Iterator[Worker]:
    """This process's worker for a sweep, for one task at a time."""
    with _PROCESS.lock:
        yield _PROCESS.worker(shared)


def work(shared: Work, tasks: Sequence[Task]) -> Done:
    """Do some runs in this process, one at a time.

    Raises
    ------
    StoreError
        If a result cannot be written: the others could not be either.
    InvalidInput
        If this process has another version of the code or of the FMUs than the parent.
    """
    done: list[str] = []
    with at_work(shared) as worker:
        for task in tasks:
            try:
                done.append(worker.do(task))
            except _Stopped:
                break
    return Done(_name(), tuple(done), psutil.Process().memory_info().rss)


def _name() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"
