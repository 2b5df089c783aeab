"""Loaded slaves with the buffers through which a coupling talks to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt

from congelation.cosim.buffers import NO_DERIVATIVE, Inputs, Outputs, Transfer
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.system import Recorded, ResolvedSystem
from congelation.fmi.slave import Slave, State

__all__ = ["LARGEST_VALUE", "Ensemble"]

Floats = npt.NDArray[np.float64]
Call = Callable[[], None]

LARGEST_VALUE = 1e100
"""Beyond this a run counts as diverged: far above physics, far below overflow of a square."""


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
    Y, read_names, reads, events, checked
        As in `Outputs`; `read_names` are its names.
    C, links, order, columns, writes, holds
        As in `Inputs`.
    source, source_derivative : integer arrays, shape (L,)
        Places in Y of each link's output and of its derivative (or NO_DERIVATIVE).
    nominal : array, shape (L,)
    judged, judged_nominal : arrays, shape (W,)
        Places in Y of the values that steps in halves are judged by, and their nominal values: the
        sources of the links, and recorded continuous outputs of components with inputs.
    read : list of callables, one per slave
        Read its part of Y.
    write : list of callables, one per slave
        Send it its columns of C.
    hold : list of callables, one per slave
        Send it its columns of C[0] alone.
    read_calls, write_calls : list of int, one per slave
        fmi2 calls that `read` and `write` take.
    stepping : bool
        False until initialisation is over: only then may derivatives move by FMI functions.
    level : int
        Which of the saved states `save` and `restore` work on; those of another level are kept.
    calls : int
        fmi2 calls made, those of the steps' regular pattern left out; see Stepper.
    strays : dict of str
        By the name of an output that has driven an input with a value that is no item of its own
        enumeration: a sentence on the first of them.
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
        self.slaves = tuple(slaves)
        self._outputs = outputs = Outputs(
            system, recorded, derivatives=derivatives, slopes=slopes, events=events
        )
        self.Y, self.read_names, self.reads = outputs.Y, outputs.names, outputs.reads
        self.checked, self.events = outputs.checked, outputs.events
        self.read = [self._calls(slave, t) for slave, t in zip(slaves, self.reads, strict=True)]
        self.read_calls = list(map(len, self.reads))
        self._inputs = inputs = Inputs(system, held=exchange)
        self.C, self.links, self.order = inputs.C, inputs.links, inputs.order
        self.columns, self.writes, self.holds = inputs.columns, inputs.writes, inputs.holds
        self.write = [self._calls(slave, t) for slave, t in zip(slaves, self.writes, strict=True)]
        self.hold = [self._calls(slave, t) for slave, t in zip(slaves, self.holds, strict=True)]
        self.write_calls = list(map(len, self.writes))
        sources = [(link.source, link.output.name) for link in self.links]
        self.source = np.array([self.place(*source) for source in sources], np.intp)
        self.source_derivative = np.array(
            [self.slope_place(*source) if derivatives else NO_DERIVATIVE for source in sources],
            np.intp,
        )
        self.nominal = np.array([link.output.nominal for link in self.links])
        targets = {link.target for link in (*self.links, *system.discrete_links)}
        known = [None, *self.source.tolist()]
        further = {
            place: item.variable.nominal
            for item in recorded
            if (place := outputs.place(item.member, item.variable.name)) not in known
            and item.member in targets
            and not item.variable.is_held
        }
        self.judged = np.array([*known[1:], *further], np.intp)
        self.judged_nominal = np.array([*self.nominal.tolist(), *further.values()])
        self.begin(system)

    def begin(self, system: ResolvedSystem) -> None:
        """Get ready for a run of this system, which may differ in start values alone from the one
        that the ensemble was made for; its slaves are new or reset."""
        self.system = system
        self.stepping = False
        self.calls = 0
        self.strays: dict[str, str] = {}
        self.level = 0
        self._states: dict[int, list[tuple[Slave, State]]] = {}
        self.Y[:] = 0.0
        self.C[:] = 0.0

    # -- what is read -------------------------------------------------------------------------

    def place(self, member: int, name: str) -> int:
        """Where a variable that is read stands in Y."""
        place = self._outputs.place(member, name)
        assert place is not None
        return place

    def slope_place(self, member: int, name: str) -> int:
        """Where the derivative of a variable stands in Y, or NO_DERIVATIVE."""
        return self._outputs.slope_place(member, name)

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
        """As `Inputs.converted`."""
        return self._inputs.converted(slots)

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

    def copy_discrete(
        self, time: float, values: Sequence[float | int | bool | str] | None = None
    ) -> None:
        """Set the inputs that are driven by discrete links, to the values of their
        sources as they are now if no others are given."""
        # All are read before any is set, so that the order of the connections does not matter.
        values = self.discrete_values() if values is None else values
        for link, value in zip(self.system.discrete_links, values, strict=True):
            if link.output.items and all(value != item for _, item in link.output.items):
                name = f"{self.slaves[link.source].name}.{link.output.name}"
                valid = ", ".join(f"'{item}' ({number})" for item, number in link.output.items)
                self.strays.setdefault(
                    name,
                    f"{name} is {value} at t = {time:.9g}, no item of its enumeration "
                    f"({valid}); it was passed on as it is.",
                )
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
