"""The master of congelation with its coupling `hermite`, steps chosen to a tolerance."""

from __future__ import annotations

from benchmarks.engines.base import Program, Run
from benchmarks.engines.ours import coupled_system
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch
from congelation.cosim import SlavePool, simulate

__all__ = ["Hermite"]


class Hermite(Program):
    """Calls `simulate`; its time includes initialisation, but no loading after the first run."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._pool = SlavePool()
        self._system = coupled_system(loop)
        self._record = [f"{owner}.{name}" for owner, name in loop.record]

    def run(
        self, stop_time: float, tolerance: float, slave_tolerance: float, *, keep_rows: bool
    ) -> Run:
        """Rows are recorded in any case."""
        watch = Stopwatch()
        result = simulate(
            self._system,
            stop_time=stop_time,
            tolerance=tolerance,
            slave_tolerance=slave_tolerance,
            coupling="hermite",
            record=self._record,
            pool=self._pool,
        )
        seconds = watch.seconds()
        if not result.completed:
            raise RuntimeError(result.message)
        if not keep_rows:
            return Run(seconds)
        pairs = zip(result.time.tolist(), result.values.tolist(), strict=True)
        return Run(seconds, [[t, *values] for t, values in pairs])
