"""``congelation ls``, ``show`` and ``export`` on the results of one short scenario."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from scipy.io import loadmat

from congelation.errors import InvalidInput
from congelation.report.export_formats import matlab_name, write_mat
from congelation.report.summary import number
from congelation.report.text_table import aligned
from congelation.results.results import Results
from congelation.sweep.engine import run
from tests.report.stored import record, results, trajectory
from tests.scenarios import SCALAR, UNDRAWN, write
from tests.studies import command as congelation
from tests.studies import last_line as one_line
from tests.studies import rows


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    return run(write(folder), out=folder / "out").folder


def test_ls_has_one_line_per_run_with_settings_status_and_metrics(out: Path) -> None:
    lines = congelation("ls", out).stdout.splitlines()
    header = ["run_id", "variant", "controller.damping", "status", "peak_x", "settling_x"]
    assert lines[0].split() == header
    assert [line.split()[0] for line in lines[1:]] == [row["run_id"] for row in rows(out)]
    assert "COMPLETED" in lines[1]
    assert congelation("ls", out, "--status", "diverged").stdout == "no runs\n"
    line = one_line(congelation("ls", out, "--status", "NOPE"), 2)
    assert line.startswith("congelation: 'NOPE' is no status; valid: COMPLETED, ")


def test_texts_of_several_lines_do_not_break_tables() -> None:
    assert number("a  b\nc\x1b[31m \u03b8") == "a  b\\nc\\x1b[31m \u03b8"


def test_ls_and_show_as_json(out: Path) -> None:
    listed = json.loads(congelation("ls", out, "--json").stdout)
    assert [row["run_id"] for row in listed] == [row["run_id"] for row in rows(out)]
    assert listed[1]["metric.settling_x"] == "inf"
    shown = json.loads(congelation("show", out, listed[0]["run_id"], "--json").stdout)
    assert shown["metric.peak_x"] == rows(out)[0]["metric.peak_x"]
    assert Path(shown["trajectory"]).is_file()


@pytest.mark.parametrize("interval", [None, 0.05])
def test_step_sizes_are_kept_whatever_rows_are(tmp_path: Path, interval: float | None) -> None:
    """By a tolerance the master chooses steps; the rows are on a grid of their own, or not."""
    own = "" if interval is None else f"\noutput_interval = {interval}"
    chosen = f'coupling = "hermite"\ntolerance = 1e-5{own}'
    found = run(write(tmp_path, SCALAR, ("step = 0.01", chosen)), out=tmp_path / "out")
    for row in found.runs:
        steps = found.trajectory(row.run_id).steps
        assert steps is not None
        assert steps.count == row.steps
        assert steps.time[-1] == pytest.approx(1.0)
        assert steps.length.sum() == pytest.approx(1.0)  # so few that all are kept


def test_run_as_json(tmp_path: Path) -> None:
    done = congelation("run", write(tmp_path, SCALAR, UNDRAWN), "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert [row["status"] for row in found] == ["COMPLETED"] * 2


def test_directories_are_compared(out: Path, tmp_path: Path) -> None:
    other = results(tmp_path / "other", [(record("r1", 1), trajectory(1.0))]).folder
    done = congelation("report", out, other)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == str(other / "comparison.html")
    assert "other against out: 1 run can be compared; 1 have no counterpart" in done.stdout
    assert "Controller 2: only in out" in done.stderr
    assert (other / "comparison.html").read_text("utf-8").startswith("<!DOCTYPE html>")
    line = one_line(congelation("report", out, other, "--pareto", "peak_x"), 2)
    assert line == "congelation: --pareto is for one result directory; give DIR alone"
    assert "is given twice" in one_line(congelation("report", out, out), 2)


def test_a_front_of_no_run_is_one_line(tmp_path: Path) -> None:
    results(tmp_path, [(record("r1", 1), trajectory(1.0))])
    done = congelation("report", tmp_path, "--pareto", "settling_x", "--pareto", "peak_x")
    assert one_line(done, 2).endswith(": no run has finite settling_x and peak_x")
    assert not (tmp_path / "figures").exists()


def test_show_finds_a_run_by_its_first_digits(out: Path) -> None:
    row = rows(out)[1]
    text = congelation("show", out, row["run_id"][:8]).stdout
    shown = dict(line.split(maxsplit=1) for line in text.splitlines())
    assert shown["run_id"] == row["run_id"]
    assert shown["variant"] == "Controller 2"
    assert shown["metric.peak_x"] == f"{row['metric.peak_x']:.4g}"
    assert shown["trajectory"] == str(Results(out).store.trajectory_file(row["run_id"]))


def test_a_run_that_does_not_exist_is_one_line(out: Path, tmp_path: Path) -> None:
    assert "has no run 'zzz'" in one_line(congelation("show", out, "zzz"), 2)
    assert "is no result directory" in one_line(congelation("show", tmp_path / "none", "a"), 2)
    results(tmp_path / "empty", [])
    assert "empty has no runs" in one_line(congelation("show", tmp_path / "empty", "a"), 2)
    assert congelation("ls", tmp_path / "empty").stdout == "no runs\n"
    for name in ("report", "open"):  # as of a study that was killed before its first run was kept
        told = one_line(congelation(name, tmp_path / "empty"), 2)
        assert told.endswith(
            "empty has no runs; if a study began there, go on with: congelation "
            "sweep SCENARIO --resume"
        )
    assert "an argument is empty after " in one_line(congelation("show", out, ""), 2)
    assert "is no result directory" in one_line(congelation("ls", tmp_path / "none"), 2)


def test_export_writes_runs_parquet_anew(out: Path) -> None:
    (out / "runs.parquet").unlink()
    assert congelation("export", out).stdout == f"{out / 'runs.parquet'}\n"
    table = pyarrow.parquet.read_table(out / "runs.parquet")
    assert table["run_id"].to_pylist() == [row["run_id"] for row in rows(out)]


def test_csv_holds_the_same_numbers(out: Path, tmp_path: Path) -> None:
    done = congelation("export", out, "--csv", tmp_path / "csv")
    assert done.stdout == f"3 files in {tmp_path / 'csv'}\n"
    table = pyarrow.csv.read_csv(tmp_path / "csv" / "runs.csv")
    stored = rows(out)
    assert table["metric.peak_x"].to_pylist() == [row["metric.peak_x"] for row in stored]
    run_id = stored[0]["run_id"]
    table = pyarrow.csv.read_csv(tmp_path / "csv" / "trajectories" / f"{run_id}.csv")
    kept = Results(out).trajectory(run_id)
    assert table.column_names == ["time", *kept.columns]
    assert np.array_equal(table["plant.x"].to_numpy(), kept.select(["plant.x"])[:, 0])


def test_mat_holds_the_same_numbers(out: Path, tmp_path: Path) -> None:
    assert congelation("export", out, "--mat", tmp_path / "a.mat").returncode == 0
    content = loadmat(tmp_path / "a.mat", simplify_cells=True)
    stored = rows(out)
    runs = content["runs"]
    assert list(runs["metric_peak_x"]) == [row["metric.peak_x"] for row in stored]
    assert list(runs["set_controller_damping"]) == [1.0, 0.0]
    assert list(runs["status"]) == ["COMPLETED", "COMPLETED"]
    assert np.isnan(runs["seed"]).all()
    for found, row in zip(content["trajectories"], stored, strict=True):
        kept = Results(out).trajectory(row["run_id"])
        assert found["run_id"] == row["run_id"]
        assert tuple(found["columns"]) == kept.columns
        assert np.array_equal(found["time"], kept.time)
        assert np.array_equal(found["values"], kept.values)


def test_names_that_matlab_would_confuse_are_refused(tmp_path: Path) -> None:
    twice = record("a", 1, settings={"plant.x0[1]": 1.0, "plant.x0_1": 2.0})
    found = results(tmp_path, [(twice, trajectory(1.0))])
    with pytest.raises(InvalidInput, match=r"'set.plant.x0\[1\]' and 'set.plant.x0_1' would both"):
        write_mat(found, tmp_path / "a.mat")
    assert not (tmp_path / "a.mat").exists()
    assert matlab_name("plant.profile[1].sine[2].omega") == "plant_profile_1_sine_2_omega"


def test_matlab_names_are_ascii_and_begin_with_a_letter(tmp_path: Path) -> None:
    assert matlab_name("plänt.x0[1]") == "plant_x0_1"
    assert matlab_name("θ_max") == "u3b8_max"
    assert matlab_name("2nd.x") == "x2nd_x"
    settings = {"plänt.x0[1]": 1.0, "straße.u": 2.0}
    entry = record("ä", 1, settings=settings, variant="größer")
    write_mat(results(tmp_path, [(entry, trajectory(1.0))]), tmp_path / "a.mat")
    runs = loadmat(tmp_path / "a.mat", simplify_cells=True)["runs"]
    assert (runs["run_id"], runs["variant"]) == ("ä", "größer")
    assert (runs["set_plant_x0_1"], runs["set_straudfe_u"]) == (1.0, 2.0)


def test_a_component_with_an_accent_is_exported(tmp_path: Path) -> None:
    text = SCALAR.replace("plant", "plänt").replace("components.plänt", "components.'plänt'")
    found = run(write(tmp_path, text), out=tmp_path / "out")
    done = congelation(
        "export", found.folder, "--mat", tmp_path / "a.mat", "--csv", tmp_path / "csv"
    )
    assert done.returncode == 0, done.stderr
    content = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert "fmu_plant" in content["runs"]
    assert "plänt.x" in content["trajectories"][0]["columns"]


def test_places_that_take_no_files_are_one_line(out: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for command in (
        ("report", out, "--html", tmp_path),
        ("export", out, "--mat", tmp_path),
    ):
        assert "this is a folder; give the name of a file" in one_line(congelation(*command), 2)
    for command in (
        ("export", out, "--csv", tmp_path / "file"),
        ("export", out, "--mat", "/proc/x.mat"),
        ("report", out, "--html", tmp_path / "file" / "a.html"),
    ):
        assert "no files can be written there" in one_line(congelation(*command), 2)


def test_a_file_is_no_result_directory(tmp_path: Path) -> None:
    (tmp_path / "file.txt").touch()
    for command in (("report",), ("ls",), ("export", "--csv", tmp_path / "csv")):
        line = one_line(congelation(command[0], tmp_path / "file.txt", *command[1:]), 2)
        assert "file.txt is a file, not a result directory" in line


def test_tables_are_aligned_and_not_cut() -> None:
    assert aligned(["a", "long"], [["x" * 90, "1"]]).splitlines()[1] == "x" * 90 + "  1"
    assert aligned(["a", "b"], [["xyz", "1"]]).splitlines()[0] == "a    b"


def test_figures_take_formats_and_a_width(out: Path, tmp_path: Path) -> None:
    for option, text in (("--format", "gif"), ("--width", "5"), ("--width", "1mm")):
        assert f"{option} {text}: give" in one_line(congelation("report", out, option, text), 2)


def test_what_was_kept_and_is_gone_is_named(out: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    gone = rows(copy)[1]["run_id"]
    (copy / "trajectories" / f"{gone}.parquet").unlink()
    for words in (("export", copy, "--csv", tmp_path / "csv"), ("report", copy)):
        done = congelation(*words)
        assert done.returncode == 0
        assert f"1 run of {copy} without the trajectory that was kept: {gone}; " in done.stderr


@pytest.mark.parametrize("option", ["--by", "--pareto"])
def test_a_name_given_twice_is_refused(out: Path, option: str) -> None:
    line = one_line(congelation("report", out, option, "peak_x", option, "peak_x"), 2)
    assert line == f"congelation: {option} peak_x is given twice"


def test_directories_without_a_common_run_are_not_compared(out: Path, tmp_path: Path) -> None:
    other = results(tmp_path / "other", [(record("r1", 7), trajectory(1.0))]).folder
    line = one_line(congelation("report", out, other), 2)
    assert line.startswith("congelation: out (2 runs) and other (1 run) have no run in common, ")
    assert not (other / "comparison.html").exists()


def test_results_are_shown_to_nobody() -> None:
    """Standard output may be closed by who started the process."""
    done = subprocess.run(
        ["sh", "-c", f"{shlex.quote(sys.executable)} -m congelation --version >&-"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
