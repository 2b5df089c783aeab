"""Write the tables of docs/benchmarks.md on peers: ``python -m benchmarks.peers [--quick]``.

Each table is of a process of its own. Times are those of the processor, the least of some rounds in
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

from benchmarks.__main__ import PAGE, Part
from benchmarks.accuracy import error_of
from benchmarks.cases import Figure, figure, native
from benchmarks.engines.monolithic import Monolithic
from benchmarks.engines.ours import coupled_system
from benchmarks.exact import Exact
from benchmarks.machine import description
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
OWN_GOAL = 0.1
"""Microseconds of a macro step that the loop may take itself."""
STEPS = 100_000
"""Macro steps, so many that the start of our run, which counts with it, does not show."""

LSODA, DOP853 = (f"{name}, compiled, on the same functions in C" for name in ("LSODA", "DOP853"))
CVODES = tuple(f"CVODE, {kind}, compiled, on the same functions in C" for kind in ("Adams", "BDF"))
IN_PYTHON = "`solve_ivp`, LSODA, on Python functions"
SAME_METHOD = "DOP853, compiled, at the tolerance of `model_exchange`"
HERMITE, EXCHANGE = (f"`{c}`, the compiled loop alone" for c in ("hermite", "model_exchange"))
RATIOS: Mapping[str, tuple[tuple[str, str, tuple[str, ...], float], ...]] = {
    "fig2": (
        ("the faster of LSODA and DOP853", HERMITE, (LSODA, DOP853), 2.0),
        ("the same method on the inlined loop", EXCHANGE, (SAME_METHOD,), 2.2),
        ("`solve_ivp`, LSODA, on Python functions", HERMITE, (IN_PYTHON,), 0.1),
    ),
    "fig3": (
        ("LSODA", HERMITE, (LSODA,), 2.5),
        ("the faster of CVODE's methods", HERMITE, CVODES, 1.2),
        ("the fastest", HERMITE, (LSODA, DOP853, *CVODES), 6.0),
        ("the same method on the inlined loop", EXCHANGE, (SAME_METHOD,), 2.2),
        ("`solve_ivp`, LSODA, on Python functions", HERMITE, (IN_PYTHON,), 0.1),
    ),
}
"""Of each figure: compared with what, which time, the least of which times, at most so many."""


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
            f"{GOALS[name]:.0f}: {_met(least[name] / least['ours'] >= GOALS[name])}"
            if name in GOALS
            else "",
        ]
        for title, name in ENGINES.items()
        if name in least
    ]
    own = 1e6 * own_cost(coupled_system(loop), steps, rounds)
    goal = f"{OWN_GOAL} us: {_met(own <= OWN_GOAL)}"
    rows.append(["congelation, with functions that do nothing", f"{own:.3f}", "", goal])
    head = ["native pair of Fig. 2, held inputs", "us per macro step", "÷ congelation", "goal"]
    return [*table(head, rows), *(f"\nNot run: {failure}." for failure in failures)]


def _met(is_met: bool) -> str:
    return "met" if is_met else "**missed**"


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
    title = IN_PYTHON
    settings[title] = f"{tolerance:.1e}"
    timed[title] = lambda: (
        python.run("LSODA", tolerance, shipped.stop_time, keep_rows=False).seconds
    )
    # The method and tolerance of `model_exchange`, whose states have nominal values of 1.
    exchange = float(settings["`model_exchange`"])
    title = SAME_METHOD
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
    """The tables of one figure: ratios to both loops, and those that there are goals for."""
    rows = [
        [
            title,
            settings[title],
            f"{1e3 * seconds:.3f}",
            *(f"{times[loop] / seconds:.2f}" for loop in (HERMITE, EXCHANGE)),
        ]
        for title, seconds in times.items()
    ]
    head = [f"{name}, error 1e-6", "tolerance", "ms", "`hermite` ÷ it", "`model_exchange` ÷ it"]
    goals = []
    for title, ours, theirs, most in RATIOS[name]:
        there = [times[other] for other in theirs if other in times]
        if there:
            ratio = times[ours] / min(there)
            found = f"{ratio:.2f}: {_met(ratio <= most)}"
            goals.append([f"{ours}, against {title}", f"{most:g}", found])
    return [
        *table(head, rows),
        "",
        *table([f"{name}, times its time", "goal, at most", "found"], goals),
        *(f"\nNot run: {reason}." for reason in missing),
    ]


def main() -> None:
    """Print all tables, and write them into docs/benchmarks.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="only show that everything runs; print, do not write"
    )
    parser.add_argument("--only", choices=("steps", *RATIOS), help="print one table")
    given = parser.parse_args()
    rounds, steps = (1, 500) if given.quick else (15, STEPS)
    if given.only == "steps":
        print("\n".join(macro_steps(min(rounds, 5), steps)))
        return
    if given.only is not None:
        print("\n".join(accuracy(given.only, 3 * rounds)))
        return
    lines = description("python -m benchmarks.peers")
    for part in ("steps", *RATIOS):
        command = [sys.executable, "-m", "benchmarks.peers", "--only", part]
        command += ["--quick"] if given.quick else []
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        lines += ["", done.stdout.strip()]
    text = "\n".join(lines)
    print(text)
    if not given.quick:
        page = Part("peers", lambda _: []).replaced(PAGE.read_text("utf-8"), text)
        PAGE.write_text(page, "utf-8")


if __name__ == "__main__":
    main()
