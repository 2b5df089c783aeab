"""A built FMU loaded by fmpy alone, for tests that hold the artefact and nothing else."""

from __future__ import annotations

import atexit
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import fmpy
from fmpy.fmi2 import (
    FMU2Model,
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)

FMUS = Path(__file__).resolve().parents[2] / "fmus"
DISCARD, ERROR = 2, 3


@dataclass(repr=False)
class Instance:
    """One instance, its variables by name, and what it logged as (status, text)."""

    slave: FMU2Slave | FMU2Model
    references: dict[str, int]
    types: dict[str, str]
    inputs: list[str]
    outputs: list[str]
    messages: list[tuple[int, str]] = field(default_factory=list)

    def get(self, *names: str) -> list[float]:
        return list(self.slave.getReal([self.references[n] for n in names]))

    def set(self, **values: float) -> None:
        self.assign(values)

    def assign(self, values: dict[str, float | bool | str]) -> None:
        setters = {
            "Real": self.slave.setReal,
            "Boolean": self.slave.setBoolean,
            "Integer": self.slave.setInteger,
            "String": self.slave.setString,
        }
        for name, value in values.items():
            setters[self.types[name]]([self.references[name]], [value])

    def start(self, stop_time: float | None = None, **values: float) -> Instance:
        """Set parameters and initialise."""
        self.slave.setupExperiment(startTime=0.0, stopTime=stop_time)
        self.slave.enterInitializationMode()
        self.assign(values)
        self.slave.exitInitializationMode()
        return self

    def step(self, t: float, h: float) -> int:
        """The status of a step: 0 is fmi2OK."""
        return int(
            self.slave.fmi2DoStep(self.slave.component, t, h, True)  # no exception for a discard
        )

    def errors(self) -> list[str]:
        return [text for status, text in self.messages if status >= DISCARD]


@contextmanager
def loaded(path: Path, count: int = 1, exchange: bool = False) -> Iterator[Sequence[Instance]]:
    """Instances of the FMU at `path`, for co-simulation or model exchange."""
    folder = _extracted(path, path.stat().st_mtime_ns)
    description = fmpy.read_model_description(str(path))
    variables = description.modelVariables
    made: list[Instance] = []
    callbacks = []
    try:
        for number in range(count):
            slave = (FMU2Model if exchange else FMU2Slave)(
                guid=description.guid,
                unzipDirectory=folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName=f"{description.modelName}{number}",
            )
            instance = Instance(
                slave,
                {v.name: v.valueReference for v in variables},
                {v.name: v.type for v in variables},
                [v.name for v in variables if v.causality == "input"],
                [v.name for v in variables if v.causality in ("output", "local")],
            )
            functions = _callbacks(instance)
            callbacks.append(functions)
            slave.instantiate(callbacks=functions, loggingOn=True)
            # fmpy's wrapper raises for a discarded step; the tests look at the status instead.
            if not exchange:
                slave.fmi2DoStep = slave.dll.fmi2DoStep
                slave.fmi2DoStep.argtypes = _STEP_TYPES
            made.append(instance)
        yield made
    finally:
        for instance in made:
            instance.slave.fmi2FreeInstance(instance.slave.component)


@cache
def _extracted(path: Path, _version: int) -> str:
    """The FMU's files, unpacked once a process: each copy of its library is loaded for good."""
    folder: str = fmpy.extract(str(path))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _callbacks(instance: Instance) -> fmi2CallbackFunctions:
    def log(_environment, _name, status, _category, message):  # type: ignore[no-untyped-def]
        instance.messages.append((status, message.decode("utf-8")))

    functions = fmi2CallbackFunctions()
    functions.logger = fmi2CallbackLoggerTYPE(log)
    functions.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
    functions.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
    return functions


def _step_types():  # type: ignore[no-untyped-def]
    from ctypes import c_double, c_int, c_void_p

    return [c_void_p, c_double, c_double, c_int]


_STEP_TYPES = _step_types()
