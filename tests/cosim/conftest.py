"""FMUs for these tests, built once per session in a process of their own."""

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    """Folder with the FMUs of tests/cosim/fmus."""
    folder = tmp_path_factory.mktemp("fmus")
    subprocess.run(
        [sys.executable, HERE / "build_test_fmus.py", folder],
        check=True,
        cwd=folder,
        capture_output=True,
    )
    return folder


@pytest.fixture(scope="session")
def parts(tmp_path_factory):
    """Folder with the FMUs of the coupling problems."""
    from benchmarks.coupling.parts import build

    folder = tmp_path_factory.mktemp("parts")
    build(folder)
    return folder


@pytest.fixture(scope="session")
def loop(fmus):
    """A function that gives the oscillator and its controller as a system."""
    from congelation.cosim import Component, Connection, System

    def make(plant=None, controller=None, names=("plant", "controller")):
        return System(
            (
                Component(names[0], fmus / "TestPlant.fmu", {"x0": [1.0, 0.5], **(plant or {})}),
                Component(names[1], fmus / "TestController.fmu", controller or {}),
            ),
            (
                Connection(f"{names[0]}.x", f"{names[1]}.x"),
                Connection(f"{names[1]}.u", f"{names[0]}.u"),
            ),
        )

    return make
