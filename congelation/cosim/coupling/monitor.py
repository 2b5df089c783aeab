"""How far inputs were from the outputs that drive them, watched at little cost."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from congelation.cosim.ensemble import Ensemble

__all__ = ["HeldError"]

Floats = npt.NDArray[np.float64]

WATCHED_ROWS = 256
"""Steps looked at together: one array operation then costs next to nothing per step."""


class HeldError:
    """The largest change of a link's value over one step, during which its input was held.

    Parameters
    ----------
    ensemble : Ensemble

    Attributes
    ----------
    largest : float
        Relative to the link's nominal value plus its size; complete after `flush`.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        self._Y = ensemble.outputs.Y
        self._source = ensemble.inputs.source
        self._nominal = ensemble.inputs.nominal
        self._rows: Floats = np.zeros((WATCHED_ROWS, len(ensemble.inputs.links)))
        self._count = 0
        self.largest = 0.0

    def watch(self) -> None:
        """Look at the values that the links have now."""
        if self._count == WATCHED_ROWS:
            self.flush()
        self._Y.take(self._source, out=self._rows[self._count], mode="clip")
        self._count += 1

    def flush(self) -> None:
        """Evaluate what was watched; the last values begin the next batch."""
        rows = self._rows[: self._count]
        if rows.shape[1] and self._count > 1:
            change = np.abs(np.diff(rows, axis=0)) / (self._nominal + np.abs(rows[1:]))
            self.largest = max(self.largest, float(change.max()))
        if self._count:
            self._rows[0] = rows[-1]
            self._count = 1
