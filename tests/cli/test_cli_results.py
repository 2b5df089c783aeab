"""``congelation ls``, ``show`` and ``export`` on the results of one short scenario."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest
from scipy.io import loadmat

from congelation.errors import InvalidInput
from congelation.report.exchange import matlab_name, write_mat
from congelation.report.table import aligned
from congelation.results.store import Store
from congelation.scenario.load import load_scenario
from congelation.sweep.run import run_scenario
from tests.cli.test_cli import congelation, one_line
from tests.scenarios import SCALAR, write


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results")
    return run_scenario(load_scenario(write(folder)), folder / "out").root


def test_ls_has_one_line_per_run_with_settings_status_and_metrics(out: Path) -> None:
    lines = congelation("ls", out).stdout.splitlines()
    header = ["run_id", "variant", "controller.damping", "status", "peak_x", "settling_x"]
    assert lines[0].split() == header
    assert [line.split()[0] for line in lines[1:]] == [row["run_id"] for row in Store(out).rows()]
    assert "COMPLETED" in lines[1]
    assert congelation("ls", out, "--status", "diverged").stdout == "no runs\n"
    line = one_line(congelation("ls", out, "--status", "NOPE"), 2)
    assert line.startswith("congelation: 'NOPE' is no status; valid: COMPLETED, ")


def test_ls_reads_a_directory_whose_sweep_is_not_done(out: Path, tmp_path: Path) -> None:
    row = Store(out).rows()[0]
    Store(tmp_path).create()
    Store(tmp_path).write(row)
    assert congelation("ls", tmp_path).stdout.splitlines()[1].startswith(row["run_id"])


def test_a_front_of_no_run_is_one_line(out: Path, tmp_path: Path) -> None:
    row = Store(out).rows()[1]
    assert row["settling_x"] == math.inf
    Store(tmp_path).create()
    Store(tmp_path).write(row)
    Store(tmp_path).compact([row["run_id"]], Store(out).read().about)
    done = congelation("report", tmp_path, "--pareto", "settling_x", "--pareto", "peak_x")
    assert one_line(done, 2).endswith(": no run has finite settling_x and peak_x")
    assert not (tmp_path / "figures").exists()


def test_show_finds_a_run_by_its_first_digits(out: Path) -> None:
    row = Store(out).rows()[1]
    text = congelation("show", out, row["run_id"][:8]).stdout
    shown = dict(line.split(maxsplit=1) for line in text.splitlines())
    assert shown["run_id"] == row["run_id"]
    assert shown["variant"] == "Controller 2"
    assert shown["peak_x"] == f"{row['peak_x']:.4g}"
    assert shown["trajectory"] == str(Store(out).trajectory_file(row["run_id"]))


def test_a_run_that_does_not_exist_is_one_line(out: Path, tmp_path: Path) -> None:
    assert "has no run 'zzz'" in one_line(congelation("show", out, "zzz"), 2)
    assert "is no result directory" in one_line(congelation("show", tmp_path / "none", "a"), 2)
    Store(tmp_path / "empty").create()
    assert "empty has no runs" in one_line(congelation("show", tmp_path / "empty", "a"), 2)
    assert "2 runs begin with ''" in one_line(congelation("show", out, ""), 2)
    assert "is no result directory" in one_line(congelation("ls", tmp_path / "none"), 2)
    assert "give --csv FOLDER or --mat FILE" in one_line(congelation("export", out), 2)


def test_csv_holds_the_same_numbers(out: Path, tmp_path: Path) -> None:
    done = congelation("export", out, "--csv", tmp_path / "csv")
    assert done.stdout == f"3 files in {tmp_path / 'csv'}\n"
    rows = pyarrow.csv.read_csv(tmp_path / "csv" / "runs.csv").to_pylist()
    stored = Store(out).rows()
    assert [row["peak_x"] for row in rows] == [row["peak_x"] for row in stored]
    file = tmp_path / "csv" / "trajectories" / f"{rows[0]['run_id']}.csv"
    table, trajectory = pyarrow.csv.read_csv(file), Store(out).trajectory(rows[0]["run_id"])
    assert table.column_names == ["time", *trajectory.columns]
    assert np.array_equal(table["plant.x"].to_numpy(), trajectory.select(["plant.x"])[:, 0])


def test_mat_holds_the_same_numbers(out: Path, tmp_path: Path) -> None:
    assert congelation("export", out, "--mat", tmp_path / "a.mat").returncode == 0
    content = loadmat(tmp_path / "a.mat", simplify_cells=True)
    stored = Store(out).rows()
    runs = content["runs"]
    assert list(runs["peak_x"]) == [row["peak_x"] for row in stored]
    assert list(runs["controller_damping"]) == [1.0, 0.0]
    assert list(runs["status"]) == ["COMPLETED", "COMPLETED"]
    assert np.isnan(runs["seed"]).all()
    for found, row in zip(content["trajectories"], stored, strict=True):
        trajectory = Store(out).trajectory(row["run_id"])
        assert found["run_id"] == row["run_id"]
        assert tuple(found["columns"]) == trajectory.columns
        assert np.array_equal(found["time"], trajectory.time)
        assert np.array_equal(found["values"], trajectory.values)


def test_names_that_matlab_would_confuse_are_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.create()
    store.write({"run_id": "a", "plant.x0[1]": 1.0, "plant.x0_1": 2.0})
    with pytest.raises(InvalidInput, match=r"'plant.x0\[1\]' and 'plant.x0_1' would both be"):
        write_mat(store, tmp_path / "a.mat")
    assert not (tmp_path / "a.mat").exists()
    assert matlab_name("plant.profile[1].sine[2].omega") == "plant_profile_1_sine_2_omega"


def test_matlab_names_are_ascii_and_begin_with_a_letter(tmp_path: Path) -> None:
    assert matlab_name("plänt.x0[1]") == "plant_x0_1"
    assert matlab_name("θ_max") == "u3b8_max"
    assert matlab_name("2nd.x") == "x2nd_x"
    store = Store(tmp_path)
    store.create()
    store.write({"run_id": "ä", "plänt.x0[1]": 1.0, "straße.u": 2.0, "variant": "größer"})
    write_mat(store, tmp_path / "a.mat")
    runs = loadmat(tmp_path / "a.mat", simplify_cells=True)["runs"]
    assert runs == {"run_id": "ä", "plant_x0_1": 1.0, "straudfe_u": 2.0, "variant": "größer"}
    store.write({"run_id": "b", "plant.x0[1]": 1.0, "plänt.x0[1]": 2.0})
    with pytest.raises(InvalidInput, match=r"would both be 'plant_x0_1' in MATLAB"):
        write_mat(store, tmp_path / "b.mat")


def test_a_component_with_an_accent_is_exported(tmp_path: Path) -> None:
    text = SCALAR.replace("plant", "plänt").replace("components.plänt", "components.'plänt'")
    store = run_scenario(load_scenario(write(tmp_path, text)), tmp_path / "out")
    done = congelation("export", store.root, "--mat", tmp_path / "a.mat", "--csv", tmp_path / "csv")
    assert done.returncode == 0, done.stderr
    content = loadmat(tmp_path / "a.mat", simplify_cells=True)
    assert "plant_sha256" in content["runs"]
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
