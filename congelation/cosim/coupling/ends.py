"""What a coupling knows of each link over one step: value and derivative at both ends."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.history import History
from congelation.cosim.coupling.polynomial import extrapolation
from congelation.cosim.ensemble import NO_DERIVATIVE, Ensemble

__all__ = ["Ends"]

Floats = npt.NDArray[np.float64]

LONGEST_EXTRAPOLATION = 20.0
"""A cubic is not extrapolated over more than this many times the step that it comes from:
rounding errors would grow with the third power of the ratio."""


class Ends:
    """Values and derivatives of all L links.

    Attributes
    ----------
    w : array, shape (4, L)
        v0, d0 at the start of the step, v1, d1 at its end, as the polynomials use them.
    new : array, shape (2, L)
        Value and derivative as last read from the sources.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        count = len(ensemble.links)
        self._Y = ensemble.Y
        self._places = np.vstack([ensemble.source, ensemble.source_derivative])
        self._nominal = ensemble.nominal
        self._inexact = np.flatnonzero(ensemble.source_derivative == NO_DERIVATIVE)
        self._history = History(len(self._inexact))
        self._before: Floats = np.zeros((4, count))
        self._length_before = 0.0
        self._end = 0.0
        self.w: Floats = np.zeros((4, count))
        self.new: Floats = np.zeros((2, count))

    def start(self, time: float) -> None:
        """Begin at `time`, where outputs and inputs agree; what was before is forgotten."""
        self._length_before = 0.0
        self._Y.take(self._places, out=self.new, mode="clip")
        if self._inexact.size:
            self._history.restart(time, self.new[0, self._inexact])
            self.new[1, self._inexact] = 0.0
        self.w[:2] = self.new

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

    def extrapolates(self, length: float) -> bool:
        """Whether the step before gives a cubic to extrapolate over a step of `length`."""
        return 0.0 < length <= LONGEST_EXTRAPOLATION * self._length_before

    def predict(self, length: float) -> None:
        """Fill in v1, d1 of a step of `length` ahead of it."""
        w = self.w
        if self.extrapolates(length):
            np.dot(extrapolation(self._length_before, length), self._before, out=w[2:])
        else:
            np.multiply(w[1], length, out=w[2])
            w[2] += w[0]
            w[3] = w[1]
        if self._inexact.size:
            w[2:, self._inexact] = self._history.predict(self._end)

    def close(self, length: float) -> None:
        """The step of `length` is kept: its end, as last read, is the start of the next."""
        self.w[2:] = self.new
        self._before[:] = self.w
        self._length_before = length
        self.w[:2] = self.new
        if self._inexact.size:
            self._history.add(self._end, self.new[0, self._inexact])

    def defect(self, predicted: Floats, length: float) -> float:
        """Estimated largest distance of a link's cubic from its value, over the step.

        The cubic interpolates value and derivative at both ends, so it is off by
        f''''/24 s^2 (h - s)^2, at most f''''/24 (h/2)^4. With a step before, whose cubic
        extrapolated to this one's end missed it by f''''/24 h^2 (h + h_before)^2, that gives
        f''''. Without one, the cubic's own third-order term is taken for the error: it is that of
        the quadratic through v0, d0, v1.

        Parameters
        ----------
        predicted : array, shape (2, L)
            What `predict` gave.

        Returns
        -------
        float
            Relative to nominal value plus size.
        """
        if not self.new.size:
            return 0.0
        w, new, h = self.w, self.new, length
        if self.extrapolates(h):
            both = h + self._length_before
            miss = np.abs(new - predicted)
            # The same fourth divided difference from the value and from the derivative.
            miss[0] /= (h * both) ** 2
            miss[1] /= 2.0 * h * both * (h + both)
            distance = miss.max(axis=0) * (h / 2.0) ** 4
        else:
            cubic = 2.0 * (w[0] - new[0]) + h * (w[1] + new[1])
            distance = np.abs(cubic) * (4.0 / 27.0)
        return float((distance / (self._nominal + np.abs(new[0]))).max())

    def time_scale(self) -> float:
        """The time in which some link would change by nominal value plus size; or infinity."""
        v, d = np.abs(self.w[:2])
        rate = float((d / (self._nominal + v)).max()) if d.size else 0.0
        return 1.0 / rate if rate > 0.0 else math.inf
