"""Derivatives of links whose sources provide none, from the values at past points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["History", "differentiation"]

Floats = npt.NDArray[np.float64]

KEPT_POINTS = 3
"""With the new value four points: a cubic, as exact derivatives at both ends would give."""


def differentiation(nodes: Floats, at: float) -> tuple[Floats, Floats]:
    """Weights of the value and of the derivative at `at` of the polynomial through `nodes`.

    B. Fornberg, Calculation of weights in finite difference formulas, SIAM Review 40 (1998).

    Parameters
    ----------
    nodes : array, shape (n,)
        Distinct.

    Returns
    -------
    value, derivative : arrays, shape (n,)
    """
    n = len(nodes)
    weights = np.zeros((2, n))
    weights[0, 0] = 1.0
    product, distance = 1.0, nodes[0] - at
    for i in range(1, n):
        previous, distance = distance, nodes[i] - at
        partial = 1.0
        for j in range(i):
            gap = nodes[i] - nodes[j]
            partial *= gap
            if j == i - 1:
                weights[1, i] = product * (weights[0, j] - previous * weights[1, j]) / partial
                weights[0, i] = -product * previous * weights[0, j] / partial
            weights[1, j] = (distance * weights[1, j] - weights[0, j]) / gap
            weights[0, j] = distance * weights[0, j] / gap
        product = partial
    return weights[0], weights[1]


class History:
    """Values of some links at the last communication points.

    Parameters
    ----------
    count : int
        Number of links, n.
    """

    def __init__(self, count: int) -> None:
        self._times: list[float] = []
        self._values: list[Floats] = []
        self._count = count

    def restart(self, time: float, values: Floats) -> None:
        """Forget what was before a jump; `values` has shape (n,)."""
        self._times, self._values = [time], [values.copy()]

    def add(self, time: float, values: Floats) -> None:
        """Keep the values at a new point."""
        self._times = [*self._times, time][-KEPT_POINTS:]
        self._values = [*self._values, values.copy()][-KEPT_POINTS:]

    def predict(self, time: float) -> tuple[Floats, Floats]:
        """Value and derivative at a later time, extrapolated; shapes (n,)."""
        value, slope = differentiation(np.array(self._times) - time, 0.0)
        table = np.array(self._values)
        return value @ table, slope @ table

    def slope(self) -> Floats:
        """The derivative at the newest point, from the points before it; zero where none is."""
        return self.predict(self._times[-1])[1]

    def slopes(self, end: float, values: Floats) -> tuple[Floats, Floats]:
        """Derivatives at the newest point and at `end`, the values there included."""
        nodes = np.array([*self._times, end]) - end
        table = np.array([*self._values, values])
        at_start = differentiation(nodes, self._times[-1] - end)[1] @ table
        return at_start, differentiation(nodes, 0.0)[1] @ table
