"""Which rows of a run are recorded: every n-th communication point, or a grid of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.history import differentiation
from congelation.cosim.coupling.polynomial import interpolation
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.recorder import Recorder

__all__ = ["EveryStep", "OutputGrid", "Rows", "Several"]

Floats = npt.NDArray[np.float64]

NODES = 6
"""Values without derivatives are interpolated by quintics, through three points on either side."""

SMOOTH_NODES = 3
"""Values with derivatives as well: the order is that of the coupling of the highest order."""

GRID_ROUNDING = 1e-9
"""A communication point this near to a grid point, in grid intervals, is taken for it."""


class Rows(ABC):
    """Takes communication points as they are reached, and records rows."""

    @abstractmethod
    def start(self, time: float) -> None:
        """The start time; outputs are read."""

    @abstractmethod
    def point(self, time: float) -> None:
        """A communication point."""

    @abstractmethod
    def before_jump(self, time: float) -> None:
        """The last point before a jump, with the values from the left."""

    @abstractmethod
    def after_jump(self, time: float) -> None:
        """The jump, with the values from the right."""

    @abstractmethod
    def finish(self, time: float, *, completed: bool) -> None:
        """Nothing will follow the point at `time`; what is read now counts only if `completed`."""


class Several(Rows):
    """The same points for several recordings.

    Parameters
    ----------
    parts : sequence of Rows
    """

    def __init__(self, parts: Sequence[Rows]) -> None:
        self._parts = tuple(parts)

    def start(self, time: float) -> None:
        for part in self._parts:
            part.start(time)

    def point(self, time: float) -> None:
        for part in self._parts:
            part.point(time)

    def before_jump(self, time: float) -> None:
        for part in self._parts:
            part.before_jump(time)

    def after_jump(self, time: float) -> None:
        for part in self._parts:
            part.after_jump(time)

    def finish(self, time: float, *, completed: bool) -> None:
        for part in self._parts:
            part.finish(time, completed=completed)


class EveryStep(Rows):
    """Every n-th communication point, the first, the jumps and the last.

    Parameters
    ----------
    ensemble : Ensemble
    recorder : Recorder
    every : int
        n.
    """

    def __init__(self, ensemble: Ensemble, recorder: Recorder, every: int) -> None:
        self._ensemble = ensemble
        self._recorder = recorder
        self._every = every
        self._left = 0

    def start(self, time: float) -> None:
        self._record(time)

    def point(self, time: float) -> None:
        if self._left:
            self._left -= 1
        else:
            self._record(time)

    def before_jump(self, time: float) -> None:
        """The row of a jump holds the values from the right."""

    def after_jump(self, time: float) -> None:
        self._record(time)

    def finish(self, time: float, *, completed: bool) -> None:
        if completed and self._left < self._every - 1:
            self._record(time)

    def _record(self, time: float) -> None:
        self._left = self._every - 1
        self._ensemble.fill(self._recorder.row(time))


class OutputGrid(Rows):
    """The points t_0 + k dt and the last one, whatever the communication points are.

    Between two communication points, a variable whose derivative is read follows the quintic
    through values and derivatives at both and at a neighbour; any other the quintic through the
    values at three points on either side, or the nearest there are. Jumps are not interpolated
    across.

    Parameters
    ----------
    ensemble : Ensemble
    recorder : Recorder
    interval : float
        dt in seconds.
    """

    def __init__(self, ensemble: Ensemble, recorder: Recorder, interval: float) -> None:
        self._ensemble = ensemble
        self._recorder = recorder
        self._interval = interval
        self._smooth, self._slopes = ensemble.smooth_columns()
        self._width = ensemble.width
        self._first = 0.0
        self._count = 0
        self._times: list[float] = []
        self._values: list[Floats] = []
        self._derivatives: list[Floats] = []

    def start(self, time: float) -> None:
        self._first = time
        self._begin(time)

    def point(self, time: float) -> None:
        self._add(time)
        if len(self._times) == NODES:
            # Two points late, so that an interval has its neighbours on the right.
            self._emit(NODES // 2)

    def before_jump(self, time: float) -> None:
        if time > self._times[-1]:
            self.point(time)
        self._close()

    def after_jump(self, time: float) -> None:
        self._begin(time)

    def finish(self, time: float, *, completed: bool) -> None:
        self._close()
        self._recorder.row(self._times[-1])[:] = self._values[-1]

    def _begin(self, time: float) -> None:
        self._times, self._values, self._derivatives = [], [], []
        self._add(time)

    def _add(self, time: float) -> None:
        row = np.empty(self._width)
        self._ensemble.fill(row)
        keep = NODES - 1
        self._times = [*self._times[-keep:], time]
        self._values = [*self._values[-keep:], row]
        self._derivatives = [*self._derivatives[-keep:], self._ensemble.outputs.Y[self._slopes]]

    def _close(self) -> None:
        """What is left: nothing smooth follows on the right."""
        self._emit(len(self._times) - 1)

    def _grid_point(self) -> float:
        return self._first + self._count * self._interval

    def _emit(self, count: int) -> None:
        """Rows at the grid points in the first `count` intervals that have none yet."""
        for k in range(count):
            end = self._times[k + 1] - GRID_ROUNDING * self._interval
            while (time := self._grid_point()) < end:
                self._recorder.row(time)[:] = self._at(time, k)
                self._count += 1

    def _at(self, time: float, k: int) -> Floats:
        """The recorded values, shape (M,), at a time in interval k."""
        if abs(time - self._times[k]) <= GRID_ROUNDING * self._interval:
            return self._values[k]
        weights, _ = differentiation(np.array(self._times), time)
        row: Floats = weights @ np.array(self._values)
        nodes = slice(max(k - 1, 0), max(k - 1, 0) + SMOOTH_NODES)
        values = [row[self._smooth] for row in self._values[nodes]]
        weights, _ = interpolation(self._times[nodes], time)
        row[self._smooth] = weights @ np.array([*values, *self._derivatives[nodes]])
        return row
