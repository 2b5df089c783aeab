"""Everything that is sent to the slaves: input polynomials over a macro step.

u(t + s) = C[0] + C[1] s + C[2] s^2 / 2 + C[3] s^3 / 6
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.calls import chained
from congelation.cosim.outputs import NO_DERIVATIVE, Outputs
from congelation.cosim.system import MAX_DERIVATIVE, Link, ResolvedSystem
from congelation.fmi.slave import Slave

__all__ = ["Inputs"]

Floats = npt.NDArray[np.float64]


class Inputs:
    """The coefficients of all links, each slave's sent in one call.

    They reach a slave through the inputs v, der(v), der(v,2), der(v,3) that it has, or through
    fmi2SetRealInputDerivatives where it says canInterpolateInputs and has no der(v).

    Parameters
    ----------
    system : ResolvedSystem
    slaves : sequence of Slave
    outputs : Outputs
    derivatives : bool
        Whether derivatives are sent along with values.

    Attributes
    ----------
    links : tuple of Link, length L
        Sorted by target.
    C : array, shape (4, L)
    source, source_derivative : integer arrays, shape (L,)
        Places in Y of each link's output and of its derivative (or NO_DERIVATIVE).
    order : integer array, shape (L,)
        Highest derivative that the target takes.
    nominal : array, shape (L,)
    columns : list of slice, one per slave
        Its links.
    write : list of callables, one per slave
        Send it its columns of C.
    write_calls : list of int, one per slave
        fmi2 calls that this takes.
    hold : list of callables, one per slave
        Send it the newest values of its sources in Y, as held inputs.
    """

    def __init__(
        self,
        system: ResolvedSystem,
        slaves: Sequence[Slave],
        outputs: Outputs,
        *,
        derivatives: bool,
    ) -> None:
        self._system = system
        self._outputs = outputs
        self.links = tuple(sorted(system.links, key=lambda link: link.target))
        self.C: Floats = np.zeros((1 + MAX_DERIVATIVE, len(self.links)))
        sources = [(link.source, link.output.name) for link in self.links]
        self.source = np.array([outputs.place(*source) for source in sources], np.intp)
        self.source_derivative = np.array(
            [outputs.slope_place(*source) if derivatives else NO_DERIVATIVE for source in sources],
            np.intp,
        )
        self.order = np.array([self._order(link) for link in self.links], np.intp)
        self.nominal = np.array([link.output.nominal for link in self.links])
        self.columns = [self._columns(m) for m in range(len(slaves))]
        self.hold = [self._holder(m, slave, outputs.Y) for m, slave in enumerate(slaves)]
        self.write = [self._writer(m, slave) for m, slave in enumerate(slaves)]
        self.write_calls = [self._write_calls(m) for m in range(len(slaves))]

    def _columns(self, m: int) -> slice:
        places = [k for k, link in enumerate(self.links) if link.target == m]
        return slice(places[0], places[-1] + 1) if places else slice(0, 0)

    def _order(self, link: Link) -> int:
        """Highest derivative that a link's target takes, all lower ones included."""
        if self._interpolates(link):
            return MAX_DERIVATIVE
        return next((k for k, v in enumerate(link.target_derivatives) if v is None), MAX_DERIVATIVE)

    def _interpolates(self, link: Link) -> bool:
        """Whether derivatives reach the target by fmi2SetRealInputDerivatives."""
        able = self._system.members[link.target].description.can_interpolate_inputs
        return able and link.target_derivatives[0] is None

    def _holder(self, m: int, slave: Slave, Y: Floats) -> Callable[[], None]:
        links = self.links[self.columns[m]]
        if not links:
            return chained(())
        values = np.zeros(len(links))
        send = slave.writer([link.input.reference for link in links], values)
        source = self.source[self.columns[m]]

        def hold() -> None:
            Y.take(source, out=values, mode="clip")
            send()

        return hold

    def _writer(self, m: int, slave: Slave) -> Callable[[], None]:
        columns = self.columns[m]
        numbered = list(enumerate(self.links[columns], columns.start))
        calls = []
        plain = [(0, k, link.input.reference) for k, link in numbered] + [
            (order, k, variable.reference)
            for k, link in numbered
            for order, variable in enumerate(link.target_derivatives[: self.order[k]], 1)
            if variable is not None
        ]
        if plain:
            values = np.zeros(len(plain))
            send = slave.writer([reference for _, _, reference in plain], values)
            calls.append(self._gathered([(order, k) for order, k, _ in plain], values, send))
        ranked = [
            (order, k)
            for k, link in numbered
            if self._interpolates(link)
            for order in range(1, 1 + MAX_DERIVATIVE)
        ]
        if ranked:
            values = np.zeros(len(ranked))
            references = [self.links[k].input.reference for _, k in ranked]
            send = slave.derivative_writer(references, [order for order, _ in ranked], values)
            calls.append(self._when_stepping(self._gathered(ranked, values, send)))
        return chained(calls)

    def _when_stepping(self, call: Callable[[], None]) -> Callable[[], None]:
        """fmi2SetRealInputDerivatives may be called once initialisation is over."""

        def guarded() -> None:
            if self._outputs.stepping:
                call()

        return guarded

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
