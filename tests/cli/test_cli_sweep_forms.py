"""``congelation sweep``: estimates, progress, timeouts, groups, and disks that take nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_cli_sweep import LONG, SWEEP, rows, sweep
from tests.scenarios import SCALAR, UNDRAWN, write
from tests.studies import command as congelation
from tests.studies import environment, install, process, start, until
from tests.studies import last_line as one_line

pytestmark = pytest.mark.slow

TINY = '[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [0.5, 1.0]\n'


def test_a_dry_run_measures_a_run_and_writes_nothing(tmp_path: Path) -> None:
    done = sweep(write(tmp_path, SCALAR + SWEEP), tmp_path / "out", "--dry-run")
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert first == f"24 runs, 24 of them to do in {tmp_path / 'out'}"
    assert second.startswith("about ")
    assert " kB, judging by 5 pilot runs of " in second
    assert not (tmp_path / "out").exists()


def test_a_pilot_that_cannot_begin_does_not_hinder_the_sweep(tmp_path: Path) -> None:
    axis = TINY.replace("[0.5, 1.0]", "[-1.0]")
    done = sweep(write(tmp_path, SCALAR + axis), tmp_path / "out", "--dry-run")
    assert done.returncode == 0, done.stderr
    assert "judging by" in done.stdout or "no estimate: " in done.stdout


def test_an_axis_of_one_variant_leaves_the_other_a_run(tmp_path: Path) -> None:
    axis = '[sweep]\n[[sweep.axes]]\nset = "controller.gamma"\nvalues = [0.5, 1.0, 2.0]\n'
    file = write(tmp_path, SCALAR + axis + 'variants = ["Controller 2"]\n')
    out = tmp_path / "out"
    done = sweep(file, out)
    assert done.returncode == 0, done.stderr
    assert "4 runs, 4 of them to do" in done.stdout
    found = {(row["variant"], row["set.controller.gamma"]) for row in rows(out)}
    assert found == {("Controller 1", None), *(("Controller 2", g) for g in (0.5, 1.0, 2.0))}
    assert "4 runs, 0 of them to do" in sweep(file, out, "--resume").stdout
    alone = tmp_path / "alone"
    assert congelation("run", write(tmp_path, SCALAR, UNDRAWN), "--out", alone).returncode == 0
    (own,) = (row for row in rows(alone) if row["variant"] == "Controller 1")
    (same,) = (row for row in rows(out) if row["variant"] == "Controller 1")
    assert same["metric.peak_x"] == own["metric.peak_x"]

    listed = congelation("ls", out).stdout.splitlines()
    (line,) = (line for line in listed if " Controller 1 " in line)
    assert " – " in line
    by = congelation("report", out, "--by", "controller.gamma").stdout.splitlines()
    labels = [line.split()[:2] for line in by if line and line.split()[0] in ("0.5", "1", "2", "–")]
    assert labels == [["0.5", "1"], ["1", "1"], ["2", "1"], ["–", "1"]]
    report = congelation("report", out)
    assert report.returncode == 0, report.stderr
    page = (out / "report.html").read_text()
    assert "Controller 1 pays with a peak" not in page  # no metric of u
    assert "none up to gamma" not in page


@pytest.mark.workers
def test_progress_as_lines_of_json_or_none(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR + SWEEP)
    done = sweep(file, tmp_path / "json", "--progress", "json")
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert lines[-1]["done"] == lines[-1]["total"] == 24
    assert lines[-1]["failed"] == 0
    assert lines[-1]["eta"] == 0.0
    assert lines[-1]["rate"] > 0.0
    assert 50e6 < lines[-1]["memory"] < 1e9
    done = sweep(file, tmp_path / "quiet", "--progress", "quiet")
    assert (done.returncode, done.stderr) == (0, "")


HANG = """
import time
from congelation.scenario.metrics import Metric

def hang(time_, values):
    if values[0, 0] > 1.5:
        time.sleep(1000)
    return 0.0

