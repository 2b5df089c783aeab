"""FMPy's simulate_ssp runs an SSP archive: hosts/fmpy_ssp.py JOB.json ROWS.json."""

import json
import sys

from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import ParameterSet, find_components, read_ssd


def parameters(archive):
    """The parameters that the archive binds; simulate_ssp itself leaves bindings aside.

    It takes names with the component's in front, takes every non-empty text for a true Boolean,
    and knows no Strings.
    """
    bound = ParameterSet()
    for component in find_components(read_ssd(archive).system):
        for binding in component.parameterBindings:
            for parameter in binding.parameterValues[0].parameters:
                if parameter.type == "String":
                    continue
                if parameter.type == "Boolean":
                    parameter.value = parameter.value == "true"
                parameter.name = f"{component.name}.{parameter.name}"
                bound.parameters.append(parameter)
    return bound


def main(request, answer):
    with open(request) as file:
        job = json.load(file)
    # It goes on while time < stop_time, where time is a sum of steps.
    stop_time = (job["steps"] - 0.5) * job["step"]
    rows = simulate_ssp(
        job["ssp"],
        stop_time=stop_time,
        step_size=job["step"],
        parameter_set=parameters(job["ssp"]),
    )
    columns = ["time", *(".".join(column) for column in job["record"])]
    with open(answer, "w") as file:
        json.dump({name: rows[name].tolist() for name in columns}, file)


main(*sys.argv[1:])
