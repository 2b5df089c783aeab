"""How far inputs were from the outputs that drive them, watched at little cost."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from congelation.cosim.ensemble import Ensemble

__all__ = ["Watch"]

Floats = npt.NDArray[np.float64]

WATCHED_ROWS = 256
"""Steps looked at together: one array operation then costs next to nothing per step."""


class Watch:
    """The largest distance of a link's value from where its held or extrapolated input was.

    Parameters
    ----------
    ensemble : Ensemble
    extrapolated : bool
        Whether inputs follow their derivative, rather than being held.

    Attributes
    ----------
    largest : float
        Relative to the link's nominal value plus its size; complete after `flush`.
    """

    def __init__(self, ensemble: Ensemble, *, extrapolated: bool) -> None:
        self._nominal = ensemble.inputs.nominal
        count = len(ensemble.inputs.links)
        self._values: Floats = np.zeros((WATCHED_ROWS, count))
        self._slopes: Floats = np.zeros((WATCHED_ROWS, count if extrapolated else 0))
        self._times: list[float] = []
        self._Y, self._source = ensemble.outputs.Y, ensemble.inputs.source
        self.largest = 0.0

    def held(self, time: float) -> None:
        """Look at the values that the links have now."""
        self._Y.take(self._source, out=self._values[self._row(time)], mode="clip")

    def extrapolated(self, time: float, w: Floats) -> None:
        """Look at values and derivatives, shape (2, L), that extrapolation starts from."""
        row = self._row(time)
        self._values[row], self._slopes[row] = w

    def _row(self, time: float) -> int:
        if len(self._times) == WATCHED_ROWS:
            self.flush()
        self._times.append(time)
        return len(self._times) - 1

    def flush(self) -> None:
        """Evaluate what was watched; the last values begin the next batch."""
        count = len(self._times)
        values, slopes = self._values[:count], self._slopes[:count]
        if count > 1 and values.size:
            change = np.diff(values, axis=0)
            if slopes.size:
                change -= np.diff(self._times)[:, None] * slopes[:-1]
            relative = np.abs(change) / (self._nominal + np.abs(values[1:]))
            self.largest = max(self.largest, float(relative.max()))
        if count:
            self._values[0], self._slopes[0] = values[-1], slopes[-1]
            self._times = self._times[-1:]
