"""FMPy's simulate_fmu runs one FMU: hosts/fmpy_fmu.py JOB.json ROWS.json."""

import json
import sys

import numpy as np
from fmpy import simulate_fmu


def main(request, answer):
    with open(request) as file:
        job = json.load(file)
    columns = list(job["input"])
    table = np.array(
        list(zip(*job["input"].values(), strict=True)), dtype=[(name, float) for name in columns]
    )
    rows = simulate_fmu(
        job["fmu"],
        stop_time=job["step"] * job["steps"],
        step_size=job["step"],
        output_interval=job["step"],
        start_values=job["start"],
        input=table,
        output=job["record"],
    )
    with open(answer, "w") as file:
        json.dump({name: rows[name].tolist() for name in rows.dtype.names}, file)


main(*sys.argv[1:])
