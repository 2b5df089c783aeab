"""Small measurements: the generated law, deriving, loading, and single calls of an FMU."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from ctypes import byref, c_double, c_uint, c_void_p
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cases import figure
from benchmarks.engines.bare import Bare, Instance
from benchmarks.loop import variables
from benchmarks.timing import Stopwatch, Timing, interleaved, per_call
from congelation.export.equations import Special, equations_module
from congelation.theory.adaptation import NEUTRAL, robust
from congelation.theory.model import Model
from congelation.theory.state_feedback import state_feedback_controller
from congelation.theory.values import complete_values

__all__ = ["Micro", "measure"]

SEED = 20180627
"""Of the random plants: their regressors are dense, the worst case."""

CALLS = 2000
REALS = 10


@dataclass(frozen=True)
class Micro:
    """One measurement.

    Parameters
    ----------
    what : str
    time : Timing
    goal : float or None
        Seconds; None where there is none.
    """

    what: str
    time: Timing
    goal: float | None


def measure(rounds: int, orders: tuple[int, int]) -> list[Micro]:
    """All of them.

    Parameters
    ----------
    rounds : int
        Repetitions of the quick ones; the slow ones are made three times at most.
    orders : (int, int)
        n and p of the law that is derived for its derivation's time.
    """
    few = min(rounds, 3)
    return [
        *_laws(rounds),
        _derivation(few, *orders),
        *_loading(few),
        *_calls(rounds),
    ]


def phibar(n: int, p: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """A dense random plant (9)."""
    generator = np.random.default_rng(SEED)
    dense = generator.uniform(-1.0, 1.0, (n, n, p))
    rows, columns = np.triu_indices(n, 1)
    dense[rows, columns] = 0.0
    return dense


def _laws(rounds: int) -> list[Micro]:
    """One evaluation of u and of the rates of the estimates, as the FMUs do it."""
    paper = state_feedback_controller()
    larger = state_feedback_controller(phibar(3, 2))
    laws = {
        "law of system (60), n = 2, p = 2: u": (_evaluation(paper, "outputs"), None),
        "law of system (60), n = 2, p = 2: θ̂′": (_evaluation(paper, "rates"), None),
        "dense law, n = 3, p = 2: u": (_evaluation(larger, "outputs"), 10e-6),
        "dense law, n = 3, p = 2: θ̂′": (_evaluation(larger, "rates"), 10e-6),
    }
    times = interleaved(
        {name: partial(per_call, call, CALLS) for name, (call, _) in laws.items()}, rounds
    )
    return [Micro(f"evaluate the {name}", times[name], laws[name][1]) for name in laws]


def _evaluation(model: Model, function: str) -> Callable[[], object]:
    namespace: dict[str, Any] = {}
    exec(equations_module(model), namespace)
    values = complete_values(model, None)
    groups = [p.variables for p in model.parameters] + [g.variables for g in model.gains]
    numbers = [float(v) for group in groups for v in np.ravel(values[group.name], "F")]
    functions = dict(
        zip(("rates", "outputs", "derivatives", "step"), namespace["bind"](*numbers), strict=True)
    )
    states = tuple(0.1 for s in model.states for _ in s.variables.names)
    inputs = tuple(0.1 for i in model.inputs for _ in i.variables.names)
    return partial(functions[function], states, inputs)


def _derivation(rounds: int, n: int, p: int) -> Micro:
    """From a dense plant to the text of the law, with and without the rival adaptation laws."""

    def derive() -> float:
        watch = Stopwatch()
        plant = phibar(n, p)
        plain = Special(state_feedback_controller(plant), NEUTRAL)
        equations_module(state_feedback_controller(plant, robust), plain)
        return watch.seconds()

    times = interleaved({"derive": derive}, rounds)
    return Micro(f"derive and write out the dense law, n = {n}, p = {p}", times["derive"], 10.0)


_LOADING = """
from benchmarks.timing import Stopwatch
import fmpy, sys
from fmpy.fmi2 import FMU2Slave
file = sys.argv[1]
description = fmpy.read_model_description(file, validate=False)
folder = fmpy.extract(file)
for _ in range(5):
    watch = Stopwatch()
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=folder, instanceName="one",
        modelIdentifier=description.coSimulation.modelIdentifier,
    )
    slave.instantiate()
    print(watch.seconds(), flush=True)
import os
os._exit(0)
"""


def _loading(rounds: int) -> list[Micro]:
    """Loading the library and instantiating, first and later, in fresh processes."""
    file = next(c.fmu for c in figure("fig3").loop.components if c.name == "controller")
    first, later = [], []
    for _ in range(rounds):
        ended = subprocess.run(
            [sys.executable, "-c", _LOADING, file],
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).absolute().parent.parent,
        )
        seconds = [float(line) for line in ended.stdout.split()]
        first.append(seconds[0])
        later += seconds[1:]
    name = Path(file).stem
    return [
        Micro(f"instantiate {name}, first in a process", Timing(tuple(first)), 0.5),
        Micro(f"instantiate {name}, later", Timing(tuple(later)), 0.02),
    ]


def _calls(rounds: int) -> list[Micro]:
    """Single calls through preallocated buffers."""
    engine = Bare(figure("fig2").loop)
    plant, controller = engine.instances
    calls: dict[str, tuple[Callable[[], object], float | None]] = {}
    for instance in (plant, controller):
        instance.initialise()
        name = Path(instance.component.fmu).stem
        table = variables(instance.component.fmu)
        outputs = [v.reference for v in table.values() if v.causality == "output"]
        own = _reals(instance, (outputs * REALS)[:REALS])
        inputs = [v.reference for n, v in table.items() if v.causality == "input"]
        repeated = _reals(instance, (inputs * REALS)[:REALS])
        calls[f"{name}: get {REALS} reals"] = (partial(_read, instance, own), 10e-6)
        calls[f"{name}: set {REALS} reals"] = (partial(_write, instance, repeated), 10e-6)
        calls[f"{name}: set {REALS} reals, then get {REALS}, which are evaluated anew"] = (
            partial(_renewed, instance, repeated, own),
            None,
        )
        calls[f"{name}: get + set the whole state"] = (_state_calls(instance), 60e-6)
    times = interleaved(
        {name: partial(per_call, call, CALLS) for name, (call, _) in calls.items()}, rounds
    )
    return [Micro(name, times[name], calls[name][1]) for name in calls]


def _reals(instance: Instance, references: list[int]) -> tuple[Any, int, Any]:
    n = len(references)
    arrays = (c_uint * n)(*references), n, (c_double * n)()
    instance.get_real(instance.handle, *arrays)
    return arrays


def _read(instance: Instance, arrays: tuple[Any, int, Any]) -> None:
    instance.get_real(instance.handle, *arrays)


def _write(instance: Instance, arrays: tuple[Any, int, Any]) -> None:
    instance.set_real(instance.handle, *arrays)


def _renewed(instance: Instance, given: tuple[Any, int, Any], read: tuple[Any, int, Any]) -> None:
    instance.set_real(instance.handle, *given)
    instance.get_real(instance.handle, *read)


def _state_calls(instance: Instance) -> Callable[[], None]:
    get = instance.function("fmi2GetFMUstate", c_void_p)
    put = instance.function("fmi2SetFMUstate", c_void_p)
    free = instance.function("fmi2FreeFMUstate", c_void_p)
    handle = instance.handle

    def both() -> None:
        state = c_void_p()
        get(handle, byref(state))
        put(handle, state)
        free(handle, byref(state))

    return both
