"""``congelation sweep --retry``: runs that ended with some status are done again."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from congelation.results.store import Store
from congelation.scenario.load import load_scenario
from congelation.sweep.sweep_plan import plan_sweep
from tests.cli.test_cli import one_line
from tests.cli.test_cli_sweep import (
    children,
    environment,
    install,
    rows,
    start,
    sweep,
    until,
)
from tests.cli.test_cli_sweep_forms import TINY
from tests.scenarios import SCALAR, write

pytestmark = pytest.mark.slow

# Of each variant one run is short and the other takes seconds.
UNEVEN = """
[sweep]
timeout = 1
trajectories = true
[[sweep.axes]]
set = "experiment.stop_time"
values = [0.1, 1000]
"""
LONGER = ("timeout = 1", "timeout = 300")


def test_runs_that_timed_out_are_done_again_with_a_longer_timeout(tmp_path: Path) -> None:
    out = tmp_path / "out"
    file = write(tmp_path, SCALAR + UNEVEN)
    assert sweep(file, out).returncode == 0
    before = {row["run_id"]: row for row in rows(out)}
    ended = {(row["experiment.stop_time"], row["status"]) for row in before.values()}
    assert ended == {(0.1, "COMPLETED"), (1000.0, "TIMED_OUT")}
    parts = {part: part.stat().st_mtime_ns for part in (out / "parts").iterdir()}

    file = write(tmp_path, SCALAR + UNEVEN, LONGER)
    scenario = load_scenario(file)
    assert not plan_sweep(scenario, out, resume=True).missing
    assert not plan_sweep(scenario, out, resume=True, retry=["WORKER_DIED"]).missing
    done = sweep(file, out, "--retry", "timed-out", "--retry", "WORKER_DIED", "--workers", "2")
    assert done.returncode == 0, done.stderr
    assert "4 runs, 2 of them to do" in done.stdout
    assert "4 of 4 runs, 0 failed" in done.stderr
    after = {row["run_id"]: row for row in rows(out)}
    assert list(after) == list(before)  # the timeout is no part of what a run is
    assert {row["status"] for row in after.values()} == {"COMPLETED"}
    for part, written in parts.items():
        redone = before[part.stem]["status"] == "TIMED_OUT"
        assert (part.stat().st_mtime_ns > written) == redone
        assert Store(out).trajectory(part.stem).time[-1] == after[part.stem]["experiment.stop_time"]


def test_the_old_row_stands_until_the_new_one_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    text = SCALAR + TINY.replace("[sweep]", "[sweep]\ntimeout = 0.3").replace("0.5, 1.0", "0.5")
    forever = ("stop_time = 1.0", "stop_time = 1e6")
    assert sweep(write(tmp_path, text, forever), out).returncode == 0
    before = rows(out)
    assert {row["status"] for row in before} == {"TIMED_OUT"}
    file = write(tmp_path, text, forever, ("timeout = 0.3", "timeout = 3000"))
    process = start(file, out, "--retry", "timed_out")
    try:
        until(lambda: bool(children(process.pid)))
        os.killpg(process.pid, signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 130, errors
    assert rows(out) == before


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
    metric = '[metrics]\ndead = {metric = "frail", of = "plant.x"}'
    file = write(tmp_path, SCALAR + axis, ("[metrics]", metric))
    env = {**environment(tmp_path), "ILL": str(ill)}
    ill.touch()

    def statuses(*arguments: str) -> list[str]:
        done = sweep(file, out, *arguments, env=env)
        assert done.returncode == 0, done.stderr
        return [row["status"] for row in rows(out)]

    first = statuses()
    assert sorted(set(first)) == ["COMPLETED", "WORKER_DIED"]
    written = {part: part.stat().st_mtime_ns for part in (out / "parts").iterdir()}
    assert statuses("--retry", "worker_died") == first  # it dies again, and is a new row
    newer = [part for part, then in written.items() if part.stat().st_mtime_ns > then]
    assert len(newer) == first.count("WORKER_DIED") == 2
    ill.unlink()
    assert statuses("--retry", "worker_died") == ["COMPLETED"] * 4


def test_a_status_that_does_not_exist_is_one_line(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR + TINY)
    line = one_line(sweep(file, tmp_path / "out", "--retry", "timedout"), 2)
    assert line.startswith("congelation: 'TIMEDOUT' is no status to retry; valid: SLAVE_FAILED, ")
    assert line.endswith("STEP_TOO_SMALL, REFUSED, TIMED_OUT, WORKER_DIED")
