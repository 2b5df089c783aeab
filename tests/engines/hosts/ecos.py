"""Ecos runs a job: hosts/ecos.py JOB.json ROWS.json."""

import json
import sys

from ecospy import EcosSimulation, EcosSimulationStructure

PARAMETERS = "initialValues"


def from_fmus(job):
    """The system, put together call by call."""
    structure = EcosSimulationStructure()
    for name, component in job["components"].items():
        structure.add_model(name, component["fmu"])
    for source, output, target, input_ in job["connections"]:
        structure.make_real_connection(f"{source}::{output}", f"{target}::{input_}")
    start = {
        f"{name}::{variable}": value
        for name, component in job["components"].items()
        for variable, value in component["start"].items()
    }
    structure.add_parameter_set(PARAMETERS, start)
    return structure


def main(request, answer):
    with open(request) as file:
        job = json.load(file)
    if "ssp" in job:
        simulation = EcosSimulation(job["step"], ssp_path=job["ssp"])
    else:
        simulation = EcosSimulation(job["step"], structure=from_fmus(job))
    assert simulation.init(parameter_set=PARAMETERS)
    rows = {".".join(column): [] for column in job["record"]}
    times = [0.0]
    for k in range(job["steps"] + 1):
        if k:
            times.append(simulation.step())
        for (component, name), column in zip(job["record"], rows.values(), strict=True):
            column.append(simulation.get_real(f"{component}::{name}"))
    simulation.terminate()
    simulation.free()
    with open(answer, "w") as file:
        json.dump({"time": times, **rows}, file)


main(*sys.argv[1:])
