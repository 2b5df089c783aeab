"""Write tables of times, in Markdown: ``python -m benchmarks.peers [--quick]``.

Each figure is a process of its own. Times are those of the processor, the least of some rounds in
which all programs take turns.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

from benchmarks.accuracy import error_of
from benchmarks.cases import Figure, figure, native
from benchmarks.engines.monolithic import Monolithic
from benchmarks.engines.ours import coupled_system
from benchmarks.exact import Exact
from benchmarks.macro_step import STEP
from benchmarks.markdown import table
from benchmarks.peers.equation import Equation
from benchmarks.timing import interleaved
from benchmarks.workers import workers
from congelation.cosim import SlavePool, System, simulate
from congelation.cosim.compiled import base
from congelation.fmi.slave import Slave

ROOT = Path(__file__).absolute().parents[2]
FOLDER = ROOT / "build" / "peers"
TARGET = 1e-6
TOLERANCES = tuple(10.0 ** (-k / 4.0) for k in range(16, 45))
ENGINES = {
    "congelation, `jacobi`": "ours",
    "Ecos": "ecos",
    "libcosim": "libcosim",
    "plain FMPy loop": "fmpy_loop",
    "FMPy `simulate_ssp`": "fmpy_ssp",
}
GOALS = {"ecos": 3.0, "libcosim": 10.0, "fmpy_loop": 30.0, "fmpy_ssp": 35.0}


def macro_steps(rounds: int, steps: int) -> list[str]:
    """Held inputs: every engine on the native pair of Fig. 2."""
    loop = native(figure("fig2")).loop
    connected = dict.fromkeys((source, name) for source, name, _, _ in loop.connections)
    loop = replace(loop, record=tuple(connected))
    with workers({name: (name, loop) for name in ENGINES.values()}) as (running, failures):
        times = interleaved(
            {
                name: (lambda worker=worker: worker.seconds(steps=steps, step=STEP))
                for name, worker in running.items()
            },
            rounds,
        )
    least = {name: timing.per(steps).least for name, timing in times.items()}
    rows = [
        [
            title,
            f"{1e6 * least[name]:.2f}",
            f"{least[name] / least['ours']:.1f}",
            f"{GOALS[name]:.0f}" if name in GOALS else "",
        ]
        for title, name in ENGINES.items()
        if name in least
    ]
    own = own_cost(coupled_system(loop), steps, rounds)
    rows.append(["congelation, with functions that do nothing", f"{1e6 * own:.3f}", "", "0.1 us"])
    head = ["native pair of Fig. 2, held inputs", "us per macro step", "÷ congelation", "goal"]
    return [*table(head, rows), *(f"\nNot run: {failure}." for failure in failures)]


def own_cost(system: System, steps: int, rounds: int) -> float:
    """Seconds of a macro step in which every FMI function is one that does nothing."""
    with tempfile.TemporaryDirectory() as folder:
        source, file = Path(folder) / "nothing.c", Path(folder) / "nothing.so"
        source.write_text("int nothing(void) { return 0; }\n")
        subprocess.run(["gcc", "-O2", "-shared", "-fPIC", source, "-o", file], check=True)
        nothing = ctypes.cast(ctypes.CDLL(str(file)).nothing, ctypes.c_void_p).value or 0
    address = Slave.address
    Slave.address = lambda self, function: nothing  # type: ignore[method-assign]
    try:
        with SlavePool() as pool:

            def seconds(count: int) -> float:
                begin = process_time()
                simulate(system, stop_time=count * STEP, step=STEP, coupling="jacobi", pool=pool)
                return process_time() - begin

            # What is not a step is the same in both.
            return min(seconds(4 * steps) - seconds(steps) for _ in range(rounds)) / (3 * steps)
    finally:
        Slave.address = address  # type: ignore[method-assign]


class Loops:
    """`simulate` on the native pair; it also takes the time within the compiled loop alone."""

    def __init__(self, found: Figure) -> None:
        self._system = coupled_system(found.loop)
        self._record = [f"{owner}.{name}" for owner, name in found.loop.record]
        self._stop = found.stop_time
        self._pool = SlavePool()
        self.inside = 0.0
        called = base.Compiled.called

        def timed(compiled: Any, function: Callable[..., int], *arguments: Any) -> int:
            def inner(*given: object) -> int:
                begin = process_time()
                code = function(*given)
                self.inside += process_time() - begin
                return code

            return called(compiled, inner, *arguments)

        base.Compiled.called = timed  # type: ignore[method-assign]

    def run(self, coupling: str, tolerance: float, share: float) -> Any:
        """The result."""
        self.inside = 0.0
        return simulate(
            self._system,
            stop_time=self._stop,
            tolerance=tolerance,
            coupling=coupling,
            slave_tolerance=share * tolerance,
            record=self._record,
            pool=self._pool,
        )


def accuracy(name: str, rounds: int) -> list[str]:
    """Time to an error of 1e-6 of one figure."""
    shipped = figure(name)
    found = native(shipped)
    exact = Exact(shipped, shipped.stop_time)
    loops, equation, python = Loops(found), Equation(found, FOLDER), Monolithic(shipped.loop)

    def of_loops(coupling: str, tolerance: float, share: float) -> float:
        result = loops.run(coupling, tolerance, share)
        rows = [[t, *v] for t, v in zip(result.time[1:], result.values[1:], strict=True)]
        return error_in(rows)

    def error_in(rows: Any) -> float:
        import numpy as np

        rows = np.array(rows)
        return error_of(rows, exact.values(rows[:, 0]))

    def of_equation(method: str, tolerance: float) -> float:
        return error_in(equation.rows(equation.run(method, tolerance)))

    def of_python(tolerance: float) -> float:
        run = python.run("LSODA", tolerance, shipped.stop_time, keep_rows=True)
        return error_in(run.rows)

    def cheapest(error: Callable[[float], float]) -> float:
        return next(t for t in TOLERANCES if error(t) <= TARGET)

    timed: dict[str, Callable[[], float]] = {}
    settings: dict[str, str] = {}
    for coupling in ("hermite", "model_exchange"):
        share = 1.0
        tolerance = cheapest(lambda t, c=coupling: of_loops(c, t, 1.0))  # type: ignore[misc]
        title = f"`{coupling}`"
        settings[title] = settings[f"{title}, the compiled loop alone"] = f"{tolerance:.1e}"
        arguments = coupling, tolerance, share
        timed[title] = lambda a=arguments: clocked(lambda: loops.run(*a))  # type: ignore[misc]

        def inside(a: tuple[str, float, float] = arguments) -> float:
            loops.run(*a)
            return loops.inside

        timed[f"{title}, the compiled loop alone"] = inside
    for method in equation.methods:
        tolerance = cheapest(lambda t, m=method: of_equation(m, t))  # type: ignore[misc]
        title = f"{method}, compiled, on the same functions in C"
        settings[title] = f"{tolerance:.1e}"
        timed[title] = lambda m=method, t=tolerance: clocked(  # type: ignore[misc]
            lambda: equation.run(m, t)
        )
    tolerance = cheapest(of_python)
    title = "`solve_ivp`, LSODA, on Python functions"
    settings[title] = f"{tolerance:.1e}"
    timed[title] = lambda: (
        python.run("LSODA", tolerance, shipped.stop_time, keep_rows=False).seconds
    )
    # The method and tolerance of `model_exchange`, whose states have nominal values of 1.
    exchange = float(settings["`model_exchange`"])
    title = "DOP853, compiled, at the tolerance of `model_exchange`"
    settings[title] = settings["`model_exchange`"]
    timed[title] = lambda: clocked(lambda: equation.run("DOP853", exchange))
    times = {key: t.least for key, t in interleaved(timed, rounds).items()}
    return figure_table(name, times, settings, equation.missing)


def clocked(function: Callable[[], object]) -> float:
    """Processor time of one call, in seconds."""
    begin = process_time()
    function()
    return process_time() - begin


def figure_table(
    name: str, times: Mapping[str, float], settings: Mapping[str, str], missing: tuple[str, ...]
) -> list[str]:
    """The table of one figure, with the ratios to both loops."""
    loops = [f"`{c}`, the compiled loop alone" for c in ("hermite", "model_exchange")]
    rows = [
        [
            title,
            settings[title],
            f"{1e3 * seconds:.3f}",
            *(f"{times[loop] / seconds:.2f}" for loop in loops),
        ]
        for title, seconds in times.items()
    ]
    head = [f"{name}, error 1e-6", "tolerance", "ms", "`hermite` ÷ it", "`model_exchange` ÷ it"]
    return [*table(head, rows), *(f"\nNot run: {reason}." for reason in missing)]


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="only show that everything runs")
    parser.add_argument("--only", choices=("steps", "fig2", "fig3"), help="one table")
    given = parser.parse_args()
    rounds, steps = (1, 500) if given.quick else (15, 20_000)
    if given.only is None:
        for part in ("steps", "fig2", "fig3"):
            command = [sys.executable, "-m", "benchmarks.peers", "--only", part]
            subprocess.run([*command, *(["--quick"] if given.quick else [])], check=True)
            print()
    elif given.only == "steps":
        print("\n".join(macro_steps(min(rounds, 5), steps)))
    else:
        print("\n".join(accuracy(given.only, 3 * rounds)))


if __name__ == "__main__":
    main()
