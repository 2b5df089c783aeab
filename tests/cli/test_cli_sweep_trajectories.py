"""What a sweep records: trajectories on a grid, or what is measured alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from congelation.results.results import Results
from congelation.scenario.load import load_scenario
from congelation.sweep import estimate as estimates
from congelation.sweep.local import Local
from congelation.sweep.plan import plan_study
from tests.cli.test_cli_sweep import rows, sweep
from tests.scenarios import SCALAR, write
from tests.studies import environment, install, process

pytestmark = pytest.mark.slow

# The square wave jumps at 0.15, 0.3, ..; 0.7 is no multiple of the interval.
GRID = """step = 0.01
output_interval = 0.04
"""
AXES = """
[sweep]
trajectories = true
[[sweep.axes]]
set = "controller.epsilon"
values = [0.2, 1.0]
[[sweep.axes]]
set = ["experiment.coupling", "experiment.step", "experiment.tolerance"]
values = [["hermite", 0.01, 1e-5], ["derivative", 0.003, 1e-4], ["hermite", 0.05, 1e-2]]
"""


def test_trajectories_of_a_sweep_share_their_grid_whatever_the_steps(tmp_path: Path) -> None:
    changes = (("step = 0.01\n", GRID), ("stop_time = 1.0", "stop_time = 0.7"))
    done = sweep(write(tmp_path, SCALAR + AXES, *changes), tmp_path / "out", "--workers", "2")
    assert done.returncode == 0, done.stderr
    found = rows(tmp_path / "out")
    assert {row["status"] for row in found} == {"COMPLETED"}
    assert len({row["steps"] for row in found}) > 3
    expected = np.append(0.04 * np.arange(18), 0.7)
    for row in found:
        trajectory = Results(tmp_path / "out").trajectory(row["run_id"])
        assert trajectory.time.tolist() == expected.tolist()


COUNT = """
from congelation.scenario.metrics import Metric

def count(case, time, columns, values):
    return float(len(columns))

metric = Metric("count", count, "number of recorded columns", str, loop=True)
"""


def test_without_trajectories_only_what_is_measured_is_recorded(tmp_path: Path) -> None:
    install(tmp_path, "count", COUNT)
    metric = (
        'settling_x = {metric = "settling_time", of = "plant.x", below = 0.1}',
        'columns = {metric = "count"}',
    )
    file = write(tmp_path, SCALAR + AXES, metric)
    env = environment(tmp_path)
    assert process("sweep", file, "--out", tmp_path / "with", env=env).returncode == 0
    file.write_text(file.read_text().replace("trajectories = true", "trajectories = false"))
    assert process("sweep", file, "--out", tmp_path / "without", env=env).returncode == 0
    kept, not_kept = rows(tmp_path / "with"), rows(tmp_path / "without")
    # The states of plant and controller; with trajectories u as well, which a figure shows.
    assert {row["metric.columns"] for row in kept} == {3.0}
    assert {row["metric.columns"] for row in not_kept} == {2.0}
    for before, after in zip(kept, not_kept, strict=True):
        apart = {"metric.columns": None, "study": ""}  # the two scenarios differ in what they keep
        assert {**before, **apart} == {**after, **apart}
    assert not list((tmp_path / "without" / "trajectories").iterdir())


def test_a_metric_of_everything_recorded_is_of_no_less_in_a_sweep(tmp_path: Path) -> None:
    loops = '[metrics]\nerror = {metric = "deviation"}'
    assert load_scenario(write(tmp_path)).measured == ("plant.x",)
    assert load_scenario(write(tmp_path, SCALAR, ("[metrics]", loops))).measured is None


@pytest.mark.parametrize("interval", [None, 1.0])
def test_the_estimate_of_space_knows_the_grid(
    tmp_path: Path, interval: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(estimates, "ENOUGH", 0.0)  # as of long runs, 2 % are done
    grid = "step = 0.01\n" + (f"output_interval = {interval}\n" if interval else "")
    changes = (("step = 0.01\n", grid), ("stop_time = 1.0", "stop_time = 20"))
    axis = (
        '[sweep]\ntrajectories = true\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [1]\n'
    )
    file, out = write(tmp_path, SCALAR + axis, *changes), tmp_path / "out"
    plan = plan_study(load_scenario(file), out, swept=True, write=False)
    estimated = estimates.estimate(plan, Local()).size
    assert sweep(file, out).returncode == 0
    kept = (out / "runs.sqlite", out / "runs.parquet", *(out / "trajectories").iterdir())
    actual = sum(part.stat().st_size for part in kept)
    assert actual / 3 < estimated < 3 * actual
