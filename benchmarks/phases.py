"""Where a sweep's time goes: timers around functions of congelation, in the worker processes."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any, ParamSpec, TypeVar, final

from congelation.sweep.executors import Crew, Workers

__all__ = ["PHASES", "STEPPING", "TimedWorkers", "Timers", "read_runs"]

P = ParamSpec("P")
T = TypeVar("T")

STEPPING = "the stepping loop"

RUN = ("congelation.sweep.workers", "Worker.do", "everything else")
PHASES = (
    ("congelation.cosim.master", "run_fixed", STEPPING),
    ("congelation.cosim.master", "run_adaptive", STEPPING),
    ("congelation.cosim.rows", "EveryStep.point", "recording rows"),
    ("congelation.sweep.workers", "plan_run", "planning the run"),
    ("congelation.cosim.system", "System.resolve", "finding names, checking start values"),
    ("congelation.fmi.slave", "Slave.__init__", "instantiating the FMUs"),
    ("congelation.fmi.slave", "Slave.reset", "resetting the FMUs"),
    ("congelation.cosim.session", "Session.initialise", "initialising the FMUs"),
    ("congelation.sweep.execute", "measure", "metrics"),
    ("congelation.results.store", "Store.write", "writing the row"),
    RUN,
)
"""(module, function or method, what it does); time in one is not counted in the one around it."""


@dataclass
class Timers:
    """Seconds by phase since they were last taken."""

    seconds: dict[str, float] = field(default_factory=dict)
    _inner: list[float] = field(default_factory=lambda: [0.0])

    def install(
        self, module: str, name: str, label: str, after: Callable[[], None] | None = None
    ) -> None:
        """Time a function from now on; `after` is called whenever it has returned."""
        owner = importlib.import_module(module)
        *path, attribute = name.split(".")
        for part in path:
            owner = getattr(owner, part)
        setattr(owner, attribute, self._timed(getattr(owner, attribute), label, after))

    def _timed(
        self, function: Callable[P, T], label: str, after: Callable[[], None] | None
    ) -> Callable[P, T]:
        inner, seconds = self._inner, self.seconds

        def timed(*args: P.args, **kwargs: P.kwargs) -> T:
            inner.append(0.0)
            begin = perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                elapsed = perf_counter() - begin
                seconds[label] = seconds.get(label, 0.0) + elapsed - inner.pop()
                inner[-1] += elapsed
                if after is not None:
                    after()

        return timed


@final
@dataclass(frozen=True)
class TimedWorkers(Workers):
    """Other workers, which also write what each run took to a file.

    Parameters
    ----------
    workers : Workers
    file : Path
        Takes a line of JSON per run: seconds by phase.
    """

    workers: Workers
    file: Path

    def open(self) -> AbstractContextManager[Crew]:
        return self._timed(self.workers.open())

    def alone(self) -> AbstractContextManager[Crew]:
        return self._timed(self.workers.alone())

    @contextmanager
    def _timed(self, opened: AbstractContextManager[Crew]) -> Iterator[Crew]:
        with opened as crew:
            yield Crew(_TimedExecutor(crew.executor, self.file), crew.size, crew.runs)


class _TimedExecutor(Executor):
    def __init__(self, executor: Executor, file: Path) -> None:
        self._executor, self._file = executor, file

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        return self._executor.submit(_with_timers, self._file, fn, *args, **kwargs)


_INSTALLED: list[Timers] = []
"""This process's timers, once they are there."""


def _with_timers(file: Path, function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    if not _INSTALLED:
        timers = Timers()
        _INSTALLED.append(timers)
        for phase in PHASES:
            timers.install(*phase, after=_write(timers, file) if phase is RUN else None)
    return function(*args, **kwargs)


def _write(timers: Timers, file: Path) -> Callable[[], None]:
    def write() -> None:
        with file.open("a") as stream:
            stream.write(json.dumps(timers.seconds) + "\n")
        timers.seconds.clear()

    return write


def read_runs(file: Path) -> list[dict[str, float]]:
    """What each run took, by phase."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]
