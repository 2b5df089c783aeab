"""``congelation sweep`` when the scenario has changed since, or does not stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.results.store import Store
from tests.cli.test_cli import congelation, one_line
from tests.cli.test_cli_sweep import rows, sweep
from tests.scenarios import SCALAR, write

pytestmark = pytest.mark.slow

EPSILON = '[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [0.5, 1.0]\n'
STEP = '[sweep]\n[[sweep.axes]]\nset = "experiment.step"\nvalues = [0.01, 0.02]\n'


def test_a_changed_scenario_lists_its_own_runs_and_keeps_the_others(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert sweep(write(tmp_path, SCALAR + EPSILON), out).returncode == 0
    before = rows(out)
    file = write(tmp_path, SCALAR + STEP)

    done = sweep(file, out, "--resume")

    assert done.returncode == 0, done.stderr
    first, second, *_ = done.stdout.splitlines()
    assert first == f"4 runs, 4 of them to do in {out}"
    assert second == "4 runs there are of another state of the scenario, and not listed"
    found = rows(out)
    assert [row["experiment.step"] for row in found] == [0.01, 0.01, 0.02, 0.02]
    assert "controller.epsilon" not in found[0]
    listed = congelation("ls", out).stdout
    assert len(listed.splitlines()) == 1 + 4
    assert all(row["run_id"] not in listed for row in before)
    assert congelation("show", out, before[0]["run_id"]).returncode == 0

    file = write(tmp_path, SCALAR + EPSILON)
    done = sweep(file, out, "--resume")
    assert f"4 runs, 0 of them to do in {out}" in done.stdout
    assert rows(out) == before


def test_runs_of_another_plan_are_not_listed_while_none_of_this_one_is_done(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert sweep(write(tmp_path, SCALAR + EPSILON), out).returncode == 0
    Store(out).compact([], {"sweep": {"unlisted": sorted(Store(out).finished())}})
    assert Store(out).rows() == ()
    assert congelation("ls", out).stdout == "no runs\n"


def test_a_tolerance_that_the_coupling_does_not_take_ends_the_plan(tmp_path: Path) -> None:
    file = write(
        tmp_path, SCALAR + EPSILON, ("step = 0.01", 'tolerance = 1e-3\ncoupling = "jacobi"')
    )
    for command in ("run", "sweep"):
        line = one_line(congelation(command, file, "--out", tmp_path / "out"), 2)
        assert line.startswith(
            f"congelation: {file}: experiment.tolerance: coupling 'jacobi' takes"
        )
    assert not Store(tmp_path / "out").finished()


def test_failures_are_counted_and_none_that_begins_is_bad_input(tmp_path: Path) -> None:
    some = EPSILON.replace("0.5", "-1.0")
    done = sweep(write(tmp_path, SCALAR + some), tmp_path / "some")
    assert one_line(done, 0) == "congelation: 2 of 4 runs failed (2 SLAVE_FAILED)"
    file = write(tmp_path, SCALAR + EPSILON, ("step = 0.01", "step = 1e-18"))
    done = sweep(file, tmp_path / "all", "--progress", "quiet")
    assert one_line(done, 2).startswith(f"congelation: {file}: step 1e-18 is too small")
    assert "congelation: 4 of 4 runs failed (4 REFUSED)\n" in done.stderr
    assert len(rows(tmp_path / "all")) == 4
    line = one_line(congelation("run", file, "--out", tmp_path / "run"), 2)
    assert line.startswith(f"congelation: {file}: Controller 1: step 1e-18 is too small")


def test_a_timeout_beyond_all_clocks_is_none(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR + EPSILON.replace("[sweep]", "[sweep]\ntimeout = 1e300"))
    done = sweep(file, tmp_path / "out", "--progress", "quiet")
    assert (done.returncode, done.stderr) == (0, "")
