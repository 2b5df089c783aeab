"""The theta(t) that makes an objective of a loop as large as it gets: a search, so a lower bound.

theta enters a closed loop affinely. The Hamiltonian lambda^T f(X, theta) of the problem is then
affine in theta, so (Pontryagin) a worst theta(t) jumps between extreme points of the admissible
set: from corner to corner of a box, along the unit vector of the gradient on a ball. The search
holds theta on cells, moves cells to the extreme point that their gradient asks for, and then moves
the times of the jumps. What starts it are constants, square waves and random cells, because the
objective has many local maxima.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from congelation.design.attack_problem import Admissible
from congelation.design.shooting import Cells, Path, Shooting

__all__ = ["Candidate", "Search"]

Floats = NDArray[np.float64]

CELLS = 60
"""Cells of a start. Times of jumps are refined afterwards, and cells split once."""

RANDOM_STARTS = 60

CLIMBED = 4
"""Short climbs, the best ones, that the long climb goes on from."""

SHARES = (0.2, 0.5, 0.7, 0.9)
"""Parts of the effort spent by the end of the starts, short climbs, long climbs and hops."""

ALIKE = 1e-4
"""Starts whose values agree to this relative difference lead to the same maximum."""

LOSS = 0.01
"""What the simplified theta(t) may lose of the objective."""


@dataclass(frozen=True)
class Candidate:
    """A theta(t) and the value of the objective, max |v| or the integral of |v|^2."""

    value: float
    cells: Cells
    path: Path = field(repr=False)


class Search:
    """Climbs from many starts.

    Parameters
    ----------
    shooting : Shooting
    admissible : Admissible
    start : ndarray
        The loop's states at the first time.
    span : tuple of float
        First and last time, in seconds.
    peak : bool
        Whether the objective is max |v| (else the integral of |v|^2).
    steps : int
        Runge-Kutta steps to spend; the search ends within one climb of it.
    seed : int
    progress : callable
        Called with the fraction of the steps that are spent, and the best value so far.
    """

    def __init__(
        self,
        shooting: Shooting,
        admissible: Admissible,
        start: Floats,
        span: tuple[float, float],
        *,
        peak: bool,
        steps: int,
        seed: int = 0,
        progress: Callable[[float, float], None] = lambda done, best: None,
    ) -> None:
        self._shooting, self._admissible, self._start = shooting, admissible, start
        self._span, self._peak = span, peak
        self._steps, self._spent, self._best = steps, 0, 0.0
        self._generator = np.random.default_rng(seed)
        self._progress = progress

    def run(self, more: tuple[Cells, ...] = ()) -> list[Candidate]:
        """The maxima found, the largest first.

        Parameters
        ----------
        more : tuple of Cells
            Starts besides those of the search itself.
        """
        tried = [self._try(cells) for cells in more]
        for cells in self._starts():
            tried.append(self._try(cells))
            if self._spent > SHARES[0] * self._steps:
                break
        # A short climb from many starts, then the long one from the best of what they led to.
        climbed: list[Candidate] = []
        for candidate in _different(tried):
            climbed.append(self._by_values(candidate))
            if self._spent > SHARES[1] * self._steps:
                break
        found: list[Candidate] = []
        for candidate in _different(climbed)[:CLIMBED]:
            found.append(self._climb(candidate))
            if self._spent > SHARES[2] * self._steps:
                break
        found.sort(key=lambda c: -c.value)
        hopped = self._hop(found[0])
        best = [hopped] if hopped is not found[0] else []
        return [self._simplified(c) for c in [*best, *found][:2]]

    def _starts(self) -> Iterator[Cells]:
        """Constants, square waves between two extreme points, random cells."""
        extremes, edges = self._admissible.extremes, np.linspace(*self._span, CELLS + 1)
        for theta in extremes:
            yield Cells(np.array(self._span), theta[None, :])
        generator, m, index = self._generator, len(extremes), np.arange(CELLS)
        pairs = [(i, j) for i in range(m) for j in range(m) if i != j]
        waves = [(pair, half) for half in (1, 2, 3, 5, 8, 15, 30) for pair in pairs]
        randoms = [
            (None, length) for length in np.geomspace(1, CELLS / 2, RANDOM_STARTS).astype(int)
        ]
        # In turns, so that a budget that ends early has tried both kinds.
        order = generator.permutation(len(waves))
        for k in range(max(len(waves), len(randoms))):
            if k < len(waves):
                pair, half = waves[order[k]]
                yield Cells(edges, extremes[np.array(pair)[(index // half) % 2]])
            if k < len(randoms):
                length = randoms[k][1]
                blocks = generator.integers(m, size=CELLS // length + 1)
                yield Cells(edges, extremes[blocks[index // length]])

    def _try(self, cells: Cells) -> Candidate:
        path = self._shooting.solve(self._start, cells)
        self._spent += len(path.cell)
        value = path.peak if self._peak else path.integral
        self._best = max(self._best, value)
        self._progress(min(1.0, self._spent / self._steps), self._best)
        return Candidate(value, cells, path)

    def _gradient(self, candidate: Candidate) -> tuple[Floats, Floats]:
        self._spent += 2 * len(candidate.path.cell)
        return self._shooting.gradient(candidate.path, candidate.cells, self._peak)

    def _climb(self, candidate: Candidate) -> Candidate:
        """A local maximum over the values of theta on cells, and over the times of its jumps."""
        for cells in (CELLS, 2 * CELLS):
            candidate = self._by_values(self._split(candidate, cells))
            candidate = self._by_blocks(candidate)
            candidate = self._by_times(self._merged(candidate))
        return candidate

    def _hop(self, candidate: Candidate) -> Candidate:
        """Leave a maximum by changing some runs of cells at once, and climb again."""
        best, generator = candidate, self._generator
        while self._spent < SHARES[3] * self._steps:
            split = self._split(best, CELLS)
            theta = split.cells.theta.copy()
            for _ in range(int(generator.integers(2, 6))):
                self._change_block(theta)
            trial = self._by_values(self._try(Cells(split.cells.edges, theta)))
            if trial.value > 0.95 * best.value:
                trial = self._by_times(self._merged(trial))
            if trial.value > best.value:
                best = trial
        return best if best is candidate else self._climb(best)

    def _change_block(self, theta: Floats) -> None:
        """Set a random run of cells to a random extreme point."""
        extremes, cells = self._admissible.extremes, len(theta)
        first = int(self._generator.integers(cells))
        length = int(np.ceil(cells * 10 ** self._generator.uniform(-2, -0.5)))
        theta[first : first + length] = extremes[self._generator.integers(len(extremes))]

    def _split(self, candidate: Candidate, cells: int) -> Candidate:
        """The same theta(t) on cells no longer than the span over their number."""
        grid = np.union1d(candidate.cells.edges, np.linspace(*self._span, cells + 1))
        # An edge of the grid next to a jump would only cost steps.
        jumps, near = candidate.cells.edges, (self._span[1] - self._span[0]) / cells / 20
        distance = np.abs(grid[:, None] - jumps[None, :]).min(axis=1)
        grid = grid[(distance == 0.0) | (distance > near)]
        middle = (grid[:-1] + grid[1:]) / 2
        index = np.searchsorted(jumps, middle, side="right") - 1
        return self._try(Cells(grid, candidate.cells.theta[index]))

    def _merged(self, candidate: Candidate) -> Candidate:
        return self._try(candidate.cells.merged())

    def _by_values(self, candidate: Candidate) -> Candidate:
        """Move cells to where their gradient is largest; fewer of them where that overshoots."""
        for _ in range(30):
            by_cell, _ = self._gradient(candidate)
            wanted = np.array([self._admissible.worst(row) for row in by_cell])
            gains = np.sum(by_cell * (wanted - candidate.cells.theta), axis=1)
            order = np.argsort(-gains)
            count = int(np.sum(gains > 1e-9 * max(float(gains.max(initial=0.0)), 1e-300)))
            better = None
            while count >= 1 and better is None:
                theta = candidate.cells.theta.copy()
                theta[order[:count]] = wanted[order[:count]]
                trial = self._try(Cells(candidate.cells.edges, theta))
                better = trial if trial.value > candidate.value * (1 + 1e-9) else None
                count //= 2
            if better is None or self._spent > SHARES[3] * self._steps:
                return better or candidate
            candidate = better
        return candidate

    def _by_blocks(self, candidate: Candidate) -> Candidate:
        """Try random runs of cells at random extreme points."""
        for _ in range(CELLS // 2):
            if self._spent > SHARES[3] * self._steps:
                break
            theta = candidate.cells.theta.copy()
            self._change_block(theta)
            trial = self._try(Cells(candidate.cells.edges, theta))
            if trial.value > candidate.value * (1 + 1e-6):
                candidate = self._by_values(trial)
        return candidate

    def _by_times(self, candidate: Candidate) -> Candidate:
        """A maximum over the times of the jumps, each between its neighbours."""
        for _ in range(3):
            edges = candidate.cells.edges
            if len(edges) < 3 or self._spent > self._steps:
                return candidate
            middles = (edges[:-1] + edges[1:]) / 2
            low = np.concatenate([[edges[0] + 0.02 * (edges[1] - edges[0])], middles[1:-1]])
            high = np.concatenate([middles[1:-1], [edges[-1] - 0.02 * (edges[-1] - edges[-2])]])
            best = candidate

            def fall(times: Floats, of: Candidate = candidate) -> tuple[float, Floats]:
                nonlocal best
                moved = np.concatenate([of.cells.edges[:1], times, of.cells.edges[-1:]])
                trial = self._try(Cells(moved, of.cells.theta))
                if trial.value > best.value:
                    best = trial
                # Of max |v| the gradient is that of its square, which has the same maxima.
                value = trial.value**2 if self._peak else trial.value
                return -value, -self._gradient(trial)[1]

            scipy.optimize.minimize(
                fall,
                edges[1:-1],
                jac=True,
                method="L-BFGS-B",
                bounds=list(zip(low, high, strict=True)),
                options={"maxiter": 12, "maxfun": 20},
            )
            gain = best.value / candidate.value - 1 if candidate.value > 0 else 0.0
            candidate = best
            if gain < 1e-4:
                return candidate
        return candidate

    def _simplified(self, candidate: Candidate) -> Candidate:
        """Fewer jumps at rounder times, for at most `LOSS` of the value."""
        least, changed = (1 - LOSS) * candidate.value, True
        while changed and len(candidate.cells.theta) > 1:
            changed = False
            cells = candidate.cells
            for k in np.argsort(np.diff(cells.edges)):
                for other in (k - 1, k + 1):
                    if not 0 <= other < len(cells.theta):
                        continue
                    theta = cells.theta.copy()
                    theta[k] = theta[other]
                    trial = self._try(Cells(cells.edges, theta).merged())
                    if trial.value >= least:
                        candidate, changed = trial, True
                        break
                if changed:
                    break
        candidate = self._by_times(candidate)
        digits = 4 - math.floor(math.log10(self._span[1] - self._span[0]))
        edges = candidate.cells.edges.copy()
        edges[1:-1] = np.round(edges[1:-1], digits)
        if np.all(np.diff(edges) > 0):
            rounded = self._try(Cells(edges, candidate.cells.theta))
            if rounded.value >= 0.999 * candidate.value:
                return rounded
        return candidate


def _different(candidates: list[Candidate]) -> list[Candidate]:
    """The largest first, and of those of one value one alone."""
    chosen: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda c: -c.value):
        if not chosen or chosen[-1].value - candidate.value > ALIKE * candidate.value:
            chosen.append(candidate)
    return chosen
