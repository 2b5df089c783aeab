"""Making inputs agree with the outputs that drive them, at one point of time.

Where outputs follow directly from inputs (feedthrough), setting one input changes other outputs.
The declared dependencies give the order in which values are carried over; those that depend on
each other form an algebraic loop, which is solved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from congelation.cosim.broyden import broyden_step, learnt
from congelation.cosim.buffers import NO_DERIVATIVE
from congelation.cosim.ensemble import Ensemble
from congelation.cosim.result import RunEnded, Status
from congelation.fmi.description import derivative_name

__all__ = ["Exchange", "settle_discrete", "strong_components"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

LOOP_TOLERANCE = 1e-11
"""Agreement asked of a loop, relative to nominal value plus size: what double precision leaves
after a few operations."""

MAX_ITERATIONS = 50
"""Most iterations of one loop: an affine loop of 25 values still has its 2 n iterations."""


MAX_DISCRETE_PASSES = 1000
"""Of Integer, Boolean and String values: a loop may count up to where it comes to rest."""


@dataclass(frozen=True)
class Wire:
    """A value (order 0) or derivative (order 1) of a link, carried from Y to C."""

    order: int
    link: int
    place: int


@dataclass(frozen=True)
class Block:
    """Wires that can be carried over together.

    Parameters
    ----------
    sources, targets : tuple of int
        Slaves to read first, and to set afterwards.
    places, slots : integer arrays, shape (k,)
        Where the values of the k wires stand in Y, and go in C (flattened).
    loop : bool
        Whether the values depend on themselves.
    """

    sources: tuple[int, ...]
    targets: tuple[int, ...]
    places: Indices
    slots: Indices
    wires: tuple[Wire, ...]
    loop: bool


class Exchange:
    """Carries outputs over to inputs until they agree.

    Parameters
    ----------
    ensemble : Ensemble
        Its C is written: rows 0 and 1 (rows 2 and 3 are set to zero).

    Attributes
    ----------
    blocks : list of Block
        In the order in which they are carried over.
    loops : tuple of str
        Each algebraic loop as the names of its connections.
    """

    def __init__(self, ensemble: Ensemble) -> None:
        self._ensemble = ensemble
        self._wires = _wires(ensemble)
        self.blocks = _blocks(ensemble, self._wires)
        self.loops = tuple(self._names(block) for block in self.blocks if block.loop)

    @property
    def feedthrough(self) -> bool:
        """Whether some value depends on another, so that copying once is not enough."""
        return any(block.loop for block in self.blocks) or len(self.blocks) > 1

    def run(self, time: float) -> None:
        """Make inputs and outputs agree; reads and sets as often as the dependencies need.

        Raises
        ------
        RunEnded
            LOOP_UNSOLVED; the message names the connections of the loop.
        SlaveError
        """
        ensemble = self._ensemble
        links = ensemble.system.discrete_links
        ensemble.C[2:] = 0.0
        settle_discrete(ensemble, time)
        for _ in range(MAX_ITERATIONS):
            sent = ensemble.discrete_values() if links else []
            self.carry(time)
            # A comparison of Real inputs may have changed, and with it what drives a switch.
            if not links or ensemble.discrete_values() == sent:
                ensemble.read_all()
                ensemble.calls += sum(ensemble.read_calls)
                return
            settle_discrete(ensemble, time)
        raise RunEnded(
            Status.LOOP_UNSOLVED,
            f"at t = {time:.9g}: {', '.join(link.name for link in links)} keep changing with the "
            f"Real values around {self._all_names()}",
        )

    def carry(self, time: float) -> None:
        """Carry Real outputs over to inputs, in the order of the dependencies.

        Raises
        ------
        RunEnded
            LOOP_UNSOLVED.
        SlaveError
        """
        for block in self.blocks:
            self._read(block)
            values = self._ensemble.Y[block.places]
            self._send(block, values)
            if block.loop:
                self._solve(block, values, time)

    def settle(self, time: float) -> None:
        """Run, and again while that changes anything: for initialisation, where an output may
        depend on an input in ways that the FMU declares for initialisation only.

        Raises
        ------
        RunEnded
            LOOP_UNSOLVED.
        SlaveError
        """
        places = np.array([wire.place for wire in self._wires], np.intp)
        before = np.full(len(places), np.nan)
        for _ in range(len(self._wires) + 2):
            self.run(time)
            self._ensemble.check(time)
            after = self._ensemble.Y[places]
            if np.array_equal(before, after) or self._agree(after - before, after, self._wires):
                return
            before = after
        raise RunEnded(
            Status.LOOP_UNSOLVED,
            f"at t = {time:.9g}: initial values keep changing "
            f"around {'; '.join(self.loops) or self._all_names()}",
        )

    def _solve(self, block: Block, z: Floats, time: float) -> None:
        """Fixed point first, quasi-Newton from the second iteration on."""
        J = np.zeros((len(z), len(z)))
        z_before = r_before = None
        for _ in range(MAX_ITERATIONS):
            self._read(block)
            r = self._ensemble.Y[block.places] - z
            if not np.isfinite(r).all():
                break
            if self._agree(r, z, block.wires):
                return
            if z_before is not None and r_before is not None:
                J = learnt(J, z - z_before, r - r_before)
            z_before, r_before = z, r
            z = z + broyden_step(J, r)
            self._send(block, z)
        raise self.unsolved(block, time)

    def unsolved(self, block: Block, time: float) -> RunEnded:
        """What ends the run where a loop has no solution.

        Raises
        ------
        RunEnded
            A value in it is not finite.
        """
        self._ensemble.check(time)
        return RunEnded(
            Status.LOOP_UNSOLVED,
            f"at t = {time:.9g}: no solution of the algebraic loop {self._names(block)}",
        )

    def _agree(self, residual: Floats, z: Floats, wires: Sequence[Wire]) -> bool:
        nominal = self._ensemble.nominal[[wire.link for wire in wires]]
        return bool((np.abs(residual) <= LOOP_TOLERANCE * (nominal + np.abs(z))).all())

    def _read(self, block: Block) -> None:
        for m in block.sources:
            self._ensemble.read[m]()
            self._ensemble.calls += self._ensemble.read_calls[m]

    def _send(self, block: Block, values: Floats) -> None:
        self._ensemble.C.reshape(-1)[block.slots] = values
        for m in block.targets:
            self._ensemble.write[m]()
            self._ensemble.calls += self._ensemble.write_calls[m]

    def _names(self, block: Block) -> str:
        names = dict.fromkeys(self._ensemble.links[wire.link].name for wire in block.wires)
        return ", ".join(names)

    def _all_names(self) -> str:
        return ", ".join(link.name for link in self._ensemble.links)


def settle_discrete(ensemble: Ensemble, time: float) -> None:
    """Copy Integer, Boolean and String outputs to the inputs that they drive until none changes,
    as an output may follow from an input at once.

    All are read before any is set, so that the order of the connections does not matter: after as
    many passes as its longest chain has links, a system without loops agrees.

    Raises
    ------
    RunEnded
        LOOP_UNSOLVED, where a loop does not come to rest; the message names its connections.
    """
    links = ensemble.system.discrete_links
    values = ensemble.discrete_values()
    for _ in range(MAX_DISCRETE_PASSES):
        ensemble.copy_discrete(time, values)
        if not ensemble.discrete_feedthrough:
            return
        before, values = values, ensemble.discrete_values()
        if values == before:
            return
    changing = {k for k, (a, b) in enumerate(zip(before, values, strict=True)) if a != b}
    successors = {
        k: [n for n, after in enumerate(links) if link.target == after.source]
        for k, link in enumerate(links)
    }
    loop = next(c for c in strong_components(successors) if changing.intersection(c))
    raise RunEnded(
        Status.LOOP_UNSOLVED,
        f"at t = {time:.9g}: the loop of Integer, Boolean or String values "
        f"{', '.join(links[k].name for k in sorted(loop))} does not come to rest in "
        f"{MAX_DISCRETE_PASSES} passes; break it by an FMU that passes its input on at the next "
        "step",
    )


def _wires(ensemble: Ensemble) -> list[Wire]:
    values = [Wire(0, k, int(place)) for k, place in enumerate(ensemble.source)]
    derivatives = [
        Wire(1, k, int(place))
        for k, place in enumerate(ensemble.source_derivative)
        if place != NO_DERIVATIVE
    ]
    return values + derivatives


def _follows(ensemble: Ensemble, first: Wire, second: Wire) -> bool:
    """Whether the value on `second` depends directly on the input that `first` sets."""
    into, out = ensemble.links[first.link], ensemble.links[second.link]
    if into.target != out.source or ensemble.order[first.link] < first.order:
        return False
    known = ensemble.system.members[out.source].description.dependencies
    output = out.output.name if second.order == 0 else derivative_name(out.output.name, 1)
    depends_on = known.get(output)
    if depends_on is None:
        return True  # undeclared: FMI 2.0 takes it to depend on every input
    name = into.input.name
    return (name if first.order == 0 else derivative_name(name, 1)) in depends_on


def _blocks(ensemble: Ensemble, wires: Sequence[Wire]) -> list[Block]:
    """Loops one by one, and between them as many wires at a time as the order allows."""
    successors = {
        a: [b for b, second in enumerate(wires) if _follows(ensemble, first, second)]
        for a, first in enumerate(wires)
    }
    level: dict[int, int] = {}
    groups: dict[tuple[int, int], list[int]] = {}
    for number, component in enumerate(strong_components(successors), 1):
        loop = len(component) > 1 or component[0] in successors[component[0]]
        depth = max((level.get(node, 0) for node in component), default=0)
        for node in component:
            for after in successors[node]:
                level[after] = max(level.get(after, 0), depth + 1)
        groups.setdefault((depth, number if loop else 0), []).extend(component)
    return [
        _block(ensemble, [wires[node] for node in group], loop=key[1] > 0)
        for key, group in sorted(groups.items())
    ]


def _block(ensemble: Ensemble, wires: Sequence[Wire], *, loop: bool) -> Block:
    links = [ensemble.links[wire.link] for wire in wires]
    count = len(ensemble.links)
    return Block(
        sources=tuple(sorted({link.source for link in links})),
        targets=tuple(sorted({link.target for link in links})),
        places=np.array([wire.place for wire in wires], np.intp),
        slots=np.array([wire.order * count + wire.link for wire in wires], np.intp),
        wires=tuple(wires),
        loop=loop,
    )


def strong_components(successors: Mapping[int, Sequence[int]]) -> list[list[int]]:
    """Strongly connected components of a directed graph, in topological order.

    R. Tarjan, Depth-first search and linear graph algorithms, SIAM J. Computing 1 (1972), without
    recursion.

    Parameters
    ----------
    successors : mapping of int to sequence of int
        Every node is a key.

    Returns
    -------
    list of list of int
        A component comes before those that its edges lead to.
    """
    number: dict[int, int] = {}
    low: dict[int, int] = {}
    stack: list[int] = []
    found: list[list[int]] = []
    for root in successors:
        if root in number:
            continue
        path = [(root, iter(successors[root]))]
        number[root] = low[root] = len(number)
        stack.append(root)
        while path:
            node, rest = path[-1]
            step = next(rest, None)
            if step is None:
                path.pop()
                if path:
                    low[path[-1][0]] = min(low[path[-1][0]], low[node])
                if low[node] == number[node]:
                    place = stack.index(node)
                    found.append(stack[place:])
                    del stack[place:]
                    for member in found[-1]:
                        low[member] = len(successors)
            elif step not in number:
                number[step] = low[step] = len(number)
                stack.append(step)
                path.append((step, iter(successors[step])))
            else:
                # A node of a finished component has the low of no open one.
                low[node] = min(
                    low[node], low[step] if low[step] == len(successors) else number[step]
                )
    return found[::-1]
