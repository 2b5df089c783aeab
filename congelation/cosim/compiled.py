"""The compiled stepping loop (loop.c), called through ctypes.

It makes the steps of `jacobi`, `gauss_seidel`, `derivative` and `hermite`, for any FMUs, and the
jumps between steps that a tolerance chooses. The loops in Python are the reference: they make the
step that the compiled loop ended at, and so find the status and the message of a run that fails.

The shared library is built when the package is installed. Where there is none, because there was no
compiler, runs are the same, and slower.
"""

from __future__ import annotations

import ctypes
import sysconfig
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from congelation.cosim.coupling.derivative import DerivativePlan
from congelation.cosim.coupling.hermite import HermitePlan, HermiteState
from congelation.cosim.coupling.points import KEPT, Points
from congelation.cosim.ensemble import NO_DERIVATIVE, Ensemble, Transfer
from congelation.cosim.exchange import Block, Exchange
from congelation.cosim.recording import NODES, Columns, EveryStep, OutputGrid, Rows
from congelation.cosim.step_control import Halving, StepSize

__all__ = [
    "CHUNK",
    "DONE",
    "FULL",
    "NOT_FINITE",
    "UNUSUAL",
    "CompiledHeld",
    "CompiledPolynomials",
    "Loop",
    "available",
    "fits",
    "library",
    "load_library",
]

Floats = npt.NDArray[np.float64]

CHUNK = 1024
"""Steps per call: progress is reported, and Ctrl-C is heard, between two calls."""

KEPT_POINTS = 256
"""Communication points that are kept before rows are made of them."""

DONE, FULL, REFUSED, NOT_FINITE, UNUSUAL, UNSOLVED = range(6)
"""Why a call ended; as in loop.c."""

POINT, BEFORE_JUMP, AFTER_JUMP = range(3)
"""What a kept row is of; as in loop.c."""


class _Call(ctypes.Structure):
    _fields_ = [
        ("plain", ctypes.c_void_p),
        ("ranked", ctypes.c_void_p),
        ("references", ctypes.c_void_p),
        ("orders", ctypes.c_void_p),
        ("note", ctypes.c_uint64),
        ("count", ctypes.c_size_t),
        ("values", ctypes.c_void_p),
        ("places", ctypes.c_void_p),
        ("factors", ctypes.c_void_p),
        ("offsets", ctypes.c_void_p),
    ]


class _Slave(ctypes.Structure):
    _fields_ = [
        ("component", ctypes.c_void_p),
        ("note", ctypes.c_void_p),
        ("step_note", ctypes.c_uint64),
        ("get_note", ctypes.c_uint64),
        ("free_note", ctypes.c_uint64),
        ("set_note", ctypes.c_uint64),
        ("step", ctypes.c_void_p),
        ("get_state", ctypes.c_void_p),
        ("free_state", ctypes.c_void_p),
        ("set_state", ctypes.c_void_p),
        ("states", ctypes.c_void_p * 2),
        ("reads", ctypes.POINTER(_Call)),
        ("writes", ctypes.POINTER(_Call)),
        ("holds", ctypes.POINTER(_Call)),
        ("n_reads", ctypes.c_int),
        ("n_writes", ctypes.c_int),
        ("n_holds", ctypes.c_int),
        ("checked", ctypes.c_void_p),
        ("n_checked", ctypes.c_size_t),
        ("holds_some", ctypes.c_int),
        ("forward", ctypes.c_void_p),
        ("ahead", ctypes.c_void_p),
        ("steps_ahead", ctypes.c_int),
        ("reaches_end", ctypes.c_int),
    ]


class _Block(ctypes.Structure):
    _fields_ = [
        ("sources", ctypes.c_void_p),
        ("targets", ctypes.c_void_p),
        ("n_sources", ctypes.c_int),
        ("n_targets", ctypes.c_int),
        ("n", ctypes.c_ssize_t),
        ("places", ctypes.c_void_p),
        ("slots", ctypes.c_void_p),
        ("nominal", ctypes.c_void_p),
        ("loops", ctypes.c_int),
    ]


