"""Work and precision: what a run costs, and how far it is from the solution.

The error of a run is the largest over its variables of the largest distance from the solution over
its rows, relative to the largest of the solution. Time is that of the processor, see
`benchmarks.timing`; loading is left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from benchmarks.coupling.problems import Problem, problem
from benchmarks.loop import Component, Loop
from benchmarks.timing import Stopwatch
from benchmarks.workers import EngineError, Worker

__all__ = ["METHODS", "SHOWN", "Method", "Point", "draw", "measure", "shown", "table"]

SHOWN = (
    "two_masses_force",
    "quarter_car",
    "spring_damper",
    "van_der_pol_5",
    "relay",
    "oscillator",
    "two_masses_loop",
    "stiff_loop",
    "lorenz",
)
"""The problems of the diagrams."""

LOOKED_AT = 500
"""Rows of a run, at least, whose errors are looked at; solutions take longer than runs."""

PREDICTABLE = 5.0
"""Seconds for which chaos is followed."""

LEAST, MOST = 1e-12, 1e1
"""Errors that diagrams show."""

TARGETS = (1e-2, 1e-4, 1e-6)
"""That the table asks for."""

SOLVER_TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)

MONOLITHIC = "monolithic"


@dataclass(frozen=True)
class Method:
    """A program at some settings.

    Parameters
    ----------
    label : str
        In tables and diagrams.
    engine : str
        Module of benchmarks.engines.
    ability : str
        Of the FMUs, see `parts.ABILITIES`.
    coupling : str
        Of congelation's master, else empty.
    tolerances : tuple of float
        That steps are chosen by; empty: the fixed steps of the problem.
    colour, marker : str
        In diagrams.
    """

    label: str
    engine: str
    ability: str
    colour: str
    marker: str
    coupling: str = ""
    tolerances: tuple[float, ...] = ()


_CHOSEN = (1e-1, 1e-2, 1e-3)
_STRICT = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8)

METHODS = (
    Method("hermite, tolerance", "master", "full", "#0072B2", "o", "hermite", _STRICT),
    Method(
        "hermite, tolerance, held inputs", "master", "state", "#56B4E9", "o", "hermite", _CHOSEN
    ),
    Method("derivative", "master", "full", "#009E73", "s", "derivative"),
    Method("derivative, held inputs", "master", "held", "#009E73", "D", "derivative"),
    Method("jacobi", "master", "held", "#E69F00", "s", "jacobi"),
    Method("FMPy loop", "fmpy_loop", "held", "#000000", "x"),
    Method("libcosim", "libcosim", "held", "#D55E00", "x"),
    Method("libcosim, ECCO", "ecco", "held", "#D55E00", "^", "", _CHOSEN),
    Method("Ecos", "ecos", "held", "#CC79A7", "x"),
)

_SOLVERS: Mapping[str, str] = MappingProxyType({"DOP853": "-", "LSODA": ":"})


@dataclass(frozen=True)
class Point:
    """A run.

    Parameters
    ----------
    problem, method : str
    length : float
        Step, or tolerance.
    seconds, error : float
        Of the processor; relative.
    """

    problem: str
    method: str
    length: float
    seconds: float
    error: float


def shown() -> list[Problem]:
    """The problems of the diagrams; chaos is cut where it can still be followed."""
    found = [problem(name) for name in SHOWN]
    return [replace(p, stop=min(p.stop, PREDICTABLE)) if p.chaotic else p for p in found]


def measure(
    folder: Path, found: Problem, methods: tuple[Method, ...] = METHODS
) -> tuple[list[Point], list[str]]:
    """All methods on a problem; and what did not run, and why."""
    points, failures = [], []
    for method in methods:
        system = found.system(folder, method.ability)
        loop = Loop(
            found.name,
            tuple(Component(c.name, str(c.fmu), dict(c.start)) for c in system.components),
            tuple((*c.source.split("."), *c.target.split(".")) for c in system.connections),
            tuple(tuple(name.split(".")) for name in found.record),
        )
        try:
            with Worker(method.engine, loop) as worker:
                for settings, length in _settings(found, method):
                    try:
                        points.append(_point(found, method.label, worker, settings, length))
                    except EngineError as error:
                        failures.append(f"{found.name}, {length:g}: {error}")
        except EngineError as error:
            failures.append(f"{found.name}: {error}")
    return [*points, *_monolithic(found)], failures


def _settings(found: Problem, method: Method) -> Iterator[tuple[dict[str, float | str], float]]:
    """Arguments of a program's `run`, and the step or tolerance."""
    if method.tolerances:
        for tolerance in method.tolerances:
            settings: dict[str, float | str] = {"tolerance": tolerance, "stop_time": found.stop}
            yield settings | ({"coupling": method.coupling} if method.coupling else {}), tolerance
        return
    for step in found.steps:
        if method.coupling:
            yield {"coupling": method.coupling, "step": step, "stop_time": found.stop}, step
        else:
            yield {"steps": round(found.stop / step), "step": step}, step


