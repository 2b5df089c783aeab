"""The shipped scenarios show what they are for."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.cosim.pool import SlavePool
from congelation.scenario.load import load_scenario
from congelation.sweep.execute import execute
from congelation.sweep.plan import plan_run
from congelation.sweep.run import run_scenario
from congelation.sweep.sweep_plan import plan_sweep
from congelation.verify.reference import LARGEST_DEVIATION
from tests.scenarios import ROOT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scalar", "fig2", "fig3", "fig3_r11"])
def test_controller_1_settles_earlier_with_a_correct_solution(tmp_path: Path, name: str) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    study = run_scenario(scenario, tmp_path, verify=True).read()
    one, two = study.rows
    assert [one["status"], two["status"]] == ["COMPLETED", "COMPLETED"]
    assert one["settling_x"] < 0.7 * two["settling_x"]
    if name != "scalar":
        assert one["peak_u"] > two["peak_u"]  # the price
    for found in study.about["verification"].values():
        assert max(deviation["relative"] for deviation in found) < LARGEST_DEVIATION


def test_fig1_shows_fast_and_slow_variations_inside_the_box(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "fig1.toml")
    store = run_scenario(scenario, tmp_path)
    (row,) = store.read().rows
    trajectory = store.trajectory(row["run_id"])
    assert row["status"] == "COMPLETED"
    theta_1, theta_2 = trajectory.select(("plant.theta[1]", "plant.theta[2]")).T
    assert (theta_1.min() >= -4.0, theta_1.max() <= -2.0) == (True, True)
    assert (theta_2.min() >= 1.0, theta_2.max() <= 3.0) == (True, True)
    assert theta_1.max() - theta_1.min() > 1.9
    assert theta_2.max() - theta_2.min() > 1.9


STUDIES = {"rate": 48, "design": 384, "step": 40, "monte_carlo": 2000}


@pytest.mark.parametrize(("name", "runs"), STUDIES.items())
def test_the_studies_are_as_large_as_they_say(tmp_path: Path, name: str, runs: int) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"study_{name}.toml")
    plan = plan_sweep(scenario, tmp_path, resume=False)
    assert len(plan.run_ids) == len(plan.missing) == runs


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rate", "monte_carlo"])
def test_the_certificate_holds_for_controller_1_alone_whatever_theta_does(
    tmp_path: Path, name: str
) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"study_{name}.toml")
    plan = plan_sweep(scenario, tmp_path, resume=False)
    some = plan.missing[:: len(plan.missing) // 4 - 1]  # an odd step, so that both variants occur
    assert {task.variant for task in some} == {"Controller 1", "Controller 2"}
    with SlavePool() as pool:
        for task in some:
            run = plan_run(scenario, task.variant, task.settings, plan.shared.varied)
            row, _ = execute(run, scenario, pool)
            assert row["status"] == "COMPLETED"
            assert (row["margin"] <= 1e-9) == (task.variant == "Controller 1")


@pytest.mark.slow
def test_held_inputs_are_wrong_where_hermite_is_right(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "study_step.toml")
    settings = {"controller.damping": True, "experiment.step": 1e-3}
    errors = {}
    with SlavePool() as pool:
        for coupling in ("jacobi", "hermite"):
            run = plan_run(
                scenario, "Controller 1", {**settings, "experiment.coupling": coupling}, ()
            )
            errors[coupling] = execute(run, scenario, pool)[0]["error"]
    assert errors["jacobi"] > 0.1
    assert errors["hermite"] < 1e-4
