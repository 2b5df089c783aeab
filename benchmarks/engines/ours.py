"""The master of congelation with its coupling `jacobi`."""

from __future__ import annotations

from pathlib import Path

from benchmarks.engines.base import Engine, Run
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch
from congelation.cosim import Component, Connection, SlavePool, System, simulate

__all__ = ["Ours", "coupled_system"]


def coupled_system(loop: Loop) -> System:
    """A loop as congelation describes it."""
    return System(
        tuple(Component(c.name, Path(c.fmu), c.start) for c in loop.components),
        tuple(Connection(f"{a}.{y}", f"{b}.{u}") for a, y, b, u in loop.connections),
    )


class Ours(Engine):
    """Calls `simulate`; its time includes initialisation, but no loading after the first run."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._pool = SlavePool()
        self._system = coupled_system(loop)
        self._record = [f"{owner}.{name}" for owner, name in loop.record]

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Rows are recorded in any case."""
        watch = Stopwatch()
        result = simulate(
            self._system,
            stop_time=steps * step,
            step=step,
            coupling="jacobi",
            record=self._record,
            pool=self._pool,
        )
        seconds = watch.seconds()
        if not result.completed and not keep_rows:
            raise RuntimeError(result.message)
        if not keep_rows:
            return Run(seconds)
        pairs = zip(result.time[1:].tolist(), result.values[1:].tolist(), strict=True)
        return Run(seconds, [[t, *values] for t, values in pairs])
