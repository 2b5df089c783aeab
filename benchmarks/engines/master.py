"""The master of congelation with any coupling, steps fixed or chosen to a tolerance."""

from __future__ import annotations

from benchmarks.engines.base import Program, Run
from benchmarks.engines.ours import coupled_system
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch
from congelation.cosim import SlavePool, simulate

__all__ = ["Master"]


class Master(Program):
    """Calls `simulate`; its time includes initialisation, but no loading after the first run."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._pool = SlavePool()
        self._system = coupled_system(loop)
        self._record = [f"{owner}.{name}" for owner, name in loop.record]

    def run(
        self,
        *,
        coupling: str,
        stop_time: float,
        step: float | None = None,
        tolerance: float | None = None,
        slave_tolerance: float | None = None,
        keep_rows: bool,
    ) -> Run:
        """Rows are recorded in any case."""
        watch = Stopwatch()
        result = simulate(
            self._system,
            stop_time=stop_time,
            step=step,
            tolerance=tolerance,
            slave_tolerance=slave_tolerance,
            coupling=coupling,
            record=self._record,
            pool=self._pool,
        )
        seconds = watch.seconds()
        if not result.completed:
            raise RuntimeError(result.message)
        if not keep_rows:
            return Run(seconds)
        pairs = zip(result.time[1:].tolist(), result.values[1:].tolist(), strict=True)
        return Run(seconds, [[t, *values] for t, values in pairs])
