"""The side of a sweep that runs in worker processes, and the executors that hold them.

A worker keeps its FMU instances between runs, writes each run into the store itself, and tells
the parent only how the runs ended. Workers ignore Ctrl-C, which belongs to the parent; they end
with it, also if it is killed.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing.synchronize import Event

from congelation.cosim.pool import SlavePool
from congelation.errors import CongelationError
from congelation.study.execute import execute, lost_row
from congelation.study.plan import plan_run
from congelation.study.scenario import Scenario
from congelation.study.store import Store, StoreError
from congelation.study.sweep import Settings

__all__ = ["REFUSED", "Task", "Work", "process_executor", "work"]

REFUSED = "REFUSED"
"""Status of a run that could not begin; its message is that of the InvalidInput."""


@dataclass(frozen=True)
class Task:
    """A run to do, small enough to send: a worker makes the `Run` of it."""

    run_id: str
    variant: str
    settings: Settings


@dataclass(frozen=True)
class Work:
    """What all tasks of a sweep share.

    Parameters
    ----------
    scenario : Scenario
    store : Store
    varied : tuple of str
        Names of the settings that rows show.
    trajectories : bool
        Whether they are kept.
    seed : int
        Of the sweep.
    """

    scenario: Scenario
    store: Store
    varied: tuple[str, ...]
    trajectories: bool
    seed: int


class _Stopped(Exception):
    """The parent asked to stop."""


class _Worker:
    """What a worker process holds between tasks."""

    def __init__(self, shared: Work, stop: Event) -> None:
        self._shared = shared
        self._stop = stop
        self._pool = SlavePool()

    def do(self, task: Task) -> str:
        """Do and store one run; returns its status."""
        shared = self._shared
        run = plan_run(shared.scenario, task.variant, task.settings, shared.varied, shared.seed)
        try:
            row, trajectory = execute(run, shared.scenario, self._pool, self._check)
        except StoreError:
            raise
        except CongelationError as error:
            row, trajectory = lost_row(run, shared.scenario, REFUSED, str(error)), None
        shared.store.write(row, trajectory if shared.trajectories else None)
        return str(row["status"])

    def _check(self, done: float) -> None:
        if self._stop.is_set():
            raise _Stopped


_WORKER: list[_Worker] = []
"""The one worker of this process, once it has started."""


def _start(shared: Work, stop: Event) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _WORKER[:] = [_Worker(shared, stop)]


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)  # whatever is being written stands under a temporary name


def work(tasks: Sequence[Task]) -> list[str]:
    """Do some runs in this worker process; returns the status of each one done.

    Raises
    ------
    StoreError
        If a result cannot be written: the others could not be either.
    """
    done = []
    for task in tasks:
        try:
            done.append(_WORKER[0].do(task))
        except _Stopped:
            break
    return done


def process_executor(workers: int, shared: Work, stop: Event) -> Executor:
    """Worker processes on this machine, each started afresh: FMUs do not survive a fork."""
    return ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start,
        initargs=(shared, stop),
    )
