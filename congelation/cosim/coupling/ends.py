"""What a coupling knows of each link over one step: value and derivative at both ends."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.history import History
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.outputs import NO_DERIVATIVE

__all__ = ["Ends"]

Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Ends:
    """Values and derivatives of all L links.

    Attributes
    ----------
    data : array, shape (6, L)
        v0, d0 at the start of the step, v1, d1 at its end, as the polynomials use them; then value
        and derivative at a point before, where one is used.
    w : array, shape (4, L)
        Its first four rows.
    new : array, shape (2, L)
        Value and derivative as last read from the sources.
    inexact : boolean array, shape (L,)
        Links whose source provides no derivative.
    start_time, end_time : float
        Of the step turned to.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        count = len(ensemble.inputs.links)
        self._Y = ensemble.outputs.Y
        self._places = np.vstack([ensemble.inputs.source, ensemble.inputs.source_derivative])
        self._nominal = ensemble.inputs.nominal
        self.inexact: Mask = ensemble.inputs.source_derivative == NO_DERIVATIVE
        self._inexact = np.flatnonzero(self.inexact)
        self._is_exact = not self._inexact.size
        self._history = History(len(self._inexact))
        self.data: Floats = np.zeros((6, count))
        self.w: Floats = self.data[:4]
        self._w0, self._w1, self._before = self.data[:2], self.data[2:4], self.data[4:]
        self.new: Floats = np.zeros((2, count))
        self.start_time = self.end_time = 0.0

    def start(self, time: float) -> None:
        """Begin at `time`, where outputs and inputs agree; what was before is forgotten."""
        self._Y.take(self._places, out=self.new, mode="clip")
        if not self._is_exact:
            self._history.restart(time, self.new[0, self._inexact])
            self.new[1, self._inexact] = 0.0
        self._w0[:] = self.new

    def open(self, time: float, end: float) -> None:
        """Turn to a step from `time` to `end`."""
        self.start_time, self.end_time = time, end
        if not self._is_exact:
            self.w[1, self._inexact] = self._history.slope()

    def read(self) -> None:
        """Take the newest values and derivatives from Y into `new`."""
        self._Y.take(self._places, out=self.new, mode="clip")
        if not self._is_exact:
            values = self.new[0, self._inexact]
            at_start, at_end = self._history.slopes(self.end_time, values)
            self.w[1, self._inexact] = at_start
            self.new[1, self._inexact] = at_end

    def set_ends(self, values: Floats) -> None:
        """Let the polynomials end with these values and derivatives, shape (2, L)."""
        self._w1[:] = values

    def set_before(self, values: Floats) -> None:
        """Let the polynomials take in these values and derivatives, shape (2, L)."""
        self._before[:] = values

    def predict_inexact(self) -> None:
        """Fill in v1, d1 of the links without derivatives ahead of the step."""
        if not self._is_exact:
            self.w[2:, self._inexact] = self._history.predict(self.end_time)

    def close(self) -> None:
        """The step is kept: its end, as last read, is the start of the next."""
        self._w0[:] = self.new
        if not self._is_exact:
            self._history.add(self.end_time, self.new[0, self._inexact])

    def relative(self, distance: Floats) -> Floats:
        """Distances of links, shape (L,), over nominal value plus size."""
        scaled: Floats = distance / (self._nominal + np.abs(self.new[0]))
        return scaled

    def time_scale(self) -> float:
        """The time in which some link would change by nominal value plus size; or infinity."""
        v, d = np.abs(self._w0)
        rate = float((d / (self._nominal + v)).max()) if d.size else 0.0
        return 1.0 / rate if rate > 0.0 else math.inf
