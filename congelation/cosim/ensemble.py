"""Loaded slaves, and the arrays through which they talk.

Y    every Real value that is read, slave by slave, each slave's in one call
C    the polynomials of all inputs that are driven, links sorted by target:
     u(t + s) = C[0] + C[1] s + C[2] s^2 / 2 + C[3] s^3 / 6

Both are buffers between the FMUs and the coupling, whose C functions hold their addresses; they
are written by every trial of a step and are no state of the coupling.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.result import RunEnded, Status
from congelation.cosim.system import (
    MAX_DERIVATIVE,
    Link,
    Recorded,
    ResolvedSystem,
)
from congelation.fmi.description import EVENT, Description, Variable, derivative_name
from congelation.fmi.slave import Slave, State

__all__ = ["LARGEST_VALUE", "NO_DERIVATIVE", "Ensemble", "Transfer"]

Floats = npt.NDArray[np.float64]
Call = Callable[[], None]

LARGEST_VALUE = 1e100
"""Beyond this a run counts as diverged: far above physics, far below overflow of a square."""

NO_DERIVATIVE = -1
"""Stands for the place of a derivative that the source does not provide."""


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
        exact = description.derivative(variable, "output")
        if exact is not None:
            self.plain[exact.name] = exact
        elif description.misfit(variable):
            return
        elif description.max_output_derivative_order > 0 and variable.causality == "output":
            self.ranked[variable.name] = variable


class Transfer(NamedTuple):
    """One call that reads or sends values of a slave, as data; the compiled loop makes it as well.

    Parameters
    ----------
    function : str
        fmi2GetReal, fmi2SetReal, fmi2GetRealOutputDerivatives or fmi2SetRealInputDerivatives.
    references : list of int, length n
    orders : list of int
        Of derivatives; empty for the first two functions.
    values : array, shape (n,)
        Where the values are read to, or sent from.
    slots : sequence of (int, int)
        The entries (order, link) of C that are gathered into `values` before they are sent, in
        the units of the inputs; empty where `values` is a part of Y or C itself.
    """

    function: str
    references: list[int]
    orders: list[int]
    values: Floats
    slots: Sequence[tuple[int, int]] = ()


class Ensemble:
    """The slaves of a system with their buffers.

    Parameters
    ----------
    system : ResolvedSystem
    slaves : sequence of Slave
        In the order of the system's members, instantiated or reset.
    recorded : sequence of Recorded
        Variables to read besides the sources of the links.
    derivatives : bool
        Whether the derivatives of the links' sources are read, and derivatives of inputs sent.
    slopes : bool
        Whether the derivatives of the recorded variables are read.
    events : bool
        Whether announcements of jumps are.
    exchange : bool
        Whether the slaves are ones of model exchange: their inputs are values at all times.

    Attributes
    ----------
    Y : array, shape (number of values,)
    C : array, shape (4, L)
    links : tuple of Link, length L
        Sorted by target.
    source, source_derivative : integer arrays, shape (L,)
        Places in Y of each link's output and of its derivative (or NO_DERIVATIVE).
    order : integer array, shape (L,)
        Highest derivative that the target takes.
    nominal : array, shape (L,)
    columns : list of slice, one per slave
        The links that drive it.
    read : list of callables, one per slave
        Read its part of Y.
    write : list of callables, one per slave
        Send it its columns of C.
    hold : list of callables, one per slave
        Send it its columns of C[0] alone.
    reads, writes, holds : list of list of Transfer, one per slave
        What these three do, as data.
    events : list of int
        Places in Y of the announcements of jumps.
    checked : list of array, one per slave
        The parts of Y in which every value has to be finite.
    read_calls, write_calls : list of int, one per slave
        fmi2 calls that `read` and `write` take.
    stepping : bool
        False until initialisation is over: only then may derivatives move by FMI functions.
    level : int
        Which of the saved states `save` and `restore` work on; those of another level are kept.
    calls : int
        fmi2 calls made, those of the steps' regular pattern left out; see Stepper.
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
        exchange: bool = False,
    ) -> None:
        self.system = system
        self._exchange = exchange
        self.slaves = tuple(slaves)
        self._plan_outputs(recorded, derivatives, slopes, events)
        self._plan_inputs(derivatives)
        self._plan_judgement(recorded)
        self.begin(system)

    def begin(self, system: ResolvedSystem) -> None:
        """Get ready for a run of this system, which may differ in start values alone from the one
        that the ensemble was made for; its slaves are new or reset."""
        self.system = system
        self.stepping = False
        self.calls = 0
        self.level = 0
        self._states: dict[int, list[tuple[Slave, State]]] = {}
        self.Y[:] = 0.0
        self.C[:] = 0.0

    # -- what is read -------------------------------------------------------------------------

    def _plan_outputs(
        self, recorded: Sequence[Recorded], derivatives: bool, slopes: bool, events: bool
    ) -> None:
        members, links = self.system.members, self.system.links
        parts = [_Part() for _ in members]
        driven = {(link.target, link.input.name) for link in links}
        for link in links:
            parts[link.source].plain[link.output.name] = link.output
            if derivatives or slopes:
                parts[link.source].add_derivative(members[link.source].description, link.output)
        for item in recorded:
            # A driven input is recorded as the value of its source.
            if item.variable.type == "Real" and (item.member, item.variable.name) not in driven:
                part = parts[item.member]
                part.plain[item.variable.name] = item.variable
                if slopes:
                    part.add_derivative(members[item.member].description, item.variable)
        for part, member in zip(parts, members, strict=True):
            event = member.description.announcement
            if event is not None and (part.plain.pop(EVENT, None) is not None or events):
                part.plain[EVENT] = event
        keys = [(m, name) for m, part in enumerate(parts) for name in part.names]
        self.read_names = [f"{members[m].name}.{name}" for m, name in keys]
        self._place = {key: place for place, key in enumerate(keys)}
        self.Y: Floats = np.zeros(len(keys))
        self.read_calls = [bool(part.plain) + bool(part.ranked) for part in parts]
        self.read: list[Call] = []
        self.reads: list[list[Transfer]] = []
        self.checked: list[Floats] = []
        self.events: list[int] = []
        begin = 0
        for part, slave in zip(parts, self.slaves, strict=True):
            middle, end = begin + len(part.plain), begin + len(part.names)
            reads = []
            if part.plain:
                references = [variable.reference for variable in part.plain.values()]
                reads.append(Transfer("fmi2GetReal", references, [], self.Y[begin:middle]))
            if part.ranked:
                references = [variable.reference for variable in part.ranked.values()]
                orders = [1] * len(references)
                reads.append(
                    Transfer("fmi2GetRealOutputDerivatives", references, orders, self.Y[middle:end])
                )
            self.reads.append(reads)
            self.read.append(self._calls(slave, reads))
            announces = EVENT in part.plain and slave.description.announcement is not None
            if announces:
                self.events.append(middle - 1)
            # An announcement may be infinite, so the check of finite values stops before it.
            self.checked.append(self.Y[begin : middle - announces])
            begin = end

    def place(self, member: int, name: str) -> int:
        """Where a variable that is read stands in Y."""
        return self._place[member, name]

    def slope_place(self, member: int, name: str) -> int:
        """Where the derivative of a variable stands in Y, or NO_DERIVATIVE."""
        description = self.system.members[member].description
        if description.misfit(description.variables[name]):
            return NO_DERIVATIVE
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
        for part in self.checked:
            # Also false for nan; one product instead of a search.
            if not part.dot(part) < LARGEST_VALUE**2:
                break
        else:
            return
        for k, value in enumerate(self.Y.tolist()):
            if k in self.events:
                continue
            where = f"{self.read_names[k]} at t = {time:.9g}"
            if not math.isfinite(value):
                raise RunEnded(Status.NON_FINITE, f"{where} is {value}")
            if abs(value) > LARGEST_VALUE:
                raise RunEnded(Status.DIVERGED, f"{where} is {value:.3g}, past {LARGEST_VALUE:g}")

    def next_event(self, time: float) -> float:
        """The first jump announced after `time`; infinity where there is none."""
        announced = (float(self.Y[k]) for k in self.events)
        return min((event for event in announced if event > time), default=math.inf)

    # -- what is sent -------------------------------------------------------------------------

    def _plan_inputs(self, derivatives: bool) -> None:
        self.links = tuple(sorted(self.system.links, key=lambda link: link.target))
        self.C: Floats = np.zeros((1 + MAX_DERIVATIVE, len(self.links)))
        sources = [(link.source, link.output.name) for link in self.links]
        self.source = np.array([self.place(*source) for source in sources], np.intp)
        self.source_derivative = np.array(
            [self.slope_place(*source) if derivatives else NO_DERIVATIVE for source in sources],
            np.intp,
        )
        self.order = np.array([self._input_order(link) for link in self.links], np.intp)
        self.nominal = np.array([link.output.nominal for link in self.links])
        self.columns: list[slice] = []
        self.hold: list[Call] = []
        self.holds: list[list[Transfer]] = []
        self.write: list[Call] = []
        self.writes: list[list[Transfer]] = []
        self.write_calls: list[int] = []
        begin = 0
        for m, slave in enumerate(self.slaves):
            links = [link for link in self.links if link.target == m]
            columns = slice(begin, begin + len(links))
            references = [link.input.reference for link in links]
            # Sorted by target, so that a slave's part of C[0] can be sent from where it stands.
            if any(link.converts for link in links):
                slots = [(0, k) for k in range(begin, columns.stop)]
                holds = [Transfer("fmi2SetReal", references, [], np.zeros(len(links)), slots)]
            elif links:
                holds = [Transfer("fmi2SetReal", references, [], self.C[0, columns])]
            else:
                holds = []
            writes = self._writes(columns)
            self.columns.append(columns)
            self.holds.append(holds)
            self.writes.append(writes)
            self.hold.append(self._calls(slave, holds))
            self.write.append(self._calls(slave, writes))
            self.write_calls.append(bool(links) + any(map(self._interpolates, links)))
            begin = columns.stop

    def _plan_judgement(self, recorded: Sequence[Recorded]) -> None:
        sources = set(self.source.tolist())
        targets = {link.target for link in (*self.links, *self.system.discrete_links)}
        further: dict[int, float] = {}
        for item in recorded:
            variable = item.variable
            place = self._place.get((item.member, variable.name))
            if place is None or variable.is_held or place in sources or item.member not in targets:
                continue
            further[place] = variable.nominal
        self.judged = np.array([*self.source.tolist(), *further], np.intp)
        self.judged_nominal = np.array([*self.nominal.tolist(), *further.values()])

    def _input_order(self, link: Link) -> int:
        return 0 if self._exchange else self.system.input_order(link)

    def _interpolates(self, link: Link) -> bool:
        return not self._exchange and self.system.interpolates(link)

    def _writes(self, columns: slice) -> list[Transfer]:
        """What sends a slave all of its columns of C."""
        numbered = list(enumerate(self.links[columns], columns.start))
        transfers = []
        plain = [(0, k, link.input.reference) for k, link in numbered] + [
            (order, k, variable.reference)
            for k, link in numbered
            for order, variable in enumerate(link.target_derivatives[: self.order[k]], 1)
            if variable is not None
        ]
        if plain:
            references, slots = [r for _, _, r in plain], [(order, k) for order, k, _ in plain]
            values = np.zeros(len(plain))
            transfers.append(Transfer("fmi2SetReal", references, [], values, slots))
        ranked = [
            (order, k)
            for k, link in numbered
            if self._interpolates(link)
            for order in range(1, 1 + MAX_DERIVATIVE)
        ]
        if ranked:
            references = [self.links[k].input.reference for _, k in ranked]
            orders, values = [order for order, _ in ranked], np.zeros(len(ranked))
            transfers.append(
                Transfer("fmi2SetRealInputDerivatives", references, orders, values, ranked)
            )
        return transfers

    def _calls(self, slave: Slave, transfers: Sequence[Transfer]) -> Call:
        """A function that makes all of some transfers."""
        calls = []
        for transfer in transfers:
            call = slave.bound(transfer.function, *transfer[1:4])
            if transfer.slots:
                call = self._gathered(transfer.slots, transfer.values, call)
            calls.append(self._when_stepping(call) if transfer.orders else call)
        return _chained(calls)

    def converted(self, slots: Sequence[tuple[int, int]]) -> tuple[Floats, Floats] | None:
        """Factors and offsets to the units of the inputs, for entries (order, link) of C; None
        where all units are the same."""
        if not any(self.links[k].converts for _, k in slots):
            return None
        factor = np.array([self.links[k].factor for _, k in slots])
        # A derivative has no offset.
        return factor, np.array([0.0 if order else self.links[k].offset for order, k in slots])

    def _gathered(self, slots: Sequence[tuple[int, int]], values: Floats, send: Call) -> Call:
        """Take the entries (order, link) of C, and send them in the units of the inputs."""
        C = self.C.reshape(-1)
        place = np.array([order * len(self.links) + k for order, k in slots], np.intp)
        units = self.converted(slots)

        def write() -> None:
            C.take(place, out=values, mode="clip")
            if units is not None:
                np.multiply(values, units[0], out=values)
                np.add(values, units[1], out=values)
            send()

        return write

    def _when_stepping(self, call: Call) -> Call:
        """A call that FMI 2.0 allows once initialisation is over."""

        def guarded() -> None:
            if self.stepping:
                call()

        return guarded

    @property
    def moves_derivatives(self) -> bool:
        """Whether some are moved by FMI functions, which initialisation mode does not allow."""
        return max((*self.read_calls, *self.write_calls), default=0) > 1

    def passes_on_held(self, m: int) -> bool:
        """Whether an output of slave m may follow at once from a driven input that is held."""
        known = self.system.members[m].description.dependencies.values()
        columns = self.columns[m]
        held = {
            link.input.name
            for link, order in zip(self.links[columns], self.order[columns], strict=True)
            if order == 0
        }
        return bool(held) and any(names is None or held.intersection(names) for names in known)

    def copy_discrete(self, values: Sequence[float | int | bool | str] | None = None) -> None:
        """Set the inputs that are driven by discrete links, to the values of their
        sources as they are now if no others are given."""
        # All are read before any is set, so that the order of the connections does not matter.
        values = self.discrete_values() if values is None else values
        for link, value in zip(self.system.discrete_links, values, strict=True):
            sent = link.factor * value + link.offset if link.converts else value  # type: ignore[operator]
            self.slaves[link.target].set_value(link.input, sent)

    @cached_property
    def discrete_feedthrough(self) -> bool:
        """Whether an Integer, Boolean or String output that drives an input may follow at once
        from an input that is driven; where an FMU does not say, it may."""
        links = self.system.discrete_links
        driven = {(link.target, link.input.name) for link in (*self.links, *links)}
        for link in links:
            known = self.system.members[link.source].description.dependencies
            depends_on = known.get(link.output.name)
            inputs = {name for target, name in driven if target == link.source}
            if inputs and (depends_on is None or inputs.intersection(depends_on)):
                return True
        return False

    def discrete_values(self) -> list[float | int | bool | str]:
        """The outputs that drive Integer, Boolean and String inputs, as they are now."""
        found: list[float | int | bool | str] = []
        for link in self.system.discrete_links:
            reference = link.output.reference
            (value,) = self.slaves[link.source].get_values(link.output.type, [reference])
            if isinstance(value, float) and not math.isfinite(value):
                slave = self.slaves[link.source]
                raise RunEnded(
                    Status.NON_FINITE,
                    f"{slave.name}.{link.output.name} at t = {slave.time:.9g} is {value}",
                )
            found.append(value)
        return found

    # -- states of the slaves -----------------------------------------------------------------

    def save(self) -> None:
        """Save the states of all slaves as they are now, over those saved before."""
        saved = self._states.get(self.level)
        if saved is None:
            self._states[self.level] = [(slave, slave.save()) for slave in self.slaves]
            self.calls += len(self.slaves)
            return
        for slave, state in saved:
            self.calls += 1 if state.value is None else 2
            slave.save_into(state)

    def state_handles(self) -> list[State]:
        """The handles of the states that `save` saves over, one per slave, for compiled code."""
        if self.level not in self._states:
            self._states[self.level] = [(slave, slave.state_handle()) for slave in self.slaves]
        return [state for _, state in self._states[self.level]]

    def forget_states(self) -> None:
        """Free what was saved."""
        self._states.clear()
        for slave in self.slaves:
            slave.free_states()

    def restore(self) -> None:
        """Take all slaves back to the saved states."""
        for slave, state in self._states[self.level]:
            slave.restore(state)
        self.calls += len(self.slaves)


def _chained(calls: Sequence[Call]) -> Call:
    """A function that calls each; the function itself where there is one."""
    if len(calls) == 1:
        return calls[0]

    def chain() -> None:
        for call in calls:
            call()

    return chain
