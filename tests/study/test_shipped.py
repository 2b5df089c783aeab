"""The shipped scenarios show what they are for."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.study.run import run_scenario
from congelation.study.scenario_file import load_scenario
from congelation.study.verify import LARGEST_DEVIATION
from tests.study.scenarios import ROOT


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
