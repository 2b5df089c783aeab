"""``congelation sweep`` with replicates, in real worker processes."""

from __future__ import annotations

import shutil
from collections import defaultdict
from pathlib import Path

import pytest

from congelation.results.results import Results
from tests.cli.test_cli_sweep import rows, sweep
from tests.scenario.test_replicates import REPLICATED, SEED
from tests.scenarios import SCALAR, write
from tests.studies import command as congelation

pytestmark = pytest.mark.slow

TELEGRAPH = (
    "{square = {amplitude = 0.4, period = 0.3}}",
    "{telegraph = {amplitude = 0.4, rate = 20.0, seed = 1}}",
)


@pytest.fixture(scope="module")
def replicated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of three replicates at two points, for two variants."""
    folder = tmp_path_factory.mktemp("replicated")
    done = sweep(write(folder, SCALAR + REPLICATED, TELEGRAPH), folder / "out")
    assert done.returncode == 0, done.stderr
    return folder / "out"


def test_replicates_differ_by_their_seed_alone_and_more_of_them_only_add(
    replicated: Path, tmp_path: Path
) -> None:
    out = shutil.copytree(replicated, tmp_path / "out")
    before = rows(out)
    assert len(before) == 2 * 2 * 3
    times = {run.run_id: run.wall_time for run in Results(out).runs}
    more = ("replicates = 3", "replicates = 5")
    file = write(tmp_path, SCALAR + REPLICATED, TELEGRAPH, more)
    second = sweep(file, out, "--resume", "--workers", "2")
    assert second.returncode == 0, second.stderr
    assert "20 runs, 8 of them to do" in second.stdout
    again = {run.run_id: run.wall_time for run in Results(out).runs}
    assert {run_id: again[run_id] for run_id in times} == times
    after = rows(out)
    kept = [row for row in after if row["replicate"] <= 3]
    assert [{**row, "number": 0, "study": ""} for row in kept] == [
        {**row, "number": 0, "study": ""} for row in before
    ]

    seeds, peaks = defaultdict(set), defaultdict(set)
    for row in after:
        seeds[row["replicate"]].add(row[f"set.{SEED}"])
        peaks[row["variant"], row["set.controller.epsilon"]].add(row["metric.peak_x"])
    assert sorted(seeds) == [1, 2, 3, 4, 5]
    assert all(len(found) == 1 for found in seeds.values())
    assert all(len(found) == 5 for found in peaks.values())  # the signals do differ


def test_reports_are_over_replicates_or_by_them(replicated: Path) -> None:
    out = replicated
    report = congelation("report", out, "--by", "variant", "--by", "controller.epsilon").stdout
    lines = [line for line in report.splitlines() if line.startswith("Controller 1, 0.5")]
    found = rows(out)
    peaks = sorted(
        row["metric.peak_x"]
        for row in found
        if (row["variant"], row["set.controller.epsilon"]) == ("Controller 1", 0.5)
    )
    low, median, high = (f"{value:.4g}" for value in peaks)
    assert lines[0].split()[3:5] == ["3", "3"]
    assert f"{median} [{low}, {high}]" in lines[0]
    by_replicate = congelation("report", out, "--by", "replicate").stdout.splitlines()
    assert [line.split()[:2] for line in by_replicate[1:4]] == [["1", "4"], ["2", "4"], ["3", "4"]]
    assert congelation("ls", out).stdout.split()[:3] == ["run_id", "variant", "replicate"]


def test_replicates_that_are_all_equal_are_named(tmp_path: Path) -> None:
    """The seed of a term that is not there."""
    silent = (TELEGRAPH[0], TELEGRAPH[1].replace("amplitude = 0.4", "amplitude = 0.0"))
    done = sweep(write(tmp_path, SCALAR + REPLICATED, silent), tmp_path / "out")
    assert done.returncode == 0, done.stderr
    line = "warning: replicate makes no difference: its values give the same metrics"
    assert done.stderr.splitlines()[-1] == f"congelation: {line}"
