"""FMU instances for the loops written out in this package, loaded with FMPy."""

from __future__ import annotations

from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave

from benchmarks.loop import Component, variables

__all__ = ["initialise", "instantiate"]


def instantiate(component: Component) -> FMU2Slave:
    """Load an FMU and make an instance."""
    description = read_model_description(component.fmu, validate=False)
    slave = FMU2Slave(
        guid=description.guid,
        unzipDirectory=extract(component.fmu),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=component.name,
    )
    slave.instantiate()
    return slave


def initialise(slave: FMU2Slave, component: Component) -> None:
    """Reset an instance, set its start values and initialise it."""
    slave.reset()
    slave.setupExperiment(startTime=0.0)
    table = variables(component.fmu)
    for name, value in component.start.items():
        variable = table[name]
        getattr(slave, f"set{variable.type}")([variable.reference], [value])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
