"""Loaded slaves, and the arrays through which they talk."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from congelation.cosim.inputs import Inputs
from congelation.cosim.outputs import NO_DERIVATIVE, Outputs
from congelation.cosim.system import Recorded, ResolvedSystem
from congelation.fmi.slave import Slave

__all__ = ["Ensemble"]

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]


class Ensemble:
    """The slaves of a system with their shared arrays.

    Parameters
    ----------
    system : ResolvedSystem
    slaves : sequence of Slave
        In the order of the system's members, instantiated or reset.
    recorded : sequence of Recorded, length M
    derivatives, slopes, events : bool
        What is read besides; see Outputs.

    Attributes
    ----------
    outputs : Outputs
    inputs : Inputs
    latched : bool
        Whether driven inputs keep the values in C between communication points, rather than
        those of their sources.
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
        self.system = system
        self.slaves = tuple(slaves)
        self.outputs = Outputs(
            system, slaves, recorded, derivatives=derivatives, slopes=slopes, events=events
        )
        self.inputs = Inputs(system, slaves, self.outputs, derivatives=derivatives)
        self.latched = False
        self.width = len(recorded)
        self._plan_recording(recorded)

    def _plan_recording(self, recorded: Sequence[Recorded]) -> None:
        links = {(link.target, link.input.name): k for k, link in enumerate(self.inputs.links)}
        places, slopes = [], []
        self._driven: list[tuple[int, int]] = []
        self._slow: list[tuple[int, Recorded]] = []
        for column, item in enumerate(recorded):
            link = links.get((item.member, item.variable.name))
            if item.variable.type != "Real":
                self._slow.append((column, item))
                places.append(0)
                slopes.append(NO_DERIVATIVE)
            elif link is not None:
                # At a communication point a driven input has the value of its source.
                self._driven.append((column, link))
                places.append(int(self.inputs.source[link]))
                source = self.inputs.links[link]
                slopes.append(self.outputs.slope_place(source.source, source.output.name))
            else:
                places.append(self.outputs.place(item.member, item.variable.name))
                slopes.append(self.outputs.slope_place(item.member, item.variable.name))
        self._recorded = np.array(places, np.intp)
        self._slopes = np.array(slopes, np.intp)

    @property
    def calls_per_sweep(self) -> int:
        """fmi2 calls that it takes to set, step and read every slave once."""
        inputs, outputs = sum(self.inputs.write_calls), sum(self.outputs.read_calls)
        return inputs + len(self.slaves) + outputs

    @property
    def moves_derivatives(self) -> bool:
        """Whether some are moved by FMI functions, which initialisation mode does not allow."""
        return max((*self.outputs.read_calls, *self.inputs.write_calls), default=0) > 1

    def fill(self, row: Floats) -> None:
        """Write the recorded values, shape (M,), into `row`."""
        if self.outputs.Y.size:
            self.outputs.Y.take(self._recorded, out=row, mode="clip")
        if self.latched:
            for column, link in self._driven:
                row[column] = self.inputs.C[0, link]
        for column, item in self._slow:
            slave = self.slaves[item.member]
            (value,) = slave.get_values(item.variable.type, [item.variable.reference])
            row[column] = float(value)

    def smooth_columns(self) -> tuple[Indices, Indices]:
        """The columns of a row whose derivatives are read, and where those stand in Y."""
        columns = np.flatnonzero(self._slopes != NO_DERIVATIVE)
        if self.latched:
            columns = np.setdiff1d(columns, [column for column, _ in self._driven])
        return columns, self._slopes[columns]

    def copy_discrete(self) -> None:
        """Copy the Integer, Boolean and String outputs to the inputs that they drive."""
        for link in self.system.discrete_links:
            kind = link.output.type
            (value,) = self.slaves[link.source].get_values(kind, [link.output.reference])
            self.slaves[link.target].set_value(link.input, value)
