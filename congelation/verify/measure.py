"""The metrics of a run: of all its communication points, whichever rows are kept of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import final

import numpy as np
import numpy.typing as npt

from congelation.cosim.recorder import Memory, Sink
from congelation.results.records import Trajectory
from congelation.scenario.metrics import metric
from congelation.scenario.scenario import Case, MetricSpec

__all__ = ["Points", "measure"]

Floats = npt.NDArray[np.float64]


@final
class Points(Sink):
    """Keeps every communication point of a run, for its metrics.

    Parameters
    ----------
    wanted : sequence of str or None
        The columns that metrics are of; None: all that are recorded.
    """

    def __init__(self, wanted: Sequence[str] | None) -> None:
        self._wanted = wanted
        self._columns: tuple[str, ...] = ()
        self._picked: list[int] = []
        self._kept = Memory()

    def open(self, columns: Sequence[str]) -> None:
        """Find the columns."""
        self._columns = tuple(columns[1:] if self._wanted is None else self._wanted)
        self._picked = [columns.index(name) for name in ("time", *self._columns)]
        self._kept.open(["time", *self._columns])

    def write(self, block: Floats) -> None:
        """Keep these columns of a block."""
        self._kept.write(block[:, self._picked])

    def close(self) -> None:
        """Nothing is left to do."""
        self._kept.close()

    def abandon(self) -> None:
        """Nothing is left to do."""
        self._kept.abandon()

    def with_rows(self, kept: Trajectory) -> Trajectory:
        """The points, and between them the rows that are kept.

        Where an output interval is shorter than the steps, peaks lie between two points.
        """
        points = self._kept.rows()
        rows = np.column_stack([kept.time, kept.select(self._columns)])
        every = np.concatenate([points, rows])
        _, first = np.unique(every[:, 0], return_index=True)  # a point, where both are there
        chosen = every[first]
        return Trajectory(chosen[:, 0], self._columns, chosen[:, 1:], kept.units)


def measure(
    specs: Sequence[MetricSpec], case: Case, trajectory: Trajectory
) -> Mapping[str, float | None]:
    """The metrics of a run that reached its stop time, by name; None where one has no answer."""
    return {spec.name: _value(spec, case, trajectory) for spec in specs}


def _value(spec: MetricSpec, case: Case, trajectory: Trajectory) -> float | None:
    found = metric(spec.metric)
    time, columns = trajectory.time, trajectory.columns
    if found.loop:
        value = found.evaluate(case, time, columns, trajectory.values, **spec.options)
    else:
        group = trajectory.select(trajectory.group(spec.of))
        value = found.evaluate(time, group, **spec.options)
    return None if value is None or math.isnan(value) else value
