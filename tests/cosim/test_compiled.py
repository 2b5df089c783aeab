"""The compiled stepping loop does what the loops in Python do, to the last bit."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.coupling.parts import ABILITIES
from benchmarks.coupling.problems import PROBLEMS
from congelation.cosim import (
    Experiment,
    Memory,
    Output,
    Result,
    SlavePool,
    System,
    perform,
)
from congelation.cosim.compiled import base, library
from congelation.cosim.coupling.derivative import DerivativeStepper
from congelation.cosim.coupling.hermite import HermiteStepper
from congelation.cosim.session import Session
from congelation.scenario.load import load_scenario
from tests.cosim.c_fmus import bouncing_fmu, plain_fmu
from tests.cosim.sanitized import WAYS, faulty
from tests.scenarios import ROOT

HELD = {"tolerance": None, "step": 2e-3, "stop_time": 0.5, "output_interval": None}
SCENARIOS = ("scalar", "fig2", "fig3", "rivals")


def both(
    monkeypatch: pytest.MonkeyPatch, system: System, experiment: Experiment, **options: object
) -> tuple[Result, Result]:
    """A run by the compiled loop, and by Python."""
    assert library.loaded() is not None, "the stepping loop was not compiled"
    used = []
    called = base.Compiled.called
    with monkeypatch.context() as patch:
        patch.setattr(base.Compiled, "called", lambda *a: used.append(1) or called(*a))
        fast = perform(system, experiment, **options)
    assert used
    with monkeypatch.context() as patch:
        patch.setattr(library, "loaded", lambda: None)
        slow = perform(system, experiment, **options)
    return fast, slow


def assert_equal(fast: Result, slow: Result) -> None:
    assert (fast.status, fast.message, fast.names) == (slow.status, slow.message, slow.names)
    np.testing.assert_array_equal(fast.time, slow.time)
    np.testing.assert_array_equal(fast.values, slow.values)
    assert replace(fast.statistics, wall_time=0.0) == replace(slow.statistics, wall_time=0.0)


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenarios(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    for variant in scenario.variants[:2]:
        case = scenario.case(variant.settings)
        stop = min(case.experiment.stop_time, 0.7)  # theta jumps at 0.65 s
        shortened = replace(case.experiment, stop_time=stop, output_interval=None)
        if shortened.tolerance is not None:
            assert_equal(*both(monkeypatch, case.system, shortened))
            changed = replace(shortened, coupling="derivative", tolerance=1e-4)
            assert_equal(*both(monkeypatch, case.system, changed))
        for coupling in ("jacobi", "gauss_seidel", "derivative"):
            held = replace(shortened, coupling=coupling, **HELD)
            assert_equal(*both(monkeypatch, case.system, held))


def fig2(**changes: object) -> tuple[System, Experiment]:
    case = load_scenario(ROOT / "scenarios" / "fig2.toml").case({})
    usual = {"stop_time": 1.0, "output_interval": None}
    return case.system, replace(case.experiment, **{**usual, **changes})


@pytest.mark.parametrize("output", [Output(every=7), Output(interval=1e-2)])
@pytest.mark.parametrize("coupling", ["hermite", "jacobi"])
def test_which_rows_are_kept(
    monkeypatch: pytest.MonkeyPatch, coupling: str, output: Output
) -> None:
    changes = {} if coupling == "hermite" else {**HELD, "coupling": coupling}
    system, experiment = fig2(**changes)
    assert_equal(*both(monkeypatch, system, experiment, output=output))


@pytest.mark.parametrize("coupling", ["hermite", "derivative"])
@pytest.mark.parametrize("name", ["scalar", "fig2"])
def test_values_without_derivatives_shorten_steps(
    monkeypatch: pytest.MonkeyPatch, name: str, coupling: str
) -> None:
    """theta and theta_hat on two grids, across jumps of theta."""
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    case = scenario.case({"controller.damping": False})
    changes = {"stop_time": 1.5, "coupling": coupling, "tolerance": 1e-4, "output_interval": None}
    experiment = replace(case.experiment, **changes)
    coarse = [Memory(), Memory()]
    output = [[Output(interval=1e-3), Output(interval=0.02, sink=sink)] for sink in coarse]
    with monkeypatch.context() as patch:
        judged = []
        patch.setattr(Session, "unresolved", lambda self, time: judged.append(time) or 0.0)
        fast = perform(case.system, experiment, output=output[0])
    assert not judged, "Python has made a step"
    with monkeypatch.context() as patch:
        patch.setattr(library, "loaded", lambda: None)
        slow = perform(case.system, experiment, output=output[1])
    assert_equal(fast, slow)
    np.testing.assert_array_equal(coarse[0].rows(), coarse[1].rows())
    smooth = replace(experiment, record=("plant.x", "controller.u"))
    unjudged = perform(case.system, smooth, output=Output(interval=1e-3))
    assert fast.statistics.events == unjudged.statistics.events > 0
    assert fast.statistics.macro_steps > unjudged.statistics.macro_steps


@pytest.mark.parametrize("most", [1, 5, 100])
def test_steps_run_out(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    for changes in ({}, {**HELD, "coupling": "jacobi"}):
        system, experiment = fig2(max_steps=most, **changes)
        fast, slow = both(monkeypatch, system, experiment)
        assert_equal(fast, slow)
        assert fast.status.name == "TOO_MANY_STEPS"


@pytest.mark.parametrize("order", [4, 6])
def test_orders(monkeypatch: pytest.MonkeyPatch, order: int) -> None:
    system, experiment = fig2(options={"order": order, "acceleration": "broyden"})
    assert_equal(*both(monkeypatch, system, experiment))


def test_diverging(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held inputs at 10 ms: the loop of Fig. 2 is unstable, and a value overflows."""
    system, experiment = fig2(**{**HELD, "step": 2e-2, "stop_time": 50.0, "coupling": "jacobi"})
    fast, slow = both(monkeypatch, system, experiment)
    assert_equal(fast, slow)
    assert not fast.completed


