"""The shipped scenarios show what they are for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from congelation.scenario.load import load_scenario
from congelation.sweep.engine import run
from congelation.sweep.plan import plan_study
from congelation.verify.reference import LARGEST_DEVIATION
from tests.scenarios import ROOT, write
from tests.studies import command, done


@pytest.mark.slow
@pytest.mark.parametrize("name", ["scalar", "fig2", "fig3", "fig3_r11"])
def test_controller_1_settles_earlier_with_a_correct_solution(tmp_path: Path, name: str) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    one, two = run(scenario, out=tmp_path, verify=True).runs
    assert [one.status, two.status] == ["COMPLETED", "COMPLETED"]
    settling = [found.metrics["settling_x"] or 0.0 for found in (one, two)]
    assert 0.0 < settling[0] < 0.7 * settling[1]
    if name != "scalar":
        assert (one.metrics["peak_u"] or 0.0) > (two.metrics["peak_u"] or 0.0)  # the price
    for found in (one, two):
        assert 0.0 < max(found.deviations.values()) < LARGEST_DEVIATION


def test_fig1_shows_fast_and_slow_variations_inside_the_box(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "fig1.toml")
    results = run(scenario, out=tmp_path)
    (found,) = results.runs
    trajectory = results.trajectory(found.run_id)
    assert found.status == "COMPLETED"
    theta_1, theta_2 = trajectory.select(("plant.theta[1]", "plant.theta[2]")).T
    assert (theta_1.min() >= -4.0, theta_1.max() <= -2.0) == (True, True)
    assert (theta_2.min() >= 1.0, theta_2.max() <= 3.0) == (True, True)
    assert theta_1.max() - theta_1.min() > 1.9
    assert theta_2.max() - theta_2.min() > 1.9


STUDIES = {"rate": 48, "design": 384, "step": 40, "monte_carlo": 2000}


@pytest.mark.parametrize(("name", "runs"), STUDIES.items())
def test_the_studies_are_as_large_as_they_say(tmp_path: Path, name: str, runs: int) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"study_{name}.toml")
    plan = plan_study(scenario, tmp_path, swept=True, write=False)
    assert plan.total == len(plan.missing) == runs


@pytest.mark.slow
def test_the_printed_command_of_the_study_of_rates_answers_it(tmp_path: Path) -> None:
    """Shortened to two rates and an amplitude: a line per rate and controller, nothing pooled."""
    text = (ROOT / "scenarios" / "study_rate.toml").read_text(encoding="utf-8")
    (printed,) = (
        line.removeprefix("#").split() for line in text.splitlines() if "congelation report" in line
    )
    arguments = [word.strip('"') for word in printed[1:]]
    changes = (
        ("stop_time = 12.0", "stop_time = 0.1"),
        ("values = [0.01, 0.1, 1.0, 10.0, 100.0, 1000.0]", "values = [1.0, 100.0]"),
        ("values = [0.25, 0.5, 1.0, 2.0]", "values = [1.0]"),
        ("trajectories = true", "trajectories = false"),
    )
    file, out = write(tmp_path, text, *changes), tmp_path / "out"
    assert command("sweep", file, "--out", out).returncode == 0
    arguments[arguments.index("results/study_rate")] = str(out)
    header, *lines = command(*arguments).stdout.splitlines()
    assert header.split()[:4] == ["plant.profile[1].sine[1].omega,", "variant", "runs", "completed"]
    groups = [(rate, f"Controller {k}") for rate in ("1", "100") for k in (1, 2)]
    assert [tuple(re.split(r", |  +", line)[:4]) for line in lines] == [
        (*group, "1", "1") for group in groups
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rate", "monte_carlo"])
def test_the_certificate_holds_for_controller_1_alone_whatever_theta_does(
    tmp_path: Path, name: str
) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"study_{name}.toml")
    plan = plan_study(scenario, tmp_path, swept=True, write=False)
    some = plan.missing[:: len(plan.missing) // 4 - 1]  # an odd step, so that both variants occur
    tasks = list(plan.tasks(some))
    assert {task.variant for task in tasks} == {"Controller 1", "Controller 2"}
    for task in tasks:
        outcome, _ = done(scenario, tmp_path, task.number)
        assert outcome.status == "COMPLETED"
        assert outcome.worst_margin == outcome.metrics["margin"]
        assert outcome.worst_margin is not None
        assert (outcome.worst_margin <= 1e-9) == (task.variant == "Controller 1")


@pytest.mark.slow
def test_held_inputs_are_wrong_where_hermite_is_right(tmp_path: Path) -> None:
    scenario = load_scenario(ROOT / "scenarios" / "study_step.toml")
    settings = {"controller.damping": True, "experiment.step": 1e-3}
    errors = {}
    for coupling in ("jacobi", "hermite"):
        chosen = {**settings, "experiment.coupling": coupling}
        errors[coupling] = done(scenario, tmp_path, 0, chosen)[0].metrics["error"] or 0.0
    assert errors["jacobi"] > 0.1
    assert 0.0 < errors["hermite"] < 1e-4
