"""Where the runs of a study are done: what workers take, and the events that they have."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from congelation.results.record import Outcome
from congelation.sweep.execute import Job, Task

__all__ = ["Event", "Finished", "Lost", "Progress", "Remark", "Unfinished", "Workers"]


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
    """What is to be said of the FMUs of a study, in one line."""

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
