"""Where a sweep's time goes: timers around functions of congelation, in the worker processes."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any, ParamSpec, TypeVar

from congelation.results.record import Outcome
from congelation.sweep import execute

__all__ = ["PHASES", "STEPPING", "Timers", "read_runs", "timed_execute"]

P = ParamSpec("P")
T = TypeVar("T")

STEPPING = "the stepping loop"

RUN = ("congelation.sweep.execute", "execute", "everything else")
PHASES = (
    ("congelation.cosim.master", "run_fixed", STEPPING),
    ("congelation.cosim.master", "run_adaptive", STEPPING),
    ("congelation.cosim.recording", "EveryStep.point", "recording rows"),
    ("congelation.scenario.scenario", "Scenario.case", "planning the run"),
    ("congelation.cosim.system", "System.resolve", "finding names, checking start values"),
    ("congelation.fmi.slave", "Slave.__init__", "instantiating the FMUs"),
    ("congelation.fmi.slave", "Slave.reset", "resetting the FMUs"),
    ("congelation.cosim.stepping", "Session.initialise", "initialising the FMUs"),
    ("congelation.sweep.execute", "measure", "metrics"),
    ("congelation.sweep.execute", "trajectory_bytes", "writing the trajectory"),
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


_INSTALLED: list[Timers] = []
"""This process's timers, once they are there."""


def timed_execute(file: Path, *arguments: Any) -> tuple[Outcome, bytes | None]:
    """`execute`, which also writes to a file what each run took: seconds by phase, as JSON."""
    if not _INSTALLED:
        timers = Timers()
        _INSTALLED.append(timers)
        for phase in PHASES:
            timers.install(*phase, after=_write(timers, file) if phase is RUN else None)
    return execute.execute(*arguments)


def _write(timers: Timers, file: Path) -> Callable[[], None]:
    def write() -> None:
        with file.open("a") as stream:
            stream.write(json.dumps(timers.seconds) + "\n")
        timers.seconds.clear()

    return write


def read_runs(file: Path) -> list[dict[str, float]]:
    """What each run took, by phase."""
    return [json.loads(line) for line in file.read_text("utf-8").splitlines()]
