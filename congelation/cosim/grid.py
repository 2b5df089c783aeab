"""The communication points of a run with fixed steps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.experiment import step_count

__all__ = ["GivenPoints", "Grid"]

Floats = npt.NDArray[np.float64]

EVENT_ROUNDING = 1e-9
"""A jump this near to a grid point, in steps, is taken to lie on it."""


class Grid:
    """The points t_0 + k h for `run_fixed`, the last one at the stop time exactly."""

    def __init__(self, start: float, stop: float, step: float) -> None:
        self._start, self._stop, self._step = start, stop, step
        self._count = step_count(start, stop, step)
        self.near = EVENT_ROUNDING * min(step, stop - start)

    def after(self, k: int, most: int) -> Floats:
        """The points that follow the first k, at most so many of them."""
        last = min(self._count, k + most)
        points = np.arange(k + 1, last + 1, dtype=np.float64) * self._step + self._start
        if last == self._count:
            points[-1:] = self._stop
        return points


class GivenPoints:
    """Any other points for `run_fixed`, the last one the stop time."""

    def __init__(self, points: Sequence[float], start: float) -> None:
        self._points = np.asarray(points)
        self.near = EVENT_ROUNDING * float(np.diff(self._points, prepend=start).min())

    def after(self, k: int, most: int) -> Floats:
        """As of `Grid`."""
        found: Floats = self._points[k : k + most]
        return found
