"""The ends of a step told ahead of it from past points, and its error told afterwards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.ends import Ends
from congelation.cosim.coupling.polynomial import extrapolation

__all__ = ["Predictor"]

Floats = npt.NDArray[np.float64]

LONGEST_EXTRAPOLATION = 20.0
"""A polynomial is not extrapolated over more than this many times the step that it comes from:
errors of its data would grow with a power of the ratio."""

MOST_NODES = 3
"""Values and derivatives at so many past points give a quintic; each further one would multiply
the errors of the data by four or more."""


class Predictor:
    """Values and derivatives of all links at the last communication points.

    Parameters
    ----------
    ends : Ends

    Attributes
    ----------
    worst : int
        The link of the largest defect found last.
    """

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        count = ends.new.shape[1]
        # Values, then derivatives; of each node, the newest last; of each link.
        self._past: Floats = np.zeros((2, MOST_NODES, count))
        self._times: list[float] = []
        self.worst = 0

    def start(self, time: float) -> None:
        """Forget what was before a jump."""
        self._times = [time]
        self._past[:, -1] = self._ends.new

    def close(self) -> None:
        """Keep the end of the step, as last read."""
        self._times = [*self._times, self._ends.end_time][-MOST_NODES:]
        self._past[:, :-1] = self._past[:, 1:]
        self._past[:, -1] = self._ends.new

    def predict(self) -> None:
        """Fill in v1, d1 ahead of the step, from as many past points as are useful."""
        self._ends.set_ends(self._extrapolated(MOST_NODES))
        self._ends.predict_inexact()

    def _far_enough(self) -> list[int]:
        """Past points, counted from the newest (0), that are not too near to it."""
        now = self._times[-1]
        least = (self._ends.end_time - now) / LONGEST_EXTRAPOLATION
        return [k for k, t in enumerate(reversed(self._times)) if k and now - t >= least]

    def _extrapolated(self, most: int) -> Floats:
        """Value and derivative at the end of the step, shape (2, L), from at most so many nodes."""
        back = [0, *self._far_enough()[: most - 1]]
        now = self._times[-1]
        nodes = [self._times[-1 - k] - now for k in back]
        data = self._past[:, [MOST_NODES - 1 - k for k in back]]
        weights = extrapolation(nodes, self._ends.end_time - now)
        found: Floats = weights.dot(data.reshape(2 * len(nodes), -1))
        return found

    def defect(self) -> float:
        """Estimated largest distance of a link's cubic from its value, over the step.

        The cubic interpolates value and derivative at both ends, so it is off by
        f''''/24 s^2 (h - s)^2, at most f''''/24 (h/2)^4. With a point before, a distance g back,
        the cubic through that and the start, extrapolated to the end, misses by
        f''''/24 h^2 (h + g)^2, which gives f''''. Without one, the cubic's own third-order term is
        taken for the error: it is that of the quadratic through v0, d0, v1.

        Returns
        -------
        float
            Relative to nominal value plus size.
        """
        ends = self._ends
        if not ends.new.size:
            return 0.0
        w, new = ends.w, ends.new
        h = ends.end_time - ends.start_time
        before = self._far_enough()
        if before:
            both = ends.end_time - self._times[-1 - before[0]]
            miss = np.abs(new - self._extrapolated(2))
            # The same fourth divided difference from the value and from the derivative.
            by_value = miss[0] * (h**2 / (16.0 * both**2))
            by_slope = miss[1] * (h**3 / (32.0 * both * (h + both)))
            distance = np.maximum(by_value, by_slope)
        else:
            cubic = 2.0 * (w[0] - new[0]) + h * (w[1] + new[1])
            distance = np.abs(cubic) * (4.0 / 27.0)
        relative = ends.relative(distance)
        self.worst = int(relative.argmax())
        return float(relative[self.worst])
