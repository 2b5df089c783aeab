"""Workers on this machine: processes that Pebble starts, replaces and ends.

FMUs run in them alone, so that one which crashes or hangs costs one run. What happens in such a
process is in `congelation.sweep.process`. It reports the runs that have ended through a pipe of its
own, short ones several at a time, and notes the run under way in memory in common with its parent.
So one task may hold several short runs, a time limit holds for each of them, a row is never lost
with its neighbours (what is not reported yet is done again), and a process that ends, even by
exit(0), is noticed at once by the end of its pipe.

An FMU that crashes or hangs in fmi2Terminate costs its process, and one line says so; from then on
each task is a single run, so that its row is always sent before.
"""

from __future__ import annotations

import itertools
import pickle
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, cast, final

import psutil
from pebble import ProcessExpired, ProcessFuture, ProcessPool

from congelation.errors import CongelationError, require_count
from congelation.fmi.calls import noted_call
from congelation.places import StoreError
from congelation.results.record import Outcome
from congelation.sweep.execute import ERROR, TIMED_OUT, WORKER_DIED, Job, Task, execute
from congelation.sweep.process import (
    PLACE,
    SINCE,
    TERMINATES,
    WorkerProcess,
    interrupts_held,
    prepare,
    work,
)
from congelation.sweep.workers import Event, Finished, Lost, Progress, Remark, Unfinished, Workers

__all__ = ["Local"]

TASKS_PER_WORKER = 1000
"""After so many tasks a process is replaced: the FMUs' interpreter leaks a little with each run."""

PERIOD = 0.1
"""Seconds after which new processes and time limits are looked at."""

GRACE = 5.0
"""Seconds that the FMUs of a run have for fmi2Terminate."""

FAILED_STARTS = 5
"""Processes that may end, one after the other, before any of them has begun a run."""


@dataclass
class _Batch:
    """Runs that were submitted together; `ended` of them have been reported.

    It is kept until the FMUs of the last of them are terminated.
    """

    tasks: list[Task]
    future: ProcessFuture[None]
    process: WorkerProcess | None = None
    ended: int = 0
    timed_out: bool = False
    was_done: bool = False

    @property
    def under_way(self) -> tuple[Task, float] | None:
        """The run under way, and since when."""
        if self.process is None or self.process.run_under_way[PLACE] < self.ended:
            return None
        since, place = self.process.run_under_way[SINCE], int(self.process.run_under_way[PLACE])
        return self.tasks[place], since

    @property
    def terminates_since(self) -> float | None:
        """Since when the FMUs of a run that has ended are under way in fmi2Terminate, if so."""
        if self.process is None or self.process.run_under_way[PLACE] != TERMINATES:
            return None
        return float(self.process.run_under_way[SINCE])

    @property
    def left(self) -> list[str]:
        """Those that have not been reported."""
        return [task.run_id for task in self.tasks[self.ended :]]


