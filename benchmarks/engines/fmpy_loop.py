"""A loop as FMPy's documentation writes one: setReal, doStep, getReal, rows in a list."""

from __future__ import annotations

from benchmarks.engines.base import Engine, Run
from benchmarks.engines.slaves import initialise, instantiate
from benchmarks.loop import Loop, variables
from benchmarks.timing import Stopwatch

__all__ = ["FmpyLoop"]


class FmpyLoop(Engine):
    """Jacobi; each FMU's inputs and outputs in one call each."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._slaves = {c.name: instantiate(c) for c in loop.components}
        tables = {c.name: variables(c.fmu) for c in loop.components}
        self._inputs = {
            c: [tables[c][name].reference for name in loop.inputs(c)] for c in self._slaves
        }
        self._outputs = {
            c: [tables[c][name].reference for name in loop.outputs(c)] for c in self._slaves
        }
        self._sources = {
            c: [
                (source, loop.outputs(source).index(name))
                for source, name, target, _ in loop.connections
                if target == c
            ]
            for c in self._slaves
        }

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Rows are recorded in any case."""
        slaves, inputs, outputs = self._slaves, self._inputs, self._outputs
        for component in self.loop.components:
            initialise(slaves[component.name], component)
        # Twice: the controller's output follows from the plant's.
        values = {c: slave.getReal(outputs[c]) for c, slave in slaves.items()}
        for _ in range(2):
            for c, slave in slaves.items():
                slave.setReal(inputs[c], [values[source][k] for source, k in self._sources[c]])
                values[c] = slave.getReal(outputs[c])
        rows = []
        watch = Stopwatch()
        for n in range(steps):
            for c, slave in slaves.items():
                slave.setReal(inputs[c], [values[source][k] for source, k in self._sources[c]])
            for slave in slaves.values():
                slave.doStep(currentCommunicationPoint=n * step, communicationStepSize=step)
            values = {c: slave.getReal(outputs[c]) for c, slave in slaves.items()}
            rows.append((n, values))
        seconds = watch.seconds()
        if not keep_rows:
            return Run(seconds)
        places = [(c, self.loop.outputs(c).index(name)) for c, name in self.loop.record]
        return Run(
            seconds, [[(n + 1) * step, *(values[c][k] for c, k in places)] for n, values in rows]
        )
