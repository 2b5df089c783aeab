"""Loaded slaves, and the arrays through which they talk.

All Real outputs that anyone needs are read into one vector Y, each slave's part in one call. All
connected Real inputs are polynomials over a macro step,

    u(t + s) = C[0] + C[1] s + C[2] s^2 / 2 + C[3] s^3 / 6,

whose coefficients stand in one array C of shape (4, L), a column per link, and reach a slave in
one call through the inputs v, der(v), der(v,2), der(v,3) that it has.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.description import Variable
from congelation.cosim.result import RunEnded, Status
from congelation.cosim.slave import Slave
from congelation.cosim.system import MAX_DERIVATIVE, Link, Recorded, ResolvedSystem

__all__ = ["LARGEST_VALUE", "NO_DERIVATIVE", "Ensemble"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

LARGEST_VALUE = 1e100
"""Beyond this a run counts as diverged: far above physics, far below overflow of a square."""

NO_DERIVATIVE = -1
"""Stands for the place of a derivative that the source does not provide."""


class Ensemble:
    """The slaves of a system with their shared arrays.

    Parameters
    ----------
    system : ResolvedSystem
    slaves : sequence of Slave
        In the order of the system's members, instantiated or reset.
    recorded : sequence of Recorded
        Variables to read at each communication point.
    derivatives : bool
        Whether the derivatives of connected outputs are read too.
    events : bool
        Whether `next_event` outputs are read too.

    Attributes
    ----------
    Y : array, shape (number of values read,)
    C : array, shape (4, L)
        Input polynomials of the L links, which are sorted by target.
    links : tuple of Link, length L
    source : integer array, shape (L,)
        Place in Y of each link's output.
    source_derivative : integer array, shape (L,)
        Place in Y of its derivative, or NO_DERIVATIVE.
    order : integer array, shape (L,)
        Highest derivative that the target takes.
    nominal : array, shape (L,)
    columns : list of slice, one per slave
        Its links.
    read, write : list of callables, one per slave
        Read its outputs into Y; send it its columns of C.
    hold : list of callables, one per slave
        Send it the newest values of its sources in Y, as held inputs.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        slaves: Sequence[Slave],
        recorded: Sequence[Recorded],
        *,
        derivatives: bool,
        events: bool,
    ) -> None:
        self.system = system
        self.slaves = tuple(slaves)
        self.links = tuple(sorted(system.links, key=lambda link: link.target))
        self._place: dict[tuple[int, str], int] = {}
        self._names: list[str] = []
        self._plan_reading(recorded, derivatives, events)
        self._plan_links(derivatives)
        self._plan_recording(recorded)

    # -- reading ------------------------------------------------------------------------------

    def _plan_reading(self, recorded: Sequence[Recorded], derivatives: bool, events: bool) -> None:
        sources = {(link.target, link.input.name) for link in self.links}
        parts: list[tuple[slice, list[int], list[int], bool]] = []
        for m, member in enumerate(self.system.members):
            plain: dict[str, Variable] = {}
            ranked: dict[str, int] = {}
            for link in (link for link in self.links if link.source == m):
                plain[link.output.name] = link.output
                exact = link.source_derivatives[0]
                if derivatives and exact is not None:
                    plain[exact.name] = exact
                elif derivatives and member.description.max_output_derivative_order > 0:
                    ranked[link.output.name] = link.output.reference
            for item in (item for item in recorded if item.member == m):
                if item.variable.type == "Real" and (m, item.variable.name) not in sources:
                    plain[item.variable.name] = item.variable
            # Last, since it may be infinite: left out of the check of finite values.
            event = plain.pop("next_event", member.description.variables.get("next_event"))
            announces = event is not None and event.causality == "output"
            if event is not None and announces and (events or self._is_recorded(recorded, m)):
                plain["next_event"] = event
            begin = len(self._names)
            for name in (*plain, *(f"fmi2:der({name})" for name in ranked)):
                self._place[m, name] = len(self._names)
                self._names.append(f"{member.name}.{name}")
            parts.append(
                (
                    slice(begin, len(self._names)),
                    [v.reference for v in plain.values()],
                    list(ranked.values()),
                    "next_event" in plain,
                )
            )
        self.Y: Floats = np.zeros(len(self._names))
        self.read = [self._reader(m, *part) for m, part in enumerate(parts)]
        self._checked = [
            self.Y[part.start : part.start + len(plain) - has_event]
            for part, plain, _, has_event in parts
        ]
        self._events = [part.start + len(plain) - 1 for part, plain, _, has in parts if has]
        self.read_calls = [bool(plain) + bool(ranked) for _, plain, ranked, _ in parts]

    @staticmethod
    def _is_recorded(recorded: Sequence[Recorded], member: int) -> bool:
        return any(r.member == member and r.variable.name == "next_event" for r in recorded)

    def _reader(
        self, m: int, part: slice, plain: Sequence[int], ranked: Sequence[int], _: bool
    ) -> Callable[[], None]:
        slave, middle = self.slaves[m], part.start + len(plain)
        calls = []
        if plain:
            calls.append(slave.reader(plain, self.Y[part.start : middle]))
        if ranked:
            calls.append(slave.derivative_reader(ranked, 1, self.Y[middle : part.stop]))
        return _chained(calls)

    # -- links --------------------------------------------------------------------------------

    def _plan_links(self, derivatives: bool) -> None:
        count = len(self.links)
        self.C: Floats = np.zeros((1 + MAX_DERIVATIVE, count))
        self.source = np.array([self._place[k.source, k.output.name] for k in self.links], np.intp)
        self.source_derivative = np.array(
            [self._derivative_place(link) if derivatives else NO_DERIVATIVE for link in self.links],
            np.intp,
        )
        self.order = np.array([self._order(link) for link in self.links], np.intp)
        self.nominal = np.array([link.output.nominal for link in self.links])
        targets = [link.target for link in self.links]
        self.columns = [
            slice(targets.index(m), targets.index(m) + targets.count(m))
            if m in targets
            else slice(0, 0)
            for m in range(len(self.slaves))
        ]
        self.hold = [self._holder(m) for m in range(len(self.slaves))]
        self.write = [self._writer(m) for m in range(len(self.slaves))]
        self.write_calls = [self._write_calls(m) for m in range(len(self.slaves))]

    def _derivative_place(self, link: Link) -> int:
        exact = link.source_derivatives[0]
        name = exact.name if exact is not None else f"fmi2:der({link.output.name})"
        return self._place.get((link.source, name), NO_DERIVATIVE)

    def _order(self, link: Link) -> int:
        """Highest derivative that a link's target takes, all lower ones included."""
        if self._interpolates(link):
            return MAX_DERIVATIVE
        return next((k for k, v in enumerate(link.target_derivatives) if v is None), MAX_DERIVATIVE)

    def _interpolates(self, link: Link) -> bool:
        """Whether derivatives reach the target by fmi2SetRealInputDerivatives."""
        able = self.system.members[link.target].description.can_interpolate_inputs
        return able and link.target_derivatives[0] is None

    def _holder(self, m: int) -> Callable[[], None]:
        links = self.links[self.columns[m]]
        if not links:
            return _nothing
        values = np.zeros(len(links))
        send = self.slaves[m].writer([link.input.reference for link in links], values)
        Y, source = self.Y, self.source[self.columns[m]]

        def hold() -> None:
            Y.take(source, out=values, mode="clip")
            send()

        return hold

    def _writer(self, m: int) -> Callable[[], None]:
        columns = self.columns[m]
        numbered = list(enumerate(self.links[columns], columns.start))
        plain = [(0, k, link.input.reference) for k, link in numbered] + [
            (order, k, variable.reference)
            for k, link in numbered
            for order, variable in enumerate(link.target_derivatives[: self.order[k]], 1)
            if variable is not None
        ]
        ranked = [
            (order, k, link.input.reference)
            for k, link in numbered
            if self._interpolates(link)
            for order in range(1, 1 + MAX_DERIVATIVE)
        ]
        calls = []
        for slots, is_plain in ((plain, True), (ranked, False)):
            if slots:
                values = np.zeros(len(slots))
                references = [reference for _, _, reference in slots]
                send = (
                    self.slaves[m].writer(references, values)
                    if is_plain
                    else self.slaves[m].derivative_writer(
                        references, [o for o, _, _ in slots], values
                    )
                )
                calls.append(self._gathered([(o, k) for o, k, _ in slots], values, send))
        return _chained(calls)

    def _gathered(
        self, slots: Sequence[tuple[int, int]], values: Floats, send: Callable[[], None]
    ) -> Callable[[], None]:
        """Take the entries (order, link) of C and send them."""
        C = self.C.reshape(-1)
        place = np.array([order * len(self.links) + k for order, k in slots], np.intp)

        def write() -> None:
            C.take(place, out=values, mode="clip")
            send()

        return write

    def _write_calls(self, m: int) -> int:
        links = self.links[self.columns[m]]
        return bool(links) + any(self._interpolates(link) for link in links)

    # -- recording ----------------------------------------------------------------------------

    def _plan_recording(self, recorded: Sequence[Recorded]) -> None:
        driven = {
            (link.target, link.input.name): self.source[k] for k, link in enumerate(self.links)
        }
        places, self._slow = [], list[tuple[int, Recorded]]()
        for column, item in enumerate(recorded):
            key = (item.member, item.variable.name)
            if item.variable.type != "Real":
                self._slow.append((column, item))
            # A driven input has at a communication point the value of its source.
            places.append(driven[key] if key in driven else self._place.get(key, 0))
        self._recorded = np.array(places, np.intp)

    def fill(self, row: Floats) -> None:
        """Write the recorded values, shape (M,), into `row`."""
        if self.Y.size:
            self.Y.take(self._recorded, out=row, mode="clip")
        for column, item in self._slow:
            slave = self.slaves[item.member]
            (value,) = slave.get_values(item.variable.type, [item.variable.reference])
            row[column] = float(value)

    # -- values -------------------------------------------------------------------------------

    def read_all(self) -> None:
        """Read the outputs of every slave."""
        for read in self.read:
            read()

    def copy_discrete(self) -> None:
        """Copy the Integer, Boolean and String outputs to the inputs that they drive."""
        for link in self.system.discrete_links:
            kind = link.output.type
            (value,) = self.slaves[link.source].get_values(kind, [link.output.reference])
            self.slaves[link.target].set_value(link.input, value)

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


def _nothing() -> None:
    """Stands where a slave has nothing to read or to set."""


def _chained(calls: Sequence[Callable[[], None]]) -> Callable[[], None]:
    """One function for several; the function itself where there is one."""
    if len(calls) == 1:
        return calls[0]

    def chain() -> None:
        for call in calls:
            call()

    return chain if calls else _nothing
