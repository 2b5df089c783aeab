"""The least that a Python program can do per macro step: two sets, two steps, two gets.

The C functions are called directly, with arrays made once, for this one loop of two FMUs. Nothing
is checked but the status, and nothing is recorded unless asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_double, c_int, c_size_t, c_uint, c_void_p
from typing import Any

from benchmarks.engines.base import Engine, Run
from benchmarks.engines.slaves import initialise, instantiate
from benchmarks.loop import Component, Loop, variables
from benchmarks.timing import Stopwatch

__all__ = ["Bare", "Instance"]

WARNING = 1


class Instance:
    """One FMU with the C functions of the stepping loop and their arrays."""

    def __init__(self, loop: Loop, component: Component) -> None:
        self.component = component
        self.slave = instantiate(component)
        self.handle = c_void_p(self.slave.component)
        self.step = self.function("fmi2DoStep", c_double, c_double, c_int)
        table = variables(component.fmu)
        self.inputs = self._arrays([table[n].reference for n in loop.inputs(component.name)])
        self.outputs = self._arrays([table[n].reference for n in loop.outputs(component.name)])
        values = (c_void_p, c_size_t, c_void_p)
        self.set_real = self.function("fmi2SetReal", *values)
        self.get_real = self.function("fmi2GetReal", *values)

    @staticmethod
    def _arrays(references: list[int]) -> tuple[Any, int, Any]:
        n = len(references)
        return (c_uint * n)(*references), n, (c_double * n)()

    def function(self, name: str, *arguments: Any) -> Callable[..., int]:
        """A C function whose first argument is the instance."""
        # A prototype of its own: FMPy has set argument types on the library's functions.
        function = self.slave.dll[name]
        function.argtypes, function.restype = [c_void_p, *arguments], c_int
        found: Callable[..., int] = function
        return found

    def initialise(self) -> None:
        """Start values set, initialisation mode left."""
        initialise(self.slave, self.component)

    def write(self) -> None:
        """Set the inputs."""
        self.set_real(self.handle, *self.inputs)

    def read(self) -> None:
        """Get the outputs."""
        self.get_real(self.handle, *self.outputs)


class Bare(Engine):
    """Jacobi, for a loop of two FMUs."""

    def __init__(self, loop: Loop) -> None:
        super().__init__(loop)
        self.instances = [Instance(loop, component) for component in loop.components]
        self._copies = self._planned_copies()

    def _planned_copies(self) -> list[tuple[Any, int, Any, int]]:
        """(target array, place, source array, place) of each connection."""
        names = [c.name for c in self.loop.components]
        copies = []
        for source, output, target, name in self.loop.connections:
            a, b = self.instances[names.index(source)], self.instances[names.index(target)]
            place = self.loop.inputs(target).index(name)
            copies.append(
                (b.inputs[2], place, a.outputs[2], self.loop.outputs(source).index(output))
            )
        return copies

    def _exchange(self) -> None:
        for target, i, source, k in self._copies:
            target[i] = source[k]

    def run(self, steps: int, step: float, *, keep_rows: bool) -> Run:
        """Two loops, so that keeping no rows costs nothing."""
        first, second = self.instances
        for instance in self.instances:
            instance.initialise()
            instance.read()
        for _ in range(2):
            self._exchange()
            for instance in self.instances:
                instance.write()
                instance.read()
        if keep_rows:
            return Run(0.0, [self._recorded(n, step) for n in range(steps)])
        copies, a, b = self._copies, first.handle, second.handle
        a_in, a_out, b_in, b_out = first.inputs, first.outputs, second.inputs, second.outputs
        set_a, set_b, get_a, get_b = (
            first.set_real,
            second.set_real,
            first.get_real,
            second.get_real,
        )
        step_a, step_b = first.step, second.step
        worst = 0
        watch = Stopwatch()
        for n in range(steps):
            for target, i, source, k in copies:
                target[i] = source[k]
            set_a(a, *a_in)
            set_b(b, *b_in)
            worst = max(worst, step_a(a, n * step, step, 1), step_b(b, n * step, step, 1))
            get_a(a, *a_out)
            get_b(b, *b_out)
        seconds = watch.seconds()
        if worst > WARNING:
            raise RuntimeError(f"fmi2DoStep returned {worst}")
        return Run(seconds)

    def _recorded(self, n: int, step: float) -> list[float]:
        self._exchange()
        for instance in self.instances:
            instance.write()
        for instance in self.instances:
            instance.step(instance.handle, n * step, step, 1)
            instance.read()
        names = [c.name for c in self.loop.components]
        return [
            (n + 1) * step,
            *(
                self.instances[names.index(c)].outputs[2][self.loop.outputs(c).index(name)]
                for c, name in self.loop.record
            ),
        ]
