"""The workers of a dask.distributed scheduler, behind the same interface as processes here.

Each dask worker does its runs in a process of its own, as `Local` does, so that time limits and
crashes are the same there. It reaches FMUs and result directory by their paths, unless they are
shipped: then it gets the files by the hash of their content, and returns trajectories.
"""

from __future__ import annotations

import hashlib
import os
import queue
import socket
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, cast, final
from urllib.parse import urlsplit

from congelation.errors import CongelationError, InvalidInput
from congelation.places import replace_whole
from congelation.results.record import Outcome
from congelation.scenario.scenario import Scenario
from congelation.sweep.execute import WORKER_DIED, Job, Task
from congelation.sweep.local import PERIOD, Local
from congelation.sweep.workers import Event, Lost, Progress, Remark, Workers

__all__ = ["Cluster"]

REACHED_IN = 30
"""Seconds to wait for a cluster's scheduler, and then for its first worker."""

FOLDER = "congelation"
"""Folder in each dask worker's own directory that files are put into: HASH/NAME."""


@final
@dataclass
class Cluster(Workers):
    """The workers of a dask scheduler.

    Parameters
    ----------
    address : str
        ``tcp://HOST:PORT``.
    ship : bool
        Whether FMUs and tables are sent, and trajectories returned.
    """

    address: str
    ship: bool = False
    most: int = 1  # a task costs a cluster a millisecond, and a lost one all of its runs

    def start(self, job: Job) -> None:
        try:
            from distributed import Client  # an optional extra
        except ImportError as error:
            raise InvalidInput(
                "--scheduler needs dask.distributed; install congelation[cluster]"
            ) from error
        _reach(self.address)
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        try:
            self._client = Client(self.address, timeout=REACHED_IN, set_as_default=False)
        except OSError as error:  # something else answers there
            raise InvalidInput(f"no dask scheduler at {self.address}: {error}") from error
        try:
            self._client.wait_for_workers(1, timeout=REACHED_IN)
        except TimeoutError as error:
            raise CongelationError(
                f"the scheduler at {self.address} has no workers; start: dask worker "
                f"{self.address} --nthreads 1"
            ) from error
        self.size = len(self._client.scheduler_info(n_workers=-1)["workers"])
        self._sent: dict[str, Any] = {}
        # As a task, whose result is made anew if the worker that has it ends.
        sent = replace(job, folder=None) if self.ship else job
        self._job = self._client.submit(_same, sent, pure=False)
        components = job.scenario.system.components
        self._paths = [str(c.fmu) for c in components]
        self._paths += _files(value for c in components for value in c.start.values())

    def submit(self, tasks: Sequence[Task]) -> None:
        for task in tasks:
            files = self._files(task) if self.ship else None
            future = self._client.submit(_do, self._job, files, task, pure=False)
            future.add_done_callback(partial(self._ended, task))

    def _ended(self, task: Task, future: Any) -> None:
        self._events.put((task, future))

    def events(self) -> list[Event]:
        try:
            task, future = self._events.get(timeout=PERIOD)
        except queue.Empty:
            return []
        from distributed import KilledWorker

        error = None if future.cancelled() else future.exception()
        if error is None and not future.cancelled():
            return [cast(Event, future.result())]
        if future.cancelled() or isinstance(error, KilledWorker):
            message = f"The dask worker ended in this run: {error or 'the task was cancelled'}"
            return [Lost(task.run_id, Outcome(WORKER_DIED, message, "dask worker"))]
        raise cast(BaseException, error)

    def stop(self) -> None:
        if hasattr(self, "_client"):
            self._client.close()

    def _files(self, task: Task) -> dict[str, Any]:
        """The files that a run reads, by their paths here: (place on a worker, content)."""
        wanted = [*self._paths, *_files(task.settings.values())]
        for path in wanted:
            if path not in self._sent:
                content = Path(path).read_bytes()
                place = f"{hashlib.sha256(content).hexdigest()}/{Path(path).name}"
                self._sent[path] = self._client.submit(_same, (place, content), pure=False)
        return {path: self._sent[path] for path in wanted}


def _files(values: Any) -> list[str]:
    """Those of some values that are the paths of files: tables of theta."""
    return [value for value in values if isinstance(value, str) and os.path.isfile(value)]


def _same(value: Any) -> Any:
    return value


def _reach(address: str) -> None:
    """Raise InvalidInput unless something listens there; dask would wait for it and then some."""
    url = urlsplit(address)
    try:
        known = url.scheme in ("tcp", "tls") and url.hostname is not None and url.port is not None
    except ValueError:  # a port that is no number
        known = False
    if not known:
        raise InvalidInput(f"'{address}' is no address of a dask scheduler; give tcp://HOST:PORT")
    try:
        socket.create_connection((url.hostname, url.port), timeout=REACHED_IN).close()
    except OSError as error:
        raise InvalidInput(f"no dask scheduler at {address}: {error.strerror or error}") from error


# -- in the dask worker -----------------------------------------------------------------------


class _OwnProcess:
    """The worker process of a dask worker; its threads take turns."""

    lock: ClassVar = threading.Lock()
    workers: ClassVar[Local | None] = None
    job: ClassVar[tuple[object, ...]] = ()


def _do(job: Job, files: Mapping[str, tuple[str, bytes]] | None, task: Task) -> Event:
    """Do one run in a process beside the dask worker."""
    if files is not None:
        job, task = _unpacked(job, files, task)
    # Two calls for one study may differ in where its files are and its results go.
    key = (job.study, job.folder, *(c.fmu for c in job.scenario.system.components))
    with _OwnProcess.lock:
        if _OwnProcess.workers is None or _OwnProcess.job != key:
            if _OwnProcess.workers is not None:
                _OwnProcess.workers.stop()
            _OwnProcess.workers, _OwnProcess.job = Local(), key
            _OwnProcess.workers.start(job)
        _OwnProcess.workers.submit([task])
        while True:
            for event in _OwnProcess.workers.events():
                if not isinstance(event, Progress | Remark):
                    return event


def _unpacked(job: Job, files: Mapping[str, tuple[str, bytes]], task: Task) -> tuple[Job, Task]:
    """Job and run with the paths that their files have on this machine."""
    from distributed import get_worker

    root = Path(get_worker().local_directory) / FOLDER
    here = {path: root / place for path, (place, _) in files.items()}
    for path, (_, content) in files.items():
        if not here[path].is_file():
            replace_whole(here[path], partial(Path.write_bytes, data=content))

    def moved(values: Mapping[str, Any]) -> dict[str, Any]:
        return {
            name: str(here[value]) if isinstance(value, str) and value in here else value
            for name, value in values.items()
        }

    scenario: Scenario = job.scenario
    components = tuple(
        replace(c, fmu=here[str(c.fmu)], start=moved(c.start)) for c in scenario.system.components
    )
    system = replace(scenario.system, components=components)
    local = replace(job, scenario=scenario.changed(system=system))
    return local, replace(task, settings=moved(task.settings))
