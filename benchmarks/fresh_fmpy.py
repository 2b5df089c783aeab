"""A sweep as one would write it with FMPy: for each point load, run, measure and free."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from scipy.interpolate import PchipInterpolator

from congelation.scenario.scenario import Case, Scenario

__all__ = ["sweep"]

Floats = npt.NDArray[np.float64]

SETTLED = 1e-2
"""|x| at rest, as in scenarios/fig2.toml."""


def sweep(scenario: Scenario, file: Path) -> int:
    """Do every run of the sweep of a scenario with held inputs; returns their number.

    Parameters
    ----------
    scenario : Scenario
        Of Fig. 2, with a step.
    file : Path
        Takes one line of CSV per run: settings and metrics.
    """
    points = [] if scenario.sweep is None else scenario.sweep.points()
    rows = [
        {"variant": variant.name, **point, **_run(scenario.case({**variant.settings, **point}))}
        for point in points
        for variant in scenario.variants
    ]
    with file.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return len(rows)


class _Instance:
    """An FMU, from the file to an initialised instance."""

    def __init__(self, name: str, file: Path, start: Mapping[str, object]) -> None:
        description = read_model_description(str(file))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        types = {v.name: v.type for v in description.modelVariables}
        self._folder = extract(str(file))
        self.slave = FMU2Slave(
            guid=description.guid,
            unzipDirectory=self._folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.slave.instantiate()
        self.slave.setupExperiment(startTime=0.0)
        for variable, value in start.items():
            write = getattr(self.slave, f"set{types[variable]}")
            write([self.references[variable]], [value])
        self.slave.enterInitializationMode()

    def all(self, *names: str) -> list[int]:
        """Value references."""
        return [self.references[name] for name in names]

    def close(self) -> None:
        """End the run and leave nothing behind."""
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self._folder)


def _run(case: Case) -> dict[str, float]:
    """Metrics of one run."""
    parts: dict[str, Any] = {
        c.name: _Instance(c.name, c.fmu, c.start) for c in case.system.components
    }
    plant, controller = parts["plant"], parts["controller"]
    try:
        rows = _stepped(plant, controller, case)
    finally:
        plant.close()
        controller.close()
    table = np.array(rows)
    return _metrics(table[:, 0], table[:, 1:3], table[:, 5])


def _stepped(plant: _Instance, controller: _Instance, case: Case) -> list[list[float]]:
    """Rows of time and everything that the scenario records."""
    step = float(case.experiment.step or 0.0)
    count = round(case.experiment.stop_time / step)
    x_in, u_in = controller.all("x[1]", "x[2]"), plant.all("u")
    plant_out = plant.all("x[1]", "x[2]", "theta[1]", "theta[2]")
    controller_out = controller.all("u", "theta_hat[1]", "theta_hat[2]", "z[1]", "z[2]")
    controller.slave.setReal(x_in, plant.slave.getReal(plant_out)[:2])
    plant.slave.setReal(u_in, controller.slave.getReal(controller_out)[:1])
    plant.slave.exitInitializationMode()
    controller.slave.exitInitializationMode()
    state, law = plant.slave.getReal(plant_out), controller.slave.getReal(controller_out)
    rows = [[0.0, *state, *law]]
    for n in range(count):
        controller.slave.setReal(x_in, state[:2])
        plant.slave.setReal(u_in, law[:1])
        plant.slave.doStep(currentCommunicationPoint=n * step, communicationStepSize=step)
        controller.slave.doStep(currentCommunicationPoint=n * step, communicationStepSize=step)
        state, law = plant.slave.getReal(plant_out), controller.slave.getReal(controller_out)
        rows.append([(n + 1) * step, *state, *law])
    return rows


def _metrics(time: Floats, x: Floats, u: Floats) -> dict[str, float]:
    size = np.linalg.norm(x, axis=1)
    return {
        "peak_x": float(size.max()),
        "peak_u": float(np.abs(u).max()),
        "settling_x": _settling(time, size),
        "ise_x": _integral(time, size**2),
        "ise_u": _integral(time, u**2),
    }


def _integral(time: Floats, values: Floats) -> float:
    return float(PchipInterpolator(time, values).integrate(time[0], time[-1]))


def _settling(time: Floats, size: Floats) -> float:
    outside = np.flatnonzero(size > SETTLED)
    if outside.size == 0:
        return 0.0
    k = int(outside[-1])
    if k == len(time) - 1:
        return math.inf
    return float(np.interp(-SETTLED, -size[k : k + 2], time[k : k + 2]))
