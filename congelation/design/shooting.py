"""A closed loop under piecewise constant theta(t), solved forwards and differentiated backwards.

One step of the Runge-Kutta pair of order 5(4) by Dormand and Prince is one compiled function, with
its error estimate, and so is its adjoint: a solution costs some microseconds per step, and the
gradient of an objective with respect to every value of theta about twice as much.

References
----------
E. Hairer, S. P. Norsett and G. Wanner, Solving Ordinary Differential Equations I, Springer 1993,
sec. II.4 (step control) and II.5 (the pair).
J. T. Betts, Practical Methods for Optimal Control, SIAM 2010 (discrete adjoints).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import RK45

from congelation.theory.closed_loop import ClosedLoop, Compiled

__all__ = ["Cells", "Path", "Shooting"]

Floats = NDArray[np.float64]

LARGEST = 1e9
"""A state beyond this, for a loop that starts at unit size, is taken to diverge."""

MOST_STEPS = 200_000
"""Steps of one solution; a solution that needs more is given up as too stiff for this method."""


@dataclass(frozen=True)
class Cells:
    """theta(t), constant on each cell.

    Attributes
    ----------
    edges : ndarray, shape (K + 1,)
        Increasing times, in seconds.
    theta : ndarray, shape (K, p)
        The value from each edge to the next.
    """

    edges: Floats
    theta: Floats

    def merged(self) -> Cells:
        """The same theta(t) without edges at which nothing changes, and without empty cells."""
        keep = np.diff(self.edges) > 1e-9 * max(1.0, abs(float(self.edges[-1])))
        theta, starts = self.theta[keep], self.edges[:-1][keep]
        starts = np.concatenate([self.edges[:1], starts[1:]])
        change = np.concatenate([[True], np.any(theta[1:] != theta[:-1], axis=1)])
        return Cells(np.append(starts[change], self.edges[-1]), theta[change])

    def until(self, time: float) -> Cells:
        """theta(t) up to a time, which lies after the first edge."""
        last = int(np.searchsorted(self.edges, time, side="left"))
        return Cells(np.append(self.edges[:last], time), self.theta[:last])

    def then(self, later: Cells) -> Cells:
        """This theta(t), then `later`, which starts where this one ends."""
        return Cells(
            np.concatenate([self.edges, later.edges[1:]]),
            np.concatenate([self.theta, later.theta]),
        )


@dataclass(frozen=True)
class Path:
    """A solution at its own steps.

    Attributes
    ----------
    time : ndarray, shape (N + 1,)
    states : ndarray, shape (N + 1, n + 1)
        The loop's states, then the integral of |v|^2.
    cell : ndarray of int, shape (N,)
        The cell of each step.
    size : ndarray, shape (N + 1,)
        |v|^2.
    finished : bool
        False where the solution diverged or took too many steps.
    """

    time: Floats
    states: Floats
    cell: NDArray[np.int64]
    size: Floats
    finished: bool

    @property
    def peak(self) -> float:
        """max |v|; infinite if the solution did not finish."""
        return math.sqrt(float(self.size.max())) if self.finished else math.inf

    @property
    def integral(self) -> float:
        """The integral of |v|^2; infinite if the solution did not finish."""
        return float(self.states[-1, -1]) if self.finished else math.inf


class Shooting:
    """The loop with the group of signals v that an objective is of.

    Parameters
    ----------
    loop : ClosedLoop
    v : casadi.SX
        A column in terms of the loop's states and theta, with numbers for the parameters.
    rtol, atol : float
        Of a step.
    """

    def __init__(
        self, loop: ClosedLoop, v: ca.SX, *, rtol: float = 1e-7, atol: float = 1e-9
    ) -> None:
        self.loop = loop
        X, theta = loop.arguments
        (f,) = loop.bind([loop.rate])
        Y = ca.vertcat(X, ca.SX.sym("q"))
        size = ca.sumsqr(v)
        self._rate = ca.Function("rate", [Y, theta], [ca.vertcat(f, size)])
        self._size = Compiled([size], [X, theta])
        h = ca.SX.sym("h")
        stages: list[ca.SX] = []
        for row in RK45.A:
            weighted = [a * k for a, k in zip(row, stages, strict=False) if a != 0.0]
            stages.append(
                self._rate(Y + h * sum(weighted[1:], weighted[0]) if weighted else Y, theta)
            )
        # The next value, and the rate there, which the error estimate of the pair takes as well.
        new = Y + h * sum((b * k for b, k in zip(RK45.B, stages, strict=True) if b), ca.SX(0))
        last = self._rate(new, theta)
        error = h * sum(
            (e * k for e, k in zip(RK45.E, [*stages, last], strict=True) if e), ca.SX(0)
        )
        n = X.numel()
        scale = atol + rtol * ca.fmax(ca.fabs(Y[:n]), ca.fabs(new[:n]))
        norm = ca.sqrt(ca.sumsqr(error[:n] / scale) / n)
        after = ca.substitute(size, X, new[:n])
        self._step = Compiled([new, norm, after], [Y, theta, h])
        co = ca.SX.sym("lambda", Y.numel())
        gradients = [ca.jtimes(new, Y, co, True), ca.jtimes(new, theta, co, True)]
        self._adjoint_expression = (gradients, [Y, theta, h, co])
        self._v = v
        self.operations: int = ca.Function("count", [Y, theta, h], ca.cse([new])).n_instructions()

    @cached_property
    def _adjoint(self) -> Compiled:
        return Compiled(*self._adjoint_expression)

    @cached_property
    def _size_slope(self) -> Compiled:
        """The gradient of |v|^2 with respect to the states."""
        X, theta = self.loop.arguments
        Y = ca.SX.sym("Y", X.numel() + 1)
        size = self._rate(Y, theta)[-1]
        return Compiled([ca.gradient(size, Y)], [Y, theta])

    @cached_property
    def rate(self) -> Compiled:
        """(states and integral, theta) -> their rates."""
        X, theta = self.loop.arguments
        Y = ca.SX.sym("Y", X.numel() + 1)
        return Compiled([self._rate(Y, theta)], [Y, theta])

    def signals(self, path: Path, cells: Cells) -> Floats:
        """v at each step, shape (N + 1, size of v)."""
        v = Compiled([self._v], self.loop.arguments)
        of_point = np.append(path.cell, path.cell[-1:])
        return np.array(
            [v(Y[:-1], cells.theta[k]) for Y, k in zip(path.states, of_point, strict=True)]
        )

    def solve(
        self,
        start: Floats,
        cells: Cells,
        *,
        first_step: float = 1e-3,
        longest: float = math.inf,
        most_steps: int = MOST_STEPS,
    ) -> Path:
        """The solution from a state at the first edge to the last edge.

        Parameters
        ----------
        start : ndarray
            The loop's states.
        cells : Cells
        first_step : float
            Seconds; later steps follow from the error.
        longest : float
            Largest step, in seconds.
        most_steps : int
            Where the solution is given up.
        """
        step, n = self._step, len(start) + 1
        Y = np.append(start, 0.0)
        t, h = float(cells.edges[0]), min(first_step, longest)
        times, rows, of_cell = [t], [Y], []
        sizes = [float(self._size(start, cells.theta[0])[0])]
        finished = True
        for k, end in enumerate(cells.edges[1:].tolist()):
            theta = cells.theta[k]
            while t < end and finished:
                left = end - t
                # A last step that is a little longer is better than one that is tiny.
                taken = left if left <= 1.01 * h else min(h, 0.5 * left) if left < 2.0 * h else h
                found = step(Y, theta, taken)
                error = found[n]
                if not error <= 1.0:  # also where it is not a number
                    h = taken * (max(0.2, 0.9 * error**-0.2) if error < math.inf else 0.1)
                    if t + h == t or len(times) > most_steps:
                        finished = False
                    continue
                t = end if taken == left else t + taken
                Y = found[:n]
                times.append(t)
                rows.append(Y)
                of_cell.append(k)
                sizes.append(float(found[n + 1]))
                growth = min(5.0, 0.9 * max(error, 1e-10) ** -0.2)
                h = min(longest, max(h, taken * growth) if taken < h else taken * growth)
                finished = bool(np.abs(Y[:-1]).max() < LARGEST) and len(times) <= most_steps
            if not finished:
                break
        return Path(
            np.array(times),
            np.array(rows),
            np.array(of_cell, dtype=np.int64),
            np.array(sizes),
            finished,
        )

    def gradient(self, path: Path, cells: Cells, peak: bool) -> tuple[Floats, Floats]:
        """The derivatives of max |v|^2 (`peak`) or of the integral of |v|^2.

        Returns
        -------
        by_cell : ndarray, shape (K, p)
            With respect to the value of theta on each cell.
        by_edge : ndarray, shape (K - 1,)
            With respect to the time of each inner edge: lambda^T (f(X, theta_-) - f(X, theta_+)).
        """
        by_cell, by_edge = np.zeros_like(cells.theta), np.zeros(len(cells.theta) - 1)
        co, last = np.zeros(path.states.shape[1]), len(path.cell)
        if peak:
            last = int(np.argmax(path.size))
            if last == 0:
                return by_cell, by_edge
            co = self._size_slope(path.states[last], cells.theta[path.cell[last - 1]])
        else:
            co[-1] = 1.0
        n, steps = len(co), np.diff(path.time)
        for i in range(last - 1, -1, -1):
            k = path.cell[i]
            found = self._adjoint(path.states[i], cells.theta[k], steps[i], co)
            co = found[:n]
            by_cell[k] += found[n:]
            if i > 0 and path.cell[i - 1] != k:
                Y = path.states[i]
                jump = self.rate(Y, cells.theta[k - 1]) - self.rate(Y, cells.theta[k])
                by_edge[k - 1] = co @ jump
        return by_cell, by_edge
