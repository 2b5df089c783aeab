"""Sweeps carried out: runs handed to worker processes in chunks, and nothing lost on the way.

Each run is stored by the worker that did it, before the parent hears of it. So whatever dies, a
sweep goes on from what the store holds: after a worker's death the runs that were under way are
tried once more, one at a time, and one that kills its worker again is recorded as such; after the
parent's death `resume` does what is missing.
"""

from __future__ import annotations

import itertools
import multiprocessing
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from congelation.cosim.result import Status
from congelation.errors import InvalidInput
from congelation.study.execute import lost_row
from congelation.study.plan import plan_run, varied_settings
from congelation.study.provenance import about
from congelation.study.scenario import Scenario
from congelation.study.store import Store
from congelation.study.workers import Task, Work, process_executor, work

__all__ = ["WORKER_DIED", "Plan", "plan_sweep", "run_sweep"]

WORKER_DIED = "WORKER_DIED"
"""Status of a run that ended its worker process twice."""

CHUNK = 16
"""Most runs per task: a task costs about a millisecond, and a dead worker's chunk is done again."""

RUNS_PER_WORKER = 2000
"""After so many runs workers are replaced: the FMUs' interpreter leaks a little with each."""

Progress = Callable[[int, int], None]
"""Called with the numbers of runs done and of those that failed."""


@dataclass(frozen=True)
class Plan:
    """A sweep to do: all run_ids, in order, and the tasks that the store does not hold yet."""

    shared: Work
    run_ids: tuple[str, ...]
    missing: tuple[Task, ...]


def plan_sweep(scenario: Scenario, folder: Path, *, resume: bool) -> Plan:
    """The runs of a sweep, every variant at every point, each content once.

    Raises
    ------
    InvalidInput
        If the scenario has no sweep, or the directory has runs and `resume` is false.
    """
    sweep = scenario.sweep
    if sweep is None:
        raise InvalidInput(f"{scenario.file}: no [sweep]; give its axes, or use: congelation run")
    store = Store(folder)
    done = store.finished()
    if done and not resume:
        raise InvalidInput(
            f"{folder} holds {len(done)} finished runs; give --resume to go on, or another --out"
        )
    varied = varied_settings(scenario, next(sweep.points()))
    tasks: dict[str, Task] = {}
    for point in sweep.points():
        for variant in scenario.variants:
            settings = {**variant.settings, **point}
            run_id = plan_run(scenario, variant.name, settings, varied).run_id
            tasks[run_id] = Task(run_id, variant.name, settings)
    missing = tuple(task for run_id, task in tasks.items() if run_id not in done)
    shared = Work(scenario, store, varied, sweep.trajectories, sweep.seed)
    return Plan(shared, tuple(tasks), missing)


def run_sweep(plan: Plan, *, workers: int = 1, progress: Progress | None = None) -> Store:
    """Do what is missing of a sweep, and index everything that the directory holds.

    Parameters
    ----------
    plan : Plan
    workers : int
        Number of processes.
    progress : callable, optional

    Raises
    ------
    StoreError
        If results cannot be written.
    KeyboardInterrupt
        On Ctrl-C, after the workers have stopped; what is finished is indexed.
    """
    shared, store = plan.shared, plan.shared.store
    store.create()
    counts = _Counts(len(plan.run_ids) - len(plan.missing), progress)
    waiting = deque(plan.missing)
    try:
        while waiting:
            lost = _together(shared, waiting, workers, counts)
            _one_by_one(shared, lost, counts)
    finally:
        _index(plan)
    return store


class _Counts:
    """How many runs are done and have failed; tells whoever listens."""

    def __init__(self, done: int, progress: Progress | None) -> None:
        self._done, self._failed, self._progress = done, 0, progress

    def add(self, statuses: Sequence[str]) -> None:
        self._done += len(statuses)
        self._failed += sum(status != Status.COMPLETED.name for status in statuses)
        if self._progress is not None:
            self._progress(self._done, self._failed)


@contextmanager
def _workers(count: int, shared: Work) -> Iterator[Executor]:
    """Worker processes; on any error they stop in the middle of their runs."""
    stop = multiprocessing.get_context("spawn").Event()
    executor = process_executor(count, shared, stop)
    try:
        yield executor
    except BaseException:
        stop.set()
        raise
    finally:
        executor.shutdown(wait=True, cancel_futures=True)


def _together(
    shared: Work, waiting: deque[Task], workers: int, counts: _Counts
) -> tuple[Task, ...]:
    """Do tasks side by side, as many as fresh workers may do, or until one of them dies.

    Takes the tasks from `waiting`; returns those that were lost with a worker.
    """
    budget = min(len(waiting), RUNS_PER_WORKER * workers)
    chunks = _chunks(waiting, budget, max(1, min(CHUNK, budget // (4 * workers))))
    lost: list[Task] = []
    with _workers(workers, shared) as executor:
        running: dict[Future[list[str]], list[Task]] = {}
        while True:
            # Two chunks per worker are under way: enough that none waits, few to be lost.
            free = 0 if lost else 2 * workers - len(running)
            for chunk in itertools.islice(chunks, free):
                running[_submit(executor, chunk)] = chunk
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                chunk = running.pop(future)
                try:
                    counts.add(future.result())
                except BrokenExecutor:
                    lost += chunk
    finished = shared.store.finished() if lost else set()
    counts.add([shared.store.row(t.run_id)["status"] for t in lost if t.run_id in finished])
    return tuple(task for task in lost if task.run_id not in finished)


def _submit(executor: Executor, chunk: list[Task]) -> Future[list[str]]:
    try:
        return executor.submit(work, chunk)
    except BrokenExecutor as error:  # a worker died after the last wait
        failed: Future[list[str]] = Future()
        failed.set_exception(error)
        return failed


def _chunks(waiting: deque[Task], budget: int, size: int) -> Iterator[list[Task]]:
    """Lists of `size` tasks taken from `waiting`, `budget` tasks in all."""
    while budget > 0:
        chunk = [waiting.popleft() for _ in range(min(size, budget))]
        budget -= len(chunk)
        yield chunk


def _one_by_one(shared: Work, tasks: Sequence[Task], counts: _Counts) -> None:
    """Do tasks in a process of their own; one that kills it is recorded as a failed run."""
    remaining = deque(tasks)
    while remaining:
        with _workers(1, shared) as executor:
            while remaining:
                task = remaining.popleft()
                try:
                    counts.add(_submit(executor, [task]).result())
                except BrokenExecutor:
                    shared.store.write(_died(shared, task))
                    counts.add([WORKER_DIED])
                    break


def _died(shared: Work, task: Task) -> dict[str, Any]:
    run = plan_run(shared.scenario, task.variant, task.settings, shared.varied, shared.seed)
    message = "The worker process died twice in this run; an FMU may have crashed it."
    return lost_row(run, shared.scenario, WORKER_DIED, message)


def _index(plan: Plan) -> None:
    """Write runs.parquet: the plan's finished runs in order, then others of the directory."""
    store, scenario = plan.shared.store, plan.shared.scenario
    done = store.finished()
    ordered = [run_id for run_id in plan.run_ids if run_id in done]
    others = sorted(done.difference(plan.run_ids))
    if done:
        described = about(scenario, plan.shared.varied)
        sweep = {"planned": len(plan.run_ids), "seed": plan.shared.seed}
        store.compact([*ordered, *others], {**described, "sweep": sweep, "verification": {}})