class Loop(ctypes.Structure):
    """What the compiled loop works on, and what became of it; as in loop.c."""

    _fields_ = [
        ("slaves", ctypes.POINTER(_Slave)),
        ("n_slaves", ctypes.c_int),
        ("which", ctypes.c_int),
        ("n_links", ctypes.c_ssize_t),
        ("Y", ctypes.c_void_p),
        ("C", ctypes.c_void_p),
        ("source", ctypes.c_void_p),
        ("source_derivative", ctypes.c_void_p),
        ("columns", ctypes.c_void_p),
        ("order", ctypes.c_void_p),
        ("inexact", ctypes.c_int),
        ("nominal", ctypes.c_void_p),
        ("blocks", ctypes.POINTER(_Block)),
        ("solving", ctypes.c_void_p),
        ("n_blocks", ctypes.c_int),
        ("n_events", ctypes.c_int),
        ("events", ctypes.c_void_p),
        ("stop", ctypes.c_double),
        ("rows", ctypes.c_void_p),
        ("kinds", ctypes.c_void_p),
        ("recorded", ctypes.c_void_p),
        ("width", ctypes.c_ssize_t),
        ("capacity", ctypes.c_ssize_t),
        ("n_rows", ctypes.c_ssize_t),
        ("every", ctypes.c_long),
        ("left", ctypes.c_long),
        ("most", ctypes.c_long),
        ("steps", ctypes.c_long),
        ("rejected", ctypes.c_long),
        ("events_crossed", ctypes.c_long),
        ("floors", ctypes.c_long),
        ("passes", ctypes.c_long),
        ("calls", ctypes.c_long),
        ("largest_error", ctypes.c_double),
        ("counted", ctypes.c_double),
        ("counted_before", ctypes.c_double),
        ("status", ctypes.c_int),
        ("function", ctypes.c_char_p),
        ("time", ctypes.c_double),
        ("level", ctypes.c_int),
    ]


class _Plan(ctypes.Structure):
    _fields_ = [
        ("iterates", ctypes.c_int),
        ("highest", ctypes.c_int),
        ("chooses", ctypes.c_int),
        ("accelerates", ctypes.c_int),
        ("max_iterations", ctypes.c_int),
        ("iterations", ctypes.c_int),
        ("saves", ctypes.c_int),
        ("halves", ctypes.c_int),
        ("sequential", ctypes.c_int),
        ("exchanges", ctypes.c_int),
        ("tolerance", ctypes.c_double),
        ("accuracy", ctypes.c_double),
        ("unsettled", ctypes.c_double),
        ("horizon", ctypes.c_double),
        ("first_change", ctypes.c_double),
        ("n_back", ctypes.c_ssize_t),
        ("back", ctypes.c_void_p),
        ("work", ctypes.c_void_p),
    ]


class _Grid(ctypes.Structure):
    _fields_ = [
        ("interval", ctypes.c_double),
        ("n_sampled", ctypes.c_ssize_t),
        ("places", ctypes.c_void_p),
        ("nominal", ctypes.c_void_p),
        ("samples", ctypes.c_void_p),
        ("times", ctypes.c_double * NODES),
        ("n_times", ctypes.c_int),
    ]


class _State(ctypes.Structure):
    _fields_ = [
        ("times", ctypes.c_double * KEPT),
        ("n_times", ctypes.c_int),
        ("order", ctypes.c_int),
        ("table", ctypes.c_void_p),
        ("J", ctypes.c_void_p),
        ("length", ctypes.c_double),
    ]


class _Memory(ctypes.Structure):
    _fields_ = [
        ("state", _State),
        ("step", ctypes.c_double),
        ("error_before", ctypes.c_double),
        ("event", ctypes.c_double),
        ("refused_length", ctypes.c_double),
        ("refused_error", ctypes.c_double),
        ("sizes", ctypes.c_void_p),
        ("lasting", ctypes.c_void_p),
        ("found", ctypes.c_double),
        ("left", ctypes.c_int),
        ("rejected", ctypes.c_int),
        ("n_grids", ctypes.c_int),
        ("grids", ctypes.POINTER(_Grid)),
    ]


VERSION = 4
"""Version of the library that fits these structures; as in loop.c."""


@cache
def library() -> ctypes.CDLL | None:
    """The compiled loop; None where it was not built, or in another version."""
    return load_library(
        Path(__file__).with_name("loop" + str(sysconfig.get_config_var("EXT_SUFFIX")))
    )


def load_library(file: Path) -> ctypes.CDLL | None:
    """The compiled loop in a file; None where it is none of this version."""
    try:
        found = ctypes.CDLL(str(file))
        if found.loop_version() != VERSION:
            return None
    except (OSError, AttributeError):
        return None
    found.work_size.restype = ctypes.c_size_t
    found.work_size.argtypes = [ctypes.c_size_t, ctypes.c_size_t]
    return found


def available() -> bool:
    """Whether there is a compiled loop."""
    return library() is not None


def fits(ensemble: Ensemble, columns: Columns) -> bool:
    """Whether a run is one that the compiled loop makes: its connections and what is recorded are
    Real, and nothing but the steps changes them."""
    return columns.follows and not ensemble.system.discrete_links


