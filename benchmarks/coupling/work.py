"""Work and precision: what a run costs, and how far it is from the solution.

The error of a run is the largest over its variables of the largest distance from the solution over
its rows, relative to the largest of the solution. Time is that of the processor, see
`benchmarks.timing`; loading is left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from benchmarks.cases import figure, native
from benchmarks.coupling.problems import Problem, problem
from benchmarks.exact import Exact
from benchmarks.loop import Component, Loop
from benchmarks.timing import Stopwatch
from benchmarks.workers import EngineError, Worker

__all__ = [
    "FIGURES",
    "METHODS",
    "SHOWN",
    "Case",
    "Method",
    "Point",
    "draw",
    "measure",
    "of_figure",
    "of_problem",
    "shown",
    "table",
]

Floats = npt.NDArray[np.float64]

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

FIGURES: Mapping[str, str] = MappingProxyType(
    {"fig2": "Fig. 2, Controller 1", "fig3": "Fig. 3, Controller 1"}
)
"""The loops of the paper in the diagrams, by their scenarios: native FMUs that have all abilities,
so that methods which need others are left out."""

FIGURE_STOP, FIGURE_STEPS = 2.0, (1e-3, 5e-4, 2e-4, 1e-4)
"""Seconds; three jumps of theta, and the transient in which couplings differ most."""

LOOKED_AT = 500
"""Rows of a run, at least, whose errors are looked at; solutions take longer than runs."""

PREDICTABLE = 5.0
"""Seconds for which chaos is followed."""

LONG = 1.0
"""Seconds of a run from which on it is not made a second time, of which the faster counts."""

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
    Method("derivative, held inputs", "master", "state", "#009E73", "D", "derivative"),
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
        The title, and the label.
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


Solved = tuple[str, float, float, Floats, Floats]
"""Solver, tolerance, seconds; times, shape (N,), and recorded variables there, shape (N, M)."""


@dataclass(frozen=True)
class Case:
    """A loop that is measured.

    Parameters
    ----------
    name, title : str
    stop : float
        Seconds.
    steps : tuple of float
        Communication steps from coarse to fine, in seconds.
    loops : mapping of str to Loop
        By the ability of their FMUs, see `parts.ABILITIES`.
    exact : callable
        The recorded variables, shape (N, M), at increasing times, shape (N,).
    solved : callable
        What scipy's solvers make of the equations as one system.
    """

    name: str
    title: str
    stop: float
    steps: tuple[float, ...]
    loops: Mapping[str, Loop]
    exact: Callable[[Floats], Floats]
    solved: Callable[[], Iterator[Solved]]


def of_problem(found: Problem, folder: Path) -> Case:
    """A problem with the FMUs in a folder; chaos is cut where it can still be followed."""
    if found.chaotic:
        found = replace(found, stop=min(found.stop, PREDICTABLE))

    def loop(ability: str) -> Loop:
        system = found.system(folder, ability)
        return Loop(
            found.name,
            tuple(Component(c.name, str(c.fmu), dict(c.start)) for c in system.components),
            tuple((*c.source.split("."), *c.target.split(".")) for c in system.connections),
            tuple(tuple(name.split(".")) for name in found.record),
        )

    def solved() -> Iterator[Solved]:
        times = np.linspace(0.0, found.stop, 201)
        for solver in _SOLVERS:
            for tolerance in SOLVER_TOLERANCES:
                watch = Stopwatch()
                values = found.solution.solved(
                    found, times, method=solver, rtol=tolerance, atol=1e-3 * tolerance
                )
                yield solver, tolerance, watch.seconds(), times, values

    loops = {ability: loop(ability) for ability in dict.fromkeys(m.ability for m in METHODS)}
    return Case(found.name, found.title, found.stop, found.steps, loops, found.exact, solved)


def of_figure(name: str, stop: float = FIGURE_STOP) -> Case:
    """A figure of the paper, with its native FMUs; without FMUs, with the equations inside them."""
    found = figure(name)
    loop = native(found).loop

    def solved() -> Iterator[Solved]:
        with Worker("monolithic", found.loop) as worker:
            for solver in _SOLVERS:
                for tolerance in SOLVER_TOLERANCES:
                    how = {"method": solver, "rtol": tolerance, "stop_time": stop}
                    seconds, rows = worker.trajectory(**how)
                    yield solver, tolerance, seconds, rows[:, 0], rows[:, 1:]

    # A program that holds inputs makes no use of what else these FMUs can do.
    loops = {"full": loop, "held": loop}
    exact = Exact(found, stop).values
    return Case(name, FIGURES[name], stop, FIGURE_STEPS, loops, exact, solved)


def shown(folder: Path) -> Iterator[Case]:
    """The cases of the diagrams."""
    for name in SHOWN:
        yield of_problem(problem(name), folder)
    for name in FIGURES:
        yield of_figure(name)


def measure(case: Case, methods: Sequence[Method] = METHODS) -> tuple[list[Point], list[str]]:
    """All methods on a case that its FMUs allow; and what did not run, and why."""
    points, failures = [], []
    for method in methods:
        loop = case.loops.get(method.ability)
        if loop is None:
            continue
        try:
            with Worker(method.engine, loop) as worker:
                for settings, length in _settings(case, method):
                    try:
                        points.append(_point(case, method.label, worker, settings, length))
                    except EngineError as error:
                        failures.append(f"{case.title}, {length:g}: {error}")
        except EngineError as error:
            failures.append(f"{case.title}: {error}")
    for solver, tolerance, seconds, times, values in case.solved():
        error = _error(values, case.exact(times))
        points.append(Point(case.title, f"{MONOLITHIC}, {solver}", tolerance, seconds, error))
    return points, failures


def _settings(case: Case, method: Method) -> Iterator[tuple[dict[str, float | str], float]]:
    """Arguments of a program's `run`, and the step or tolerance."""
    if method.tolerances:
        for tolerance in method.tolerances:
            settings: dict[str, float | str] = {"tolerance": tolerance, "stop_time": case.stop}
            yield settings | ({"coupling": method.coupling} if method.coupling else {}), tolerance
        return
    for step in case.steps:
        if method.coupling:
            yield {"coupling": method.coupling, "step": step, "stop_time": case.stop}, step
        else:
            yield {"steps": round(case.stop / step), "step": step}, step


def _point(
    case: Case, label: str, worker: Worker, settings: dict[str, float | str], length: float
) -> Point:
    first, rows = worker.trajectory(**settings)
    rows = rows[rows[:, 0] <= case.stop * (1.0 + 1e-9)]
    rows = rows[:: max(1, len(rows) // LOOKED_AT)]
    error = _error(rows[:, 1:], case.exact(np.minimum(rows[:, 0], case.stop)))
    # What is long is not disturbed by what is short.
    seconds = first if first > LONG else min(first, worker.seconds(**settings))
    return Point(case.title, label, length, seconds, error)


def _error(values: Floats, exact: Floats) -> float:
    """The largest error of any variable over its peak, shapes (N, M); infinite where one is nan."""
    error = float((np.abs(values - exact).max(axis=0) / np.abs(exact).max(axis=0)).max())
    return error if math.isfinite(error) else math.inf


def draw(points: list[Point], file: Path) -> None:
    """Error against processor time, one panel per problem."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

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
        axis.set(xscale="log", yscale="log", ylim=(LEAST, MOST), title=name)
        axis.xaxis.set_minor_formatter(NullFormatter())  # within a decade they would overlap
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
            lines.append(f"| {found} | {method} | {' | '.join(cells)} | {least:.1e} |")
    return lines
