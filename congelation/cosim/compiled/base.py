"""A coupled system as the compiled loop sees it, and what its calls have in common."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from congelation.cosim.buffers import NO_DERIVATIVE, Transfer
from congelation.cosim.columns import Columns
from congelation.cosim.compiled import library
from congelation.cosim.compiled.structures import Block, Call, Loop, Slave
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.exchange import Block as Wires
from congelation.cosim.exchange import Exchange
from congelation.cosim.recording import EveryStep, Rows

__all__ = ["CHUNK", "DONE", "FULL", "NOT_FINITE", "UNUSUAL", "Compiled", "fits"]


CHUNK = 1024
"""Steps per call: progress is reported, and Ctrl-C is heard, between two calls."""

KEPT_POINTS = 256
"""Communication points that are kept before rows are made of them."""

(
    DONE,
    FULL,
    REFUSED,
    NOT_FINITE,
    UNUSUAL,
    UNSOLVED,
    TOO_SMALL,
    CROSSED,
    TERMINATED,
    UNSETTLED,
    LATE,
) = range(11)
"""Why a call ended; as in loop/structures.h."""

POINT, BEFORE_JUMP, AFTER_JUMP, VISITED = range(4)
"""What a kept row is of; as in loop/structures.h."""


def fits(ensemble: Ensemble, columns: Columns) -> bool:
    """Whether a run is one that the compiled loop makes: its connections and what is recorded are
    continuous, and nothing but the steps changes them."""
    return columns.follows and not ensemble.system.discrete_links


class Compiled:
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
        found = library.loaded()
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
            slaves=(Slave * len(ensemble.slaves))(
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
            blocks=(Block * len(exchange.blocks))(*map(self._block, exchange.blocks)),
            solving=self._address(np.zeros(largest * (6 + 2 * largest))),
            n_blocks=len(exchange.blocks),
            n_events=len(events),
            events=self._address(np.array(events, np.intp)),
            stop=stop,
            kinds=None if self._direct else self._address(self._kinds),
            recorded=self._address(recorded.astype(np.intp)),
            width=len(recorded),
            every=every,
            n_judged=len(ensemble.judged),
            judged=self._address(ensemble.judged),
            judged_nominal=self._address(ensemble.judged_nominal),
        )

    def _address(self, array: Any) -> int:
        """Where an array is, which is kept."""
        self._kept.append(array)
        return int(array.ctypes.data)

    def _block(self, block: Wires) -> Block:
        nominal = self.ensemble.nominal[[wire.link for wire in block.wires]]
        return Block(
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

    def _slave(self, m: int) -> Slave:
        ensemble, slave = self.ensemble, self.ensemble.slaves[m]
        reads, writes, holds = ensemble.reads[m], ensemble.writes[m], ensemble.holds[m]
        return Slave(
            component=slave.component,
            note=slave.note("fmi2DoStep")[0],
            step_note=slave.note("fmi2DoStep")[1],
            get_note=slave.note("fmi2GetFMUstate")[1],
            free_note=slave.note("fmi2FreeFMUstate")[1],
            set_note=slave.note("fmi2SetFMUstate")[1],
            step=None if slave.exchange else slave.address("fmi2DoStep"),
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
        calls = (Call * len(transfers))()
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
        self.watch_refusals()
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
                    taken = (rows.point, rows.before_jump, rows.after_jump, rows.visit)[kind]
                    taken(float(point[0]))
            Y[:] = now
        return code

    def watch_refusals(self) -> None:
        """Remember what the FMUs have logged before a call."""
        self._refusals = [slave.log.refusals for slave in self.ensemble.slaves]

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
