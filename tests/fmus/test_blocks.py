"""The blocks that stand beside a plant and its controller, as built files in fresh processes."""

from __future__ import annotations

import json
import subprocess
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.export.build import build
from congelation.export.spec import read_buildable, read_spec
from tests.fmus.instance import FMUS

ROOT = Path(__file__).resolve().parents[2]

STEPS = """
import json, sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.fmus.instance import loaded
with loaded(Path({fmu!r})) as (block,):
    block.start(**{start!r})
    rows = [block.get(*{names!r})]
    for k in range({count}):
        assert block.step(k * {h}, {h}) == 0, block.messages
        rows.append(block.get(*{names!r}))
    print(json.dumps(rows))
"""


def steps(fmu: Path, start: dict[str, float], names: list[str], h: float, count: int) -> np.ndarray:
    """The values of `names` at the start and after each step, from a process of its own."""
    script = STEPS.format(
        root=str(ROOT), fmu=str(fmu), start=start, names=names, count=count, h=h
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


def test_a_reference_is_its_sines_and_what_the_filter_makes_of_its_steps():
    """Against the steps' responses in closed form.

    The step of 0.37 s is no divisor of the half period: jumps lie within steps.
    """
    a, omega, phase, w = 0.7, 1.3, 0.4, 5.0
    start = {
        "offset": 0.2,
        "amplitude[1]": a,
        "omega[1]": omega,
        "phase[1]": phase,
        "bandwidth": w,
        "profile[1].square[1].amplitude": 1.5,
        "profile[1].square[1].period": 3.0,
    }
    names = ["yr[0]", "yr[1]", "yr[2]", "r", "next_event"]
    h, count = 0.37, 20
    found = steps(FMUS / "Reference.fmu", start, names, h, count)
    t = h * np.arange(count + 1)

    def step_response(t):
        """The response of (w/(s + w))^3 to a unit step at 0, and its two derivatives."""
        q = w * np.maximum(t, 0.0)
        decay = np.exp(-q)
        return (
            1.0 - decay * (1.0 + q + q**2 / 2),
            w * decay * q**2 / 2,
            w**2 * decay * (q - q**2 / 2),
        )

    jumps = [(0.0, 1.5)] + [(1.5 * k, 3.0 * (-1.0) ** k) for k in range(1, 5)]
    for k in range(3):
        exact = a * omega**k * np.sin(omega * t + phase + k * pi / 2) + (0.2 if k == 0 else 0.0)
        exact += sum(size * step_response(t - at)[k] for at, size in jumps)
        assert found[:, k] == pytest.approx(exact, abs=1e-6 * w**k)
    assert found[:, 3] == pytest.approx(1.5 * (-1.0) ** np.floor(t / 1.5))
    assert found[:, 4] == pytest.approx(1.5 * (np.floor(t / 1.5) + 1.0))


def test_the_derivatives_of_a_reference_are_those_of_its_value():
    """Central differences of yr[k] give yr[k+1], and those of yr[2] its der output."""
    start = {"amplitude[2]": 0.3, "omega[2]": 4.0, "q0[0]": -0.4, "profile[1].mean": 1.0}
    names = ["yr[0]", "yr[1]", "yr[2]", "der(yr[0])", "der(yr[1])", "der(yr[2])"]
    h = 1e-4
    rows = steps(FMUS / "Reference.fmu", start, names, h, 300)
    slopes = (rows[2:, :3] - rows[:-2, :3]) / (2 * h)
    assert slopes[:, :2] == pytest.approx(rows[1:-1, 1:3], abs=1e-3)
    assert slopes == pytest.approx(rows[1:-1, 3:], abs=1e-3)


BLOCK = """
form = "reference"
[structure]
n = 1
[block]
name = "Wanted"
start = {amplitude = [1, 2]}
[block.profile]
r = [{square = {amplitude = 1, period = 3}}]
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("n = 1", "n = -1", "structure.n = -1 is not valid"),
        ("n = 1", "m = 1", "structure.m is not known here"),
        ("[block]", "[plant]", "plant does not belong to the form 'reference', which is a block"),
        ("[1, 2]", "[1]", "amplitude = [1] is not valid; give 2 numbers"),
        ("r = [", "s = [", "block.profile.s is not known here; "),
        ("= {amplitude = [1, 2]}", "= {bandwidth = 0}", "bandwidth"),
        ('"reference"', '"scalar"', "block does not belong to the form 'scalar'"),
    ],
)
def test_a_mistake_in_the_spec_of_a_block_is_told(tmp_path, old, new, message):
    assert old in BLOCK
    file = tmp_path / "wanted.toml"
    file.write_text(BLOCK.replace(old, new))
    if "bandwidth" in message:  # such as an FMU refuses, too
        with pytest.raises(InvalidInput, match="bandwidth"):
            build(file, out=tmp_path)
        return
    with pytest.raises(InvalidInput) as told:
        read_buildable(file)
    assert message in str(told.value)


def test_a_block_is_no_design(tmp_path):
    file = tmp_path / "wanted.toml"
    file.write_text(BLOCK)
    with pytest.raises(InvalidInput, match=r"this is the spec of a block \(reference\)"):
        read_spec(file)
