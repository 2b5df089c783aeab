"""Ecos through ecospy: a fixed step, Jacobi."""

from __future__ import annotations

import ctypes
import sys
from pathlib import Path
from typing import Any

from benchmarks.engines.base import Engine, Run
from benchmarks.loop import Loop
from benchmarks.timing import Stopwatch

__all__ = ["Ecos"]


def _ecospy() -> Any:
    """The package; its library needs TBB, which the package `tbb` puts where no linker looks."""
    ctypes.CDLL(str(Path(sys.prefix) / "lib" / "libtbb.so.12"), ctypes.RTLD_GLOBAL)
    import ecospy

    ecospy.EcosLib.set_log_level("warn")
    return ecospy


class Ecos(Engine):
    """Every run is a simulation of its own; without rows, nothing listens to it."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self._ecospy = _ecospy()

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Loading and initialisation are left out of the time."""
        with self._structure() as structure:
            simulation = self._ecospy.EcosSimulation(step_size=step, structure=structure)
            simulation.init(parameter_set="start")
            rows: list[list[float]] = []
            watch = Stopwatch()
            if keep_rows:
                for n in range(steps):
                    simulation.step()
                    values = [simulation.get_real(f"{c}::{name}") for c, name in self.loop.record]
                    rows.append([(n + 1) * step, *values])
            else:
                simulation.step(steps)
            seconds = watch.seconds()
            simulation.terminate()
            simulation.free()
        return Run(seconds, rows)

    def _structure(self) -> Any:
        structure = self._ecospy.EcosSimulationStructure()
        for component in self.loop.components:
            structure.add_model(component.name, component.fmu)
        for a, y, b, u in self.loop.connections:
            structure.make_real_connection(f"{a}::{y}", f"{b}::{u}")
        start = {f"{c.name}::{k}": v for c in self.loop.components for k, v in c.start.items()}
        structure.add_parameter_set("start", start)
        return structure
