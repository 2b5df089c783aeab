"""Ecos: fixed step, Jacobi, initial outputs exchanged; row k holds the values at k steps.

The same scheme as our `jacobi`. After the exchange at the end of a step Ecos reads all outputs
once more, so an output that depends directly on an input (u, z) is shown as of the new inputs,
while the exchange used the one before. What was exchanged is the input, plant.u.
"""

from pathlib import Path

import pytest

from tests.engines.engine import run, tbb
from tests.engines.loops import LOOPS, Loop, columns, deviation, job, reference

STEPS = 800
NAMES = ("plant.x", "controller.theta_hat", "controller.rho_hat")


def check(loop: Loop, request: dict[str, object], folder: Path) -> None:
    record = [*request["record"], ["plant", "u"]]
    found = run("ecos", {**request, "record": record}, folder, environment=tbb())
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
