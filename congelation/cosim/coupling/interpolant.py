"""The polynomials that inputs follow over a step: their ends told ahead of it, their order chosen,
their error told afterwards."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.ends import Ends
from congelation.cosim.coupling.past import Past
from congelation.cosim.coupling.polynomial import hermite, matched

__all__ = ["HIGH", "LOW", "Interpolant"]

Floats = npt.NDArray[np.float64]

LOW, HIGH = 4, 6
"""Orders: of the Hermite cubic, and of the cubic that acts like a quintic."""

RESIDUE = 16.0 / 3150.0
"""What is left of the Hermite cubic's distance f''''/24 h^4/16 where its first two moments are
mended: the second moment is f''''/24 h^7/1575, half of which, times the square of a rate of the
slave, is an error of its states. Over the step, for a slave whose rates are 1/h."""


class Interpolant:
    """The input polynomials of all links.

    Order 4 is the Hermite cubic. Order 6 takes the point before the step as well; it is a
    two-step formula and, as such, stable only while the step is not much longer than the loop's
    shortest time constant. Where the order is chosen, it is the one that allows the longer step:
    an instability shows in the error of order 6 first.

    Parameters
    ----------
    ends : Ends
    order : int
        LOW or HIGH: the highest order used.
    tolerance : float or None
        With it, the order is chosen step by step; otherwise it is `order` wherever there is a
        point before.

    Attributes
    ----------
    order : int
        The error estimate found last falls with this power of the step.
    worst : int
        The link of the largest error found last.
    """

    def __init__(self, ends: Ends, order: int, tolerance: float | None) -> None:
        self._ends = ends
        self._highest = order
        self._tolerance = tolerance
        self._past = Past(ends.new.shape[1])
        self._preferred = self._next = order
        self._before: list[int] = []
        self._predicted: Floats = ends.new
        self._matrix: Floats = np.zeros((4, 4))
        self._data: Floats = ends.w
        self.order = LOW
        self.worst = 0

    def start(self, time: float) -> None:
        """Forget what was before a jump."""
        self._past.start(time, self._ends.new)
        self._preferred = self._next = self._highest

    def open(self) -> None:
        """Tell the ends of the step that `ends` has turned to, and choose its polynomial."""
        ends, past = self._ends, self._past
        before = past.before(ends.end_time)
        self._before = before
        self._predicted = past.extrapolated(ends.end_time, before)
        ends.set_ends(self._predicted)
        ends.predict_inexact()
        h = ends.end_time - ends.start_time
        if before and self._preferred == HIGH:
            ends.set_before(past.at(before[0]))
            self._matrix, self._data = matched(h, past.distance(before[0])), ends.data
        else:
            self._matrix, self._data = hermite(h), ends.w

    def coefficients(self, C: Floats) -> None:
        """Fill in C, shape (4, L), for the ends as they are known by now."""
        np.dot(self._matrix, self._data, out=C)

    def close(self) -> None:
        """The step is kept."""
        self._past.add(self._ends.end_time, self._ends.new)
        self._preferred = self._next

    def error(self) -> float:
        """Estimated largest distance of a link's polynomial from its value, over the step.

        Returns
        -------
        float
            Relative to nominal value plus size.
        """
        ends = self._ends
        self.order, self._next = LOW, self._highest
        if not ends.new.size:
            return 0.0
        distance = self._cubic_error() if self._before else self._cubic_term()
        low, self.worst = self._largest(distance)
        if self._highest == LOW or len(self._before) < 2:
            return low
        high, worst = self._largest(np.maximum(self._quintic_error(), RESIDUE * distance))
        if self._tolerance is not None:
            self._next = _order_of_longer_step(low / self._tolerance, high / self._tolerance)
        if self._preferred == LOW:
            return low
        self.order, self.worst = HIGH, worst
        return high

    def _largest(self, distance: Floats) -> tuple[float, int]:
        """The largest of distances, shape (L,), relative to nominal value plus size; and whose."""
        relative = self._ends.relative(distance)
        worst = int(relative.argmax())
        return float(relative[worst]), worst

    def _cubic_term(self) -> Floats:
        """The cubic's own third-order term, for want of a point before: it is the error of the
        quadratic through v0, d0, v1."""
        w, new = self._ends.w, self._ends.new
        h = self._ends.end_time - self._ends.start_time
        cubic = 2.0 * (w[0] - new[0]) + h * (w[1] + new[1])
        term: Floats = np.abs(cubic) * (4.0 / 27.0)
        return term

    def _cubic_error(self) -> Floats:
        """The Hermite cubic's distance, shape (L,).

        It is off by f''''/24 s^2 (h - s)^2, at most f''''/24 (h/2)^4. The cubic through the start
        and a point g before, extrapolated to the end, misses by f''''/24 h^2 (h + g)^2, which gives
        f''''; its derivative gives the same fourth divided difference.
        """
        ends, g = self._ends, self._past.distance(self._before[0])
        h = ends.end_time - ends.start_time
        expected = self._predicted
        if len(self._before) > 1:
            expected = self._past.extrapolated(ends.end_time, self._before[:1])
        value, slope = np.abs(ends.new - expected)
        by_value = value * (h**2 / (16.0 * (h + g) ** 2))
        by_slope = slope * (h**3 / (32.0 * (h + g) * (h + h + g)))
        largest: Floats = np.maximum(by_value, by_slope)
        return largest

    def _quintic_error(self) -> Floats:
        """The quintic's distance, shape (L,).

        It is off by f^(6)/720 s^2 (h - s)^2 (s + g)^2, taken at h/2. The quintic through the start
        and points g and k before misses the end by f^(6)/720 h^2 (h + g)^2 (h + k)^2.
        """
        ends = self._ends
        g, k = (self._past.distance(back) for back in self._before)
        h = ends.end_time - ends.start_time
        value, slope = np.abs(ends.new - self._predicted)
        share = (h * (h / 2.0 + g)) ** 2 / (16.0 * ((h + g) * (h + k)) ** 2)
        per_slope = 2.0 * (1.0 / h + 1.0 / (h + g) + 1.0 / (h + k))
        largest: Floats = np.maximum(value * share, slope * (share / per_slope))
        return largest


def _order_of_longer_step(low: float, high: float) -> int:
    """The order whose scaled error (1 is the tolerance) allows the longer next step."""
    return HIGH if high**LOW < low**HIGH else LOW