class _Compiled:
    """An ensemble, as the compiled loop sees it.

    Parameters
    ----------
    ensemble : Ensemble
    rows : sequence of Rows
        What is recorded. Where that is one row of values for every n-th communication point, the
        compiled loop writes it; else it keeps all that is read at each point, and the rows are made
        of that afterwards.
    exchange : Exchange
    lands : bool
        Whether communication points are placed on announced jumps.
    stop : float
        Seconds.
    """

    def __init__(
        self, ensemble: Ensemble, rows: Sequence[Rows], exchange: Exchange, lands: bool, stop: float
    ) -> None:
        found = library()
        if found is None:
            raise ValueError("there is no compiled loop; see available")
        self.library = found
        self.ensemble = ensemble
        self._rows = rows
        self._exchange = exchange
        self._direct: EveryStep | None = None
        if len(rows) == 1 and isinstance(rows[0], EveryStep) and rows[0].columns.places is not None:
            self._direct = rows[0]
            recorded, every = rows[0].columns.places, rows[0].every
        else:
            recorded, every = np.arange(len(ensemble.Y)), 1
        count = 0 if self._direct else KEPT_POINTS
        self._points = np.empty((count, 1 + len(recorded)))
        self._kinds = np.zeros(count, np.uint8)
        self._kept: list[object] = []  # what the structures point to
        links = len(ensemble.links)
        largest = max((len(block.places) for block in exchange.blocks if block.loop), default=0)
        events = ensemble.events if lands else []
        starts = [columns.start for columns in ensemble.columns]
        self.loop = Loop(
            slaves=(_Slave * len(ensemble.slaves))(
                *(self._slave(m) for m in range(len(ensemble.slaves)))
            ),
            n_slaves=len(ensemble.slaves),
            n_links=links,
            Y=self._address(ensemble.Y),
            C=self._address(ensemble.C),
            source=self._address(ensemble.source),
            source_derivative=self._address(ensemble.source_derivative),
            columns=self._address(np.array([*starts, links], np.intp)),
            order=self._address(ensemble.order.astype(np.uint8)),
            inexact=bool((ensemble.source_derivative == NO_DERIVATIVE).any()),
            nominal=self._address(ensemble.nominal),
            blocks=(_Block * len(exchange.blocks))(*map(self._block, exchange.blocks)),
            solving=self._address(np.zeros(largest * (6 + 2 * largest))),
            n_blocks=len(exchange.blocks),
            n_events=len(events),
            events=self._address(np.array(events, np.intp)),
            stop=stop,
            kinds=None if self._direct else self._address(self._kinds),
            recorded=self._address(recorded.astype(np.intp)),
            width=len(recorded),
            every=every,
        )

    def _address(self, array: Any) -> int:
        """Where an array is, which is kept."""
        self._kept.append(array)
        return int(array.ctypes.data)

    def _block(self, block: Block) -> _Block:
        nominal = self.ensemble.nominal[[wire.link for wire in block.wires]]
        return _Block(
            sources=self._address(np.array(block.sources, np.intc)),
            targets=self._address(np.array(block.targets, np.intc)),
            n_sources=len(block.sources),
            n_targets=len(block.targets),
            n=len(block.places),
            places=self._address(block.places),
            slots=self._address(block.slots),
            nominal=self._address(nominal),
            loops=block.loop,
        )

    def _slave(self, m: int) -> _Slave:
        ensemble, slave = self.ensemble, self.ensemble.slaves[m]
        reads, writes, holds = ensemble.reads[m], ensemble.writes[m], ensemble.holds[m]
        return _Slave(
            component=slave.component,
            note=slave.note("fmi2DoStep")[0],
            step_note=slave.note("fmi2DoStep")[1],
            get_note=slave.note("fmi2GetFMUstate")[1],
            free_note=slave.note("fmi2FreeFMUstate")[1],
            set_note=slave.note("fmi2SetFMUstate")[1],
            step=slave.address("fmi2DoStep"),
            get_state=slave.address("fmi2GetFMUstate"),
            free_state=slave.address("fmi2FreeFMUstate"),
            set_state=slave.address("fmi2SetFMUstate"),
            reads=self._calls(m, reads),
            writes=self._calls(m, writes),
            holds=self._calls(m, holds),
            n_reads=len(reads),
            n_writes=len(writes),
            n_holds=len(holds),
            checked=self._address(ensemble.checked[m]),
            n_checked=len(ensemble.checked[m]),
        )

    def _calls(self, m: int, transfers: Sequence[Transfer]) -> Any:
        calls = (_Call * len(transfers))()
        for call, transfer in zip(calls, transfers, strict=True):
            function = self.ensemble.slaves[m].address(transfer.function)
            if transfer.orders:
                call.ranked = function
                call.orders = self._address(np.array(transfer.orders, np.intc))
            else:
                call.plain = function
            call.note = self.ensemble.slaves[m].note(transfer.function)[1]
            call.references = self._address(np.array(transfer.references, np.uintc))
            call.count = len(transfer.references)
            call.values = self._address(transfer.values)
            if transfer.slots:
                count = len(self.ensemble.links)
                places = [order * count + k for order, k in transfer.slots]
                call.places = self._address(np.array(places, np.intp))
                units = self.ensemble.converted(transfer.slots)
                if units is not None:
                    call.factors, call.offsets = map(self._address, units)
        return calls

    def renew(self, rows: Sequence[Rows]) -> None:
        """Get ready for another run of the ensemble, with rows of the same kinds."""
        self._rows = rows
        self.loop.largest_error = 0.0
        if self._direct is not None:
            assert isinstance(rows[0], EveryStep)
            self._direct = rows[0]

    def called(self, function: Callable[..., int], most: int, *arguments: object) -> int:
        """Call one of the functions that step, with rows to fill, and keep what it recorded."""
        loop, direct = self.loop, self._direct
        room = self._points if direct is None else direct.recorder.room
        loop.rows, loop.capacity, loop.n_rows = room.ctypes.data, len(room), 0
        loop.left = 0 if direct is None else direct.left
        loop.most = most
        loop.steps = loop.rejected = loop.events_crossed = loop.floors = 0
        loop.passes = loop.calls = 0
        self._refusals = [slave.log.refusals for slave in self.ensemble.slaves]
        code = function(ctypes.byref(loop), *arguments)
        if direct is not None:
            direct.recorder.filled(loop.n_rows)
            direct.left = loop.left
        elif loop.n_rows:
            Y = self.ensemble.Y
            now = Y.copy()
            for point, kind in zip(room[: loop.n_rows], self._kinds.tolist(), strict=False):
                Y[:] = point[1:]
                for rows in self._rows:
                    taken = (rows.point, rows.before_jump, rows.after_jump)[kind]
                    taken(float(point[0]))
            Y[:] = now
        return code

    def raise_for(self, code: int, time: float) -> None:
        """Raise what ended a run: what an FMU refused, or a jump at `time` led to.

        Raises
        ------
        SlaveError, SlaveTerminated, RunEnded
        """
        if code == REFUSED:
            self.refuse()
        elif code == NOT_FINITE:
            self.ensemble.check(time)
        elif code == UNSOLVED:
            raise self._exchange.unsolved(self._exchange.blocks[self.loop.which], time)

    def refuse(self) -> None:
        """Raise what the call meant that an FMU refused last: code REFUSED."""
        loop = self.loop
        slave = self.ensemble.slaves[loop.which]
        slave.log.time = loop.time
        slave.refused(loop.function.decode(), loop.status, self._refusals[loop.which])


