"""What a coupling knows of each link over one step: value and derivative at both ends."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.history import History
from congelation.cosim.coupling.polynomial import extrapolation
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.outputs import NO_DERIVATIVE

__all__ = ["Ends"]

Floats = npt.NDArray[np.float64]

LONGEST_EXTRAPOLATION = 20.0
"""A polynomial is not extrapolated over more than this many times the step that it comes from:
errors of its data would grow with a power of the ratio."""

MOST_NODES = 3
"""Values and derivatives at so many past points give a quintic; each further one would multiply
the errors of the data by four or more."""


class Ends:
    """Values and derivatives of all L links.

    Attributes
    ----------
    w : array, shape (4, L)
        v0, d0 at the start of the step, v1, d1 at its end, as the polynomials use them.
    new : array, shape (2, L)
        Value and derivative as last read from the sources.
    worst : int
        The link of the largest defect found last.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        count = len(ensemble.inputs.links)
        self._Y = ensemble.outputs.Y
        self._places = np.vstack([ensemble.inputs.source, ensemble.inputs.source_derivative])
        self._nominal = ensemble.inputs.nominal
        self._inexact = np.flatnonzero(ensemble.inputs.source_derivative == NO_DERIVATIVE)
        self._history = History(len(self._inexact))
        # Values, then derivatives, at the last points, the newest last.
        self._past: Floats = np.zeros((2, 0, count))
        self._times: list[float] = []
        self._end = 0.0
        self.worst = 0
        self.w: Floats = np.zeros((4, count))
        self.new: Floats = np.zeros((2, count))

    def start(self, time: float) -> None:
        """Begin at `time`, where outputs and inputs agree; what was before is forgotten."""
        self._Y.take(self._places, out=self.new, mode="clip")
        if self._inexact.size:
            self._history.restart(time, self.new[0, self._inexact])
            self.new[1, self._inexact] = 0.0
        self.w[:2] = self.new
        self._past, self._times = self.new[:, None].copy(), [time]

    def open(self, end: float) -> None:
        """Turn to a step that ends at `end`."""
        self._end = end
        if self._inexact.size:
            self.w[1, self._inexact] = self._history.slope()

    def read(self) -> None:
        """Take the newest values and derivatives from Y into `new`."""
        self._Y.take(self._places, out=self.new, mode="clip")
        if self._inexact.size:
            values = self.new[0, self._inexact]
            at_start, at_end = self._history.slopes(self._end, values)
            self.w[1, self._inexact] = at_start
            self.new[1, self._inexact] = at_end

    def predict(self) -> None:
        """Fill in v1, d1 ahead of the step, from as many past points as are useful."""
        self.w[2:] = self._extrapolated(MOST_NODES)
        if self._inexact.size:
            self.w[2:, self._inexact] = self._history.predict(self._end)

    def _far_enough(self) -> list[int]:
        """Places of the past points, the newest apart, that are not too near to it."""
        *times, now = self._times
        least = (self._end - now) / LONGEST_EXTRAPOLATION
        return [k for k, t in enumerate(times) if now - t >= least]

    def _extrapolated(self, most: int) -> Floats:
        """Value and derivative at the end of the step, shape (2, L), from at most so many nodes."""
        newest = len(self._times) - 1
        places = [*self._far_enough()[-(most - 1) :], newest]
        now = self._times[newest]
        nodes = [self._times[k] - now for k in places]
        data = self._past[:, places].reshape(2 * len(places), -1)
        found: Floats = extrapolation(nodes, self._end - now).dot(data)
        return found

    def close(self) -> None:
        """The step is kept: its end, as last read, is the start of the next."""
        self.w[2:] = self.new
        self.w[:2] = self.new
        self._times = [*self._times, self._end][-MOST_NODES:]
        self._past = np.concatenate([self._past, self.new[:, None]], axis=1)[:, -MOST_NODES:]
        if self._inexact.size:
            self._history.add(self._end, self.new[0, self._inexact])

    def defect(self) -> float:
        """Estimated largest distance of a link's cubic from its value, over the step.

        The cubic interpolates value and derivative at both ends, so it is off by
        f/24 s^2 (h - s)^2, at most f/24 (h/2)^4. With a point before, a distance g back,
        the cubic through that and the start, extrapolated to the end, misses by
        f/24 h^2 (h + g)^2, which gives f. Without one, the cubic's own third-order term is
        taken for the error: it is that of the quadratic through v0, d0, v1.

        Returns
        -------
        float
            Relative to nominal value plus size.
        """
        if not self.new.size:
            return 0.0
        w, new = self.w, self.new
        now = self._times[-1]
        h = self._end - now
        before = self._far_enough()
        if before:
            both = self._end - self._times[before[-1]]
            miss = np.abs(new - self._extrapolated(2))
            # The same fourth divided difference from the value and from the derivative.
            miss[0] /= (h * both) ** 2
            miss[1] /= 2.0 * h * both * (h + both)
            distance = miss.max(axis=0) * (h / 2.0) ** 4
        else:
            cubic = 2.0 * (w[0] - new[0]) + h * (w[1] + new[1])
            distance = np.abs(cubic) * (4.0 / 27.0)
        distance /= self._nominal + np.abs(new[0])
        self.worst = int(distance.argmax())
        return float(distance[self.worst])

    def time_scale(self) -> float:
        """The time in which some link would change by nominal value plus size; or infinity."""
        v, d = np.abs(self.w[:2])
        rate = float((d / (self._nominal + v)).max()) if d.size else 0.0
        return 1.0 / rate if rate > 0.0 else math.inf
