"""CoFmuPy: fixed step, Jacobi; initial outputs are not exchanged, so that the first step is done
with the inputs of the configuration, 0 where it names none; a row holds the values at the end of
a step under the time of its start.

Started from the right inputs it is our `jacobi`; as it is, it deviates by the first order in the
step.
"""

import pytest

from tests.engines.engine import cofmupy, run
from tests.engines.loops import LOOPS, STEP, Loop, columns, deviation, job, reference

STEPS = 200
FROM_ZERO = LOOPS[::3]
NAMES = ("plant.x", "controller.u", "controller.theta_hat", "controller.rho_hat", "controller.z")


def first_inputs(loop: Loop, request: dict[str, object]) -> dict[str, dict[str, float]]:
    """The inputs at the start, as our master exchanges them."""
    start = reference(loop, STEPS)
    inputs: dict[str, dict[str, float]] = {}
    for source, output, target, input_ in request["connections"]:
        value = start.values[0, start.names.index(f"{source}.{output}")]
        inputs.setdefault(target, {})[input_] = float(value)
    return inputs


PARTS = (1, 2)  # of STEP


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, list[float]]]:
    """What becomes of each loop, all in one process, which takes seconds to start."""
    jobs: dict[str, object] = {}
    for loop in LOOPS:
        request = job(loop, STEPS)
        jobs[str(loop)] = {**request, "inputs": first_inputs(loop, request)}
    for loop in FROM_ZERO:
        jobs |= {f"{loop} {n}": job(loop, n * STEPS, STEP / n) for n in PARTS}
    folder = tmp_path_factory.mktemp("cofmupy")
    return run("cofmupy_loop", {"jobs": jobs}, folder, python=cofmupy())


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_agrees_with_the_master_from_the_same_inputs(
    loop: Loop, rows: dict[str, dict[str, list[float]]]
) -> None:
    found, expected = rows[str(loop)], reference(loop, STEPS)
    assert found["time"] == pytest.approx(expected.time[:-1], abs=1e-12)
    assert deviation(found, expected, columns(loop, *NAMES), first_row=1) < 1e-9


@pytest.mark.parametrize("loop", FROM_ZERO, ids=str)
def test_from_inputs_of_zero_it_deviates_by_the_first_order(
    loop: Loop, rows: dict[str, dict[str, list[float]]]
) -> None:
    deviations = [
        deviation(
            rows[f"{loop} {n}"],
            reference(loop, n * STEPS, STEP / n),
            columns(loop, "plant.x"),
            first_row=1,
        )
        for n in PARTS
    ]
    assert deviations[0] / deviations[1] == pytest.approx(2.0, rel=0.1)
