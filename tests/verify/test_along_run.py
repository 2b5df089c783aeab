"""The metrics of a closed loop: its certificate along a run, and the error of the coupling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import run as run_study
from congelation.sweep.plan import plan_study
from congelation.verify.along_run import MOST_ROWS, along
from congelation.verify.reference import reference
from tests.scenarios import SCALAR, write

METRIC = ("[metrics]", '[metrics]\nmargin = {metric = "lyapunov"}')
RADIUS = ("epsilon = 0.3", "epsilon = 0.3, delta = 0.4")


def test_the_certificate_holds_for_both_controllers_of_the_scalar_plant(tmp_path: Path) -> None:
    """For Controller 2 with ell = inf theta(t); `test_shipped.py` has one for which it fails."""
    results = run_study(write(tmp_path, SCALAR, METRIC, RADIUS), out=tmp_path / "out")
    for found in results.runs:
        margin = found.metrics["margin"]
        assert margin is not None
        assert margin <= 1e-9
        assert found.worst_margin == margin
    assert results.about["metrics"]["margin"]["of"] == "the closed loop"


def test_the_ell_of_controller_2_is_the_infimum_of_theta(tmp_path: Path) -> None:
    case = load_scenario(write(tmp_path, SCALAR, METRIC, RADIUS)).case(
        {"controller.damping": False}
    )
    found = along(case, np.zeros(1), reference(case).state_names, np.array([[1.0, 0.0]]))
    assert found.V.tolist() == [1 / 2 + 3.4**2 / 2]


def test_the_numbers_are_those_of_equation_5(tmp_path: Path) -> None:
    """V = x^2/2 + (ell - theta_hat)^2/2 with gamma = 1 and ell the centre of theta's interval."""
    scenario = load_scenario(write(tmp_path, SCALAR, METRIC, RADIUS))
    results = run_study(scenario, out=tmp_path / "out")
    run = results.trajectory(results.runs[0].run_id)
    case = scenario.case(scenario.variants[0].settings)
    found = along(case, run.time, run.columns, run.values)
    x, theta_hat = run.select(["plant.x", "controller.theta_hat[1]"]).T
    ell = -3.0
    assert reference(case).center.tolist() == [ell]
    assert np.array_equal(found.time, run.time)
    np.testing.assert_allclose(found.V, x**2 / 2 + (ell - theta_hat) ** 2 / 2, rtol=1e-12)
    assert np.all(np.diff(found.V) <= 0.0)
    assert found.worst == results.runs[0].metrics["margin"]


def test_long_runs_are_looked_at_in_parts(tmp_path: Path) -> None:
    case = load_scenario(write(tmp_path, SCALAR, METRIC)).case({})
    time = np.linspace(0.0, 1.0, 5 * MOST_ROWS)
    values = np.column_stack([np.ones_like(time), np.zeros_like(time)])
    found = along(case, time, reference(case).state_names, values)
    assert found.time.shape == found.V.shape == found.margin.shape == (MOST_ROWS,)
    assert (found.time[0], found.time[-1]) == (0.0, 1.0)


def test_the_states_of_the_loop_are_recorded_for_it(tmp_path: Path) -> None:
    changes = (METRIC, ('record = ["plant.x", "controller.theta_hat"]', 'record = ["plant.u"]'))
    scenario = load_scenario(write(tmp_path, SCALAR, *changes))
    plan = plan_study(scenario, tmp_path / "out", swept=False, write=False)
    record = plan.scenario.case({}).experiment.record
    assert {"plant.x", "controller.theta_hat[1]"} <= set(record)


def test_the_deviation_is_that_of_verify(tmp_path: Path) -> None:
    metric = ("[metrics]", '[metrics]\nerror = {metric = "deviation"}')
    scenario = load_scenario(write(tmp_path, SCALAR, metric))
    for found in run_study(scenario, out=tmp_path / "out", verify=True).runs:
        assert found.metrics["error"] == pytest.approx(max(found.deviations.values()), rel=1e-6)


MISTAKES = {
    "open loop": (
        (', "controller.u -> plant.u"]', ']\nopen = ["plant.u"]'),
        r"metrics\.margin\.metric: connection 'controller\.u -> plant\.u' is missing",
    ),
    "of": (
        ('metric = "lyapunov"', 'metric = "lyapunov", of = "plant.x"'),
        r"metrics\.margin\.of is not known here",
    ),
}


@pytest.mark.parametrize(("change", "message"), MISTAKES.values(), ids=MISTAKES)
def test_where_there_is_no_loop_one_line_says_so(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    with pytest.raises(InvalidInput, match=message):
        run_study(write(tmp_path, SCALAR, METRIC, change), out=tmp_path / "out")
