"""The arrays through which slaves and couplings talk, and the calls that move them, as data.

Y    every Real value that is read, slave by slave, each slave's in one call
C    the polynomials of all inputs that are driven, links sorted by target:
     u(t + s) = C[0] + C[1] s + C[2] s^2 / 2 + C[3] s^3 / 6

Both are buffers between the FMUs and the coupling, whose C functions hold their addresses; they
are written by every trial of a step and are no state of the coupling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from congelation.cosim.system import MAX_DERIVATIVE, Recorded, ResolvedSystem
from congelation.fmi.description import EVENT, Description, Variable, derivative_name

__all__ = ["NO_DERIVATIVE", "Inputs", "Outputs", "Transfer"]

Floats = npt.NDArray[np.float64]

NO_DERIVATIVE = -1
"""Stands for the place of a derivative that the source does not provide."""


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


class Outputs:
    """What is read of a system: Y and the calls that fill it.

    Parameters
    ----------
    system : ResolvedSystem
    recorded : sequence of Recorded
        Variables to read besides the sources of the links.
    derivatives, slopes : bool
        Whether the derivatives of the links' sources are read, and those of recorded variables.
    events : bool
        Whether announcements of jumps are.

    Attributes
    ----------
    Y : array, shape (number of values,)
    names : list of str
        Of the values, "component.variable".
    reads : list of list of Transfer, one per slave
    checked : list of array, one per slave
        The parts of Y in which every value has to be finite.
    events : list of int
        Places in Y of the announcements of jumps.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        recorded: Sequence[Recorded],
        *,
        derivatives: bool,
        slopes: bool,
        events: bool,
    ) -> None:
        self._descriptions = [member.description for member in system.members]
        parts = self._parts(system, recorded, derivatives, slopes)
        for part, description in zip(parts, self._descriptions, strict=True):
            event = description.announcement
            if event is not None and (part.plain.pop(EVENT, None) is not None or events):
                part.plain[EVENT] = event
        keys = [(m, name) for m, part in enumerate(parts) for name in part.names]
        self.names = [f"{system.members[m].name}.{name}" for m, name in keys]
        self._place = {key: place for place, key in enumerate(keys)}
        self.Y: Floats = np.zeros(len(keys))
        self.reads: list[list[Transfer]] = []
        self.checked: list[Floats] = []
        self.events: list[int] = []
        begin = 0
        for part, description in zip(parts, self._descriptions, strict=True):
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
            announces = EVENT in part.plain and description.announcement is not None
            if announces:
                self.events.append(middle - 1)
            # An announcement may be infinite, so the check of finite values stops before it.
            self.checked.append(self.Y[begin : middle - announces])
            begin = end

    def _parts(
        self,
        system: ResolvedSystem,
        recorded: Sequence[Recorded],
        derivatives: bool,
        slopes: bool,
    ) -> list[_Part]:
        """What is read of each slave, but for announcements."""
        parts = [_Part() for _ in system.members]
        driven = {(link.target, link.input.name) for link in system.links}
        for link in system.links:
            parts[link.source].plain[link.output.name] = link.output
            if derivatives or slopes:
                parts[link.source].add_derivative(self._descriptions[link.source], link.output)
        for item in recorded:
            # A driven input is recorded as the value of its source.
            if item.variable.type == "Real" and (item.member, item.variable.name) not in driven:
                part = parts[item.member]
                part.plain[item.variable.name] = item.variable
                if slopes:
                    part.add_derivative(self._descriptions[item.member], item.variable)
        return parts

    def place(self, member: int, name: str) -> int | None:
        """Where a variable stands in Y; None where it is not read."""
        return self._place.get((member, name))

    def slope_place(self, member: int, name: str) -> int:
        """Where the derivative of a variable stands in Y, or NO_DERIVATIVE."""
        description = self._descriptions[member]
        if description.misfit(description.variables[name]):
            return NO_DERIVATIVE
        return self._place.get((member, derivative_name(name, 1)), NO_DERIVATIVE)


class Inputs:
    """What is sent to a system: C and the calls that send it.

    Parameters
    ----------
    system : ResolvedSystem
    held : bool
        Whether inputs are values alone at all times, as in model exchange.

    Attributes
    ----------
    C : array, shape (4, L)
    links : tuple of Link, length L
        Sorted by target.
    order : integer array, shape (L,)
        Highest derivative that the target takes.
    columns : list of slice, one per slave
        The links that drive it.
    writes, holds : list of list of Transfer, one per slave
        What sends a slave its columns of C, and of C[0] alone.
    """

    def __init__(self, system: ResolvedSystem, *, held: bool) -> None:
        self._system, self._held = system, held
        self.links = tuple(sorted(system.links, key=lambda link: link.target))
        self.C: Floats = np.zeros((1 + MAX_DERIVATIVE, len(self.links)))
        orders = [0 if held else system.input_order(link) for link in self.links]
        self.order = np.array(orders, np.intp)
        self.columns: list[slice] = []
        self.holds: list[list[Transfer]] = []
        self.writes: list[list[Transfer]] = []
        begin = 0
        for m in range(len(system.members)):
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
            self.columns.append(columns)
            self.holds.append(holds)
            self.writes.append(self._writes(columns))
            begin = columns.stop

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
            if not self._held and self._system.interpolates(link)
            for order in range(1, 1 + MAX_DERIVATIVE)
        ]
        if ranked:
            references = [self.links[k].input.reference for _, k in ranked]
            orders, values = [order for order, _ in ranked], np.zeros(len(ranked))
            transfers.append(
                Transfer("fmi2SetRealInputDerivatives", references, orders, values, ranked)
            )
        return transfers

    def converted(self, slots: Sequence[tuple[int, int]]) -> tuple[Floats, Floats] | None:
        """Factors and offsets to the units of the inputs, for entries (order, link) of C; None
        where all units are the same."""
        if not any(self.links[k].converts for _, k in slots):
            return None
        factor = np.array([self.links[k].factor for _, k in slots])
        # A derivative has no offset.
        return factor, np.array([0.0 if order else self.links[k].offset for order, k in slots])
