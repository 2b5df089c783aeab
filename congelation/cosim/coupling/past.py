"""Values and derivatives of all links at the last communication points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.polynomial import interpolation

__all__ = ["Past"]

Floats = npt.NDArray[np.float64]

LONGEST_EXTRAPOLATION = 20.0
"""A polynomial is not extrapolated over more than this many times the step that it comes from:
errors of its data would grow with a power of the ratio."""

MOST_NODES = 3
"""Values and derivatives at so many past points give a quintic; each further one would multiply
the errors of the data by four or more."""


class Past:
    """What the links were, since the last jump.

    Parameters
    ----------
    links : int
        Their number, L.
    """

    def __init__(self, links: int) -> None:
        # Values, then derivatives; of each node, the newest last; of each link.
        self._table: Floats = np.zeros((2, MOST_NODES, links))
        self._times: list[float] = []

    def start(self, time: float, values: Floats) -> None:
        """Forget what was before a jump.

        Parameters
        ----------
        time : float
        values : array, shape (2, L)
            Values and derivatives there.
        """
        self._times = [time]
        self._table[:, -1] = values

    def add(self, time: float, values: Floats) -> None:
        """Keep values and derivatives, shape (2, L), at a new point."""
        self._times = [*self._times, time][-MOST_NODES:]
        self._table[:, :-1] = self._table[:, 1:]
        self._table[:, -1] = values

    def before(self, end: float) -> list[int]:
        """The points before the newest one that are of use for a step to `end`, the nearest first:
        how many places back, 1 or 2."""
        now = self._times[-1]
        least = (end - now) / LONGEST_EXTRAPOLATION
        return [k for k, t in enumerate(reversed(self._times)) if k and now - t >= least]

    def distance(self, back: int) -> float:
        """From the newest point to the one `back` places before it, in seconds."""
        return self._times[-1] - self._times[-1 - back]

    def at(self, back: int) -> Floats:
        """Values and derivatives, shape (2, L), `back` places before the newest point."""
        return self._table[:, -1 - back]

    def extrapolated(self, end: float, back: list[int]) -> Floats:
        """Value and derivative at `end`, shape (2, L), of the polynomials through the newest point
        and those `back` places before it."""
        places = [0, *back]
        now = self._times[-1]
        nodes = [self._times[-1 - k] - now for k in places]
        data = self._table[:, [MOST_NODES - 1 - k for k in places]]
        found: Floats = interpolation(nodes, end - now).dot(data.reshape(2 * len(nodes), -1))
        return found
