"""Worker processes: FMUs run in them alone, so that one which crashes or hangs costs one run.

Pebble starts, replaces and ends the processes. Beside its channel each process has a pipe of its
own, through which it reports the runs that have ended, short ones several at a time, and memory in
common with its parent, where it notes the run under way. So one task may hold several short runs, a
time limit holds for each of them, a row is never lost with its neighbours (what is not reported yet
is done again), and a process that ends, even by exit(0), is noticed at once by the end of its pipe.

After each run its FMUs are terminated (fmi2Terminate), those of a task's last run once the rows of
the task have been sent. An FMU that crashes or hangs there costs its process and is told in a line;
from then on each task is a single run, so that its row is always sent before.
"""

from __future__ import annotations

import ctypes
import itertools
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any, ClassVar, NamedTuple, cast, final

import psutil
from pebble import ProcessExpired, ProcessFuture, ProcessPool

from congelation.cosim.pool import SlavePool
from congelation.cosim.session import NOTICE
from congelation.errors import CongelationError
from congelation.fmi.calls import CALLS, NOTE_SIZE, noted_call
from congelation.places import StoreError
from congelation.results.record import Outcome
from congelation.sweep.execute import (
    ERROR,
    TIMED_OUT,
    WORKER_DIED,
    Job,
    Task,
    execute,
)

__all__ = ["Finished", "Local", "Lost", "Progress", "Remark", "Unfinished", "Workers"]

TASKS_PER_WORKER = 1000
"""After so many tasks a process is replaced: the FMUs' interpreter leaks a little with each run."""

PERIOD = 0.1
"""Seconds after which new processes and time limits are looked at."""

GRACE = 5.0
"""Seconds that the FMUs of a run have for fmi2Terminate."""

REPORTED = 0.05
"""Seconds after which a process reports the runs that have ended, and the progress of one."""

FAILED_STARTS = 5
"""Processes that may end, one after the other, before any of them has begun a run."""


class Finished(NamedTuple):
    """A run ended; `trajectory` is that of `execute`."""

    run_id: str
    outcome: Outcome
    trajectory: bytes | None = None


class Lost(NamedTuple):
    """A run ended its worker process, or was ended with it after its time limit."""

    run_id: str
    outcome: Outcome


class Unfinished(NamedTuple):
    """A run has to be submitted again, as its worker process ended before it began."""

    run_id: str


class Progress(NamedTuple):
    """A run is under way; `fraction` of it is done. `notice` is what it has to say, in one line."""

    run_id: str
    fraction: float
    notice: str = ""


class Remark(NamedTuple):
    """What is to be told of the FMUs of a study, in one line."""

    line: str


Event = Finished | Lost | Unfinished | Progress | Remark


class Workers(ABC):
    """Where runs are done. Every run that is submitted has one event: Finished, Lost, Unfinished.

    Attributes
    ----------
    size : int
        Number of workers.
    most : int
        Runs that one submission may have.
    """

    size: int
    most: int

    @contextmanager
    def running(self, job: Job) -> Iterator[Workers]:
        """The workers, ready for the runs of a study, for as long as the context lasts."""
        try:
            self.start(job)
            yield self
        finally:
            self.stop()

    @abstractmethod
    def start(self, job: Job) -> None:
        """Get ready for the runs of a study."""

    @abstractmethod
    def submit(self, tasks: Sequence[Task]) -> None:
        """Let a worker do some runs, one after the other."""

    @abstractmethod
    def events(self) -> list[Event]:
        """What has happened; waits for it, but not for long.

        Raises
        ------
        StoreError
            If a worker cannot write a result.
        CongelationError
            If workers do not start.
        """

    def finish(self) -> list[Remark]:
        """Wait for fmi2Terminate of the last runs' FMUs, once every run has its event."""
        return []

    @abstractmethod
    def stop(self) -> None:
        """End the workers, and with them the runs under way."""

    @property
    def memory(self) -> int:
        """Bytes that the workers take; 0 where this is not known."""
        return 0