# -- every coupling, every kind of FMU --------------------------------------------------------


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Steps made by the couplings in Python."""
    steps = {"Python": 0}
    for stepper in (HermiteStepper, DerivativeStepper):
        for name in ("advance", "attempt"):
            made = getattr(stepper, name)

            def count(self: object, *arguments: object, made: object = made) -> object:
                steps["Python"] += 1
                return made(self, *arguments)

            monkeypatch.setattr(stepper, name, count)
    return steps


# Of FMUs that cannot save their state, the ways that need none.
PAIRS = [
    (ability, way)
    for ability in ABILITIES
    for way in WAYS
    if ability in ("state", "full")
    or way in ("hermite of one iteration", "derivative at fixed steps", "derivative, all at once")
]


@pytest.mark.parametrize(("ability", "way"), PAIRS)
def test_problems(
    monkeypatch: pytest.MonkeyPatch, counted: dict[str, int], parts: Path, ability: str, way: str
) -> None:
    """FMUs with and without derivatives, inputs that can only be held, algebraic loops, relays."""
    with SlavePool() as pool:
        for problem in PROBLEMS[:: 1 if way == "derivative to a tolerance" else 3]:
            experiment = Experiment(stop_time=min(problem.stop, 0.2), max_steps=200, **WAYS[way])
            system = problem.system(parts, ability)
            counted["Python"] = 0
            with monkeypatch.context() as patch:
                patch.setattr(library, "loaded", lambda: None)
                slow = perform(system, experiment, pool=pool)
            by_python, counted["Python"] = counted["Python"], 0
            fast = perform(system, experiment, pool=pool)
            assert_equal(fast, slow)
            assert by_python > 0
            if fast.completed:
                assert counted["Python"] <= by_python // 4, problem.name


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "scenarios").glob("*.toml")))
def test_every_scenario(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """As it is, but for its length, and with `hermite` and `derivative` at fixed steps."""
    scenario = load_scenario(ROOT / "scenarios" / f"{name}.toml")
    case = scenario.case(scenario.variants[-1].settings)
    experiment = replace(case.experiment, stop_time=min(case.experiment.stop_time, 0.05))
    fixed = {**HELD, "stop_time": 0.03, "options": {}}
    with SlavePool() as pool:
        for each in (
            experiment,
            replace(experiment, coupling="hermite", **fixed),
            replace(experiment, coupling="derivative", **fixed),
        ):
            fast = perform(case.system, each, pool=pool)
            with monkeypatch.context() as patch:
                patch.setattr(library, "loaded", lambda: None)
                slow = perform(case.system, each, pool=pool)
            if not fast.completed:  # of a step that is given up, the calls are not compared
                calls = slow.statistics.fmi_calls
                fast = replace(fast, statistics=replace(fast.statistics, fmi_calls=calls))
            assert_equal(fast, slow)


# -- faulty FMUs, and sanitizers ----------------------------------------------------------------

FAULTS = {"NaN": 6.0, "discards": 7.0, "refuses": 8.0}
"""How a step past t = 0.5 goes wrong; see fmus/plain.c."""


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return plain_fmu(tmp_path_factory.mktemp("plain"))


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("way", [*WAYS, "jacobi", "gauss_seidel"])
def test_faulty_fmus(monkeypatch: pytest.MonkeyPatch, plain: Path, way: str, fault: str) -> None:
    """The same status, message and rows as by the couplings in Python."""
    change = WAYS.get(way, {"coupling": way, "step": 2e-3})
    system = faulty(plain, FAULTS[fault])
    fast, slow = both(monkeypatch, system, Experiment(stop_time=1.0, **change))
    assert_equal(fast, slow)
    assert not fast.completed
    assert 0.4 < fast.time[-1] <= 0.5


@pytest.mark.slow
def test_sanitizers_find_nothing(plain: Path, parts: Path, tmp_path: Path) -> None:
    """Runs of every kind, with checks of addresses and of undefined behaviour in the loop."""
    address = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
    ).stdout.strip()
    if not Path(address).is_file():
        pytest.skip("gcc has no libasan here")
    built = tmp_path / "loop.so"
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-ffp-contract=off"]
    source = ROOT / "congelation" / "cosim" / "loop" / "loop.c"
    subprocess.run(
        ["gcc", "-std=c99", "-O1", "-g", *checks, "-shared", "-fPIC", source, "-o", built, "-lm"],
        check=True,
    )
    # Python and the FMUs keep memory until the end, which is no fault of the loop.
    ended = subprocess.run(
        [
            sys.executable,
            "-m",
            "tests.cosim.sanitized",
            built,
            parts,
            plain,
            bouncing_fmu(tmp_path),
        ],
        cwd=ROOT,
        env={**os.environ, "LD_PRELOAD": address, "ASAN_OPTIONS": "detect_leaks=0"},
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert int(ended.stdout) >= 64, "runs that the loop has made"