@final
@dataclass
class Local(Workers):
    """Processes on this machine, started afresh: FMUs do not survive a fork.

    They end with this process, also if it is killed, and Ctrl-C is this process's alone.

    Parameters
    ----------
    size : int
    do : callable
        What does a run, as `execute`.
    """

    size: int = 1
    do: Callable[..., tuple[Outcome, bytes | None]] = execute
    most: int = 50
    _pipes: dict[Connection, WorkerProcess] = field(default_factory=dict, init=False, repr=False)
    _failed_starts: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        require_count(self.size, "workers")

    def start(self, job: Job) -> None:
        context = SpawnContext()
        context.Process = partial(WorkerProcess, self._pipes.__setitem__)  # type: ignore[assignment,misc]
        self._job = job
        self._pool = ProcessPool(
            self.size,
            TASKS_PER_WORKER,
            prepare,
            (job, self.do),
            context,
        )
        self._batches: dict[int, _Batch] = {}
        self._doing: dict[Connection, int] = {}
        self._numbers = itertools.count()
        self._heard = time.monotonic()

    def submit(self, tasks: Sequence[Task]) -> None:
        number = next(self._numbers)
        with interrupts_held():  # a pool whose threads are only half started cannot be stopped
            try:
                future = self._pool.schedule(work, args=(number, tuple(tasks)))
            except RuntimeError:  # a process died between two tasks; `events` starts a new pool
                future = ProcessFuture()
        self._batches[number] = _Batch(list(tasks), future)

    def events(self) -> list[Event]:
        found: list[Event] = []
        ready = cast(list[Connection], wait(list(self._pipes), PERIOD))
        for pipe in ready:
            try:
                while pipe.poll():
                    found += self._received(pipe, pipe.recv())
            except (EOFError, OSError):  # the process has ended, perhaps while it wrote
                found += self._ended(pipe)
        now, limit = time.monotonic(), self._job.timeout
        if ready or any(batch.under_way for batch in self._batches.values()):
            self._heard = now
        elif limit is not None and self._batches and now - self._heard > limit + GRACE:
            # A process that was stopped between two runs may keep the others from theirs.
            self._end_stopped()
        for number, batch in list(self._batches.items()):
            # What was sent before the future was done is certainly read the next time.
            was_done, batch.was_done = batch.was_done, batch.future.done()
            under_way = batch.under_way
            if was_done and batch.process is None:
                # Its process ended between taking the task and its first run, or the pool broke.
                found += map(Unfinished, self._dropped(number))
            elif was_done and (error := _error(batch.future)):
                self._doing = {pipe: n for pipe, n in self._doing.items() if n != number}
                outcome = Outcome(ERROR, f"{type(error).__name__}: {error}")
                found += self._lost(number, under_way, outcome)
            elif limit is not None and under_way is not None and now - under_way[1] > limit:
                batch.timed_out = True
                batch.future.cancel()  # ends the process, whatever it does
            elif (since := batch.terminates_since) is not None and now - since > GRACE:
                batch.timed_out = True
                cast(WorkerProcess, batch.process).kill()
        if self._failed_starts > FAILED_STARTS * self.size:
            raise CongelationError(
                "the worker processes end before they begin a run; what they wrote above says why"
            )
        if self._batches and not self._is_active():  # a process died in between two tasks
            for number in list(self._batches):
                found += map(Unfinished, self._dropped(number))
            self._failed_starts += 1
            self.stop()
            self.start(self._job)
        return found

    def _end_stopped(self) -> None:
        """End the processes that a signal has stopped; what they had is done again."""
        for process in list(self._pipes.values()):
            try:
                stopped = psutil.Process(process.pid).status() == psutil.STATUS_STOPPED
            except psutil.Error:  # it has just ended
                continue
            if stopped:
                process.kill()

    def _is_active(self) -> bool:
        """Whether the pool works; a process that cannot be started is the end of it."""
        try:
            return bool(self._pool.active)
        except BrokenProcessPool as error:
            cause: BaseException = error
            while (deeper := cause.__cause__ or cause.__context__) is not None:
                cause = deeper
            raise CongelationError(f"a worker process cannot be started: {cause}") from error

    def finish(self) -> list[Remark]:
        found: list[Event] = []
        while self._batches:
            found += self.events()
        return [event for event in found if isinstance(event, Remark)]

    def stop(self) -> None:
        with interrupts_held():
            self._pool.stop()
            self._pool.join()
        for pipe, process in self._pipes.items():
            pipe.close()
            # One that Pebble was just starting would go on, and miss the pool's semaphores.
            if process.exitcode is None:
                process.kill()
                process.join()
        self._pipes.clear()

    @property
    def memory(self) -> int:
        """Bytes that the processes have resident."""
        total = 0
        for process in list(self._pipes.values()):
            try:
                total += psutil.Process(process.pid).memory_info().rss
            except psutil.Error:  # it has just ended
                continue
        return total

    def _received(self, pipe: Connection, message: tuple[Any, ...]) -> list[Event]:
        kind, number, *rest = message
        batch = self._batches.get(number)
        if batch is None:  # its runs have been given up
            return []
        if kind == "begin":
            batch.process = self._pipes[pipe]
            self._doing[pipe] = number
            self._failed_starts = 0
        elif kind == "progress":
            return [Progress(*rest)]
        elif kind == "unwritten":
            raise StoreError(rest[0])
        elif kind == "remark":
            return [Remark(*rest)]
        elif kind == "end":
            (ended,) = rest
            batch.ended += len(ended)
            return [Finished(*pickle.loads(each)) for each in ended]
        else:
            del self._batches[number], self._doing[pipe]
        return []

    def _ended(self, pipe: Connection) -> list[Event]:
        """What the end of a process means for the runs that it had."""
        process = self._pipes.pop(pipe)
        number = self._doing.pop(pipe, None)
        pipe.close()
        if number is None:
            self._failed_starts += 1
            return []
        batch = self._batches[number]
        call = noted_call(process.note)
        if batch.terminates_since is not None:
            self.most = 1
            if batch.timed_out:
                how = f"did not return within {GRACE:g} s"
            else:
                how = f"ended the worker process ({_cause(_exit_code(process))})"
            line = f"{call} {how}, after the run; no result is lost"
            return [Remark(line), *map(Unfinished, self._dropped(number))]
        if batch.timed_out:
            message = (
                f"The run took longer than {self._job.timeout:g} s; see sweep.timeout, --timeout."
            )
            outcome = Outcome(TIMED_OUT, f"{message}{_last(call)}", "time limit")
        else:
            cause = _cause(_exit_code(process))
            message = f"The worker process ended in this run ({cause})."
            outcome = Outcome(WORKER_DIED, f"{message}{_last(call)}", cause)
        return self._lost(number, batch.under_way, outcome)

    def _lost(
        self, number: int, under_way: tuple[Task, float] | None, outcome: Outcome
    ) -> list[Event]:
        """What becomes of the runs of a batch, one of which, if any, had this outcome."""
        run_ids = self._dropped(number)
        if under_way is None:
            return list(map(Unfinished, run_ids))
        lost = under_way[0].run_id
        others = [run_id for run_id in run_ids if run_id != lost]
        return [Lost(lost, outcome), *map(Unfinished, others)]

    def _dropped(self, number: int) -> list[str]:
        """Forget a batch; returns what was left to do of it."""
        batch = self._batches.pop(number)
        batch.future.cancel()  # Pebble would wait for ever for a process that ended by exit(0)
        return batch.left


def _error(future: ProcessFuture[None]) -> BaseException | None:
    """What ended a task whose process goes on, such as a record that cannot be sent."""
    if not future.done() or future.cancelled():
        return None
    error = future.exception()
    return None if isinstance(error, ProcessExpired | BrokenProcessPool) else error


def _exit_code(process: SpawnProcess) -> int | None:
    """How a process ended whose pipe has closed; Pebble's threads wait for it, too."""
    end = time.monotonic() + 2.0
    while process.exitcode is None and time.monotonic() < end:
        time.sleep(0.01)
    return process.exitcode


def _cause(code: int | None) -> str:
    """What an exit code of a process says."""
    if code is None:
        return "closed its pipe"
    return f"exit code {code}" if code >= 0 else signal.Signals(-code).name


def _last(call: str) -> str:
    return f" Its last FMI call: {call}." if call else " No FMI call was under way."
