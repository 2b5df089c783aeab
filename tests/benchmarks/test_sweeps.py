"""The benchmarks of sweeps measure what they say; no time is looked at."""

import csv
import time
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks import long_run
from benchmarks.phases import STEPPING, Timers
from benchmarks.sweep_job import FRESH, RESULTS, Job, do, elsewhere, measured
from benchmarks.sweeps import overhead
from congelation.results.results import Results

STEPS, STEP = 200, 1e-4
HELD = {"coupling": "jacobi", "step": STEP, "tolerance": None, "stop_time": STEPS * STEP}


def test_fresh_instances_and_the_sweep_do_the_same_runs(tmp_path: Path) -> None:
    elsewhere(Job(2, HELD, program=FRESH), tmp_path)
    do(Job(2, HELD), tmp_path)

    with (tmp_path / "runs.csv").open(newline="") as stream:
        fresh = list(csv.DictReader(stream))
    runs = list(Results(tmp_path / RESULTS).runs)
    assert [run.variant for run in runs] == ["Controller 1", "Controller 2"] * 2
    for other, run in zip(fresh, runs, strict=True):
        assert run.steps == STEPS
        row = {**run.settings, **run.metrics}
        for name in ("controller.epsilon", "peak_x", "peak_u", "settling_x", "ise_x", "ise_u"):
            assert float(other[name]) == pytest.approx(row[name], rel=1e-9), name


def test_phases_add_up_to_the_sweep() -> None:
    found = overhead("held", 2, HELD)

    assert found.runs == 4
    assert all(seconds > 0.0 for seconds in found.per_run[STEPPING].values)
    assert all(seconds >= 0.0 for seconds in found.once.values())
    in_runs = sum(sum(timing.values) for timing in found.per_run.values())
    assert in_runs + sum(found.once.values()) == pytest.approx(found.cost.elapsed)


def test_memory_is_told_at_every_mark(tmp_path: Path) -> None:
    job = Job(12, {"stop_time": 5 * STEP}, workers=2, marks=(8, 24))
    answer = elsewhere(job, tmp_path).answer

    assert answer["runs"] == 24
    assert [mark["runs"] for mark in answer["memory"]] == [8, 24]
    assert all(mark["parent"] > 1e7 and mark["worker"] > 1e7 for mark in answer["memory"])
    assert answer["workers"] == 2


def test_time_in_a_function_is_not_counted_in_the_one_around_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = iter([0.0, 10.0, 13.0, 20.0])
    monkeypatch.setattr("benchmarks.phases.perf_counter", lambda: next(now))
    monkeypatch.setattr(time, "ctime", lambda: time.asctime())
    monkeypatch.setattr(time, "asctime", lambda: "now")
    timers = Timers()
    timers.install("time", "asctime", "inner")
    timers.install("time", "ctime", "outer")

    assert time.ctime() == "now"
    assert timers.seconds == {"inner": 3.0, "outer": 17.0}


def test_processor_time_of_descendants_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmarks.sweep_job.ROOT", tmp_path)
    (tmp_path / "busy.py").write_text(
        "import subprocess, sys\n"
        "loop = 'import time\\nwhile time.process_time() < 0.3: pass'\n"
        "subprocess.run([sys.executable, '-c', loop])\n"
        "print({})"
    )

    cost = measured("busy")

    assert cost.used >= 0.3
    assert cost.elapsed >= 0.3


def test_long_run_is_recorded_to_disk(capsys: pytest.CaptureFixture[str]) -> None:
    found = long_run.measure(1000, 10)

    assert found.cost.answer["status"] == "COMPLETED"
    assert found.cost.answer["rows"] == 101
    assert found.cost.answer["memory"][-1]["done"] == 1.0
    assert command.main(["--quick", "--long"]) == 0
    assert "| macro steps | resident memory" in capsys.readouterr().out