def _point(
    found: Problem, label: str, worker: Worker, settings: dict[str, float | str], length: float
) -> Point:
    first, rows = worker.trajectory(**settings)
    rows = rows[rows[:, 0] <= found.stop * (1.0 + 1e-9)]
    rows = rows[:: max(1, len(rows) // LOOKED_AT)]
    exact = found.exact(rows[:, 0])
    error = np.abs(rows[:, 1:] - exact).max(axis=0) / np.abs(exact).max(axis=0)
    seconds = min(first, worker.seconds(**settings))
    return Point(found.name, label, length, seconds, float(error.max()))


def _monolithic(found: Problem) -> list[Point]:
    """scipy's solvers on the equations as one system."""
    times = np.linspace(0.0, found.stop, 201)
    exact = found.exact(times)
    points = []
    for solver in _SOLVERS:
        for tolerance in SOLVER_TOLERANCES:
            how = {"method": solver, "rtol": tolerance, "atol": 1e-3 * tolerance}
            watch = Stopwatch()
            values = found.solution.solved(found, times, **how)
            seconds = watch.seconds()
            error = np.abs(values - exact).max(axis=0) / np.abs(exact).max(axis=0)
            label = f"{MONOLITHIC}, {solver}"
            points.append(Point(found.name, label, tolerance, seconds, float(error.max())))
    return points


def draw(points: list[Point], file: Path) -> None:
    """Error against processor time, one panel per problem."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(point.problem for point in points))
    columns = 2
    figure = Figure(figsize=(9.0, 2.9 * math.ceil(len(names) / columns)), layout="constrained")
    axes = figure.subplots(math.ceil(len(names) / columns), columns, squeeze=False).reshape(-1)
    for axis in axes[len(names) :]:
        axis.remove()
    styles = {m.label: {"color": m.colour, "marker": m.marker, "linestyle": "-"} for m in METHODS}
    for solver, line in _SOLVERS.items():
        styles[f"{MONOLITHIC}, {solver}"] = {"color": "0.55", "linestyle": line}
    for axis, name in zip(axes, names, strict=False):
        for label, style in styles.items():
            own = [p for p in points if (p.problem, p.method) == (name, label)]
            good = [p for p in own if LEAST < p.error < MOST]
            axis.plot(
                [p.seconds for p in good],
                [p.error for p in good],
                label=label,
                linewidth=1.0,
                markersize=4.0,
                **style,
            )
        axis.set(xscale="log", yscale="log", ylim=(LEAST, MOST), title=problem(name).title)
        axis.grid(color="0.9", linewidth=0.5)
        axis.set_xlabel("processor time in s")
        axis.set_ylabel("error over peak")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    figure.savefig(file, dpi=110, metadata={"Software": None})


def table(points: list[Point]) -> list[str]:
    """Processor time of the cheapest run within an error, in milliseconds, as Markdown."""
    methods = list(dict.fromkeys(point.method for point in points))
    head = " | ".join(f"{target:.0e}" for target in TARGETS)
    lines = [
        f"| problem | method | {head} | least error |",
        "|---|---|" + "---|" * (len(TARGETS) + 1),
    ]
    for found in dict.fromkeys(point.problem for point in points):
        for method in methods:
            own = [p for p in points if (p.problem, p.method) == (found, method)]
            if not own:
                continue
            cells = []
            for target in TARGETS:
                good = [1e3 * p.seconds for p in own if p.error <= target]
                cells.append(f"{min(good):.3g}" if good else "")
            least = min(p.error for p in own)
            lines.append(
                f"| {problem(found).title} | {method} | {' | '.join(cells)} | {least:.1e} |"
            )
    return lines
