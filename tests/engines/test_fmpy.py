"""FMPy: simulate_fmu runs one FMU along given inputs, simulate_ssp a whole archive.

simulate_fmu sets the inputs at each communication point and holds them, as a slave of our
`jacobi` sees them. simulate_ssp is Jacobi as well, but exchanges nothing at the start: the first
step is done with inputs of 0; and a row holds the values at the end of a step under the time of
its start. So it deviates by the first order in the step.
"""

from pathlib import Path

import pytest

from tests.engines.engine import run
from tests.engines.loops import LOOPS, STEP, Loop, case, columns, deviation, job, reference

STEPS = 200


@pytest.mark.parametrize("component", ["plant", "controller"])
@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_an_fmu_along_the_masters_inputs(loop: Loop, component: str, tmp_path: Path) -> None:
    expected = reference(loop, STEPS)
    request = job(loop, STEPS)
    table = {
        input_: expected.column(f"{source}.{output}").ravel().tolist()
        for source, output, target, input_ in request["connections"]
        if target == component
    }
    names = [c for c in expected.names if c.startswith(f"{component}.")]
    own = {
        **request["components"][component],
        "input": {"time": expected.time.tolist(), **table},
        "record": [name.partition(".")[2] for name in names],
        "step": STEP,
        "steps": STEPS,
    }
    found = run("fmpy_fmu", own, tmp_path)
    rows = {name: found[name.partition(".")[2]] for name in names}
    assert found["time"] == pytest.approx(expected.time, abs=1e-12)
    assert deviation(rows, expected, names) < 1e-9


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_archives_deviate_by_the_first_order(
    loop: Loop, archives: dict[Loop, Path], tmp_path: Path
) -> None:
    deviations = []
    for n in (1, 2):
        request = {**job(loop, n * STEPS, STEP / n), "ssp": str(archives[loop])}
        found = run("fmpy_ssp", request, tmp_path)
        expected = reference(loop, n * STEPS, STEP / n)
        assert found["time"] == pytest.approx(expected.time[:-1], abs=1e-12)
        deviations.append(deviation(found, expected, columns(loop, "plant.x"), first_row=1))
    assert deviations[0] / deviations[1] == pytest.approx(2.0, rel=0.1)
    assert case(loop).system.connections
