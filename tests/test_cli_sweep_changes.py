"""``congelation sweep --resume`` after the scenario has changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.study.store import Store
from tests.study.scenarios import SCALAR, write
from tests.test_cli import congelation
from tests.test_cli_sweep import rows, sweep

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
