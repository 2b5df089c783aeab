"""FMUs that crash, abort, exit, hang or return no number: a row each, and the others go on."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cosim.c_fmus import plain_fmu
from tests.scenarios import write
from tests.studies import environment, process
from tests.studies import rows as stored

pytestmark = [pytest.mark.slow, pytest.mark.workers]

FAULTS = {
    0: ("COMPLETED", None),
    1: ("WORKER_DIED", "SIGSEGV"),
    2: ("WORKER_DIED", "SIGABRT"),
    3: ("WORKER_DIED", "exit code 0"),
    4: ("TIMED_OUT", "time limit"),
    5: ("TIMED_OUT", "time limit"),  # with the interpreter's lock held
    6: ("NON_FINITE", None),
}
"""Status and cause of a run by the parameter `fault` of tests/cosim/fmus/plain.c."""

PAIR = """
title = "A pair, one of which goes wrong"
connections = ["good.y -> bad.u1"]
open = ["good.u1", "good.u2", "bad.u2"]

[components]
good = {{fmu = "{folder}/plain_False.fmu", start = {{a = -1.0, x0 = 1.0}}}}
bad = {{fmu = "{folder}/plain_True.fmu", start = {{a = -1.0, b1 = 1.0}}}}

[experiment]
stop_time = 1.0
step = 0.1
coupling = "jacobi"

[metrics]
peak = {{metric = "peak", of = "bad.y"}}
"""

AXIS = f'[sweep]\n[[sweep.axes]]\nset = "bad.fault"\nvalues = {list(FAULTS)}\n'
VARIANTS = "".join(
    f'[[variants]]\nname = "{fault}"\nset = {{"bad.fault" = {fault}}}\n' for fault in FAULTS
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the FMUs are."""
    folder = tmp_path_factory.mktemp("plain")
    for declares in (False, True):
        plain_fmu(folder, declares=declares)
    return folder


def marked(mark: str) -> Iterator[int]:
    """Processes that have a text in their environment."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (entry / "environ").read_bytes():
                yield int(entry.name)
        except OSError:  # it has ended, or is not ours
            continue


@pytest.mark.parametrize(("name", "runs"), [("run", VARIANTS), ("sweep", AXIS)])
def test_a_faulty_fmu_is_a_row_that_names_it(
    tmp_path: Path, folder: Path, name: str, runs: str
) -> None:
    file, out = write(tmp_path, PAIR.format(folder=folder) + runs), tmp_path / "out"
    mark = f"FAULTS_OF={os.getpid()}-{tmp_path}"
    env = environment() | dict([mark.split("=", 1)])
    done = process(name, file, "--out", out, "--timeout", "5", "--workers", "2", env=env)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert not list(marked(mark))
    rows = {int(row["set.bad.fault"]): row for row in stored(out)}
    assert {fault: (row["status"], row["cause"]) for fault, row in rows.items()} == FAULTS
    for fault in (1, 2, 3, 4, 5):
        assert "fmi2DoStep of bad (plain_True.fmu)" in rows[fault]["message"]
    assert rows[6]["message"] == "bad.y at t = 0.6 is nan"
    if name == "run":
        assert all(row["message"] in done.stderr for fault, row in rows.items() if fault)
    else:
        assert "6 of 7 runs failed" in done.stderr
