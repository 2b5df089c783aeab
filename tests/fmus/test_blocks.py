"""The blocks that stand beside a plant and its controller, as built files in fresh processes."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from math import pi
from pathlib import Path

import numpy as np
import pytest

from congelation.errors import InvalidInput
from congelation.export.build import build
from congelation.export.spec import read_buildable, read_spec
from tests.fmus.instance import FMUS, loaded

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


def _splitmix64(seed: int, k: int) -> int:
    """The generator as its authors print it: a state that advances, and a mix of it."""
    mask, state = 2**64 - 1, seed
    for _ in range(k):
        state = (state + 0x9E3779B97F4A7C15) & mask
    z = ((state ^ (state >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def test_noise_is_what_its_seed_says_and_is_announced():
    start = {
        "profile[1].noise[1].deviation": 0.3,
        "profile[1].noise[1].sample_time": 0.25,
        "profile[1].noise[1].seed": 42,
        "profile[1].mean": -1.0,
    }
    found = steps(FMUS / "Noise.fmu", start, ["y[1]", "n[1]", "next_event"], 0.1, 30)
    samples = [
        -1.0 + 0.3 * (sum((_splitmix64(42, 12 * k + j) >> 11) / 2**53 for j in range(1, 13)) - 6)
        for k in range(13)
    ]
    # The 25th step ends at 2.5 s but for rounding; every other one is away from a sample.
    index = (0.1 * np.arange(31) / 0.25 + 1e-9).astype(int)
    away = np.arange(31) % 5 != 0
    assert found[away, 0] == pytest.approx(np.array(samples)[index][away], rel=1e-12)
    assert (found[:, 0] == found[:, 1]).all()
    assert found[away, 2] == pytest.approx(0.25 * (index[away] + 1))


BLOCKS = {
    # name: what starts it, and outputs of the ramp u = 2 t - 1 in closed form.
    "Saturation": (
        {"limit[1]": 0.5, "centre[1]": 0.25},
        lambda t: {
            "y[1]": np.clip(2 * t - 1, -0.25, 0.75),
            "der(y[1])": 2.0 * (np.abs(2 * t - 1.25) < 0.5),
            "saturated[1]": np.sign(2 * t - 1.25) * (np.abs(2 * t - 1.25) > 0.5),
        },
    ),
    "Lag": (
        {"T[1]": 0.2, "gain[1]": 3.0, "y0[1]": 0.7},
        lambda t: {"y[1]": 3 * (2 * t - 1.4) + (0.7 + 4.2) * np.exp(-t / 0.2)},
    ),
    "Delay": (
        {"delay": 0.37, "before[1]": 0.6},
        lambda t: {
            "y[1]": np.where(t < 0.37, 0.6, 2 * (t - 0.37) - 1),
            "der(y[1])": np.where(t < 0.37, 0.0, 2.0),
            "next_event": np.where(t < 0.37, 0.37, 1e9),
        },
    ),
}

RAMP = """
import json, sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.fmus.instance import loaded
rows = []
with loaded(Path({fmu!r})) as (block,):
    block.start(**{start!r})
    for k in range({count} + 1):
        block.assign({{"u[1]": 2.0 * k * {h} - 1.0, "der(u[1])": 2.0}})
        rows.append(block.get(*{names!r}))
        assert block.step(k * {h}, {h}) == 0, block.messages
print(json.dumps(rows))
"""


@pytest.mark.parametrize("name", BLOCKS)
@pytest.mark.parametrize("h", [0.11, 0.51], ids=["short steps", "steps longer than the delay"])
def test_a_ramp_through_a_block(name, h):
    start, formulas = BLOCKS[name]
    t = h * np.arange(11)
    exact = formulas(t)
    script = RAMP.format(
        root=str(ROOT),
        fmu=str(FMUS / f"{name}.fmu"),
        start=start,
        names=list(exact),
        count=10,
        h=h,
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = np.minimum(json.loads(done.stdout), 1e9)
    for column, values in zip(found.T, exact.values(), strict=True):
        assert column == pytest.approx(values, abs=1e-7)


def test_a_jump_comes_out_of_a_delay_when_announced():
    """Held inputs that jump at 0.3 s; the state taken back to before it forgets it."""
    with loaded(FMUS / "Delay.fmu") as (delay,):
        delay.start(**{"delay": 0.25})
        names = ("y[1]", "next_event")
        assert delay.get(*names) == [0.0, math.inf]
        delay.assign({"u[1]": 1.0})
        assert delay.step(0.0, 0.3) == 0
        assert delay.get(*names) == [1.0, math.inf]
        state = delay.slave.getFMUstate()
        delay.assign({"u[1]": 3.0})
        assert delay.get("next_event") == [0.3 + 0.25]
        assert delay.step(0.3, 0.2) == 0
        assert delay.get(*names) == [1.0, 0.3 + 0.25]
        at = 0.3 + 0.25
        assert delay.step(0.5, at - 0.5) == 0
        assert delay.get(*names) == [3.0, math.inf]
        delay.slave.setFMUstate(state)
        delay.assign({"u[1]": 1.0})
        assert delay.step(0.3, 0.4) == 0
        assert delay.get(*names) == [1.0, math.inf]
        delay.slave.freeFMUstate(state)


def test_the_memory_of_a_delay_is_bounded():
    """What has come out is forgotten: the state stays as large as the delay needs."""
    with loaded(FMUS / "Delay.fmu") as (delay,):
        delay.start(**{"delay": 0.1})
        sizes = []
        for k in range(300):
            assert delay.step(k * 0.01, 0.01) == 0
            if k % 100 == 99:
                state = delay.slave.getFMUstate()
                sizes.append(len(bytes(delay.slave.serializeFMUstate(state))))
                delay.slave.freeFMUstate(state)
        assert max(sizes) - min(sizes) < 60


def test_a_disturbance_and_its_derivative():
    start = {"profile[1].mean": 0.5, "profile[1].sine[1].amplitude": 0.4}
    start["profile[1].sine[1].omega"] = 3.0
    found = steps(FMUS / "Disturbance.fmu", start, ["d[1]", "der(d[1])"], 0.2, 10)
    t = 0.2 * np.arange(11)
    assert found[:, 0] == pytest.approx(0.5 + 0.4 * np.sin(3 * t))
    assert found[:, 1] == pytest.approx(1.2 * np.cos(3 * t))
