"""The compiled stepping loop does what the loops in Python do, to the last bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from congelation.cosim import Experiment, Memory, Output, Result, System, perform
from congelation.cosim import compiled as module
from congelation.cosim.session import Session
from congelation.scenario.load import load_scenario
from tests.scenarios import ROOT

HELD = {"tolerance": None, "step": 1e-3, "stop_time": 0.5, "output_interval": None}
SCENARIOS = ("scalar", "fig2", "fig3", "rivals")


def both(
    monkeypatch: pytest.MonkeyPatch, system: System, experiment: Experiment, **options: object
) -> tuple[Result, Result]:
    """A run by the compiled loop, and by Python."""
    assert module.library() is not None, "the stepping loop was not compiled"
    used = []
    called = module._Compiled.called
    with monkeypatch.context() as patch:
        patch.setattr(module._Compiled, "called", lambda *a: used.append(1) or called(*a))
        fast = perform(system, experiment, **options)
    assert used
    with monkeypatch.context() as patch:
        patch.setattr(module, "library", lambda: None)
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
    for variant in scenario.variants[:3]:
        case = scenario.case(variant.settings)
        stop = min(case.experiment.stop_time, 1.0)
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
        patch.setattr(module, "library", lambda: None)
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
