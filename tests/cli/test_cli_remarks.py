"""What a run that reached its stop time has to say: told by `run`, and on the page of the runs."""

from __future__ import annotations

from pathlib import Path

from congelation.report.run_page import write_html
from congelation.results.results import open_results
from tests.cosim.c_fmus import plain_fmu, signals_fmu
from tests.studies import command

SCENARIO = """
title = "An FMU that takes steps of 0.5 s alone"
connections = ["s.s -> i.u"]
components = {{s = {{fmu = "{fmu}"}}, i = {{fmu = "{fmu}"}}}}
open = ["s.u", "s.switch", "s.level", "i.switch", "i.level"]

[experiment]
stop_time = 2.0
tolerance = 1e-4
"""


def test_a_tolerance_that_is_not_kept_is_told(tmp_path: Path) -> None:
    file, folder = tmp_path / "fixed.toml", tmp_path / "out"
    file.write_text(SCENARIO.format(fmu=signals_fmu(tmp_path, fixed=True)), "utf-8")
    done = command("run", file, "--out", folder, "--progress", "quiet")
    assert done.returncode == 0, done.stderr
    results = open_results(folder)
    (record,) = results.runs
    said = "The tolerance of 0.0001 is not kept, as not all FMUs take other steps"
    assert record.remark.startswith(said)
    assert record.estimated_error > 1e-4
    assert done.stderr.splitlines() == [f"congelation: warning: fixed: {record.remark}"]
    write_html(results, tmp_path / "page.html")
    assert f'<p class="note">fixed: {record.remark}</p>' in (tmp_path / "page.html").read_text()


def test_an_overflow_is_told_in_one_line(tmp_path: Path) -> None:
    """And by no warning of numpy: neither of the trial of `auto` nor of the run."""
    fmu = plain_fmu(tmp_path, declares=True)
    file = tmp_path / "huge.toml"
    file.write_text(
        f"""
title = "y' = 1e300 y"
connections = ["a.y -> b.u1", "b.y -> a.u1"]
components.a = {{fmu = "{fmu}", start = {{b1 = 1e300, x0 = 1.0}}}}
components.b = {{fmu = "{fmu}", start = {{b1 = 1e300, x0 = 1.0}}}}
open = ["a.u2", "b.u2"]
[experiment]
stop_time = 1.0
tolerance = 1e-4
output_interval = 0.01
[metrics]
size = {{metric = "ise", of = "a.y"}}
"""
    )
    done = command("run", file, "--out", tmp_path / "out", "--progress", "quiet")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("congelation: huge: ")
    (record,) = open_results(tmp_path / "out").runs
    assert record.status == "DIVERGED"
