"""Sweeps carried out: runs handed to worker processes in chunks, and nothing lost on the way.

Each run is stored by the worker that did it, before the parent hears of it. So whatever dies, a
sweep goes on from what the store holds: after a worker's death the runs that were under way are
tried once more, one at a time, and one that kills its worker again is recorded as such; after the
parent's death `resume` does what is missing.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass, replace
from typing import Any

from congelation.cosim.result import Status
from congelation.results.store import Store
from congelation.sweep.execute import lost_row
from congelation.sweep.executors import Processes, Workers
from congelation.sweep.interrupt import deferred_interrupts
from congelation.sweep.sweep_plan import WORKER_DIED, Plan, write_index
from congelation.sweep.workers import Done, Task, Work, work

__all__ = ["Tally", "run_sweep"]

CHUNK = 16
"""Most runs per task: a task costs about a millisecond, and a dead worker's chunk is done again."""

INDEX_GROWTH = 4
"""The index is written anew whenever there are so many times the runs: a row is read 1.3 times.

Workers wait meanwhile. Who needs the newest rows reads them one by one, as `ls` does."""


@dataclass(frozen=True)
class Tally:
    """How far a sweep is.

    Parameters
    ----------
    done, total : int
        Runs.
    failed : int
        Those done by this call that did not reach their stop time.
    memory : int
        Bytes: the largest that each present worker had between its tasks, added up.
    """

    done: int
    total: int
    failed: int = 0
    memory: int = 0


Progress = Callable[[Tally], None]
"""Called whenever some runs are done."""


def run_sweep(
    plan: Plan, *, workers: Workers | None = None, progress: Progress | None = None
) -> Store:
    """Do what is missing of a sweep, and index its runs.

    Parameters
    ----------
    plan : Plan
    workers : Workers, optional
        Where runs are done; one process here by default.
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
    place = workers if workers is not None else Processes()
    counts = _Counts(plan, progress)
    waiting = deque(plan.missing)
    if plan.others:
        write_index(plan)  # so that nobody takes them for runs of this sweep meanwhile
    try:
        while waiting:
            lost = _together(shared, waiting, place, counts)
            _one_by_one(shared, lost, place, counts)
    finally:
        write_index(plan)
    return store


class _Counts:
    """How many runs are done and have failed; tells whoever listens, and keeps an index of them."""

    def __init__(self, plan: Plan, progress: Progress | None) -> None:
        total = len(plan.run_ids)
        self._tally = Tally(total - len(plan.missing), total)
        self._memory: dict[str, int] = {}
        self._progress = progress
        self._plan = plan
        self._index_at = max(INDEX_GROWTH * self._tally.done, CHUNK)

    def new_crew(self) -> None:
        """The workers heard of so far have ended."""
        self._memory.clear()

    def add(self, done: Done) -> None:
        """Count what a worker has done."""
        self._memory[done.worker] = max(done.memory, self._memory.get(done.worker, 0))
        self.add_statuses(done.statuses)

    def add_statuses(self, statuses: Sequence[str]) -> None:
        """Count runs by how they ended."""
        failed = sum(status != Status.COMPLETED.name for status in statuses)
        self._tally = replace(
            self._tally,
            done=self._tally.done + len(statuses),
            failed=self._tally.failed + failed,
            memory=sum(self._memory.values()),
        )
        if self._progress is not None:
            self._progress(self._tally)
        if self._index_at <= self._tally.done < self._tally.total:
            write_index(self._plan)
            self._index_at = INDEX_GROWTH * self._tally.done


def _together(
    shared: Work, waiting: deque[Task], workers: Workers, counts: _Counts
) -> tuple[Task, ...]:
    """Do tasks side by side, as many as fresh workers may do, or until one of them dies.

    Takes the tasks from `waiting`; returns those that were lost with a worker.
    """
    lost: list[Task] = []
    with workers.open() as crew:
        counts.new_crew()
        budget = min(len(waiting), crew.runs or len(waiting))
        chunks = _chunks(waiting, budget, max(1, min(CHUNK, budget // (4 * crew.size))))
        running: dict[Future[Done], list[Task]] = {}
        while True:
            # Two chunks per worker are under way: enough that none waits, few to be lost.
            free = 0 if lost else 2 * crew.size - len(running)
            for chunk in itertools.islice(chunks, free):
                running[_submit(crew.executor, shared, chunk)] = chunk
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                chunk = running.pop(future)
                try:
                    counts.add(_received(future, shared))
                except BrokenExecutor:
                    lost += chunk
    finished = {task.run_id for task in lost if task.is_done(shared.store)}
    counts.add_statuses([shared.store.row(run_id)["status"] for run_id in finished])
    return tuple(task for task in lost if task.run_id not in finished)


def _submit(executor: Executor, shared: Work, chunk: list[Task]) -> Future[Done]:
    try:
        # An executor whose threads are only half started cannot be shut down.
        with deferred_interrupts() as check:
            future = executor.submit(work, shared, chunk)
            check()
        return future
    except BrokenExecutor as error:  # a worker died after the last wait
        failed: Future[Done] = Future()
        failed.set_exception(error)
        return failed


def _received(future: Future[Done], shared: Work) -> Done:
    """What a worker has done, stored here if it could not store it itself."""
    done = future.result()
    for shipment in done.shipments:
        shared.store.write(shipment.row, shipment.trajectory)
    return replace(done, shipments=())


def _chunks(waiting: deque[Task], budget: int, size: int) -> Iterator[list[Task]]:
    """Lists of `size` tasks taken from `waiting`, `budget` tasks in all."""
    while budget > 0:
        chunk = [waiting.popleft() for _ in range(min(size, budget))]
        budget -= len(chunk)
        yield chunk


def _one_by_one(shared: Work, tasks: Sequence[Task], workers: Workers, counts: _Counts) -> None:
    """Do tasks in a process of their own; one that kills it is recorded as a failed run."""
    remaining = deque(tasks)
    while remaining:
        with workers.alone() as crew:
            counts.new_crew()
            while remaining:
                task = remaining.popleft()
                try:
                    counts.add(_received(_submit(crew.executor, shared, [task]), shared))
                except BrokenExecutor:
                    if not task.is_done(shared.store):
                        shared.store.write(_died(shared, task))
                    counts.add_statuses([shared.store.row(task.run_id)["status"]])
                    break


def _died(shared: Work, task: Task) -> dict[str, Any]:
    run = task.run(shared)
    message = "The worker process died twice in this run; an FMU may have crashed it."
    return lost_row(run, shared.scenario, WORKER_DIED, message)
