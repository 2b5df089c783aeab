"""Time to accuracy: what it costs to come within an error of the exact solution.

The error of a run is the largest over its variables of max |error| / max |exact| over time, the
exact solution being that of `benchmarks.exact`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from benchmarks.cases import Figure, figure
from benchmarks.exact import Exact
from benchmarks.timing import Timing, interleaved
from benchmarks.workers import EngineError, Worker, workers

__all__ = ["MINUTE", "OURS", "SOLVERS", "TARGETS", "Accuracy", "Held", "Reached", "measure"]

Floats = npt.NDArray[np.float64]
Settings = Mapping[str, float | str]

TARGETS = (1e-3, 1e-6, 1e-8)
OURS = "hermite"
SOLVERS = ("DOP853", "LSODA")
MINUTE = 60.0
"""Held inputs that would take longer are extrapolated."""

REPEATED = 3
"""Timed runs of an engine with held inputs; the fastest counts."""

SLAVE_SHARES = (1.0, 0.1)
"""Tolerances of the FMUs that are tried, over that of the coupling."""


@dataclass(frozen=True)
class Reached:
    """The cheapest settings of a program that meet a target.

    Parameters
    ----------
    settings : mapping
    error : float
    time : Timing
    """

    settings: Settings
    error: float
    time: Timing


@dataclass(frozen=True)
class Held:
    """An engine with held inputs on the whole horizon.

    Parameters
    ----------
    steps : tuple of float
        Communication steps in seconds, decreasing.
    errors : tuple of float
        At these.
    seconds_per_step : float
    stop_time : float
    """

    steps: tuple[float, ...]
    errors: tuple[float, ...]
    seconds_per_step: float
    stop_time: float

    @property
    def order(self) -> float:
        """From the two smallest steps."""
        (h, k), (e, f) = self.steps[-2:], self.errors[-2:]
        return math.log(e / f) / math.log(h / k)

    def seconds(self, target: float) -> float:
        """To reach `target`, at the measured order."""
        step = self.steps[-1] * float((target / self.errors[-1]) ** (1.0 / self.order))
        return self.stop_time / step * self.seconds_per_step


@dataclass(frozen=True)
class Accuracy:
    """One figure.

    Parameters
    ----------
    title : str
    reached : mapping of (str, float) to Reached
        By the program (OURS or one of SOLVERS) and the target.
    held : mapping of str to Held
        By the engine's name.
    failures : tuple of str
        Engines that did not run, and why.
    """

    title: str
    reached: Mapping[tuple[str, float], Reached]
    held: Mapping[str, Held]
    failures: tuple[str, ...]


def measure(
    name: str,
    title: str,
    engines: Sequence[str],
    *,
    stop_time: float | None,
    finest: float,
    tolerances: Sequence[float],
    rounds: int,
) -> Accuracy:
    """Measure one figure.

    Parameters
    ----------
    name, title : str
        Of the scenario, and in the tables.
    engines : sequence of str
        With held inputs, by their names in ENGINES.
    stop_time : float or None
        Seconds; None: the scenario's own.
    finest : float
        Smallest communication step of the engines with held inputs, in seconds; four and two times
        that are run too.
    tolerances : sequence of float
        That are tried where steps are chosen.
    rounds : int
        Of the final timing.
    """
    found = figure(name)
    stop = found.stop_time if stop_time is None else stop_time
    exact = Exact(found, stop)
    reached = _reached(found, exact, stop, tolerances, rounds)
    held, failures = _held(found, exact, stop, engines, finest)
    return Accuracy(title, reached, held, tuple(failures))


def error_of(rows: Floats, exact: Floats) -> float:
    """The largest relative error; rows of shape (N, 1 + M), exact of shape (N, M)."""
    error = np.abs(rows[:, 1:] - exact).max(axis=0)
    return float((error / np.abs(exact).max(axis=0)).max())


def _reached(
    found: Figure, exact: Exact, stop: float, tolerances: Sequence[float], rounds: int
) -> dict[tuple[str, float], Reached]:
    """Find the cheapest settings by one run each, then time those, interleaved."""
    candidates: dict[str, list[Settings]] = {
        OURS: [
            {
                "coupling": "hermite",
                "tolerance": t,
                "slave_tolerance": t * share,
                "stop_time": stop,
            }
            for t in tolerances
            for share in SLAVE_SHARES
        ]
    }
    for solver in SOLVERS:
        candidates[solver] = [{"method": solver, "rtol": t, "stop_time": stop} for t in tolerances]
    loops = {OURS: ("master", found.loop)}
    loops |= dict.fromkeys(SOLVERS, ("monolithic", found.loop))
    with workers(loops) as (running, failures):
        if failures:
            raise EngineError("; ".join(failures))
        chosen: dict[tuple[str, float], tuple[Settings, float]] = {}
        for program, worker in running.items():
            tried = [_tried(worker, exact, settings) for settings in candidates[program]]
            for target in TARGETS:
                good = [t for t in tried if t[1] <= target]
                if good:
                    settings, error, _ = min(good, key=lambda t: t[2])
                    chosen[program, target] = settings, error
        timed = interleaved(
            {
                key: partial(running[key[0]].seconds, **settings)
                for key, (settings, _) in chosen.items()
            },
            rounds,
        )
    return {key: Reached(*chosen[key], timed[key]) for key in chosen}


def _tried(worker: Worker, exact: Exact, settings: Settings) -> tuple[Settings, float, float]:
    """(settings, error, seconds) of the faster of two runs; infinite where they fail."""
    try:
        seconds, rows = worker.trajectory(**settings)
    except EngineError:
        return settings, math.inf, math.inf
    return (
        settings,
        error_of(rows, exact.values(rows[:, 0])),
        min(seconds, worker.seconds(**settings)),
    )


def _held(
    found: Figure, exact: Exact, stop: float, engines: Sequence[str], finest: float
) -> tuple[dict[str, Held], list[str]]:
    steps = (4.0 * finest, 2.0 * finest, finest)
    count = round(stop / finest)
    solution = exact.values(finest * np.arange(1.0, count + 1.0))
    held: dict[str, Held] = {}
    failures: list[str] = []
    for engine in engines:
        try:
            with Worker(engine, found.loop) as worker:
                held[engine] = _one_held(worker, steps, stop, solution)
        except EngineError as error:
            failures.append(str(error))
    return held, failures


def _one_held(worker: Worker, steps: tuple[float, ...], stop: float, exact: Floats) -> Held:
    errors = []
    for step in steps:
        count = round(stop / step)
        _, rows = worker.trajectory(steps=count, step=step)
        every = len(exact) // count
        # Without the first row, in which u is zero where an engine starts from zero inputs.
        errors.append(error_of(rows[1:], exact[2 * every - 1 :: every]))
    count = round(stop / steps[0])
    seconds = min(worker.seconds(steps=count, step=steps[0]) for _ in range(REPEATED))
    return Held(steps, tuple(errors), seconds / count, stop)
