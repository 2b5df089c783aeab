"""``congelation sweep`` when the scenario has changed since, or does not stand."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.results.results import Results
from congelation.results.store import Store
from congelation.sweep import plan as plans
from tests.cli.test_cli_sweep import rows, sweep
from tests.scenarios import SCALAR, UNDRAWN, write
from tests.studies import command
from tests.studies import last_line as one_line

pytestmark = pytest.mark.slow

EPSILON = '[sweep]\n[[sweep.axes]]\nset = "controller.epsilon"\nvalues = [0.5, 1.0]\n'
STEP = '[sweep]\n[[sweep.axes]]\nset = "experiment.step"\nvalues = [0.01, 0.02]\n'


def test_a_changed_scenario_adds_its_runs_and_keeps_the_others(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert sweep(write(tmp_path, SCALAR + EPSILON), out).returncode == 0
    before = rows(out)
    file = write(tmp_path, SCALAR + STEP)

    done = sweep(file, out, "--resume")

    assert done.returncode == 0, done.stderr
    first, second, *_ = done.stdout.splitlines()
    assert first == f"4 runs, 4 of them to do in {out}"
    assert second == "another study or an earlier state of the scenario has 4 other runs"
    new = Results(out, Store(out).newest()).runs
    assert new["set.experiment.step"].tolist() == [0.01, 0.01, 0.02, 0.02]
    assert "set.controller.epsilon" not in new.columns
    lines = command("ls", out).stdout.splitlines()
    assert len(lines) == 1 + 8
    assert {"experiment.step", "controller.epsilon"} <= set(lines[0].split())

    file = write(tmp_path, SCALAR + EPSILON)
    done = sweep(file, out, "--resume")
    assert f"4 runs, 0 of them to do in {out}" in done.stdout
    kept = [row for row in rows(out) if row["study"] == before[0]["study"]]
    assert [{**row, "set.experiment.step": None} for row in kept] == [
        {**row, "set.experiment.step": None} for row in before
    ]


def test_run_refuses_the_folder_of_another_scenario(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert command("run", write(tmp_path, SCALAR, UNDRAWN), "--out", out).returncode == 0
    before = rows(out)
    other = write(tmp_path, SCALAR, UNDRAWN, ("A short loop", "Another loop"))
    line = one_line(command("run", other, "--out", out), 2)
    assert line.endswith("holds runs of another scenario, 'A short loop'; give another --out")
    assert rows(out) == before
    changed = write(tmp_path, SCALAR, UNDRAWN, ("k_bar = 0.5", "k_bar = 0.6"))
    assert command("run", changed, "--out", out).returncode == 0
    assert len(rows(out)) == 2 * len(before)


def test_other_sources_are_a_warning_and_other_numerics_another_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, out = write(tmp_path, SCALAR + EPSILON), tmp_path / "out"
    monkeypatch.setattr(plans, "code_version", lambda: "0.0+before")
    assert sweep(file, out).returncode == 0
    monkeypatch.undo()
    done = sweep(file, out, "--resume")
    assert "4 runs, 0 of them to do" in done.stdout
    assert "warning: finished runs are of congelation 0.0+before" in done.stderr
    assert done.returncode == 0
    monkeypatch.setattr(plans, "NUMERICS_VERSION", 1000)
    assert "4 runs, 4 of them to do" in sweep(file, out, "--dry-run").stdout


def test_a_tolerance_that_the_coupling_does_not_take_ends_the_plan(tmp_path: Path) -> None:
    file = write(
        tmp_path, SCALAR + EPSILON, ("step = 0.01", 'tolerance = 1e-3\ncoupling = "jacobi"')
    )
    for name in ("run", "sweep"):
        line = one_line(command(name, file, "--out", tmp_path / "out"), 2)
        assert line.startswith(
            f"congelation: {file}: experiment.tolerance: coupling 'jacobi' takes"
        )
    assert not Store(tmp_path / "out").count()


def test_failures_are_counted_and_none_that_begins_is_bad_input(tmp_path: Path) -> None:
    some = EPSILON.replace("0.5", "-1.0")
    done = sweep(write(tmp_path, SCALAR + some), tmp_path / "some")
    assert "congelation: 2 of 4 runs failed (2 SLAVE_FAILED)\n" in done.stderr
    assert one_line(done, 1).startswith("congelation: 2 x, such as run ")
    file = write(tmp_path, SCALAR + EPSILON, ("step = 0.01", "step = 1e-18"))
    done = sweep(file, tmp_path / "all", "--progress", "quiet")
    assert one_line(done, 2).startswith(
        f"congelation: {file}: Controller 1: step 1e-18 is too small"
    )
    assert "congelation: 4 of 4 runs failed (4 REFUSED)\n" in done.stderr
    assert len(rows(tmp_path / "all")) == 4
    line = one_line(command("run", file, "--out", tmp_path / "run"), 2)
    assert line.startswith(f"congelation: {file}: Controller 1: step 1e-18 is too small")


@pytest.mark.workers
def test_a_timeout_beyond_all_clocks_is_none(tmp_path: Path) -> None:
    file = write(tmp_path, SCALAR + EPSILON.replace("[sweep]", "[sweep]\ntimeout = 1e300"))
    done = sweep(file, tmp_path / "out", "--progress", "quiet")
    assert (done.returncode, done.stderr) == (0, "")
