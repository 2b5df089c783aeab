"""Native pairs in the engines, against our master's run of the Python pairs, with no python3 on
the PATH. What each engine does with a loop is said in its own test file."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from congelation.scenario.ssp import write_ssp
from tests.engines.engine import cofmupy, ecos, installed, run
from tests.engines.loops import STEP, Loop, columns, deviation, job, reference, scenario, twin
from tests.engines.test_cofmupy import first_inputs

LOOPS = (Loop("fig2", "Controller 1"), Loop("fig3", "Controller 2"))
NAMES = ("plant.x", "controller.u", "controller.theta_hat", "controller.rho_hat", "controller.z")
STATES = ("plant.x", "controller.theta_hat", "controller.rho_hat")
STEPS = 800  # with a jump of theta inside, at 0.65 s

pytestmark = pytest.mark.parametrize("loop", LOOPS, ids=str)


@pytest.fixture
def bare(tmp_path: Path) -> dict[str, str]:
    """An environment without Python: what has libpython in it has brought it along."""
    empty = tmp_path / "bin"
    empty.mkdir()
    return {"PATH": str(empty), "PYTHONHOME": "", "LD_PRELOAD": ""}


def archive(loop: Loop, folder: Path) -> Path:
    file = folder / f"{loop}.ssp"
    native = replace(scenario(loop), system=twin(scenario(loop).system))
    write_ssp(native, file, loop.variant, step=STEP)
    return file


def test_libcosim(loop: Loop, tmp_path: Path, bare: dict[str, str]) -> None:
    found = run("libcosim", job(loop, STEPS, native=True), tmp_path, environment=bare)
    assert deviation(found, reference(loop, STEPS), columns(loop, *NAMES), first_row=1) < 1e-9


def test_ecos(loop: Loop, tmp_path: Path, bare: dict[str, str]) -> None:
    environment = {**bare, **ecos(tmp_path)}
    environment["PATH"] = environment["PATH"].partition(":")[0]  # its own unzip
    found = run("ecos", job(loop, STEPS, native=True), tmp_path, environment=environment)
    assert deviation(found, reference(loop, STEPS), columns(loop, *STATES)) < 1e-9


def test_the_command_of_ecos_needs_no_python(
    loop: Loop, tmp_path: Path, bare: dict[str, str]
) -> None:
    """A C++ program runs the archive; nothing is preloaded. Its CSV has six decimals."""
    command = tmp_path / "ecos"
    shutil.copyfile(installed("ecospy", "ecos"), command)
    command.chmod(0o755)
    environment = {**bare, **ecos(tmp_path)}
    environment["PATH"] = environment["PATH"].partition(":")[0]
    del environment["LD_PRELOAD"], environment["PYTHONHOME"]
    file = archive(loop, tmp_path)
    arguments = "--stopTime 0.1 --stepSize 0.001 --parameterSet initialValues --path"
    done = subprocess.run(
        [command, "simulate", *arguments.split(), file],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    header, *rows = (line.split(", ") for line in file.with_suffix(".csv").read_text().splitlines())
    last = dict(zip(header, rows[-1], strict=True))
    row = round(float(last["time"]) / 1e-3)
    assert row >= 99
    expected = reference(loop, 100)
    for name in columns(loop, *STATES):
        value = float(last[f"{name.replace('.', '::', 1)}[REAL]"])
        assert value == pytest.approx(expected.column(name)[row], abs=1e-6)


def test_cofmupy(loop: Loop, tmp_path: Path, bare: dict[str, str]) -> None:
    request = job(loop, 200, native=True)
    jobs = {"native": {**request, "inputs": first_inputs(loop, request)}}
    rows = run("cofmupy_loop", {"jobs": jobs}, tmp_path, python=cofmupy(), environment=bare)
    assert (
        deviation(rows["native"], reference(loop, 200), columns(loop, *NAMES), first_row=1) < 1e-9
    )


def test_fmpy_archives(loop: Loop, tmp_path: Path, bare: dict[str, str]) -> None:
    """Twice the error at twice the step, as with the Python pairs; FMPy takes the archive."""
    errors = []
    for n in (1, 2):
        request = {**job(loop, n * 200, STEP / n), "ssp": str(archive(loop, tmp_path))}
        found = run("fmpy_ssp", request, tmp_path / str(n), environment=bare)
        expected = reference(loop, n * 200, STEP / n)
        errors.append(deviation(found, expected, columns(loop, "plant.x"), first_row=1))
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("component", ["plant", "controller"])
def test_fmpy(loop: Loop, component: str, tmp_path: Path, bare: dict[str, str]) -> None:
    expected = reference(loop, 200)
    request = job(loop, 200, native=True)
    table = {
        input_: expected.column(f"{source}.{output}").ravel().tolist()
        for source, output, target, input_ in request["connections"]
        if target == component
    }
    names = [c for c in expected.names if c.startswith(f"{component}.")]
    own = {
        **request["components"][component],
        "input": {"time": expected.time.tolist(), **table},
        "record": [name.partition(".")[2] for name in names],
        "step": STEP,
        "steps": 200,
    }
    found = run("fmpy_fmu", own, tmp_path, environment=bare)
    rows = {name: found[name.partition(".")[2]] for name in names}
    assert deviation(rows, expected, names) < 1e-9