class CompiledHeld(_Compiled):
    """`jacobi`, and with `sequential` `gauss_seidel`, compiled."""

    def __init__(
        self,
        ensemble: Ensemble,
        rows: Sequence[Rows],
        exchange: Exchange,
        *,
        sequential: bool,
    ) -> None:
        super().__init__(ensemble, rows, exchange, False, np.inf)
        self._sequential = sequential

    def run(self, time: float, ends: Floats) -> int:
        """Step from `time` to each of the points `ends`.

        Returns
        -------
        int
            DONE, FULL, or NOT_FINITE or REFUSED in the step that was the last one.
        """
        ends = np.ascontiguousarray(ends)
        before = self.ensemble.Y[self.ensemble.source]
        return self.called(
            self.library.run_held,
            len(ends),
            ctypes.c_int(self._sequential),
            ctypes.c_double(time),
            ctypes.c_void_p(ends.ctypes.data),
            ctypes.c_long(len(ends)),
            ctypes.c_void_p(before.ctypes.data),
        )


class CompiledPolynomials(_Compiled):
    """`hermite` and `derivative`, compiled.

    Parameters
    ----------
    ensemble, rows, exchange, lands
        As of `_Compiled`.
    plan : HermitePlan or DerivativePlan
    tolerance : float
        Of steps that are chosen by one; else any number.
    first_change : float
        Share of its size by which an input may change over the first step after a jump.
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
        self._plan = _Plan(
            iterates=self._iterates,
            halves=plan.halves,
            tolerance=tolerance,
            first_change=first_change,
            horizon=stop - start,
            work=self._address(np.zeros(self.library.work_size(links, unknowns))),
            **fields,
        )
        self._table = np.zeros((2, KEPT, links))
        self._J = np.zeros((unknowns, unknowns))
        self._grids = _judging(rows)
        self._samples = [np.empty((NODES, grid.columns.sampled.size)) for grid in self._grids]
        self._sizes, self._lasting = np.zeros(links), np.zeros(links)
        self._memory = _Memory(
            state=_State(table=self._address(self._table), J=self._address(self._J)),
            sizes=self._address(self._sizes),
            lasting=self._address(self._lasting),
            n_grids=len(self._grids),
            grids=(_Grid * len(self._grids))(
                *(
                    _Grid(
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
