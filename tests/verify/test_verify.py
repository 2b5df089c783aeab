"""Verification: the monolithic solution agrees with good runs, and tells bad ones apart."""

from __future__ import annotations

import math
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.results.record import Trajectory
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import run
from congelation.verify.reference import LARGEST_DEVIATION, Deviation, compare, reference
from tests.cosim.test_units import with_units
from tests.scenarios import FMUS, ROOT, SCALAR, write
from tests.studies import done

SET_1 = '{"controller.damping" = true}'


def deviations(file: Path, variant: int = 0) -> tuple[Deviation, ...]:
    scenario = load_scenario(file)
    outcome, trajectory = done(scenario, file.parent / "out", variant)
    assert outcome.status == "COMPLETED", outcome.message
    return compare(reference(scenario.case(scenario.variants[variant].settings)), trajectory)


def shortened(folder: Path, name: str, stop: float, step: float) -> Path:
    """A shipped scenario over a shorter time and with another step."""
    lines = (ROOT / "scenarios" / f"{name}.toml").read_text().splitlines()
    changed = {
        "stop_time": f"stop_time = {stop}",
        "tolerance": f"step = {step}",
        "coupling": 'coupling = "derivative"',
        "output_interval": "",
    }
    lines = [changed.get(line.partition(" =")[0], line) for line in lines]
    return write(folder, "\n".join(lines))


@pytest.mark.parametrize("variant", [0, 1])
def test_fig2_agrees_at_a_step_of_its_time_constants(tmp_path: Path, variant: int) -> None:
    found = deviations(shortened(tmp_path, "fig2", 1.5, 1e-4), variant)
    assert {d.variable for d in found} == {
        *("plant.x[1]", "plant.x[2]", "controller.u", "controller.z[1]", "controller.z[2]"),
        *("controller.theta_hat[1]", "controller.theta_hat[2]"),
    }
    assert max(d.relative for d in found) < LARGEST_DEVIATION


@pytest.mark.parametrize(
    ("name", "step", "stop"), [("fig2", 4e-4, 0.5), ("fig3", 2e-3, 0.6), ("scalar", 2e-3, 0.6)]
)
def test_halving_the_step_divides_the_error_by_four(
    tmp_path: Path, name: str, step: float, stop: float
) -> None:
    coarse = deviations(shortened(tmp_path, name, stop, step))
    fine = deviations(shortened(tmp_path, name, stop, step / 2))
    for a, b in zip(coarse, fine, strict=True):
        assert 3.2 < a.error / b.error < 4.8, a.variable


def test_states_inside_the_controller_are_compared_too(tmp_path: Path) -> None:
    file = shortened(tmp_path, "fig3_r11", 1.0, 5e-4)
    text = file.read_text().replace('"plant.y",', '"controller.eta", "controller.lambda",')
    found = deviations(write(tmp_path, text))
    names = {d.variable for d in found}
    assert {"controller.eta[1]", "controller.lambda[2]", "controller.rho_hat"} <= names
    assert max(d.relative for d in found) < LARGEST_DEVIATION


def test_start_values_offsets_and_start_time_are_those_of_the_run(tmp_path: Path) -> None:
    found = deviations(
        write(
            tmp_path,
            SCALAR,
            ("x0 = [1.0]", 'x0 = [-2.0], "dtheta[1]" = 0.7'),
            ("stop_time = 1.0", "stop_time = 1.55\nstart_time = 0.55"),
            ("step = 0.01", "step = 0.001"),
            (SET_1, '{"controller.damping" = true, "controller.theta_hat0" = [-1.5]}'),
        )
    )
    assert max(d.relative for d in found) < 1e-5


def test_a_wrong_trajectory_is_told(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path))
    case = scenario.case(scenario.variants[0].settings)
    _, trajectory = done(scenario, tmp_path / "out")
    values = trajectory.values.copy()
    values[50, 0] += 0.25
    wrong: Trajectory = replace(trajectory, values=values)
    found = {d.variable: d for d in compare(reference(case), wrong)}
    assert found["plant.x"].error == pytest.approx(0.25, abs=1e-3)
    assert found["plant.x"].relative == pytest.approx(0.25, abs=1e-3)  # the peak is x(0) = 1
    assert found["controller.u"].relative < 1e-3


