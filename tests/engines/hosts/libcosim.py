"""libcosim runs a job: hosts/libcosim.py JOB.json ROWS.json."""

import json
import sys

from libcosimpy.CosimEnums import CosimVariableType
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave


def variables(execution, slave):
    return {v.name.decode(): v for v in execution.slave_variables(slave)}


def from_fmus(job, nanoseconds):
    """The system, put together call by call."""
    execution = CosimExecution.from_step_size(nanoseconds)
    slaves = [CosimLocalSlave(c["fmu"], name) for name, c in job["components"].items()]
    indices = [execution.add_local_slave(slave) for slave in slaves]
    setters = {
        CosimVariableType.REAL.value: execution.real_initial_value,
        CosimVariableType.INTEGER.value: execution.integer_initial_value,
        CosimVariableType.BOOLEAN.value: execution.boolean_initial_value,
        CosimVariableType.STRING.value: execution.string_initial_value,
    }
    for index, component in zip(indices, job["components"].values(), strict=True):
        known = variables(execution, index)
        for name, value in component["start"].items():
            assert setters[known[name].type](index, known[name].reference, value), name
    for source, output, target, input_ in job["connections"]:
        source, target = (list(job["components"]).index(name) for name in (source, target))
        execution.connect_real_variables(
            indices[source],
            variables(execution, indices[source])[output].reference,
            indices[target],
            variables(execution, indices[target])[input_].reference,
        )
    return execution


def main(request, answer):
    with open(request) as file:
        job = json.load(file)
    log_output_level(CosimLogLevel.WARNING)
    nanoseconds = job["step"] and round(job["step"] * 1e9)
    if "ssp" in job:
        execution = CosimExecution.from_ssp_file(job["ssp"], nanoseconds)
    else:
        execution = from_fmus(job, nanoseconds)
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    index = {info.name.decode(): info.index for info in execution.slave_infos()}
    places = [
        (index[component], variables(execution, index[component])[name].reference)
        for component, name in job["record"]
    ]
    rows = {".".join(column): [] for column in job["record"]}
    times = []
    for _ in range(job["steps"]):
        assert execution.step(), execution.status()
        times.append(execution.status().current_time * 1e-9)
        for column, (slave, reference) in zip(rows.values(), places, strict=True):
            column += observer.last_real_values(slave, [reference])
    with open(answer, "w") as file:
        json.dump({"time": times, **rows}, file)


main(*sys.argv[1:])
