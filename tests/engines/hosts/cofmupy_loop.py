"""CoFmuPy runs jobs, one after the other: hosts/cofmupy_loop.py JOBS.json ROWS.json."""

import json
import sys

from cofmupy import Coordinator
from cofmupy.master import DefaultMaster


def configuration(job):
    """The job as CoFmuPy's own configuration, which sets Real variables only."""
    inputs = job.get("inputs", {})
    return {
        "cosim_method": "jacobi",
        "fmus": [
            {
                "id": name,
                "path": component["fmu"],
                "initialization": {**_of_type(component["start"], float), **inputs.get(name, {})},
            }
            for name, component in job["components"].items()
        ],
        "connections": [
            {"source": {"id": s, "variable": o}, "target": {"id": t, "variable": i}}
            for s, o, t, i in job["connections"]
        ],
    }


def _of_type(values, kind):
    return {name: value for name, value in values.items() if type(value) is kind}


def start(job):
    """A coordinator, started as `Coordinator.start` does, with the Booleans set in between."""
    coordinator = Coordinator()
    coordinator.parse_config(configuration(job))
    coordinator.start_graph_engine(coordinator.config_parser.graph_config)
    master = coordinator.config_parser.master_config
    coordinator.master = DefaultMaster(
        fmu_config_list=master["fmus"],
        connections=master["connections"],
        sequence_order=coordinator.graph_engine.sequence_order,
        cosim_method=master["cosim_method"],
    )
    for name, component in job["components"].items():
        handler = coordinator.master.fmu_handlers[name]
        for variable, value in _of_type(component["start"], bool).items():
            handler.fmu.setBoolean([handler.var_name2attr[variable].valueReference], [value])
    coordinator.master.init_simulation({})
    coordinator.load_stream_handlers(coordinator.config_parser.stream_handlers)
    return coordinator


def rows(job):
    coordinator = start(job)
    for _ in range(job["steps"]):
        coordinator.do_step(job["step"])
    results = coordinator.get_results()
    found = {".".join(column): results[tuple(column)] for column in job["record"]}
    return {"time": results["time"], **found}


def main(request, answer):
    with open(request) as file:
        jobs = json.load(file)["jobs"]
    with open(answer, "w") as file:
        json.dump({name: rows(job) for name, job in jobs.items()}, file)


main(*sys.argv[1:])