def test_a_variable_that_stays_at_zero_has_no_relative_error(tmp_path: Path) -> None:
    found = deviations(write(tmp_path, SCALAR, ("x0 = [1.0]", "x0 = [0.0]")))
    assert [d.relative for d in found] == [0.0, 0.0, 0.0]
    scenario = load_scenario(tmp_path / "loop.toml")
    zero = np.zeros((2, 1))
    trajectory = Trajectory(np.array([0.0, 1.0]), ("plant.x",), zero + 1e-3, {})
    (found_,) = compare(reference(scenario.case(scenario.variants[0].settings)), trajectory)
    assert (found_.error, found_.relative) == (1e-3, math.inf)


def without_spec(folder: Path) -> Path:
    """A copy of ScalarController.fmu as another tool might have made it."""
    with (
        zipfile.ZipFile(FMUS / "ScalarController.fmu") as source,
        zipfile.ZipFile(folder / "Other.fmu", "w") as target,
    ):
        for item in source.infolist():
            if item.filename != "resources/spec.json":
                target.writestr(item, source.read(item))
    return folder / "Other.fmu"


CONTROLLER = f'"{FMUS}/ScalarController.fmu"'
MISTAKES = {
    "no spec": (
        CONTROLLER,
        "OTHER",
        "Other.fmu has no resources/spec.json; only FMUs of `congelation build`",
    ),
    "open loop": (
        ', "controller.u -> plant.u"',
        "",
        "connection 'controller.u -> plant.u' is missing",
    ),
    "two plants": (
        "[experiment]",
        f'[components.other]\nfmu = "{FMUS}/ScalarPlant.fmu"\n[experiment]',
        "a plant and its controller are needed, one Reference at most, and Disturbances, not "
        "plant, controller, "
        "other",
    ),
}


@pytest.mark.filterwarnings("ignore:.*has no connection")
@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES)
def test_what_cannot_be_verified_is_told_before_it_runs(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    new = new.replace("OTHER", f'"{without_spec(tmp_path)}"')
    scenario = load_scenario(write(tmp_path, SCALAR, (old, new)))
    with pytest.raises(InvalidInput) as told:
        run(scenario, out=tmp_path / "out", verify=True)
    assert message in str(told.value)
    assert not list((tmp_path / "out").glob("*/*.parquet"))


OTHERS = f"""
title = "A plant and the controller of another"
connections = ["plant.x -> controller.y", "controller.u -> plant.u"]
components.plant.fmu = "{FMUS}/ScalarPlant.fmu"
components.controller.fmu = "{FMUS}/OutputFeedbackController.fmu"
experiment = {{stop_time = 1, step = 0.1}}
"""


def test_a_plant_and_the_controller_of_another_are_no_loop(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path, OTHERS))
    with pytest.raises(InvalidInput, match="plant and controller are of different systems"):
        reference(scenario.case({}))


def test_the_deviations_are_stored(tmp_path: Path) -> None:
    scenario = load_scenario(write(tmp_path, SCALAR, (SET_1, '{"controller.epsilon" = -1.0}')))
    refused, _ = run(scenario, out=tmp_path / "out", verify=True).runs
    assert refused.status == "REFUSED"
    assert refused.message.startswith("epsilon = ")
    for found in run(write(tmp_path), out=tmp_path / "out", verify=True).runs:
        assert list(found.deviations) == ["plant.x", "controller.theta_hat[1]", "controller.u"]
        assert max(found.deviations.values()) < LARGEST_DEVIATION


def test_a_loop_that_converts_units_has_no_reference(tmp_path: Path) -> None:
    plant = with_units(tmp_path, "ScalarPlant", {"x": "mm", "der(x)": "mm/s"})
    controller = with_units(tmp_path, "ScalarController", {"x": "m", "der(x)": "m/s"})
    changes = [(f"{FMUS}/{fmu.name}", str(fmu)) for fmu in (plant, controller)]
    scenario = load_scenario(write(tmp_path, SCALAR, *changes))
    with pytest.raises(InvalidInput, match=r"'plant\.x -> controller\.x' converts units"):
        reference(scenario.case(scenario.variants[0].settings))
