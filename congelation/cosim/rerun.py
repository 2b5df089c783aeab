"""A run made again, with other steps and tighter tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling import Coupling, Hermite
from congelation.cosim.coupling.interpolant import HIGH, LOW
from congelation.cosim.experiment import Experiment, slave_tolerance, step_count
from congelation.cosim.recording import Output
from congelation.cosim.result import Result, Statistics
from congelation.cosim.sinks import Memory, Sink

__all__ = ["Again", "At", "divided", "halved_grid", "tightened"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

TIGHTER = 0.03
"""Tolerance of the iterations in the second run, relative to that of the first."""

MORE_ITERATIONS = 4
"""Iterations that a step of the second run may take, relative to the first."""

TIGHTER_SLAVES = 0.01
"""Tolerance of the FMUs in the second run, relative to that of the first."""

NEAR = 1e-9
"""Rows of two runs are of the same time if they differ by less, relative to the shortest step."""


class At(Sink):
    """Keeps the rows at some times.

    Parameters
    ----------
    times : array, shape (N,), or None
        Increasing; None: the times of all rows are kept, and no values.
    near : float
        Rows this near count, in seconds.
    """

    def __init__(self, times: Floats | None, near: float = 0.0) -> None:
        self._times, self._near = times, near
        self._kept = Memory()

    def open(self, columns: Sequence[str]) -> None:
        """Begin with nothing."""
        self._kept.open(columns if self._times is not None else columns[:1])

    def write(self, block: Floats) -> None:
        """Keep what is wanted of a block."""
        if self._times is None:
            self._kept.write(block[:, :1].copy())
        else:
            distance = np.abs(self._times[_nearest(self._times, block[:, 0])] - block[:, 0])
            self._kept.write(block[distance <= self._near])

    def times(self) -> Floats:
        """Of all rows, shape (N,)."""
        return self._kept.rows()[:, 0]

    def values(self) -> Floats:
        """The values at each of the times, shape (N, M); nan where there is no row."""
        assert self._times is not None
        rows = self._kept.rows()
        found = np.full((len(self._times), rows.shape[1] - 1), math.nan)
        if len(rows):
            found[_nearest(self._times, rows[:, 0])] = rows[:, 1:]
        return found


def _nearest(times: Floats, wanted: Floats) -> Indices:
    """The places in increasing times that are nearest to those wanted."""
    after = np.searchsorted(times, wanted).clip(1, len(times) - 1)
    return np.asarray(after - (wanted - times[after - 1] < times[after] - wanted), dtype=np.intp)


class Again:
    """Makes a run again, with other steps.

    Parameters
    ----------
    run : callable
        Performs an experiment.
    experiment : Experiment
        Of the run.
    statistics : Statistics
    points : array, shape (P,)
        Its communication points, the start time among them.
    table : array, shape (N, 1 + M)
        Its rows.
    interval : float or None
        Of its rows, where they have one of their own.
    ahead : callable
        Gives the rows of the run with halved steps to a sink, and returns its result; None where it
        was not made already.
    """

    def __init__(
        self,
        run: Callable[..., Result],
        experiment: Experiment,
        statistics: Statistics,
        points: Floats,
        table: Floats,
        interval: float | None,
        ahead: Callable[[At], Result | None],
    ) -> None:
        self._run, self._ahead = run, ahead
        self._interval = interval
        self.experiment, self.statistics = experiment, statistics
        self.points = points
        self.time, self.values = table[:, 0], table[:, 1:]
        self.steps = 0

    def halved(self, progress: Callable[[float], None] | None) -> tuple[Result, Floats]:
        """The run with every one of its steps halved, as `at` returns it."""
        kept = At(self.time, NEAR * float(np.diff(self.points).min()) / 2.0)
        made = self._ahead(kept)
        if made is not None:
            self.steps += made.statistics.macro_steps
            return made, kept.values()
        points = halved_grid(self.experiment)
        if points is None:
            points = divided(self.points, 2 * self.statistics.parts)
        return self.at(points, progress)

    def at(
        self, points: Floats, progress: Callable[[float], None] | None = None
    ) -> tuple[Result, Floats]:
        """Another run over other communication points, shape (P,), tightened inside; and its values
        at the times of the rows, shape (N, M), nan where it has none."""
        lengths = np.diff(points)
        experiment = replace(
            tightened(self.experiment, self.statistics.order),
            stop_time=float(points[-1]),
            step=float(lengths.max()),
        )
        kept = At(self.time, NEAR * float(lengths.min()))
        result = self._run(
            experiment,
            [Output(interval=self._interval, sink=kept)],
            points=points[1:].tolist(),
            progress=progress,
        )
        self.steps += result.statistics.macro_steps
        return result, kept.values()


def tightened(experiment: Experiment, order: int) -> Experiment:
    """An experiment with the accuracy inside that a second run has: iterations that end closer to
    their solution, FMUs of a smaller tolerance, the highest order. Its steps are to be given.

    Parameters
    ----------
    experiment : Experiment
        Of the first run.
    order : int
        Of its coupling at work; LOW where inputs follow polynomials through exact derivatives.
    """
    coupling: Coupling = experiment.chosen_coupling
    if isinstance(coupling, Hermite):
        accuracy = min(coupling.tolerance, experiment.tolerance or coupling.tolerance)
        coupling = replace(
            coupling,
            order=HIGH if order == LOW else coupling.order,
            # One iteration takes no step back, which FMUs may not be able to.
            iterations=1 if coupling.iterations == 1 else None,
            tolerance=TIGHTER * accuracy,
            # There is no shorter step to fall back on, as the first run may have had.
            max_iterations=MORE_ITERATIONS * coupling.max_iterations,
        )
    slaves = slave_tolerance(experiment)
    return replace(
        experiment,
        step=experiment.step or experiment.stop_time - experiment.start_time,
        tolerance=None,
        coupling=coupling,
        options={},
        slave_tolerance=None if slaves is None else TIGHTER_SLAVES * slaves,
        output_interval=None,
        output_every=None,
        max_steps=None,
    )


def divided(points: Floats, parts: int) -> Floats:
    """Points, shape (P,), with each interval divided into so many; they stay what they are."""
    shares = np.arange(parts) / parts
    finer = points[:-1, None] + np.diff(points)[:, None] * shares
    return np.append(finer.reshape(-1), points[-1])


def halved_grid(experiment: Experiment) -> Floats | None:
    """The points t_0 + k h / 2 up to the stop time; None where steps are chosen.

    Jumps come besides, as in the first run.
    """
    start, stop, step = experiment.start_time, experiment.stop_time, experiment.step
    if step is None or experiment.tolerance is not None:
        return None
    count = step_count(start, stop, step)
    return divided(np.append(start + step * np.arange(count), stop), 2)
