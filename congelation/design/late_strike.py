"""Settle, then strike: the theta(t) that makes a loop burst after it has come to rest.

Shooting at the peak misses such bursts, because the gradient at a state near 0 is small. So: let
the loop settle under a theta(t) that moves the estimates, freeze the estimates, and look for a
theta, or for two between which it switches, under which the linear loop that is left grows; strike
with that.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
import scipy
from numpy.typing import NDArray

from congelation.design.attack_problem import Problem
from congelation.design.search import Search
from congelation.design.shooting import Cells, Path, Shooting
from congelation.theory.closed_loop import Compiled

__all__ = ["SETTLED", "Strike", "strikes"]

Floats = NDArray[np.float64]

SETTLED = 1e-2
"""|v| below which a loop counts as settled, if it stays there."""

REST = 2.5
"""How long the loop may settle, in spans of the scenario."""

OWN_CELLS = 400
"""Cells per span on which the scenario's own theta(t) is held."""

STRUCK = 6
"""Strikes, those of the fastest growth, that are simulated; the best is then refined."""

NEAR = 0.98
"""Strikes within this ratio of the best value count as equal; the earliest of them is refined."""

ESTIMATES = ("theta_hat", "rho_hat")
"""States that stay where they are when the others are at rest."""

SWITCHING = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Durations of the two phases of a switching theta, in seconds per unit of the loop's own time."""


@dataclass(frozen=True)
class Strike:
    """A theta(t) that lets the loop settle, and then strikes.

    Attributes
    ----------
    value : float
        max |v| from the strike on.
    settled, burst : Cells
        theta(t) until the strike, and from then on.
    state : ndarray
        The loop's states at the strike.
    path : Path
        From then on.
    growth : float
        Rate, in 1/s, at which the loop with the estimates that it had then grows: not positive
        where no growth was found.
    """

    value: float
    settled: Cells
    burst: Cells
    state: Floats
    path: Path
    growth: float

    @property
    def cells(self) -> Cells:
        """theta(t) from the start."""
        return self.settled.then(self.burst)

    @property
    def time(self) -> float:
        """When theta(t) strikes, in seconds."""
        return float(self.burst.edges[0])


class _Frozen:
    """The linear loop that is left when all but the estimates are at rest."""

    def __init__(self, problem: Problem) -> None:
        loop = problem.loop
        names = [n.split("[")[0].partition(".")[2] for n in loop.state_names]
        self._moving = np.array([n not in ESTIMATES for n in names])
        X, theta = loop.arguments
        (f,) = loop.bind([loop.rate])
        rows = np.flatnonzero(self._moving).tolist()
        self._slope = Compiled([ca.jacobian(f, X)[rows, rows]], [X, theta])
        self.extremes = problem.admissible.extremes

    def matrices(self, state: Floats) -> list[Floats]:
        """A(theta) at each extreme theta, for the estimates of a state."""
        rest = np.where(self._moving, 0.0, state)
        n = int(self._moving.sum())
        return [self._slope(rest, theta).reshape(n, n).T for theta in self.extremes]

    def growth(self, state: Floats, length: float) -> list[tuple[float, Floats, Floats]]:
        """(rate, thetas, durations) of the fastest growth, under one theta and under two.

        The rate under two in turn is that of the largest Floquet multiplier.
        """
        matrices = self.matrices(state)
        found: list[tuple[float, Floats, Floats]] = []
        for theta, A in zip(self.extremes, matrices, strict=True):
            rate = float(np.linalg.eigvals(A).real.max())
            found.append((rate, theta[None, :], np.array([length])))
        best = max(found, key=lambda one: one[0])
        unit = (
            2
            * math.pi
            / max(1e-9, max(float(np.abs(np.linalg.eigvals(A)).max()) for A in matrices))
        )
        flows = {
            (i, d): scipy.linalg.expm(A * d * unit)
            for i, A in enumerate(matrices)
            for d in SWITCHING
        }
        two = (-math.inf, np.zeros((0, 0)), np.zeros(0))
        for i, j in itertools.combinations(range(len(matrices)), 2):
            for d, e in itertools.product(SWITCHING, repeat=2):
                multiplier = float(np.abs(np.linalg.eigvals(flows[j, e] @ flows[i, d])).max())
                rate = math.log(max(multiplier, 1e-300)) / ((d + e) * unit)
                if rate > two[0]:
                    two = (rate, self.extremes[[i, j]], np.array([d, e]) * unit)
        # Switching counts where it beats either theta alone by more than the grid's coarseness.
        return [best, two] if two[0] > best[0] + 1e-3 * abs(best[0]) else [best]


