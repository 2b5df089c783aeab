"""What a run that reached its stop time has to say is printed, by ``run`` and by ``sweep``."""

from __future__ import annotations

from pathlib import Path

import pytest

from congelation.results.results import open_results
from tests.cosim.c_fmus import signals_fmu
from tests.studies import command

SCENARIO = """
title = "cos 50 t beside sin t"
connections = ["s.s -> i.u"]
components = {{s = {{fmu = "{fmu}"}}, i = {{fmu = "{fmu}"}}}}
open = ["i.switch", "i.level"]

[experiment]
stop_time = 2.0
tolerance = 1e-4
{output}

[metrics]
size = {{metric = "ise", of = "s.z"}}
{sweep}
"""

COARSE = "The points of the run are too far apart for 'size': s.z is off the straight line"
FIXED = "The tolerance of 0.0001 is not kept, as not all FMUs take other steps"


def written(folder: Path, fmu: Path, output: str = "", sweep: str = "") -> Path:
    file = folder / "signals.toml"
    file.write_text(SCENARIO.format(fmu=fmu, output=output, sweep=sweep), "utf-8")
    return file


def test_a_metric_over_long_steps_is_doubted(tmp_path: Path) -> None:
    """The integral of cos(50 t)^2 is 1 + sin(200) / 200 over two seconds."""
    fmu = signals_fmu(tmp_path)
    done = command("run", written(tmp_path, fmu), "--out", tmp_path / "long")
    assert done.returncode == 0, done.stderr
    assert COARSE in done.stdout
    (record,) = open_results(tmp_path / "long").runs
    assert record.remark.startswith(COARSE)
    fine = written(tmp_path, fmu, "output_interval = 0.005")
    done = command("run", fine, "--out", tmp_path / "fine")
    assert done.returncode == 0, done.stderr
    assert "too far apart" not in done.stdout
    (record,) = open_results(tmp_path / "fine").runs
    assert record.metrics["size"] == pytest.approx(0.99563, abs=1e-3)
    assert record.remark == ""


def test_a_sweep_says_how_many_runs_do_not_keep_their_tolerance(tmp_path: Path) -> None:
    fmu = signals_fmu(tmp_path, fixed=True)
    file = written(tmp_path, fmu, sweep='[[sweep.axes]]\nset = "s.w"\nvalues = [1.0, 2.0]')
    done = command("sweep", file, "--out", tmp_path / "results", "--progress", "quiet")
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if FIXED in line]
    assert line.startswith("congelation: warning: 2 x, such as run ")
