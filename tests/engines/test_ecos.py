"""Ecos: fixed step, Jacobi, initial outputs exchanged; row k holds the values at k steps.

The same scheme as our `jacobi`. After the exchange at the end of a step Ecos reads all outputs
once more, so an output that depends directly on an input (u, z) is shown as of the new inputs,
while the exchange used the one before. What was exchanged is the input, plant.u.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from tests.engines.engine import ecos, installed, run
from tests.engines.loops import LOOPS, Loop, columns, deviation, job, reference

STEPS = 800
NAMES = ("plant.x", "controller.theta_hat", "controller.rho_hat")


def check(loop: Loop, request: dict[str, object], folder: Path) -> None:
    record = [*request["record"], ["plant", "u"]]
    found = run("ecos", {**request, "record": record}, folder, environment=ecos(folder))
    expected = reference(loop, STEPS)
    assert found["time"] == pytest.approx(expected.time, abs=1e-12)
    exchanged = {**found, "controller.u": found["plant.u"]}
    assert deviation(exchanged, expected, columns(loop, *NAMES, "controller.u")) < 1e-9
    # The displayed output is another one; it would be a surprise if it were not.
    assert deviation(found, expected, ["controller.u"]) > 1e-4


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_fmus_agree_with_the_master(loop: Loop, tmp_path: Path) -> None:
    check(loop, job(loop, STEPS), tmp_path)


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_archives_agree_with_the_master(
    loop: Loop, archives: dict[Loop, Path], tmp_path: Path
) -> None:
    check(loop, {**job(loop, STEPS), "ssp": str(archives[loop])}, tmp_path)


LIBPYTHON = Path(sysconfig.get_config_var("LIBDIR"), sysconfig.get_config_var("INSTSONAME"))


@pytest.mark.skipif(not LIBPYTHON.is_file(), reason="this Python has no shared library to preload")
@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_the_command_is_a_host_without_python(
    loop: Loop, archives: dict[Loop, Path], tmp_path: Path
) -> None:
    """A C++ program runs the archive, with libpython preloaded; its CSV has six decimals."""
    command = tmp_path / "ecos"  # in the wheel it is not executable
    shutil.copyfile(installed("ecospy", "ecos"), command)
    command.chmod(0o755)
    environment = {
        **os.environ,
        **ecos(tmp_path),
        "LD_PRELOAD": str(LIBPYTHON),
        "PYTHONHOME": sys.base_prefix,
    }
    arguments = "--stopTime 0.1 --stepSize 0.001 --parameterSet initialValues --path"
    done = subprocess.run(
        [command, "simulate", *arguments.split(), archives[loop]],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    # Names stand unquoted, and some have commas: der(u,2); but none has ", ".
    header, *rows = (
        line.split(", ") for line in (tmp_path / f"{loop}.csv").read_text().splitlines()
    )
    last = dict(zip(header, rows[-1], strict=True))
    row = round(float(last["time"]) / 1e-3)
    assert row >= 99
    expected = reference(loop, 100)
    for name in columns(loop, *NAMES):
        value = float(last[f"{name.replace('.', '::', 1)}[REAL]"])
        assert value == pytest.approx(expected.column(name)[row], abs=1e-6)
