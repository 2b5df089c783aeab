"""Built files alone, and several of them in one process."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import textwrap
import warnings
from pathlib import Path

import pytest

from congelation.errors import DesignWarning
from congelation.export.build import build
from tests.fmus.instance import FMUS, loaded

ROOT = Path(__file__).resolve().parents[2]

ALONE = """
import importlib.util, sys
sys.path.append({packages!r})
assert importlib.util.find_spec("congelation") is None
assert importlib.util.find_spec("casadi") is not None
import fmpy
result = fmpy.simulate_fmu({fmu!r}, stop_time=0.1, output_interval=0.01, output={outputs!r})
before = set(sys.modules)
assert not any(m.split(".")[0] in ("casadi", "scipy") for m in before), before
foreign = [m for m in before if m.startswith("congelation") and len(m.split(".")[0]) < 28]
assert not foreign, foreign
print(result[-1])
"""


def test_without_the_sources(fmu, tmp_path):
    """In a fresh process without this project, an FMU runs on the standard library alone."""
    outputs = ["u"] if "Controller" in fmu.name else ["theta[1]"]
    script = ALONE.format(packages=sysconfig.get_paths()["purelib"], fmu=str(fmu), outputs=outputs)
    # -S leaves out the .pth files, so the editable installation of this project is not seen.
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout


SPEC = """
form = "strict-feedback"
[structure]
n = 2
p = 2
phibar = {{"1,1" = [{sign}1, 0], "2,1" = [0, -1]}}
[plant]
name = "Twin"
[controller]
name = "TwinController"
"""


def test_two_builds_of_different_content(tmp_path):
    """FMUs of equal name and different equations do not touch each other in one process."""
    paths = []
    for sign in ("-", ""):
        folder = tmp_path / f"build{sign}"
        folder.mkdir()
        spec = folder / "twin.toml"
        spec.write_text(SPEC.format(sign=sign))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DesignWarning)  # it has no profile and no delta
            build(spec, out=folder)
        paths.append(folder / "Twin.fmu")
    slopes = []
    with loaded(paths[0]) as (one,), loaded(paths[1]) as (two,):
        for plant in (one, two, one, two):
            plant.slave.reset()
            plant.start(**{"x0[1]": 1.0, "x0[2]": 0.0, "profile[1].mean": 3.0})
            slopes.append(plant.get("der(x[1])")[0])
    assert slopes == [-3.0, 3.0, -3.0, 3.0]


def test_builds_are_reproducible(tmp_path):
    spec = ROOT / "specs" / "state_feedback.toml"
    for folder in ("a", "b"):
        build(spec, out=tmp_path / folder)
    for name in ("StrictFeedbackPlant.fmu", "StateFeedbackController.fmu"):
        one, two = ((tmp_path / folder / name).read_bytes() for folder in ("a", "b"))
        assert one == two == (FMUS / name).read_bytes()


CYCLES = """
import gc, sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.fmus.instance import loaded
import resource
path = Path({fmu!r})
for k in range(300):
    with loaded(path) as (instance,):
        instance.start()
        assert instance.step(0.0, 0.01) == 0
    if k % 20 == 0:
        gc.collect()
    if k == 100:
        early = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - early
print(grown / 200)
"""


@pytest.mark.slow
def test_many_instances():
    """Instances come and go: no crash, and no more than what the wrapper itself leaks."""
    script = CYCLES.format(root=str(ROOT), fmu=str(FMUS / "StateFeedbackController.fmu"))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 30.0  # kB an instance


def test_instances_do_not_share_state():
    with loaded(FMUS / "StrictFeedbackPlant.fmu", 3) as plants:
        for k, plant in enumerate(plants):
            plant.start(u=float(k))
        for step in range(5):
            for plant in plants:
                assert plant.step(step * 0.1, 0.1) == 0
        interleaved = [plant.get("x[1]", "x[2]") for plant in plants]
    for k, expected in enumerate(interleaved):
        with loaded(FMUS / "StrictFeedbackPlant.fmu") as (alone,):
            alone.start(u=float(k))
            for step in range(5):
                assert alone.step(step * 0.1, 0.1) == 0
            assert alone.get("x[1]", "x[2]") == expected