@dataclass
class _Batch:
    """Runs that were submitted together; `ended` of them have been reported.

    It is kept until the FMUs of the last of them are terminated.
    """

    tasks: list[Task]
    future: ProcessFuture[None]
    process: _Process | None = None
    ended: int = 0
    timed_out: bool = False
    was_done: bool = False

    @property
    def under_way(self) -> tuple[Task, float] | None:
        """The run under way, and since when."""
        if self.process is None or self.process.run_under_way[_PLACE] < self.ended:
            return None
        since, place = self.process.run_under_way[_SINCE], int(self.process.run_under_way[_PLACE])
        return self.tasks[place], since

    @property
    def terminates_since(self) -> float | None:
        """Since when the FMUs of a run that has ended are under way in fmi2Terminate, if so."""
        if self.process is None or self.process.run_under_way[_PLACE] != _TERMINATES:
            return None
        return float(self.process.run_under_way[_SINCE])

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
    _pipes: dict[Connection, _Process] = field(default_factory=dict, init=False, repr=False)
    _failed_starts: int = field(default=0, init=False, repr=False)

    def start(self, job: Job) -> None:
        context = SpawnContext()
        context.Process = partial(_Process, self._pipes.__setitem__)  # type: ignore[assignment,misc]
        self._job = job
        self._pool = ProcessPool(
            self.size,
            TASKS_PER_WORKER,
            _prepare,
            (job, self.do),
            context,
        )
        self._batches: dict[int, _Batch] = {}
        self._doing: dict[Connection, int] = {}
        self._numbers = itertools.count()

    def submit(self, tasks: Sequence[Task]) -> None:
        number = next(self._numbers)
        with _interrupts_held():  # a pool whose threads are only half started cannot be stopped
            try:
                future = self._pool.schedule(_work, args=(number, tuple(tasks)))
            except RuntimeError:  # a process died between two tasks; `events` starts a new pool
                future = ProcessFuture()
        self._batches[number] = _Batch(list(tasks), future)

    def events(self) -> list[Event]:
        found: list[Event] = []
        for pipe in cast(list[Connection], wait(list(self._pipes), PERIOD)):
            try:
                while pipe.poll():
                    found += self._received(pipe, pipe.recv())
            except (EOFError, OSError):  # the process has ended, perhaps while it wrote
                found += self._ended(pipe)
        now, limit = time.monotonic(), self._job.timeout
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
                cast(_Process, batch.process).kill()
        if self._failed_starts > FAILED_STARTS * self.size:
            raise CongelationError(
                "the worker processes end before they begin a run; what they wrote above says why"
            )
        if self._batches and not self._pool.active:  # a process died in between two tasks
            for number in list(self._batches):
                found += map(Unfinished, self._dropped(number))
            self._failed_starts += 1
            self.stop()
            self.start(self._job)
        return found

    def finish(self) -> list[Remark]:
        found: list[Event] = []
        while self._batches:
            found += self.events()
        return [event for event in found if isinstance(event, Remark)]

    def stop(self) -> None:
        with _interrupts_held():
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


# -- starting processes -----------------------------------------------------------------------


_STARTING = threading.Lock()

_PLACE, _SINCE = 0, 1
"""In what a process notes of the run under way: its place in the batch, and when it began."""

_TERMINATES = -2.0
"""In place of that: a run has ended, and its FMUs are being terminated."""


class _Process(SpawnProcess):
    """A process with a pipe to its parent, that imports nothing of the parent's main module.

    Python's own would run the script that started it once more, which then needs an ``if __name__
    == "__main__"``, and cannot do so at all from standard input.
    """

    def __init__(self, register: Callable[[Connection, _Process], None], **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._register: Callable[[Connection, _Process], None] | None = register

    def start(self) -> None:
        # The parent reads there which FMI call the process did not survive.
        self.note = SpawnContext().RawArray("B", NOTE_SIZE)
        self.run_under_way = SpawnContext().RawArray("d", [-1.0, 0.0])
        receiver, self._sender = multiprocessing.Pipe(duplex=False)
        register, self._register = self._register, None  # it is not sent along
        with _STARTING, _interrupts_held(), _without_main(), _not_daemonic():
            super().start()
        self._sender.close()
        if register is not None:
            register(receiver, self)

    def run(self) -> None:
        _end_with_parent()
        _Child.pipe, _Child.under_way = self._sender, self.run_under_way
        CALLS.use(self.note)
        super().run()


@contextmanager
def _without_main() -> Iterator[None]:
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


@contextmanager
def _not_daemonic() -> Iterator[None]:
    """Let a daemonic process, such as dask's workers, start processes, which end with it anyhow."""
    config: dict[str, Any] = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    daemon = config.pop("daemon", None)
    try:
        yield
    finally:
        if daemon is not None:
            config["daemon"] = daemon


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back; processes that are started meanwhile never see it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """Let this process be killed when its parent ends, also while an FMU does not return."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        PR_SET_PDEATHSIG = 1
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent.pid:  # it has ended already
            os._exit(1)
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


# -- in the worker process --------------------------------------------------------------------


class _Child:
    """The state of a worker process."""

    pipe: ClassVar[Connection]
    under_way: ClassVar[Any]
    job: ClassVar[Job]
    do: ClassVar[Callable[..., tuple[Outcome, bytes | None]]]
    pool: ClassVar[SlavePool]


def _prepare(job: Job, do: Callable[..., tuple[Outcome, bytes | None]]) -> None:
    _Child.job, _Child.do, _Child.pool = job, do, SlavePool()


def _work(number: int, tasks: Sequence[Task]) -> None:
    """Do some runs, note which one is under way, and report those that have ended."""
    send, under_way = _Child.pipe.send, _Child.under_way
    under_way[_PLACE] = -1.0
    send(("begin", number))
    ended: list[bytes] = []
    reported = time.monotonic()
    for place, task in enumerate(tasks):
        # In this order: a time limit looks at the time alone.
        under_way[_SINCE] = begun = time.monotonic()
        under_way[_PLACE] = float(place)

        def progress(fraction: float, run_id: str = task.run_id, begun: float = begun) -> None:
            if time.monotonic() - begun > REPORTED:
                send(("progress", number, run_id, fraction, NOTICE.taken()))

        try:
            outcome, trajectory = _Child.do(_Child.job, task, _Child.pool, progress)
        except StoreError as error:
            send(("unwritten", number, str(error)))
            return
        # Here, so that what cannot be sent is an error of this run and not of its neighbours.
        ended.append(pickle.dumps((task.run_id, outcome, trajectory)))
        if place + 1 == len(tasks) or time.monotonic() - reported > REPORTED:
            send(("end", number, ended))
            ended, reported = [], time.monotonic()
        under_way[_SINCE] = time.monotonic()
        under_way[_PLACE] = _TERMINATES
        for line in _Child.pool.terminate():
            send(("remark", number, line))
    under_way[_PLACE] = -1.0
    send(("terminated", number))
