"""What to keep of a run: which rows, and where."""

from __future__ import annotations

from dataclasses import dataclass

from congelation.cosim.ensemble import Ensemble
from congelation.cosim.recorder import Recorder, Sink
from congelation.cosim.rows import EveryStep, OutputGrid, Rows
from congelation.errors import InvalidInput

__all__ = ["Output"]


@dataclass(frozen=True)
class Output:
    """Which rows of a run are recorded, and where to.

    Parameters
    ----------
    every : int
        Record every so many communication points (and the first, the jumps and the last).
    interval : float, optional
        Record at t_0 + k * interval, in seconds, and at the last point instead, interpolating
        between communication points. It cannot be combined with `every`.
    sink : Sink, optional
        Takes the rows block by block, for instance a ParquetFile; without one they are kept in
        memory.
    """

    every: int = 1
    interval: float | None = None
    sink: Sink | None = None

    def __post_init__(self) -> None:
        if self.every < 1:
            raise InvalidInput(f"every {self.every}: at least 1 is needed")
        if self.interval is not None and self.every != 1:
            raise InvalidInput("every and interval: give one of the two")

    def rows(self, ensemble: Ensemble, recorder: Recorder) -> Rows:
        """The recording of an ensemble."""
        if self.interval is not None:
            return OutputGrid(ensemble, recorder, self.interval)
        return EveryStep(ensemble, recorder, self.every)
