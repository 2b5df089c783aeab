"""Runs of every kind in a compiled loop that is given: ``python -m tests.cosim.sanitized LIBRARY
PARTS PLAIN BALL`` prints how many there were."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.coupling.problems import PROBLEMS
from congelation.cosim import (
    Component,
    Connection,
    Experiment,
    Hermite,
    Memory,
    Output,
    SlavePool,
    System,
    make_coupling,
    perform,
)
from congelation.cosim.compiled import base, library

WAYS: Mapping[str, Mapping[str, Any]] = {
    "hermite to a tolerance": {"coupling": "hermite", "tolerance": 1e-4},
    "hermite at fixed steps": {"coupling": "hermite", "step": 2e-3},
    "hermite of three plain iterations": {"coupling": Hermite(iterations=3), "step": 2e-3},
    "hermite of one iteration": {"coupling": Hermite(iterations=1), "step": 2e-3},
    "derivative to a tolerance": {"coupling": "derivative", "tolerance": 1e-3},
    "derivative at fixed steps": {"coupling": "derivative", "step": 2e-3},
    "derivative, all at once": {
        "coupling": make_coupling("derivative", {"sequence": "jacobi"}),
        "step": 2e-3,
    },
}


def faulty(plain: Path, fault: float) -> System:
    """Two plain FMUs in a loop, one of which goes wrong past t = 0.5."""
    return System(
        (
            Component("good", plain, {"a": -1.0, "b1": -1.0, "x0": 1.0}),
            Component("bad", plain, {"a": -2.0, "b1": 1.0, "d1": 0.25, "fault": fault}),
        ),
        (Connection("good.y", "bad.u1"), Connection("bad.y", "good.u1")),
    )


def main(file: Path, parts: Path, plain: Path, ball: Path) -> int:
    """The number of runs in which the library was called."""
    found = library.load_library(file)
    assert found is not None
    library.loaded = lambda: found  # type: ignore[assignment]
    used = set()
    called = base.Compiled.called
    base.Compiled.called = lambda self, *a: used.add(runs) or called(self, *a)  # type: ignore
    runs = 0
    held = {name: {"coupling": name, "step": 2e-3} for name in ("jacobi", "gauss_seidel")}
    for way in [*WAYS.values(), *held.values()]:
        with SlavePool() as pool:
            for ability in ("state", "full"):
                for problem in PROBLEMS[::4]:
                    runs += 1
                    experiment = Experiment(stop_time=min(problem.stop, 0.1), max_steps=300, **way)
                    output = [Output(every=3), Output(interval=1e-3, sink=Memory())]
                    perform(problem.system(parts, ability), experiment, output=output, pool=pool)
        for fault in (6.0, 7.0, 8.0):
            runs += 1
            perform(faulty(plain, fault), Experiment(stop_time=1.0, **way))
    for change in ({}, {"asks": 0.1}, *({"fault": float(k), "asks": 0.1} for k in range(1, 6))):
        for output in (Output(), Output(interval=0.01)):
            runs += 1
            system = System((Component("ball", ball, {"g": 9.0, "e": 0.5, "x0": 1.0} | change),))
            experiment = Experiment(stop_time=0.7, tolerance=1e-6, coupling="model_exchange")
            perform(system, experiment, output=output)
    return len(used)


if __name__ == "__main__":
    print(main(*map(Path, sys.argv[1:])))
