"""What the links were at the last communication points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.buffers import NO_DERIVATIVE
from congelation.cosim.coupling.polynomial import differentiation, interpolation, product
from congelation.cosim.ensemble import Ensemble

__all__ = ["LinkReader", "Points"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

KEPT = 3
"""Values and derivatives at so many points give a quintic, each further one would multiply the
errors of the data by four or more; values alone give, with the newest one, a cubic."""

LONGEST_EXTRAPOLATION = 20.0
"""A polynomial is not extrapolated over more than this many times the step that it comes from:
errors of its data would grow with a power of the ratio."""


class Points(NamedTuple):
    """Values and derivatives of all L links at the last points since the start or a jump.

    Parameters
    ----------
    times : tuple of float, length n <= KEPT
        The newest last.
    table : array, shape (2, KEPT, L)
        Values, then derivatives; of each point, the newest last; of each link. The points that
        there are not yet are zero.
    """

    times: tuple[float, ...]
    table: Floats

    @classmethod
    def begun(cls, time: float, now: Floats) -> Points:
        """With values and derivatives `now`, shape (2, L), alone."""
        table = np.zeros((2, KEPT, now.shape[1]))
        table[:, -1] = now
        return cls((time,), table)

    def followed(self, time: float, now: Floats) -> Points:
        """These points and a new one; the oldest is dropped where there are too many."""
        table = np.concatenate((self.table[:, 1:], now[:, None]), axis=1)
        return Points((*self.times, time)[-KEPT:], table)

    @property
    def now(self) -> Floats:
        """Values and derivatives at the newest point, shape (2, L)."""
        return self.table[:, -1]

    def before(self, end: float) -> list[int]:
        """The points before the newest one that are of use for a step to `end`, the nearest first:
        how many places back, 1 or 2."""
        now = self.times[-1]
        least = (end - now) / LONGEST_EXTRAPOLATION
        return [k for k, t in enumerate(reversed(self.times)) if k and now - t >= least]

    def distance(self, back: int) -> float:
        """From the newest point to the one `back` places before it, in seconds."""
        return self.times[-1] - self.times[-1 - back]

    def at(self, back: int) -> Floats:
        """Values and derivatives, shape (2, L), `back` places before the newest point."""
        return self.table[:, -1 - back]

    def extrapolated(self, end: float, back: list[int]) -> Floats:
        """Value and derivative at `end`, shape (2, L), of the polynomials through the newest point
        and those `back` places before it."""
        places = [0, *back]
        now = self.times[-1]
        nodes = [self.times[-1 - k] - now for k in places]
        data = self.table[:, [KEPT - 1 - k for k in places]]
        return product(interpolation(nodes, end - now), data.reshape(2 * len(nodes), -1))

    def predicted(self, time: float, links: Indices) -> Floats:
        """Value and derivative, shape (2, n), at `time` of the polynomials through the values of n
        links, their derivatives not being known."""
        weights = differentiation(np.array(self.times) - time, 0.0)
        return product(np.array(weights), self._values(links))

    def slopes(self, end: float, links: Indices, values: Floats) -> tuple[Floats, Floats]:
        """Derivatives, shapes (n,), at the newest point and at `end` of the polynomials through the
        values of n links, those at `end` included."""
        nodes = np.array([*self.times, end]) - end
        table = np.vstack([self._values(links), values])
        _, at_start = differentiation(nodes, self.times[-1] - end)
        _, at_end = differentiation(nodes, 0.0)
        found = product(np.array([at_start, at_end]), table)
        return found[0], found[1]

    def _values(self, links: Indices) -> Floats:
        """The values of some links at the points that there are, shape (n points, n links)."""
        found: Floats = self.table[0, KEPT - len(self.times) :][:, links]
        return found


class LinkReader:
    """Reads values and derivatives of the links out of Y.

    Parameters
    ----------
    ensemble : Ensemble

    Attributes
    ----------
    inexact : integer array
        The links whose source provides no derivative: it comes from the values.
    nominal : array, shape (L,)
    """

    def __init__(self, ensemble: Ensemble) -> None:
        self._Y = ensemble.Y
        self._places = np.vstack([ensemble.source, ensemble.source_derivative])
        self.nominal = ensemble.nominal
        self.inexact: Indices = np.flatnonzero(ensemble.source_derivative == NO_DERIVATIVE)
        self._is_inexact = bool(self.inexact.size)

    def start(self) -> Floats:
        """Values and derivatives, shape (2, L), where nothing is known of before."""
        new: Floats = self._Y[self._places]
        new[1, self.inexact] = 0.0
        return new

    def end(self, points: Points, end: float, w: Floats) -> Floats:
        """Values and derivatives, shape (2, L), at the end of a step.

        Parameters
        ----------
        points : Points
            At the start of the step and before.
        end : float
        w : array, shape (4, L)
            Its second row, the derivatives at the start, is improved by what the end says.
        """
        new: Floats = self._Y[self._places]
        if self._is_inexact:
            at_start, at_end = points.slopes(end, self.inexact, new[0, self.inexact])
            w[1, self.inexact] = at_start
            new[1, self.inexact] = at_end
        return new

    def relative(self, distance: Floats, values: Floats) -> Floats:
        """Distances of links over nominal value plus size, shapes (L,)."""
        scaled: Floats = distance / (self.nominal + np.abs(values))
        return scaled

    def time_scale(self, now: Floats) -> float:
        """The time in which some link would change by nominal value plus size; or infinity."""
        v, d = np.abs(now)
        rate = float((d / (self.nominal + v)).max()) if d.size else 0.0
        return 1.0 / rate if rate > 0.0 else np.inf
