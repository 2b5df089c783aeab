"""Which rows are kept of a run, and where.

Output      which rows (every n-th communication point, or a grid of its own), and their sink
Rows        takes the communication points of a run and records rows: EveryStep, OutputGrid
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
import numpy.typing as npt

from congelation.arguments import check_fields
from congelation.cosim.columns import Columns
from congelation.cosim.coupling.polynomial import differentiation, interpolation, product
from congelation.cosim.sinks import Recorder, Sink
from congelation.errors import InvalidInput, require_count

__all__ = [
    "NODES",
    "EveryStep",
    "Output",
    "OutputGrid",
    "Rows",
    "VisitedGrid",
]

Floats = npt.NDArray[np.float64]

NODES = 6
"""Values without derivatives are interpolated by quintics, through three points on either side."""

SMOOTH_NODES = 3
"""Values with derivatives as well: the order is that of the coupling of the highest order."""

SAMPLED_TOLERANCE = 1e-3
"""How far a recorded value without a derivative may be from what the values before it predict,
relative to nominal value plus size. Interpolation between the points is far better than that."""

MOST_AMPLIFIED = 200.0
"""Sum of the weights that such a prediction may have: more would amplify rounding. Five equal steps
have 31."""

GRID_ROUNDING = 1e-9
"""A communication point this near to a grid point, in grid intervals, is taken for it."""


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

    Examples
    --------
    >>> system = cg.load_scenario("scenarios/scalar.toml").system
    >>> result = cg.simulate(system, stop_time=1.0, step=0.01, output=cg.Output(interval=0.5))
    >>> {0.0, 0.5, 1.0} <= set(result.time.tolist())
    True
    """

    every: int = 1
    interval: float | None = None
    sink: Sink | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        require_count(self.every, "every")
        if self.interval is not None and self.every != 1:
            raise InvalidInput("every and interval: give one of the two")

    def rows(self, columns: Columns, recorder: Recorder, *, visits: bool = False) -> Rows:
        """What records these rows; `visits` where all values can be had at any time."""
        if self.interval is not None:
            kind = VisitedGrid if visits else OutputGrid
            return kind(columns, recorder, self.interval)
        return EveryStep(columns, recorder, self.every)


class Rows(ABC):
    """Takes communication points as they are reached, and records rows.

    Attributes
    ----------
    columns : Columns
        What is recorded.
    near : float
        A communication point this near to a time at which a row is asked for is taken for it.
    """

    columns: Columns
    near: float = math.inf

    @abstractmethod
    def start(self, time: float) -> None:
        """The start time; outputs are read."""

    @abstractmethod
    def point(self, time: float) -> None:
        """A communication point."""

    def unresolved(self, time: float) -> float:
        """Whether rows between the last point and this one can be recorded well; above 1 not.

        Asked before the point is handed over, and while it can still be taken back.
        """
        return 0.0

    @abstractmethod
    def before_jump(self, time: float) -> None:
        """The last point before a jump, with the values from the left."""

    @abstractmethod
    def after_jump(self, time: float) -> None:
        """The jump, with the values from the right."""

    def due(self, until: float, most: int) -> list[float]:
        """The next times before `until`, at most `most`, at which rows are asked for whatever the
        communication points are."""
        return []

    def visit(self, time: float) -> None:
        """A time between two communication points; all values are those there."""
        return

    @abstractmethod
    def finish(self, time: float, *, completed: bool) -> None:
        """Nothing will follow the point at `time`; what is read now counts only if `completed`."""


class EveryStep(Rows):
    """Every n-th communication point, the first, the jumps and the last.

    Parameters
    ----------
    columns : Columns
    recorder : Recorder
    every : int
        n.

    Attributes
    ----------
    left : int
        Communication points that are still to be left out.
    """

    def __init__(self, columns: Columns, recorder: Recorder, every: int) -> None:
        self.columns = columns
        self.recorder = recorder
        self.every = every
        self.left = 0

    def start(self, time: float) -> None:
        self._record(time)

    def point(self, time: float) -> None:
        if self.left:
            self.left -= 1
        else:
            self._record(time)

    def before_jump(self, time: float) -> None:
        """The row of a jump holds the values from the right."""

    def after_jump(self, time: float) -> None:
        self._record(time)

    def finish(self, time: float, *, completed: bool) -> None:
        if completed and self.left < self.every - 1:
            self._record(time)

    def _record(self, time: float) -> None:
        self.left = self.every - 1
        self.columns.fill(self.recorder.row(time))


