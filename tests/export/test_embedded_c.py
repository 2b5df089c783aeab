"""The bare controllers as C: compiled without a warning, and equal to what `sampled` predicts."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from congelation.cli import app
from congelation.cosim import Component, Connection, Sampled, System, simulate
from congelation.errors import InvalidInput
from congelation.export.build import build
from tests.scenarios import FMUS, ROOT

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror")
T = 5e-3

# By spec: plant and controller, what the controller measures, and the start of the plant.
LOOPS = {
    "scalar": ("ScalarPlant", "ScalarController", ("x",), {"x0": [1.0]}),
    "matched_pendulum": ("MatchedPlant", "MatchedController", ("x[1]", "x[2]"), {"x0": [0.3, 0.0]}),
    "state_feedback": (
        "StrictFeedbackPlant",
        "StateFeedbackController",
        ("x[1]", "x[2]"),
        {"x0": [0.2, -0.1]},
    ),
    "output_feedback": (
        "ObserverFormPlant",
        "OutputFeedbackController",
        ("y",),
        {"x0": [0.2, 0.0]},
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C code of several controllers."""
    out = tmp_path_factory.mktemp("code")
    names = (*LOOPS, "tracking_output", "nonlinear")
    build(*(ROOT / "specs" / f"{name}.toml" for name in names), out=out, c_code=True)
    return out / "c"


def program(folder: Path, *options: str) -> Path:
    """The example, compiled with the strictest warnings."""
    target = folder / f"program{''.join(options)}"
    command = ["gcc", *STRICT, *options, "controller.c", "main.c", "-lm", "-o", str(target)]
    subprocess.run(command, cwd=folder, check=True)
    return target


@pytest.mark.parametrize("name", ["TrackingOutputController", "NonlinearController"])
def test_it_compiles_without_a_warning(folder: Path, name: str) -> None:
    assert program(folder / name).exists()


@pytest.mark.skipif(not shutil.which("cppcheck"), reason="cppcheck: make system-packages")
def test_cppcheck_finds_nothing(folder: Path) -> None:
    files = [str(file) for file in sorted(folder.glob("*/*.c"))]
    assert len(files) == 12
    done = subprocess.run(
        ["cppcheck", "--enable=warning,performance,portability", "--error-exitcode=1", *files],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("spec", LOOPS)
def test_it_is_what_the_sampled_coupling_predicts(folder: Path, spec: str) -> None:
    """u in every sample, within the error of the Runge-Kutta method, which is of order 4."""
    plant, controller, measured, start = LOOPS[spec]
    system = System(
        (
            Component("plant", FMUS / "native" / f"{plant}.fmu", start),
            Component("controller", FMUS / "native" / f"{controller}.fmu"),
        ),
        (
            *(Connection(f"plant.{y}", f"controller.{y}") for y in measured),
            Connection("controller.u", "plant.u"),
        ),
    )
    result = simulate(
        system,
        stop_time=100 * T,
        step=T,
        coupling=Sampled(sample_time=T),
        slave_tolerance=1e-12,
        record=[*(f"plant.{y}" for y in measured), "controller.u"],
    )
    assert result.completed, result.message
    samples, u = result.values[:, :-1], result.values[:, -1]
    lines = "\n".join(" ".join(map(repr, map(float, row))) for row in samples)
    errors = []
    for substeps in (1, 2):
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", controller).upper()
        done = subprocess.run(
            [program(folder / controller, f"-D{name}_SUBSTEPS={substeps}"), str(T)],
            input=lines,
            capture_output=True,
            text=True,
            check=True,
        )
        found = np.array([float(line) for line in done.stdout.split()])
        assert found.shape == u.shape
        errors.append(np.max(np.abs(found - u)) / np.max(np.abs(u)))
    assert errors[1] < 1e-5
    # Sixteen times less, unless rounding and the tolerance of the FMUs are all that is left.
    assert errors[1] < errors[0] / 10.0 or errors[1] < 1e-11


def test_bad_measurements_change_nothing(folder: Path) -> None:
    """The last u is returned; the estimates go on from where they were. The exit code tells."""
    command = [str(program(folder / "ScalarController")), "0.01"]
    runs = [
        subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        for text in ("0.5 0.4 0.3", "0.5 0.4 nan inf 1e300 0.3")
    ]
    good, bad = ([float(line) for line in run.stdout.split()] for run in runs)
    assert bad == [*good[:2], good[1], good[1], good[1], good[2]]
    assert [run.returncode for run in runs] == [0, 1]


def test_the_cost_is_written_beside_it(folder: Path) -> None:
    text = (folder / "StateFeedbackController" / "controller.h").read_text("utf-8")
    counted = re.search(r"u: (\d+) sums, products and comparisons, (\d+) divisions", text)
    assert counted is not None
    source = (folder / "StateFeedbackController" / "controller.c").read_text("utf-8")
    body = source.partition("static void control(")[2].partition("}")[0]
    operators = len(re.findall(r" [-+*] ", body))
    assert int(counted[1]) == pytest.approx(operators, abs=6)  # squares, doubles, signs
    assert int(counted[2]) == body.count(" / ")


def test_what_has_no_controller_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    specs = [ROOT / "specs" / f"{name}.toml" for name in ("scalar", "lag")]
    with pytest.raises(InvalidInput, match="spec 'lag': a block has no controller"):
        build(*specs, out=tmp_path, c_code=True)
    assert not list(tmp_path.glob("c/*"))
    done = CliRunner().invoke(app, ["build", str(specs[0]), "--native", "--c-code"])
    assert done.exit_code != 0
    assert "--native and --c-code: give one of the two" in str(done.exception)
