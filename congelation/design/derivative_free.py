"""Maxima over theta(t) without derivatives: for metrics without a gradient, and for foreign FMUs.

A theta(t) of some pieces is a vector: the lengths of the pieces, and their place between the
bounds. It is searched by CMA-ES (N. Hansen, The CMA Evolution Strategy: A Tutorial,
arXiv:1604.00772), which copes with jumps of the objective and with couplings of its arguments,
from more pieces at each restart.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from congelation.design.attack_problem import Admissible
from congelation.design.shooting import Cells

__all__ = ["maximise"]

Floats = NDArray[np.float64]

PIECES = (2, 3, 5, 8, 12)
"""Pieces of theta(t) in one run of the strategy after another."""

KEPT = 5
"""The best candidates that are given back."""

LARGE = 1e12
"""Stands for an infinite value, such as the settling time of a loop that never settles."""


def maximise(
    value: Callable[[Cells], float],
    admissible: Admissible,
    span: tuple[float, float],
    *,
    seed: int,
    more: Callable[[], bool],
    progress: Callable[[float], None] = lambda best: None,
    inside: bool = False,
    constant: NDArray[np.bool_] | None = None,
) -> list[Cells]:
    """The best theta(t), best first.

    Parameters
    ----------
    value : callable
        Of a theta(t); nan where it has none, inf where it is beyond all bounds.
    admissible : Admissible
    span : tuple of float
        First and last time, in seconds.
    seed : int
    more : callable
        Whether there is effort left.
    progress : callable
        Called with the best value so far.
    inside : bool
        Whether values inside a box are tried, too: where theta may not enter affinely.
    constant : ndarray of bool, shape (p,), optional
        Elements that keep one value for all time.
    """
    import cma  # here: the import takes half a second, which other commands need not wait for

    found: list[tuple[float, int, Cells]] = []

    def fall(vector: Floats, pieces: int) -> float:
        edges, directions = _pieces(vector, pieces, span)
        if inside:
            theta = admissible.center + admissible.half * np.tanh(directions)
        else:  # a worst theta is an extreme point, and the direction says which
            theta = np.array([admissible.worst(row) for row in directions])
        if constant is not None:
            theta[:, constant] = theta[0, constant]
        cells = Cells(edges, theta).merged()
        score = value(cells)
        found.append((score if score == score else -math.inf, -len(found), cells))
        progress(max(found)[0])
        return (
            -min(found[-1][0], LARGE) if math.isfinite(found[-1][0]) or score == math.inf else LARGE
        )

    for corner in admissible.extremes:
        # Far out in the direction of the corner, which is the corner either way.
        scale = np.where(admissible.half > 0.0, admissible.half, 1.0)
        fall(np.concatenate([[0.0], 20.0 * (corner - admissible.center) / scale]), 1)
    for k, pieces in enumerate(PIECES):
        best = max(found)
        if not more() or best[0] == math.inf:
            break
        dimension = pieces * (1 + len(admissible.center))
        start = np.random.default_rng([seed, k]).normal(size=dimension)
        options = {"seed": seed + k + 1, "verbose": -9, "maxfevals": 200 * pieces}
        with warnings.catch_warnings():
            # The strategy warns of flat objectives, e.g. a settling time that never is.
            warnings.simplefilter("ignore")
            strategy = cma.CMAEvolutionStrategy(start, 1.0, options)
            while not strategy.stop() and more():
                asked = strategy.ask()
                strategy.tell(asked, [fall(np.asarray(v), pieces) for v in asked])
    found.sort(key=lambda one: one[:2], reverse=True)
    return [cells for _, _, cells in found[:KEPT]]


def _pieces(vector: Floats, pieces: int, span: tuple[float, float]) -> tuple[Floats, Floats]:
    """Edges of pieces, whose relative lengths the vector has the logarithms of, and directions."""
    weights = np.exp(np.clip(vector[:pieces], -6.0, 6.0))
    shares = np.concatenate([[0.0], np.cumsum(weights)]) / weights.sum()
    edges = span[0] + (span[1] - span[0]) * shares
    edges[-1] = span[1]
    return edges, vector[pieces:].reshape(pieces, -1)