class VisitedGrid(Rows):
    """The points t_0 + k dt and the last one, each with the values that all FMUs have there.

    Parameters
    ----------
    columns : Columns
    recorder : Recorder
    interval : float
        dt in seconds.
    """

    def __init__(self, columns: Columns, recorder: Recorder, interval: float) -> None:
        self.columns = columns
        self._recorder = recorder
        self._interval = interval
        self.near = GRID_ROUNDING * interval
        self._first = self._last = 0.0
        self._count = 0

    def due(self, until: float, most: int) -> list[float]:
        end = until - self.near
        places = (self._first + k * self._interval for k in range(self._count, self._count + most))
        return list(takewhile(lambda place: place < end, places))

    def start(self, time: float) -> None:
        self._first, self._count = time, 0
        self.visit(time)

    def visit(self, time: float) -> None:
        place = self._first + self._count * self._interval
        if place <= time + self.near:
            self._record(place)
            self._count += 1

    def point(self, time: float) -> None:
        self.visit(time)

    def before_jump(self, time: float) -> None:
        """The row of a jump holds the values from the right."""

    def after_jump(self, time: float) -> None:
        self.visit(time)

    def finish(self, time: float, *, completed: bool) -> None:
        if time - self._last > self.near:
            self._record(time)

    def _record(self, time: float) -> None:
        self._last = time
        self.columns.fill(self._recorder.row(time))


class OutputGrid(Rows):
    """The points t_0 + k dt and the last one, whatever the communication points are.

    Between two communication points, a variable whose derivative is read follows the quintic
    through values and derivatives at both and at a neighbour; any other the quintic through the
    values at three points on either side, or the nearest there are; one that changes at events
    alone keeps the value of the point before. Jumps are not interpolated across. Those without a
    derivative, and those that no input sees, may do anything in between (a sine of theta), so steps
    longer than dt must be short enough to predict them.

    Parameters
    ----------
    columns : Columns
    recorder : Recorder
    interval : float
        dt in seconds.

    Attributes
    ----------
    times : list of float
        The latest communication points since a jump, at most `NODES`.
    samples : list of array, shape (S,)
        What `columns.sample` was there.
    """

    def __init__(self, columns: Columns, recorder: Recorder, interval: float) -> None:
        self.columns = columns
        self.interval = interval
        self._recorder = recorder
        self._first = 0.0
        self._count = 0
        self.times: list[float] = []
        self._values: list[Floats] = []
        self._derivatives: list[Floats] = []
        self.samples: list[Floats] = []

    def unresolved(self, time: float) -> float:
        if time - self.times[-1] <= self.interval or not self.columns.sampled.size:
            return 0.0
        # As many of the latest points as do not amplify rounding; the very latest always may.
        for first in range(len(self.times)):
            weights, _ = differentiation(np.array(self.times[first:]), time)
            # Summed in the order of the compiled loop, which judges in the same way.
            if np.abs(weights).cumsum()[-1] <= MOST_AMPLIFIED:
                break
        (predicted,) = product(weights[None], np.array(self.samples[first:]))
        return self.columns.surprise(predicted) / SAMPLED_TOLERANCE

    def start(self, time: float) -> None:
        self._first = time
        self._begin(time)

    def point(self, time: float) -> None:
        self._add(time)
        if len(self.times) == NODES:
            # Two points late, so that an interval has its neighbours on the right.
            self._emit(NODES // 2)

    def before_jump(self, time: float) -> None:
        if time > self.times[-1]:
            self.point(time)
        self._close()

    def after_jump(self, time: float) -> None:
        self._begin(time)

    def finish(self, time: float, *, completed: bool) -> None:
        self._close()
        self._recorder.row(self.times[-1])[:] = self._values[-1]

    def _begin(self, time: float) -> None:
        self.times, self._values, self._derivatives, self.samples = [], [], [], []
        self._add(time)

    def _add(self, time: float) -> None:
        row = np.empty(self.columns.width)
        self.columns.fill(row)
        keep = NODES - 1
        self.times = [*self.times[-keep:], time]
        self._values = [*self._values[-keep:], row]
        slopes = self.columns.ensemble.Y[self.columns.slopes]
        self._derivatives = [*self._derivatives[-keep:], slopes]
        self.samples = [*self.samples[-keep:], self.columns.sample()]

    def _close(self) -> None:
        """What is left: nothing smooth follows on the right."""
        self._emit(len(self.times) - 1)

    def _grid_point(self) -> float:
        return self._first + self._count * self.interval

    def _emit(self, count: int) -> None:
        """Rows at the grid points in the first `count` intervals that have none yet."""
        for k in range(count):
            end = self.times[k + 1] - GRID_ROUNDING * self.interval
            while (time := self._grid_point()) < end:
                self._recorder.row(time)[:] = self._at(time, k)
                self._count += 1

    def _at(self, time: float, k: int) -> Floats:
        """The recorded values, shape (M,), at a time in interval k."""
        if abs(time - self.times[k]) <= GRID_ROUNDING * self.interval:
            return self._values[k]
        weights, _ = differentiation(np.array(self.times), time)
        row: Floats = weights @ np.array(self._values)
        nodes = slice(max(k - 1, 0), max(k - 1, 0) + SMOOTH_NODES)
        smooth = self.columns.smooth
        values = [row[smooth] for row in self._values[nodes]]
        weights, _ = interpolation(self.times[nodes], time)
        row[smooth] = weights @ np.array([*values, *self._derivatives[nodes]])
        stepped = self.columns.stepped
        row[stepped] = self._values[k][stepped]
        return row
