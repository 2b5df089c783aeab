"""libcosim through libcosimpy: a fixed step, Jacobi."""

from __future__ import annotations

from typing import Any

from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave

from benchmarks.engines.base import Engine, Run
from benchmarks.loop import Loop, variables
from benchmarks.timing import Stopwatch

__all__ = ["Libcosim"]

NANOSECONDS = 1_000_000_000


class Libcosim(Engine):
    """Every run is an execution of its own; without rows, nothing observes it."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._tables = {c.name: variables(c.fmu) for c in loop.components}

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """The first step, which initialises, is left out of the time."""
        execution = CosimExecution.from_step_size(step_size=round(step * NANOSECONDS))
        owned, places = self._added(execution)
        self._prepare(execution, places)
        observer = None
        if keep_rows:
            observer = self._observer(execution, places, steps)
        execution.step(step_count=1)
        watch = Stopwatch()
        execution.step(step_count=steps - 1)
        seconds = (watch.seconds()) * steps / (steps - 1)
        rows = [] if observer is None else self._rows(observer, places, steps, step)
        del execution, owned
        return Run(seconds, rows)

    def _added(self, execution: CosimExecution) -> tuple[list[CosimLocalSlave], dict[str, int]]:
        """The FMUs, to be referred to as long as the execution lives, which does not own them; and
        their places in it."""
        owned = [
            CosimLocalSlave(fmu_path=c.fmu, instance_name=c.name) for c in self.loop.components
        ]
        return owned, {
            c.name: execution.add_local_slave(slave)
            for c, slave in zip(self.loop.components, owned, strict=True)
        }

    def _prepare(self, execution: CosimExecution, places: dict[str, int]) -> None:
        """Start values and connections."""
        setters = {
            "Real": execution.real_initial_value,
            "Integer": execution.integer_initial_value,
            "Boolean": execution.boolean_initial_value,
            "String": execution.string_initial_value,
        }
        for component in self.loop.components:
            for name, value in component.start.items():
                variable = self._tables[component.name][name]
                setters[variable.type](places[component.name], variable.reference, value)
        for source, output, target, name in self.loop.connections:
            execution.connect_real_variables(
                places[source],
                self._tables[source][output].reference,
                places[target],
                self._tables[target][name].reference,
            )

    def _observer(self, execution: CosimExecution, places: dict[str, int], steps: int) -> Any:
        observer = CosimObserver.create_time_series(buffer_size=steps + 2)
        execution.add_observer(observer)
        for owner, name in self.loop.record:
            reference = self._tables[owner][name].reference
            observer.start_time_series(places[owner], reference, CosimVariableType.REAL)
        return observer

    def _rows(
        self, observer: Any, places: dict[str, int], steps: int, step: float
    ) -> list[list[float]]:
        columns = []
        for owner, name in self.loop.record:
            reference = self._tables[owner][name].reference
            _, _, values = observer.time_series_real_samples(places[owner], reference, 1, steps)
            columns.append(list(values))
        return [[(n + 1) * step, *row] for n, row in enumerate(zip(*columns, strict=True))]
