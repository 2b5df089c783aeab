"""libcosim: fixed step, Jacobi, initial outputs exchanged; row k holds the values at the end of
step k. The same scheme as our `jacobi`."""

from pathlib import Path

import pytest

from tests.engines.engine import run
from tests.engines.loops import LOOPS, STEP, Loop, columns, deviation, job, reference

STEPS = 800  # with a jump of theta inside, at 0.65 s
NAMES = ("plant.x", "controller.u", "controller.theta_hat", "controller.rho_hat", "controller.z")


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_fmus_agree_with_the_master(loop: Loop, tmp_path: Path) -> None:
    found = run("libcosim", job(loop, STEPS), tmp_path)
    assert found["time"] == pytest.approx(reference(loop, STEPS).time[1:], abs=1e-12)
    assert deviation(found, reference(loop, STEPS), columns(loop, *NAMES), first_row=1) < 1e-9


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_archives_agree_with_the_master(
    loop: Loop, archives: dict[Loop, Path], tmp_path: Path
) -> None:
    found = run("libcosim", {**job(loop, STEPS), "ssp": str(archives[loop])}, tmp_path)
    assert deviation(found, reference(loop, STEPS), columns(loop, *NAMES), first_row=1) < 1e-9


def test_archives_state_the_step(archives: dict[Loop, Path], tmp_path: Path) -> None:
    request = {**job(LOOPS[1], 3), "ssp": str(archives[LOOPS[1]]), "step": None}
    expected = [STEP, 2 * STEP, 3 * STEP]
    assert run("libcosim", request, tmp_path)["time"] == pytest.approx(expected, abs=1e-12)


def test_connecting_derivatives_raises_the_order(tmp_path: Path) -> None:
    """der(x) to der(x), der(u) to der(u): second order, from an engine that holds all it passes."""
    loop = Loop("fig2", "Controller 2")
    errors = {}
    for steps in (200, 400):
        held = job(loop, steps, 0.4 / steps)
        extrapolated = {
            **held,
            "connections": [
                *held["connections"],
                *([s, f"der({o})", t, f"der({i})"] for s, o, t, i in held["connections"]),
            ],
        }
        for name, request in (("held", held), ("extrapolated", extrapolated)):
            found = run("libcosim", request, tmp_path)
            exact = reference(loop, 4000, 1e-4, "derivative")
            end = {column: values[-1:] for column, values in found.items()}
            errors[name, steps] = deviation(end, exact, columns(loop, "plant.x"), first_row=4000)
    assert STEP <= 0.4 / 400
    assert errors["held", 200] / errors["held", 400] == pytest.approx(2.0, rel=0.2)
    assert errors["extrapolated", 200] / errors["extrapolated", 400] > 3.4
    assert errors["extrapolated", 400] < errors["held", 400] / 20.0
