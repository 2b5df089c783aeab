"""A worker process: how it is started, how it ends with its parent, and how it does runs."""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any, ClassVar

from congelation.cosim.pool import SlavePool
from congelation.cosim.session import NOTICE
from congelation.fmi.calls import CALLS, NOTE_SIZE
from congelation.places import StoreError
from congelation.results.record import Outcome
from congelation.sweep.execute import Job, Task

__all__ = [
    "PLACE",
    "SINCE",
    "TERMINATES",
    "WorkerProcess",
    "interrupts_held",
    "prepare",
    "without_main",
    "work",
]

REPORTED = 0.05
"""Seconds after which a process reports the runs that have ended, and the progress of one."""

_STARTING = threading.Lock()

PLACE, SINCE = 0, 1
"""In what a process notes of the run under way: its place in the batch, and when it began."""

TERMINATES = -2.0
"""In place of that: a run has ended, and its FMUs are being terminated."""


class WorkerProcess(SpawnProcess):
    """A process with a pipe to its parent, that imports nothing of the parent's main module.

    Python's own would run the script that started it once more, which then needs an ``if __name__
    == "__main__"``, and cannot do so at all from standard input.
    """

    def __init__(
        self, register: Callable[[Connection, WorkerProcess], None], **kwargs: Any
    ) -> None:
        super().__init__(**kwargs)
        self._register: Callable[[Connection, WorkerProcess], None] | None = register

    def start(self) -> None:
        # The parent reads there which FMI call the process did not survive.
        self.note = SpawnContext().RawArray("B", NOTE_SIZE)
        self.run_under_way = SpawnContext().RawArray("d", [-1.0, 0.0])
        receiver, self._sender = multiprocessing.Pipe(duplex=False)
        register, self._register = self._register, None  # it is not sent along
        with _STARTING, interrupts_held(), without_main(), _not_daemonic():
            super().start()
        self._sender.close()
        if register is not None:
            register(receiver, self)

    def run(self) -> None:
        _end_with_parent()
        # What FMUs print goes beside the results that the parent may print as JSON, not into them.
        os.dup2(2, 1)
        _Child.pipe, _Child.under_way = self._sender, self.run_under_way
        CALLS.use(self.note)
        super().run()


@contextmanager
def without_main() -> Iterator[None]:
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
def interrupts_held() -> Iterator[None]:
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


# -- in the process ---------------------------------------------------------------------------


class _Child:
    """The state of a worker process."""

    pipe: ClassVar[Connection]
    under_way: ClassVar[Any]
    job: ClassVar[Job]
    do: ClassVar[Callable[..., tuple[Outcome, bytes | None]]]
    pool: ClassVar[SlavePool]


def prepare(job: Job, do: Callable[..., tuple[Outcome, bytes | None]]) -> None:
    _Child.job, _Child.do, _Child.pool = job, do, SlavePool()
    # What has been imported stays: looking through it for garbage takes a twentieth of a short run.
    gc.freeze()


def work(number: int, tasks: Sequence[Task]) -> None:
    """Do some runs, note which one is under way, and report those that have ended."""
    send, under_way = _Child.pipe.send, _Child.under_way
    under_way[PLACE] = -1.0
    send(("begin", number))
    ended: list[bytes] = []
    reported = time.monotonic()
    for place, task in enumerate(tasks):
        # In this order: a time limit looks at the time alone.
        under_way[SINCE] = begun = time.monotonic()
        under_way[PLACE] = float(place)

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
        under_way[SINCE] = time.monotonic()
        under_way[PLACE] = TERMINATES
        for line in _Child.pool.terminate():
            send(("remark", number, line))
    under_way[PLACE] = -1.0
    send(("terminated", number))
