"""Where a sweep's runs are done: `concurrent.futures.Executor`s, here or on a cluster.

Whatever the executor, a worker that dies shows as a `BrokenExecutor` error of its tasks, and
functions are called with everything they need. FMUs and store are reached by their paths, which
have to be the same on every machine, unless they are sent to a cluster as its cargo.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import threading
import uuid
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.synchronize import Event
from typing import Any, ParamSpec, TypeVar, final
from urllib.parse import urlsplit

from congelation.errors import CongelationError, InvalidInput
from congelation.sweep.shipping import Cargo, aboard
from congelation.sweep.workers import stop_when

__all__ = ["Cluster", "Crew", "Processes", "Workers"]

P = ParamSpec("P")
T = TypeVar("T")

RUNS_PER_WORKER = 2000
"""After so many runs processes are replaced: the FMUs' interpreter leaks a little with each."""

PATIENCE = 30
"""Seconds to wait for a cluster's scheduler, and then for its first worker."""


@dataclass(frozen=True)
class Crew:
    """Workers ready to work.

    Parameters
    ----------
    executor : Executor
    size : int
        Number of workers.
    runs : int or None
        How many runs they may do before they have to be replaced; None if they need not be.
    """

    executor: Executor
    size: int
    runs: int | None


class Workers(ABC):
    """A place where crews are found."""

    @abstractmethod
    def open(self) -> AbstractContextManager[Crew]:
        """A crew for as long as the context lasts; an error in it ends runs that are under way."""

    @abstractmethod
    def alone(self) -> AbstractContextManager[Crew]:
        """One for runs that may kill their worker, which are done one at a time."""


@final
@dataclass(frozen=True)
class Processes(Workers):
    """Processes on this machine, each started afresh: FMUs do not survive a fork.

    They ignore Ctrl-C, which belongs to the parent, and end with the parent, also if it is
    killed.
    """

    count: int = 1

    @contextmanager
    def open(self) -> Iterator[Crew]:
        context = multiprocessing.get_context("spawn")
        stop = context.Event()
        executor = ProcessPoolExecutor(self.count, context, _start, (stop,))
        try:
            yield Crew(executor, self.count, RUNS_PER_WORKER * self.count)
        except BaseException:
            stop.set()
            raise
        finally:
            executor.shutdown(wait=True, cancel_futures=True)

    def alone(self) -> AbstractContextManager[Crew]:
        return Processes(1).open()


@final
@dataclass(frozen=True)
class Cluster(Workers):
    """The workers of a dask.distributed scheduler.

    On an error, runs that are under way are finished and stored, those that wait are cancelled;
    with a cargo nobody is left to store them.

    Parameters
    ----------
    address : str
        Of the scheduler.
    cargo : Cargo, optional
        What to send to workers that cannot reach the files of this machine; what they do is then
        part of their results.
    """

    address: str
    cargo: Cargo | None = None

    @contextmanager
    def open(self) -> Iterator[Crew]:
        try:
            from distributed import Client  # an optional extra
        except ImportError as error:
            raise InvalidInput(
                "--scheduler needs dask.distributed; install congelation[cluster]"
            ) from error
        _reach(self.address)
        try:
            client = Client(  # type: ignore[no-untyped-call]  # dask types only a part of itself
                self.address, timeout=PATIENCE, set_as_default=False
            )
        except OSError as error:  # something else answers there
            raise InvalidInput(f"no dask scheduler at {self.address}: {error}") from error
        with client:
            try:
                client.wait_for_workers(1, timeout=PATIENCE)
            except TimeoutError as error:
                raise CongelationError(
                    f"the scheduler at {self.address} has no workers; start: dask worker "
                    f"{self.address} --nthreads 1"
                ) from error
            size = len(client.scheduler_info(n_workers=-1)["workers"])
            yield Crew(self._executor(client), size, None)

    def alone(self) -> AbstractContextManager[Crew]:
        return self.open()

    def _executor(self, client: Any) -> _ClusterExecutor:
        if self.cargo is None:
            return _ClusterExecutor(client)
        from congelation.sweep.parcel import Parcel

        for place, data in self.cargo.contents.items():
            client.register_plugin(Parcel(place, data))
        return _ClusterExecutor(client, (aboard, uuid.uuid4().hex, self.cargo.places))


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
        socket.create_connection((url.hostname, url.port), timeout=PATIENCE).close()
    except OSError as error:
        raise InvalidInput(f"no dask scheduler at {address}: {error.strerror or error}") from error


class _ClusterExecutor(Executor):
    """A dask client that tells of dead workers as processes here do.

    `around` is a function that calls what is submitted, and its other arguments.
    """

    def __init__(self, client: Any, around: tuple[Any, ...] = ()) -> None:
        self._client = client
        self._around = around

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        outer = self._around[:1]
        remote = self._client.submit(*outer, fn, *self._around[1:], *args, **kwargs, pure=False)
        local: Future[T] = Future()
        local.set_running_or_notify_cancel()
        remote.add_done_callback(partial(_hand_over, local))
        return local


def _hand_over(local: Future[T], remote: Any) -> None:
    """Complete `local` as a dask future was completed."""
    from distributed import KilledWorker

    if remote.cancelled():
        local.set_exception(BrokenExecutor("the cluster has cancelled the task"))
        return
    error = remote.exception()
    if isinstance(error, KilledWorker):
        local.set_exception(BrokenExecutor(str(error)))
    elif error is not None:
        local.set_exception(error)
    else:
        local.set_result(remote.result())


def _start(stop: Event) -> None:
    """Prepare a worker process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    stop_when(stop.is_set)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)  # whatever is being written stands under a temporary name
