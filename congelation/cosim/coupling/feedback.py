"""What the iterations of `hermite` work on: the state between steps, the ends that are fed back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.points import Points
from congelation.cosim.ensemble import Ensemble

__all__ = ["Feedback", "HermitePlan", "HermiteState"]

Floats = npt.NDArray[np.float64]


class HermiteState(NamedTuple):
    """The state of `hermite` at a communication point.

    Parameters
    ----------
    points : Points
        What the links are and were.
    order : int
        LOW or HIGH: of the next step, if there is a point before it.
    J : array, shape (n, n)
        Approximate Jacobian of an iteration, see Feedback.
    length : float
        The step for which J holds, in seconds; 0 where there is none yet.
    """

    points: Points
    order: int
    J: Floats
    length: float


class HermitePlan(NamedTuple):
    """What `hermite` is on a system, for the compiled loop.

    Parameters
    ----------
    halves, saves : bool
        Whether steps are made again in halves; whether fixed ones are repeated.
    highest : int
        LOW or HIGH.
    chooses : bool
        Whether each step may have another order.
    accelerates : bool
    max_iterations : int
    iterations : int
        Plain ones, exactly so many; 0: as many as it takes.
    accuracy, unsettled : float
        Change at which iterations end, and at which they do where they better it no more.
    holds_some : list of bool, one per slave
        Whether an input takes no derivative.
    back : integer array, shape (n / 2,)
        The links that are fed back.
    forward : boolean array, shape (slaves, L)
        The links whose source is that slave, and steps before their target.
    """

    halves: bool
    saves: bool
    highest: int
    chooses: bool
    accelerates: bool
    max_iterations: int
    iterations: int
    accuracy: float
    unsettled: float
    holds_some: list[bool]
    back: npt.NDArray[np.intp]
    forward: npt.NDArray[np.bool_]


class Feedback:
    """The links whose source steps after their target (or is the target): an iteration needs
    their ends before it knows them.

    The unknowns z of the iterations are value and derivative at the end of the step of each such
    link, n in all, scaled by nominal value plus size, derivatives by that over the step length.

    Attributes
    ----------
    start : integer array, shape (n / 2,)
        The links.
    given, found : integer arrays, shape (n,)
        Places of the unknowns in the flattened data of a Piece, and of what an iteration makes of
        them in the flattened ends that are read.
    nominal : array, shape (n / 2,)
    """

    def __init__(self, ensemble: Ensemble) -> None:
        back = [k for k, link in enumerate(ensemble.links) if link.source >= link.target]
        count = len(ensemble.links)
        self.start = np.array(back, np.intp)
        self.given = np.array([row * count + k for row in (2, 3) for k in back], np.intp)
        self.found = np.array([row * count + k for row in (0, 1) for k in back], np.intp)
        self.nominal = ensemble.nominal[back]

    def scales(self, data: Floats, length: float) -> Floats:
        """Sizes of the unknowns, shape (n,)."""
        scale = np.abs(data[0].take(self.start))
        scale += self.nominal
        return np.concatenate([scale, scale / length])

    def worst(self, r: Floats) -> int:
        """The link of the largest residual r, shape (n,)."""
        return int(self.start[np.abs(r).reshape(2, -1).max(axis=0).argmax()])
