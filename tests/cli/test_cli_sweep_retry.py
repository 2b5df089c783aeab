"""``congelation sweep --retry``: runs that ended with some status are done again."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from congelation.results.results import Results
from tests.cli.test_cli_sweep import rows, sweep
from tests.cli.test_cli_sweep_forms import TINY
from tests.scenarios import SCALAR, write
from tests.studies import children, environment, install, process, start, until
from tests.studies import last_line as one_line

pytestmark = [pytest.mark.slow, pytest.mark.workers]

# Of each variant one run is done at once, and one hangs in its metric while a file exists.
UNEVEN = """
[sweep]
timeout = 8
trajectories = true
[[sweep.axes]]
set = "experiment.stop_time"
values = [0.1, 1.0]
"""
LONGER = ("timeout = 8", "timeout = 600")

SLOW = """
import os, pathlib, time
from congelation.scenario.metrics import Metric

def slow(t, values):
    while t[-1] > 0.5 and pathlib.Path(os.environ["ILL"]).exists():
        time.sleep(0.1)
    return 0.0

metric = Metric("slow", slow, "takes its time while a file exists", str)
"""


def with_metric(name: str) -> tuple[str, str]:
    """A replacement in a scenario, which gives it a metric of this module."""
    return "[metrics]", f'[metrics]\nown = {{metric = "{name}", of = "plant.x"}}'


def test_runs_that_timed_out_are_done_again_with_a_longer_timeout(tmp_path: Path) -> None:
    install(tmp_path, "slow", SLOW)
    out, ill = tmp_path / "out", tmp_path / "ill"
    env = {**environment(tmp_path), "ILL": str(ill)}
    ill.touch()
    file = write(tmp_path, SCALAR + UNEVEN, with_metric("slow"))
    assert process("sweep", file, "--out", out, env=env).returncode == 1
    before = {row["run_id"]: row for row in rows(out)}
    ended = {(row["set.experiment.stop_time"], row["status"]) for row in before.values()}
    assert ended == {(0.1, "COMPLETED"), (1.0, "TIMED_OUT")}
    times = {run.run_id: run.wall_time for run in Results(out).runs}

    ill.unlink()
    file = write(tmp_path, SCALAR + UNEVEN, with_metric("slow"), LONGER)
    again = ("sweep", file, "--out", out, "--resume")
    for options in ((), ("--retry", "worker_died")):
        planned = process(*again, *options, "--dry-run", env=env)
        assert "4 runs, 0 of them to do" in planned.stdout, planned.stderr
    done = process(
        *again, "--retry", "timed-out", "--retry", "WORKER_DIED", "--workers", "2", env=env
    )
    assert done.returncode == 0, done.stderr
    assert "4 runs, 2 of them to do" in done.stdout
    assert "4 of 4 runs, 0 failed" in done.stderr
    after = {row["run_id"]: row for row in rows(out)}
    assert list(after) == list(before)  # the timeout is no part of what a run is
    assert {row["status"] for row in after.values()} == {"COMPLETED"}
    for run in Results(out).runs:
        assert (run.wall_time == times[run.run_id]) == (before[run.run_id]["status"] == "COMPLETED")
        last = Results(out).trajectory(run.run_id).time[-1]
        assert last == run.settings["experiment.stop_time"]


def test_the_old_row_stands_until_the_new_one_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = SCALAR + TINY.replace("[sweep]", "[sweep]\ntimeout = 0.3").replace("0.5, 1.0", "0.5")
    forever = ("stop_time = 1.0", "stop_time = 1e6")
    assert sweep(write(tmp_path, text, forever), out).returncode == 1
    before = rows(out)
    assert {row["status"] for row in before} == {"TIMED_OUT"}
    file = write(tmp_path, text, forever, ("timeout = 0.3", "timeout = 3000"))
    running = start("sweep", file, "--out", out, "--retry", "timed_out")
    try:
        until(lambda: bool(children(running.pid)))
        os.killpg(running.pid, signal.SIGINT)
        _, errors = running.communicate(timeout=60)
    finally:
        running.kill()
        running.communicate()
    assert running.returncode == 130, errors
    # They belong to the study of the other timeout now, and are as they were.
    assert [{**row, "study": ""} for row in rows(out)] == [{**row, "study": ""} for row in before]


FRAIL = """
import os, pathlib, signal
from congelation.scenario.metrics import Metric

def frail(time, values):
    if values[0, 0] > 1.5 and pathlib.Path(os.environ["ILL"]).exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return 0.0

metric = Metric("frail", frail, "kills its process while a file exists", str)
"""


def test_runs_that_killed_their_worker_are_done_again(tmp_path: Path) -> None:
    install(tmp_path, "frail", FRAIL)
    out, ill = tmp_path / "out", tmp_path / "ill"
    axis = '[sweep]\n[[sweep.axes]]\nset = "plant.x0"\nvalues = [0, 2]\n'
    file = write(tmp_path, SCALAR + axis, with_metric("frail"))
    env = {**environment(tmp_path), "ILL": str(ill)}
    ill.touch()

    def statuses(*arguments: str) -> list[str]:
        done = process("sweep", file, "--out", out, *arguments, env=env)
        assert done.returncode in (0, 1), done.stderr
        return [row["status"] for row in rows(out)]

    first = statuses()
    assert sorted(set(first)) == ["COMPLETED", "WORKER_DIED"]
    assert first.count("WORKER_DIED") == 2
    assert statuses("--retry", "worker_died") == first  # it dies again
    ill.unlink()
    assert statuses("--retry", "worker_died") == ["COMPLETED"] * 4


def test_a_status_that_does_not_exist_is_one_line(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR + TINY)
    line = one_line(sweep(file, tmp_path / "out", "--retry", "timedout"), 2)
    assert line.startswith("congelation: 'TIMEDOUT' is no status to retry; valid: SLAVE_FAILED, ")
    assert line.endswith("STEP_TOO_SMALL, REFUSED, ERROR, TIMED_OUT, WORKER_DIED")
