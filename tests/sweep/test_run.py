"""Runs of real FMUs: rows, trajectories, failures."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from congelation.results.store import Store
from congelation.scenario.load import load_scenario
from congelation.sweep.plan import plan_runs
from congelation.sweep.run import run_scenario
from tests.scenarios import SCALAR, write

SET_2 = '{"controller.damping" = false}'


def run(folder: Path, *changes: tuple[str, str]) -> Store:
    return run_scenario(load_scenario(write(folder, SCALAR, *changes)), folder / "out")


def test_rows_and_trajectories(tmp_path: Path) -> None:
    store = run(tmp_path)
    rows = store.read().rows
    assert [row["variant"] for row in rows] == ["Controller 1", "Controller 2"]
    assert list(rows[0]) == [
        "run_id",
        "variant",
        "controller.damping",
        "status",
        "message",
        "peak_x",
        "settling_x",
        "macro_steps",
        "wall_time",
        "plant.sha256",
        "controller.sha256",
        "seed",
        "code_version",
    ]
    assert [row["controller.damping"] for row in rows] == [True, False]
    assert [row["status"] for row in rows] == ["COMPLETED", "COMPLETED"]
    assert rows[0]["settling_x"] < rows[1]["settling_x"]
    assert rows[1]["settling_x"] == math.inf
    trajectory = store.trajectory(rows[0]["run_id"])
    assert trajectory.columns == ("plant.x", "controller.theta_hat[1]", "controller.u")
    assert trajectory.units["controller.theta_hat[1]"] == "1/s"
    assert (trajectory.time[0], trajectory.time[-1]) == (0.0, 1.0)
    assert trajectory.values[0, 0] == 1.0
    assert rows[0]["peak_x"] == np.max(np.abs(trajectory.values[:, 0]))
    assert rows[0]["macro_steps"] >= 100


def test_the_horizon_ends_exactly_where_the_scenario_says(tmp_path: Path) -> None:
    store = run(tmp_path, ("stop_time = 1.0", "stop_time = 0.105\nstart_time = -0.3"))
    for row in store.read().rows:
        time = store.trajectory(row["run_id"]).time
        assert (time[0], time[-1]) == (-0.3, 0.105)
        assert np.all(np.diff(time) > 0.0)


def test_a_chosen_output_grid(tmp_path: Path) -> None:
    changes = ("step = 0.01", 'tolerance = 1e-6\ncoupling = "hermite"\noutput_interval = 0.25')
    store = run(tmp_path, changes)
    trajectory = store.trajectory(store.read().rows[0]["run_id"])
    # Jumps of theta every 0.15 s have rows of their own.
    assert {0.0, 0.25, 0.5, 0.75, 1.0} <= set(trajectory.time.tolist())
    assert len(trajectory.time) < 25


def test_every_tenth_row(tmp_path: Path) -> None:
    store = run(tmp_path, ("step = 0.01", 'step = 0.01\ncoupling = "jacobi"\noutput_every = 10'))
    trajectory = store.trajectory(store.read().rows[0]["run_id"])
    np.testing.assert_allclose(trajectory.time, np.linspace(0.0, 1.0, 11))


def test_every_row_has_what_any_variant_changes(tmp_path: Path) -> None:
    both = '{"controller.damping" = false, "experiment.step" = 0.02, "controller.k_bar" = 1}'
    rows = run(tmp_path, (SET_2, both)).read().rows
    assert [row["experiment.step"] for row in rows] == [0.01, 0.02]
    assert [row["controller.k_bar"] for row in rows] == [0.5, 1.0]
    assert rows[1]["macro_steps"] < rows[0]["macro_steps"]


def test_run_ids_are_of_the_content(tmp_path: Path) -> None:
    def run_ids(*changes: tuple[str, str]) -> list[str]:
        return [r.run_id for r in plan_runs(load_scenario(write(tmp_path, SCALAR, *changes)))]

    same = run_ids()
    assert len(set(same)) == 2
    assert run_ids(("A short loop", "Another title")) == same
    assert run_ids(("k_bar = 0.5", "k_bar = 0.50")) == same
    for change in (
        ("k_bar = 0.5", "k_bar = 0.6"),
        ("step = 0.01", "step = 0.02"),
        ("below = 0.1", "below = 0.2"),
        ("constant = -3.0", "constant = -3.1"),
        ('"Controller 1"', '"Controller one"'),
    ):
        assert set(run_ids(change)) != set(same), change


def test_a_changed_profile_table_is_another_run(tmp_path: Path) -> None:
    terms = "[{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}]"
    ids = []
    for value in ("-3", "-2"):
        (tmp_path / "theta.csv").write_text(f"0,{value}\n")
        file = write(tmp_path, SCALAR, (terms, '[{table = {file = "theta.csv"}}]'))
        ids += [next(plan_runs(load_scenario(file))).run_id]
    assert ids[0] != ids[1]


def test_running_again_repeats_the_rows(tmp_path: Path) -> None:
    first = run(tmp_path)
    rows = first.read().rows
    values = [first.trajectory(row["run_id"]).values for row in rows]
    again = run(tmp_path)
    for row, other, value in zip(rows, again.read().rows, values, strict=True):
        assert {**row, "wall_time": 0} == {**other, "wall_time": 0}
        assert np.array_equal(again.trajectory(row["run_id"]).values, value)


def test_a_scenario_without_variants_has_one_run(tmp_path: Path) -> None:
    text = SCALAR[: SCALAR.index("[[variants]]")]
    store = run_scenario(load_scenario(write(tmp_path, text)), tmp_path / "out")
    assert [row["variant"] for row in store.read().rows] == ["loop"]


def test_an_fmu_that_fails_is_a_row_and_the_rest_goes_on(tmp_path: Path) -> None:
    store = run(tmp_path, ('{"controller.damping" = true}', '{"controller.epsilon" = -1.0}'))
    failed, good = store.read().rows
    assert failed["status"] == "SLAVE_FAILED"
    assert failed["message"].startswith("controller at t = 0: ")
    assert "epsilon" in failed["message"]
    assert (failed["peak_x"], failed["settling_x"]) == (None, None)
    assert len(store.trajectory(failed["run_id"]).time) == 0
    assert good["status"] == "COMPLETED"


def test_a_diverging_run_keeps_what_was_recorded(tmp_path: Path) -> None:
    store = run(
        tmp_path,
        ('connections = ["plant.x -> controller.x", "controller.u -> plant.u"]', ""),
        ("stop_time = 1.0", "stop_time = 1000.0"),
        ("step = 0.01", "step = 1.0"),
        ("[{constant = -3.0}, {square = {amplitude = 0.4, period = 0.3}}]", "-3.0"),
    )
    for row in store.read().rows:
        assert row["status"] == "DIVERGED"
        assert row["peak_x"] is None
        assert "plant" in row["message"]
        trajectory = store.trajectory(row["run_id"])
        assert 70.0 < trajectory.time[-1] < 80.0  # exp(3 t) passes 1e100 at t = 76.8
        assert np.all(np.isfinite(trajectory.values))


def test_progress_is_reported_up_to_the_end(tmp_path: Path) -> None:
    seen: list[tuple[str, float]] = []
    scenario = load_scenario(write(tmp_path))
    run_scenario(scenario, tmp_path / "out", progress=lambda name, done: seen.append((name, done)))
    assert ("Controller 1", 1.0) in seen
    assert seen[-1] == ("Controller 2", 1.0)
    assert all(0.0 <= done <= 1.0 for _, done in seen)


def test_provenance_is_kept_with_the_rows(tmp_path: Path) -> None:
    study = run(tmp_path).read()
    assert study.about["scenario"] == (tmp_path / "loop.toml").read_text()
    assert study.about["fmus"]["plant"] == {
        "file": "ScalarPlant.fmu",
        "sha256": study.rows[0]["plant.sha256"],
    }
    assert {"congelation", "Python", "fmpy", "pythonfmu"} <= set(study.about["versions"])
    assert study.about["metrics"]["settling_x"]["unit"] == "s"
    assert study.about["metrics"]["settling_x"]["options"] == {"below": 0.1}


def test_a_refusal_names_its_component_once(tmp_path: Path) -> None:
    rows = run(tmp_path, ("epsilon = 0.3", "epsilon = -1")).read().rows
    assert rows[0]["status"] == "SLAVE_FAILED"
    assert rows[0]["message"].startswith("controller at t = 0: epsilon = -1.0 is refused: ")
