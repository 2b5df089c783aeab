"""`hermite` and `derivative` in the compiled loop."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.compiled.base import Compiled
from congelation.cosim.compiled.structures import Grid, Memory, Plan, State
from congelation.cosim.coupling.derivative import DerivativePlan
from congelation.cosim.coupling.feedback import HermitePlan, HermiteState
from congelation.cosim.coupling.points import KEPT, Points
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Exchange
from congelation.cosim.recording import NODES, OutputGrid, Rows
from congelation.cosim.step_size import Halving, StepSize

__all__ = ["CompiledPolynomials"]

Floats = npt.NDArray[np.float64]


class CompiledPolynomials(Compiled):
    """`hermite` and `derivative`, compiled.

    Parameters
    ----------
    ensemble, rows, exchange, lands
        As of `Compiled`.
    plan : HermitePlan or DerivativePlan
    tolerance : float
        Of steps that are chosen by one; else any number.
    first_change : float
        Share of its size by which an input may change over the first step after a jump.
    shortest_kept : float
        Longest step that Python is to make where its error is too large, in seconds; 0 for none.
    longest_at_rest : float
        Longest step after one without an error, in seconds.
    start, stop : float
        Of the run, in seconds.
    """

    def __init__(
        self,
        ensemble: Ensemble,
        rows: Sequence[Rows],
        exchange: Exchange,
        lands: bool,
        plan: HermitePlan | DerivativePlan,
        tolerance: float,
        first_change: float,
        shortest_kept: float,
        longest_at_rest: float,
        start: float,
        stop: float,
    ) -> None:
        super().__init__(ensemble, rows, exchange, lands, stop)
        self._iterates = isinstance(plan, HermitePlan)
        links, unknowns = len(ensemble.links), 0
        fields: dict[str, Any] = {}
        if isinstance(plan, HermitePlan):
            unknowns = 2 * len(plan.back)
            fields = {
                "highest": plan.highest,
                "chooses": plan.chooses,
                "accelerates": plan.accelerates,
                "max_iterations": plan.max_iterations,
                "iterations": plan.iterations,
                "saves": plan.saves,
                "accuracy": plan.accuracy,
                "unsettled": plan.unsettled,
                "n_back": len(plan.back),
                "back": self._address(plan.back),
            }
        else:
            fields = {"sequential": plan.sequential, "exchanges": plan.exchanges}
        for m, slave in enumerate(self.loop.slaves[: len(ensemble.slaves)]):
            if isinstance(plan, HermitePlan):
                slave.forward = self._address(plan.forward[m].astype(np.uint8))
                slave.holds_some = plan.holds_some[m]
            else:
                slave.ahead = self._address(plan.ahead[m].astype(np.uint8))
                slave.steps_ahead = bool(plan.ahead[m].any())
                slave.reaches_end = plan.reaches_end[m]
        self._plan = Plan(
            iterates=self._iterates,
            halves=plan.halves,
            tolerance=tolerance,
            first_change=first_change,
            shortest_kept=shortest_kept,
            longest_at_rest=longest_at_rest,
            horizon=stop - start,
            work=self._address(
                np.zeros(self.library.work_size(links, unknowns, len(ensemble.judged)))
            ),
            **fields,
        )
        self._table = np.zeros((2, KEPT, links))
        self._J = np.zeros((unknowns, unknowns))
        self._grids = _judging(rows)
        self._samples = [np.empty((NODES, grid.columns.sampled.size)) for grid in self._grids]
        judged = len(ensemble.judged)
        self._sizes, self._lasting = np.zeros(judged), np.zeros(judged)
        self._memory = Memory(
            state=State(table=self._address(self._table), J=self._address(self._J)),
            sizes=self._address(self._sizes),
            lasting=self._address(self._lasting),
            n_grids=len(self._grids),
            grids=(Grid * len(self._grids))(
                *(
                    Grid(
                        interval=grid.interval,
                        n_sampled=grid.columns.sampled.size,
                        places=self._address(grid.columns.sampled),
                        nominal=self._address(grid.columns.nominal),
                        samples=self._address(samples),
                    )
                    for grid, samples in zip(self._grids, self._samples, strict=True)
                )
            ),
        )

    def renew(self, rows: Sequence[Rows]) -> None:
        super().renew(rows)
        self._grids = _judging(rows)

    def adaptive(
        self,
        state: HermiteState | Points,
        size: StepSize,
        time: float,
        event: float,
        halving: Halving,
        most: int,
    ) -> tuple[int, HermiteState | Points, StepSize, float, float]:
        """Step from `time` towards the stop time, at most `most` steps, those taken back included.

        Parameters
        ----------
        event : float
            The next jump; infinity where there is none.
        halving : Halving
            It is changed in place.

        Returns
        -------
        code : int
            DONE at the stop time; FULL; REFUSED; UNUSUAL where the step that is next is for Python;
            NOT_FINITE and UNSOLVED where a jump, at `event`, led there.
        state : HermiteState or Points
        size : StepSize
        time : float
        event : float
            The next jump from there.
        """
        memory = self._memory
        self._handles()
        self._load(state)
        self._sizes[:], self._lasting[:] = halving.sizes, halving.lasting
        memory.left, memory.found = halving.left, halving.found
        memory.step, memory.error_before = size.length, size.error_before
        memory.rejected, memory.event = size.rejected, event
        # The compiled loop goes on from the points of the grids, and keeps its own; the grids get
        # them afterwards.
        for k, (grid, samples) in enumerate(zip(self._grids, self._samples, strict=True)):
            count = len(grid.times)
            memory.grids[k].times[:count] = grid.times
            memory.grids[k].n_times = count
            samples[:count] = grid.samples
        now = ctypes.c_double(time)
        code = self.called(
            self.library.run_adaptive,
            most,
            ctypes.byref(self._plan),
            ctypes.byref(memory),
            ctypes.byref(now),
        )
        halving.sizes, halving.lasting = self._sizes.copy(), self._lasting.copy()
        halving.left, halving.found = memory.left, memory.found
        step = StepSize(memory.step, memory.error_before, bool(memory.rejected))
        return code, self._state(), step, now.value, memory.event

    @property
    def refused(self) -> tuple[float, float] | None:
        """Length and error of the last trial of the step that Python goes on with."""
        memory = self._memory
        return (memory.refused_length, memory.refused_error) if memory.refused_length else None

    def fixed(
        self, state: HermiteState | Points, time: float, ends: Floats
    ) -> tuple[int, HermiteState | Points]:
        """Step from `time` to each of the points `ends`.

        Returns
        -------
        code : int
            DONE, FULL, UNUSUAL where the step that is next is for Python; or NOT_FINITE, REFUSED or
            UNSOLVED in the step that was the last one.
        state : HermiteState or Points
        """
        ends = np.ascontiguousarray(ends)
        if self._plan.saves:
            self._handles()
        self._load(state)
        points = state if isinstance(state, Points) else state.points
        before, now = np.ascontiguousarray(points.now), ctypes.c_double(time)
        code = self.called(
            self.library.run_points,
            len(ends),
            ctypes.byref(self._plan),
            ctypes.byref(self._memory),
            ctypes.byref(now),
            ctypes.c_void_p(ends.ctypes.data),
            ctypes.c_long(len(ends)),
            ctypes.c_void_p(before.ctypes.data),
        )
        return code, self._state()

    def _handles(self) -> None:
        """Tell the compiled loop where the saved states of the FMUs are."""
        ensemble = self.ensemble
        for level in (0, 1) if self._plan.halves else (0,):
            ensemble.level = level
            for m, handle in enumerate(ensemble.state_handles()):
                self.loop.slaves[m].states[level] = ctypes.addressof(handle)
        ensemble.level = 0

    def _load(self, state: HermiteState | Points) -> None:
        """Give the compiled loop a state."""
        memory = self._memory.state
        points = state if isinstance(state, Points) else state.points
        memory.times[: len(points.times)] = points.times
        memory.n_times = len(points.times)
        self._table[:] = points.table
        if not isinstance(state, Points):
            self._J[:] = state.J
            memory.order, memory.length = state.order, state.length

    def _points_now(self) -> Points:
        state = self._memory.state
        return Points(tuple(state.times[: state.n_times]), self._table.copy())

    def _state(self) -> HermiteState | Points:
        """The state that it has left."""
        points, memory = self._points_now(), self._memory.state
        if not self._iterates:
            return points
        return HermiteState(points, memory.order, self._J.copy(), memory.length)


def _judging(rows: Sequence[Rows]) -> list[OutputGrid]:
    """The grids that have something to judge steps by."""
    return [r for r in rows if isinstance(r, OutputGrid) and r.columns.sampled.size]