metric = Metric("hang", hang, "never ends where x(0) > 1.5", str)
"""


def test_a_run_that_hangs_is_ended_and_the_rest_goes_on(tmp_path: Path) -> None:
    install(tmp_path, "hang", HANG)
    axis = '[sweep]\ntimeout = 2\n[[sweep.axes]]\nset = "plant.x0"\nvalues = [0, 2, 1]\n'
    metric = '[metrics]\nh = {metric = "hang", of = "plant.x"}'
    one = ('[[variants]]\nname = "Controller 2"\nset = {"controller.damping" = false}', "")
    file = write(tmp_path, SCALAR + axis, ("[metrics]", metric), one)
    done = process("sweep", file, "--out", tmp_path / "out", env=environment(tmp_path))
    assert done.returncode == 1, done.stderr
    found = {row["set.plant.x0[1]"]: row for row in rows(tmp_path / "out")}
    assert {x0: row["status"] for x0, row in found.items()} == {
        0.0: "COMPLETED",
        1.0: "COMPLETED",
        2.0: "TIMED_OUT",
    }
    assert found[2.0]["message"] == (
        "The run took longer than 2 s; see sweep.timeout, --timeout. No FMI call was under way."
    )


def test_a_pilot_that_hangs_is_ended(tmp_path: Path) -> None:
    install(tmp_path, "hang", HANG)
    axis = '[sweep]\ntimeout = 1\n[[sweep.axes]]\nset = "plant.x0"\nvalues = [2]\n'
    metric = '[metrics]\nh = {metric = "hang", of = "plant.x"}'
    file = write(tmp_path, SCALAR + axis, ("[metrics]", metric))
    done = process("sweep", file, "--out", tmp_path / "out", "--dry-run", env=environment(tmp_path))
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    assert last.startswith("no estimate: a pilot run failed: The run took longer than 1 s")
    assert not (tmp_path / "out").exists()


@pytest.mark.workers
def test_a_pilot_that_takes_too_long_is_ended(tmp_path: Path) -> None:
    text = SCALAR + TINY.replace("[sweep]", "[sweep]\ntimeout = 0.3")
    file = write(tmp_path, text, ("stop_time = 1.0", "stop_time = 1e6"))
    done = sweep(file, tmp_path / "out", "--dry-run")
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    assert last.startswith("no estimate: a pilot run failed: The run took longer than 0.3 s")


@pytest.mark.workers
def test_a_long_run_is_ended_between_its_steps(tmp_path: Path) -> None:
    text = SCALAR + TINY.replace("[sweep]", "[sweep]\ntimeout = {value = 300, unit = 'ms'}")
    file = write(tmp_path, text, ("stop_time = 1.0", "stop_time = 1e5"))
    done = sweep(file, tmp_path / "out")
    assert done.returncode == 1, done.stderr
    assert {row["status"] for row in rows(tmp_path / "out")} == {"TIMED_OUT"}
    assert "4 of 4 runs, 4 failed" in done.stderr


def test_groups_have_quantiles(tmp_path: Path) -> None:
    file, out = write(tmp_path, SCALAR + SWEEP), tmp_path / "out"
    assert sweep(file, out).returncode == 0
    done = congelation("report", out, "--by", "variant", "--by", "controller.damping")
    header, first, second = done.stdout.splitlines()
    assert header.split()[:2] == ["variant,", "controller.damping"]
    assert first.startswith("Controller 1, true ")
    assert second.split()[:5] == ["Controller", "2,", "false", "12", "12"]
    peaks = sorted(r["metric.peak_x"] for r in rows(out) if r["variant"] == "Controller 2")
    low, high = f"{peaks[0]:.4g}", f"{peaks[-1]:.4g}"
    assert second.split()[5] == f"{peaks[5]:.4g}"
    assert low == high or f"[{low}, {high}]" in second
    line = one_line(congelation("report", out, "--by", "varian"), 2)
    assert "'varian' is no column to group by; did you mean 'variant'?" in line


def test_a_sweep_can_be_reported_while_it_runs(tmp_path: Path) -> None:
    file, out = write(tmp_path, SCALAR + SWEEP, LONG), tmp_path / "out"
    running = start("sweep", file, "--out", out)
    try:
        until(lambda: (out / "runs.sqlite").is_file() and len(rows(out)) > 0)
        assert running.poll() is None
        found = rows(out)
        done = congelation("report", out)
    finally:
        running.kill()
        running.communicate()
    assert 0 < len(found) < 24
    assert done.returncode == 0, done.stderr


def unprivileged(*command: str) -> subprocess.CompletedProcess[str]:
    """A command as a user whom permissions bind; root is not bound by them."""
    drop = ["setpriv", "--bounding-set", "-all", "--inh-caps", "-all"] if os.getuid() == 0 else []
    return subprocess.run(
        [*drop, *command],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_read_only_directory_is_one_line(tmp_path: Path) -> None:
    file, out = write(tmp_path, SCALAR + TINY), tmp_path / "out"
    assert sweep(file, out).returncode == 0
    before = rows(out)
    file.write_text(file.read_text().replace("[0.5, 1.0]", "[0.5, 1.0, 2.0]"))
    folders = (out, out / "trajectories")
    for folder in folders:
        folder.chmod(0o555)
    command = [sys.executable, "-m", "congelation", "sweep", str(file), "--out", str(out)]
    done = unprivileged(*command, "--resume")
    listed = unprivileged(*command[:3], "ls", str(out))
    for folder in folders:
        folder.chmod(0o755)
    line = one_line(done, 2)
    assert f"results {out}: no files can be written there (Permission denied)" in line
    assert len(listed.stdout.splitlines()) == 1 + len(before), listed.stderr
    assert rows(out) == before
    assert sweep(file, out, "--resume").returncode == 0
    assert len(rows(out)) == 6
