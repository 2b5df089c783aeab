"""The wheel, installed alone, away from the checkout, does everything."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

from tests.scenarios import ROOT

pytestmark = pytest.mark.slow

# What a wheel is built of.
SOURCES = ("congelation", "fmu_src", "scenarios", "specs")
FILES = ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE")


class Installed:
    """An environment with the wheel, and a folder to work in."""

    def __init__(self, environment: Path, folder: Path) -> None:
        self._bin = environment / "bin"
        self.folder = folder

    def run(self, *command: str, code: int = 0) -> str:
        """Run a program of the environment and return what it printed."""
        clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
        clean["PATH"] = f"{self._bin}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            [str(self._bin / command[0]), *command[1:]],
            cwd=self.folder,
            env=clean,
            capture_output=True,
            text=True,
        )
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout + done.stderr


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """The wheel in an environment of its own; the packages that it needs are those of this one."""
    base = tmp_path_factory.mktemp("wheel")
    source = base / "source"
    for name in SOURCES:
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in FILES:
        shutil.copy(ROOT / name, source)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    subprocess.run(
        [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(base), str(source)],
        check=True,
    )
    (wheel,) = base.glob("*.whl")
    shutil.rmtree(source)
    environment = base / "environment"
    venv.create(environment, symlinks=True, with_pip=False)
    python = environment / "bin" / "python"
    subprocess.run([*pip, "--python", str(python), "install", "--no-deps", str(wheel)], check=True)
    # A path in a .pth file is searched, but the .pth files there, one of which names the checkout,
    # are not read.
    packages = sysconfig.get_paths(vars={"base": str(environment)})["purelib"]
    (Path(packages) / "others.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    folder = base / "work"
    folder.mkdir()
    return Installed(environment, folder)


def test_the_checkout_is_out_of_reach(installed: Installed) -> None:
    script = (
        "import sys, congelation; print(congelation.__file__); print(*sys.path, sep='\\n');"
        "import importlib.metadata as m; print(m.version('congelation'))"
    )
    said = installed.run("python", "-c", script)
    assert str(ROOT / "congelation") not in said
    assert str(ROOT) not in said.splitlines()


def test_everything(installed: Installed) -> None:
    """From nothing to results, in the order of a first day."""
    run = installed.run
    assert "build it with: congelation build SPEC.toml" in run(
        "congelation", "info", "x.fmu", code=2
    )
    assert "files in specs and scenarios" in run("congelation", "examples", ".")
    built = run("congelation", "build", "specs/scalar.toml").splitlines()
    assert built == ["fmus/ScalarPlant.fmu", "fmus/ScalarController.fmu"]
    assert "holds" in run("congelation", "certify", "specs/scalar.toml", "--samples", "20")
    assert "inputs to connect" in run("congelation", "info", *built, "--stop-time", "1")
    assert "Controller 1" in run("congelation", "run", "scenarios/scalar.toml", "--verify")
    run("congelation", "report", "results/scalar", "--html", "scalar.html")
    assert "Scalar example" in (installed.folder / "scalar.html").read_text("utf-8")
    # Rules about the file, and one that runs the FMU in a host in C.
    checked = run("congelation", "check", built[0], "--rule", "FMI2-XML", "--rule", "FMI2-LIB")
    assert "0 violation" in checked
    run("congelation", "export-ssp", "scenarios/scalar.toml", "scalar.ssp")


def test_a_plant_of_ones_own(installed: Installed) -> None:
    """What `new` writes builds, holds, runs and sweeps; its own lines say how."""
    for line in installed.run("congelation", "new", "wing_flap").splitlines():
        installed.run(*line.split())
    run = installed.run
    assert (installed.folder / "results" / "wing_flap" / "runs.parquet").is_file()
    swept = run("congelation", "sweep", "wing_flap/scenario.toml", "--out", "swept")
    assert "12 runs" in swept
