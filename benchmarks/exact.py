"""The exact solution of a figure's loop, found once and evaluated anywhere."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.integrate import OdeSolution, solve_ivp

from benchmarks.cases import Figure
from congelation.theory.closed_loop import SmoothPiece
from congelation.verify.reference import reference

__all__ = ["Exact"]

Floats = npt.NDArray[np.float64]

TOLERANCE = 1e-13
"""Relative and absolute: five orders below the smallest error that is looked at."""


class Exact:
    """The loop of a figure as the theory derives it, as one differential equation.

    The equations are those of `congelation.verify.reference`; unlike there the solution is kept as
    polynomials, since hundreds of runs are compared with it.

    Parameters
    ----------
    figure : Figure
    stop_time : float
        Seconds.

    Raises
    ------
    RuntimeError
        The solver gives up.
    """

    def __init__(self, figure: Figure, stop_time: float) -> None:
        found = reference(figure.case)
        self._loop = found.loop
        names = [*found.loop.state_names, *found.loop.output_names]
        self._columns = [names.index(f"{owner}.{name}") for owner, name in figure.loop.record]
        self._pieces: list[tuple[SmoothPiece, OdeSolution]] = []
        X = found.start
        for segment in found.segments:
            if segment.start < stop_time:
                piece = solve_ivp(
                    partial(self._rates, segment),
                    (segment.start, min(segment.end, stop_time)),
                    X,
                    method="DOP853",
                    rtol=TOLERANCE,
                    atol=TOLERANCE,
                    dense_output=True,
                )
                if not piece.success:
                    raise RuntimeError(f"the exact solution stopped: {piece.message}")
                X = piece.y[:, -1]
                self._pieces.append((segment, piece.sol))

    def _rates(self, segment: SmoothPiece, t: float, X: Floats) -> Floats:
        return self._loop.function(X, segment.theta(t))

    def values(self, times: Floats) -> Floats:
        """The recorded variables at increasing `times`, shape (N, M); all are continuous."""
        starts = [segment.start for segment, _ in self._pieces]
        place = np.clip(np.searchsorted(starts, times, side="right") - 1, 0, None)
        rows = []
        for k, (segment, solution) in enumerate(self._pieces):
            inside = times[place == k]
            if inside.size:
                for t, X in zip(inside, solution(inside).T, strict=True):
                    rows.append([*X, *self._loop.output_function(X, segment.theta(t))])
        return np.array(rows)[:, self._columns]
