"""Runs of real FMUs: rows, trajectories, failures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from congelation.errors import DesignWarning, InvalidInput
from congelation.results.results import Results
from congelation.scenario.load import load_scenario
from congelation.sweep.engine import Tally
from congelation.sweep.engine import run as run_study
from congelation.sweep.plan import plan_study
from tests.scenarios import SCALAR, write
from tests.studies import rows as stored

SET_2 = '{"controller.damping" = false}'


def run(folder: Path, *changes: tuple[str, str]) -> Results:
    return run_study(write(folder, SCALAR, *changes), out=folder / "out")


def rows_of(results: Results) -> list[dict[str, Any]]:
    return list(results.runs.rows())


@pytest.mark.workers
def test_rows_and_trajectories(tmp_path: Path) -> None:
    store = run(tmp_path)
    rows = rows_of(store)
    assert [row["variant"] for row in rows] == ["Controller 1", "Controller 2"]
    assert list(rows[0]) == [
        "run_id",
        "study",
        "number",
        "variant",
        "replicate",
        "set.controller.damping",
        "status",
        "message",
        "cause",
        "metric.peak_x",
        "metric.settling_x",
        "steps",
        "rejected_steps",
        "iterations",
        "estimated_error",
        "wall_time",
        "warnings",
        "worst_margin",
        "coupling",
        "coupling_why",
        "trust.error",
        "trust.verdict",
        "trust.line",
        "fmu.plant",
        "fmu.controller",
        "seed",
        "code_version",
        "numerics_version",
    ]
    assert [row["set.controller.damping"] for row in rows] == [True, False]
    assert [row["status"] for row in rows] == ["COMPLETED", "COMPLETED"]
    assert rows[0]["metric.settling_x"] < rows[1]["metric.settling_x"]
    assert rows[1]["metric.settling_x"] == math.inf
    trajectory = store.trajectory(rows[0]["run_id"])
    assert trajectory.columns == ("plant.x", "controller.theta_hat[1]", "controller.u")
    assert trajectory.units["controller.theta_hat[1]"] == "1/s"
    assert (trajectory.time[0], trajectory.time[-1]) == (0.0, 1.0)
    assert trajectory.values[0, 0] == 1.0
    assert rows[0]["metric.peak_x"] == np.max(np.abs(trajectory.values[:, 0]))
    assert rows[0]["steps"] >= 100


@pytest.mark.parametrize(
    "change",
    [
        ("{k_bar = 0.5", "{delta = 0.1, k_bar = 0.5"),
        ('"controller.damping" = true', '"controller.delta" = 0.1'),
    ],
)
def test_a_broken_assumption_is_warned_of(tmp_path: Path, change: tuple[str, str]) -> None:
    with pytest.warns(DesignWarning, match=r"Controller \d: controller\.delta: 0\.1 is less than"):
        run(tmp_path, change)


def test_a_forgotten_connection_is_warned_of(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"plant\.u.* no connection"):
        run(tmp_path, (', "controller.u -> plant.u"', ""))


def test_the_horizon_ends_exactly_where_the_scenario_says(tmp_path: Path) -> None:
    store = run(tmp_path, ("stop_time = 1.0", "stop_time = 0.105\nstart_time = -0.3"))
    for row in rows_of(store):
        time = store.trajectory(row["run_id"]).time
        assert (time[0], time[-1]) == (-0.3, 0.105)
        assert np.all(np.diff(time) > 0.0)


def test_a_chosen_output_grid(tmp_path: Path) -> None:
    changes = ("step = 0.01", 'tolerance = 1e-6\ncoupling = "hermite"\noutput_interval = 0.25')
    store = run(tmp_path, changes)
    trajectory = store.trajectory(store.runs[0].run_id)
    # Jumps of theta every 0.15 s have rows of their own.
    assert {0.0, 0.25, 0.5, 0.75, 1.0} <= set(trajectory.time.tolist())
    assert len(trajectory.time) < 25


def test_every_tenth_row(tmp_path: Path) -> None:
    store = run(tmp_path, ("step = 0.01", 'step = 0.01\ncoupling = "jacobi"\noutput_every = 10'))
    trajectory = store.trajectory(store.runs[0].run_id)
    np.testing.assert_allclose(trajectory.time, np.linspace(0.0, 1.0, 11))


def test_every_row_has_what_any_variant_changes(tmp_path: Path) -> None:
    both = '{"controller.damping" = false, "experiment.step" = 0.02, "controller.k_bar" = 1}'
    rows = rows_of(run(tmp_path, (SET_2, both)))
    assert [row["set.experiment.step"] for row in rows] == [0.01, 0.02]
    assert [row["set.controller.k_bar"] for row in rows] == [0.5, 1.0]
    assert rows[1]["steps"] < rows[0]["steps"]


def planned(folder: Path, *changes: tuple[str, str]) -> list[str]:
    """The run_ids of the scalar loop with some changes."""
    scenario = load_scenario(write(folder, SCALAR, *changes))
    plan = plan_study(scenario, folder / "none", swept=False, write=False)
    return [task.run_id for task in plan.tasks()]


def test_run_ids_are_of_the_content(tmp_path: Path) -> None:
    same = planned(tmp_path)
    assert len(set(same)) == 2
    assert planned(tmp_path, ("A short loop", "Another title")) == same
    assert planned(tmp_path, ("k_bar = 0.5", "k_bar = 0.50")) == same
    for change in (
        ("k_bar = 0.5", "k_bar = 0.6"),
        ("step = 0.01", "step = 0.02"),
        ("below = 0.1", "below = 0.2"),
        ("constant = -3.0", "constant = -3.1"),
        ('"Controller 1"', '"Controller one"'),
    ):
        assert set(planned(tmp_path, change)) != set(same), change


def test_a_changed_profile_table_is_another_run_and_another_plan(tmp_path: Path) -> None:
    terms = "[{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}]"
    ids: list[str] = []
    for value in ("-3", "-2"):
        (tmp_path / "theta.csv").write_text(f"0,{value}\n")
        file = write(tmp_path, SCALAR, (terms, '[{table = {file = "theta.csv"}}]'))
        plan = plan_study(load_scenario(file), tmp_path / "out", swept=False)
        ids += [next(plan.tasks()).run_id]
        plan.store.close()
    assert ids[0] != ids[1]
    assert plan.store.query("SELECT count(DISTINCT keys) FROM plans") == [(2,)]


def test_running_again_repeats_the_rows(tmp_path: Path) -> None:
    first = run(tmp_path)
    rows = stored(tmp_path / "out")
    values = [first.trajectory(row["run_id"]).values for row in rows]
    again = run(tmp_path)
    assert stored(tmp_path / "out") == rows
    for row, value in zip(rows, values, strict=True):
        assert np.array_equal(again.trajectory(row["run_id"]).values, value)


def test_a_scenario_without_variants_has_one_run(tmp_path: Path) -> None:
    text = SCALAR[: SCALAR.index("[[variants]]")]
    store = run_study(write(tmp_path, text), out=tmp_path / "out")
    assert [record.variant for record in store.runs] == ["loop"]


@pytest.mark.workers
def test_an_fmu_that_fails_is_a_row_and_the_rest_goes_on(tmp_path: Path) -> None:
    store = run(tmp_path, ('{"controller.damping" = true}', '{"controller.epsilon" = -1.0}'))
    failed, good = rows_of(store)
    assert failed["status"] == "SLAVE_FAILED"
    assert failed["message"].startswith("controller at t = 0: ")
    assert "epsilon" in failed["message"]
    assert (failed["metric.peak_x"], failed["metric.settling_x"]) == (None, None)
    assert len(store.trajectory(failed["run_id"]).time) == 0
    assert good["status"] == "COMPLETED"


def test_a_diverging_run_keeps_what_was_recorded(tmp_path: Path) -> None:
    store = run(
        tmp_path,
        (
            'connections = ["plant.x -> controller.x", "controller.u -> plant.u"]',
            'open = ["plant.u", "controller.x"]',
        ),
        ("stop_time = 1.0", "stop_time = 1000.0"),
        ("step = 0.01", "step = 1.0"),
        ("[{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}]", "-3.0"),
    )
    for row in rows_of(store):
        assert row["status"] == "DIVERGED"
        assert row["metric.peak_x"] is None
        assert "plant" in row["message"]
        trajectory = store.trajectory(row["run_id"])
        assert 70.0 < trajectory.time[-1] < 80.0  # exp(3 t) passes 1e100 at t = 76.8
        assert np.all(np.isfinite(trajectory.values))


@pytest.mark.workers
def test_progress_is_reported_up_to_the_end(tmp_path: Path) -> None:
    seen: list[Tally] = []
    file = write(tmp_path, SCALAR, ("stop_time = 1.0", "stop_time = 15.0"))
    run_study(file, out=tmp_path / "out", progress=seen.append)
    assert (seen[-1].done, seen[-1].total, seen[-1].failed) == (2, 2, 0)
    assert all(0.0 <= tally.done + tally.under_way <= 2.0 for tally in seen)
    assert any(0.0 < tally.under_way < 1.0 for tally in seen)


def test_provenance_is_kept_with_the_rows(tmp_path: Path) -> None:
    study = run(tmp_path).study()
    assert study.about["scenario"] == (tmp_path / "loop.toml").read_text()
    assert study.about["fmus"]["plant"] == {
        "file": "ScalarPlant.fmu",
        "sha256": study.records[0].fmus["plant"],
    }
    assert {"congelation", "Python", "fmpy", "pythonfmu"} <= set(study.about["versions"])
    assert study.about["metrics"]["settling_x"]["unit"] == "s"
    assert study.about["metrics"]["settling_x"]["options"] == {"below": 0.1}


def test_a_refusal_names_its_component_once(tmp_path: Path) -> None:
    rows = rows_of(run(tmp_path, ("epsilon = 0.3", "epsilon = -1")))
    assert rows[0]["status"] == "SLAVE_FAILED"
    assert rows[0]["message"].startswith("controller at t = 0: epsilon = -1.0 is refused: ")


@pytest.mark.workers
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "workers = 0 is not valid; give a whole number of at least 1"),
        ({"timeout": -1.0}, "timeout = -1.0 is not valid; give a positive number of seconds"),
        (
            {"timeout": float("nan")},
            "timeout = nan is not valid; give a positive number of seconds",
        ),
        ({"out": ""}, "out = '' names no folder; give one, '.' being this one"),
    ],
)
def test_what_no_study_can_have_is_refused(
    tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidInput) as error:
        run_study(write(tmp_path), **{"out": tmp_path / "out", **options})
    assert str(error.value) == message
    assert not (tmp_path / "out").exists()