class _Settling:
    """The loop of a problem, brought to rest and struck."""

    def __init__(self, problem: Problem, shooting: Shooting) -> None:
        self.problem, self.shooting = problem, shooting
        start, stop = problem.span
        self.start, self.length = start, stop - start

    @cached_property
    def candidates(self) -> list[Cells]:
        """theta(t) to settle under: the scenario's own, and constants."""
        end = self.start + REST * self.length
        own = self.problem.own_profile(end, self.length / OWN_CELLS)
        edges = np.array([self.start, end])
        return [own, *(Cells(edges, theta[None, :]) for theta in self.problem.admissible.lattice)]

    def settled(self) -> list[Cells]:
        """Each of these up to when the loop has settled under it, and up to the end."""
        found = []
        for cells in self.candidates:
            path = self.shooting.solve(self.problem.start, cells)
            outside = np.flatnonzero(path.size > SETTLED**2)
            last = int(outside[-1]) + 1 if outside.size else 0
            if not path.finished or last >= len(path.time) - 1:
                continue
            unit = 10 ** (math.floor(math.log10(self.length)) - 3)
            first = self.start + unit * math.ceil((float(path.time[last]) - self.start) / unit)
            first = max(first, self.start + 0.01 * self.length)
            ends = {first, self.start + REST * self.length}
            if first < self.start + self.length:
                ends.add(self.start + self.length)
            for end in sorted(ends):
                found.append(cells.until(end))
        return found

    def strike(self, settled: Cells, thetas: Floats, durations: Floats) -> Cells:
        """theta(t) of the strike, for a span of the scenario."""
        start = float(settled.edges[-1])
        edges, k = [start], 0
        while edges[-1] < start + self.length:
            edges.append(min(edges[-1] + float(durations[k % len(durations)]), start + self.length))
            k += 1
        return Cells(np.array(edges), thetas[np.arange(k) % len(thetas)])


def strikes(
    problem: Problem,
    shooting: Shooting,
    *,
    steps: int,
    seed: int = 0,
    progress: Callable[[float, float], None] = lambda done, best: None,
) -> list[Strike]:
    """The bursts found after the loop had settled, the largest first; empty if it never settles.

    Parameters
    ----------
    problem : Problem
    shooting : Shooting
        Of the signals that settle; its `atol` has to be far below |v| when the loop is struck.
    steps : int
        Runge-Kutta steps to spend on the refinement of the strike.
    seed : int
    progress : callable
        As in `Search`.
    """
    settling, frozen = _Settling(problem, shooting), _Frozen(problem)
    ranked = []
    for settled in settling.settled():
        state: Floats = shooting.solve(problem.start, settled).states[-1, :-1]
        for rate, thetas, durations in frozen.growth(state, settling.length):
            ranked.append((rate, settled, state, thetas, durations))
    ranked.sort(key=lambda one: -one[0])
    tried: list[Strike] = []
    for rate, settled, state, thetas, durations in ranked[:STRUCK]:
        burst = settling.strike(settled, thetas, durations)
        path = shooting.solve(state, burst)
        tried.append(Strike(path.peak, settled, burst, state, path, rate))
        progress(0.3 * len(tried) / STRUCK, max(strike.value for strike in tried))
    if not tried:
        return []
    tried.sort(key=lambda strike: -strike.value)
    # An early strike meets a larger state, which tolerances disturb less.
    near = [strike for strike in tried if strike.value >= NEAR * tried[0].value]
    best = min(near, key=lambda strike: strike.time)
    if best.growth <= 0.0:
        return tried
    span = (best.time, best.time + settling.length)
    search = Search(
        shooting,
        problem.admissible,
        best.state,
        span,
        peak=True,
        steps=steps,
        seed=seed,
        progress=lambda done, value: progress(0.3 + 0.7 * done, value),
    )
    refined = [
        replace(best, value=found.value, burst=found.cells, path=found.path)
        for found in search.run((best.burst,))
    ]
    return [*sorted(refined, key=lambda strike: -strike.value), *tried]
