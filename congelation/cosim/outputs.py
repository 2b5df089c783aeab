"""Everything that is read from the slaves, in one vector."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from congelation.cosim.calls import chained
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.system import Recorded, ResolvedSystem, derivative_name
from congelation.fmi.description import Description, Variable
from congelation.fmi.slave import Slave

__all__ = ["LARGEST_VALUE", "NO_DERIVATIVE", "Outputs"]

Floats = npt.NDArray[np.float64]

LARGEST_VALUE = 1e100
"""Beyond this a run counts as diverged: far above physics, far below overflow of a square."""

NO_DERIVATIVE = -1
"""Stands for the place of a derivative that the source does not provide."""

EVENT = "next_event"
"""Name of the output that announces the next jump."""


@dataclass
class _Part:
    """What is read from one slave.

    Parameters
    ----------
    plain : dict of str to Variable
        Read by fmi2GetReal, the announcement of events last.
    ranked : dict of str to Variable
        Outputs whose derivative is read by fmi2GetRealOutputDerivatives.
    """

    plain: dict[str, Variable] = field(default_factory=dict)
    ranked: dict[str, Variable] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        return [*self.plain, *(derivative_name(name, 1) for name in self.ranked)]

    def add_derivative(self, description: Description, variable: Variable) -> None:
        """Read the derivative of an output, if there is any way to."""
        exact = description.variables.get(derivative_name(variable.name, 1))
        if exact is not None and exact.causality == "output" and exact.type == "Real":
            self.plain[exact.name] = exact
        elif description.max_output_derivative_order > 0 and variable.causality == "output":
            self.ranked[variable.name] = variable


class Outputs:
    """The Real values that are read at each communication point, each slave's in one call.

    Parameters
    ----------
    system : ResolvedSystem
    slaves : sequence of Slave
    recorded : sequence of Recorded
        Variables to read besides the sources of the links.
    derivatives : bool
        Whether the derivatives of the links' sources are read.
    slopes : bool
        Whether the derivatives of the recorded variables are.
    events : bool
        Whether announcements of jumps are.

    Attributes
    ----------
    Y : array, shape (number of values,)
    read : list of callables, one per slave
        Read its part of Y.
    read_calls : list of int, one per slave
        fmi2 calls that this takes.
    stepping : bool
        False until initialisation is over: only then may fmi2GetRealOutputDerivatives be called.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        slaves: Sequence[Slave],
        recorded: Sequence[Recorded],
        *,
        derivatives: bool,
        slopes: bool,
        events: bool,
    ) -> None:
        parts = [_Part() for _ in system.members]
        driven = {(link.target, link.input.name) for link in system.links}
        for link in system.links:
            parts[link.source].plain[link.output.name] = link.output
            if derivatives or slopes:
                description = system.members[link.source].description
                parts[link.source].add_derivative(description, link.output)
        for item in recorded:
            if item.variable.type == "Real" and (item.member, item.variable.name) not in driven:
                part = parts[item.member]
                part.plain[item.variable.name] = item.variable
                if slopes:
                    part.add_derivative(system.members[item.member].description, item.variable)
        for part, member in zip(parts, system.members, strict=True):
            _move_event_last(part, member.description, events)
        self._names = [
            f"{member.name}.{name}"
            for part, member in zip(parts, system.members, strict=True)
            for name in part.names
        ]
        self._place = {
            key: place
            for place, key in enumerate((m, n) for m, part in enumerate(parts) for n in part.names)
        }
        self.Y: Floats = np.zeros(len(self._names))
        self.read_calls = [bool(part.plain) + bool(part.ranked) for part in parts]
        self.stepping = False
        self.read: list[Callable[[], None]] = []
        self._checked: list[Floats] = []
        self._events: list[int] = []
        begin = 0
        for part, slave in zip(parts, slaves, strict=True):
            self._plan(part, slave, begin)
            begin += len(part.names)

    def _plan(self, part: _Part, slave: Slave, begin: int) -> None:
        middle = begin + len(part.plain)
        end = begin + len(part.names)
        calls = []
        if part.plain:
            references = [variable.reference for variable in part.plain.values()]
            calls.append(slave.reader(references, self.Y[begin:middle]))
        if part.ranked:
            references = [variable.reference for variable in part.ranked.values()]
            call = slave.derivative_reader(references, 1, self.Y[middle:end])
            calls.append(self._when_stepping(call))
        self.read.append(chained(calls))
        announces = EVENT in part.plain
        if announces:
            self._events.append(middle - 1)
        # An announcement may be infinite, so the check of finite values stops before it.
        self._checked.append(self.Y[begin : middle - announces])

    def _when_stepping(self, call: Callable[[], None]) -> Callable[[], None]:
        def guarded() -> None:
            if self.stepping:
                call()

        return guarded

    def place(self, member: int, name: str) -> int:
        """Where a variable that is read stands in Y."""
        return self._place[member, name]

    def slope_place(self, member: int, name: str) -> int:
        """Where the derivative of a variable stands in Y, or NO_DERIVATIVE."""
        return self._place.get((member, derivative_name(name, 1)), NO_DERIVATIVE)

    def read_all(self) -> None:
        """Read every slave."""
        for read in self.read:
            read()

    def check(self, time: float) -> None:
        """End the run where a value read is not finite, or too large.

        Raises
        ------
        RunEnded
            NON_FINITE or DIVERGED; the message names the variable.
        """
        for part in self._checked:
            # Also false for nan; one product instead of a search.
            if not part.dot(part) < LARGEST_VALUE**2:
                self._explain(time)

    def _explain(self, time: float) -> None:
        for k, value in enumerate(self.Y.tolist()):
            if k in self._events:
                continue
            where = f"{self._names[k]} at t = {time:.9g}"
            if not math.isfinite(value):
                raise RunEnded(Status.NON_FINITE, f"{where} is {value}")
            if abs(value) > LARGEST_VALUE:
                raise RunEnded(Status.DIVERGED, f"{where} is {value:.3g}, past {LARGEST_VALUE:g}")

    def next_event(self, time: float) -> float:
        """The first jump announced after `time`; infinity where there is none."""
        announced = (float(self.Y[k]) for k in self._events)
        return min((event for event in announced if event > time), default=math.inf)


def _move_event_last(part: _Part, description: Description, events: bool) -> None:
    event = part.plain.pop(EVENT, None)
    if event is None and events:
        event = description.variables.get(EVENT)
    if event is not None and event.causality == "output" and event.type == "Real":
        part.plain[EVENT] = event
