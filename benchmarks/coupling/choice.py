"""How good the coupling is that ``auto`` chooses, against all others for as many steps of FMUs.

The price of a run is how often fmi2DoStep is called, the trial of ``auto`` and steps that were
taken back included. Another coupling at the same price is looked up between its runs with other
steps and tolerances, along lines in logarithms; where all of its runs cost more, there is none. A
fixed step is compared with fixed steps: who gives one does not want it chosen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.coupling.problems import Problem
from benchmarks.coupling.work import PREDICTABLE
from congelation.cosim import Coupling, Derivative, Result, simulate
from congelation.cosim.error_bars import MOST_LEVELS

__all__ = ["LIMIT", "Chosen", "measure", "table"]

LIMIT = 2.0
"""Errors of the best other coupling that ``auto`` may have."""

ROWS = 100
"""Of a run, about as many as are compared with the solution."""

INSTANTS = 20_000
"""At which a variable that switches is compared with the solution."""

MOST_STEPS = 20_000

CHOSEN = ", tolerance"
"""What is added to the name of a coupling whose steps a tolerance chooses."""

FIXED: Mapping[str, Coupling | str] = MappingProxyType(
    {
        "jacobi": "jacobi",
        "gauss_seidel": "gauss_seidel",
        "derivative": "derivative",
        "derivative, jacobi": Derivative("jacobi"),
    }
)
"""The couplings that any FMU takes at a fixed step."""

TRIED: Mapping[str, Sequence[Mapping[str, float]]] = MappingProxyType(
    {
        "fixed": ({"step": 0}, {"step": 1}, {"step": 2}),
        "held": ({"step": 0}, {"step": 2}, {"tolerance": 1e-2}, {"tolerance": 1e-3}),
        "state": ({"step": 0}, {"step": 2}, {"tolerance": 1e-2}, {"tolerance": 1e-3}),
        "full": ({"step": 0}, {"step": 2}, {"tolerance": 1e-2}, {"tolerance": 1e-4}),
    }
)
"""What ``auto`` is tried with, by abilities of FMUs; steps by their place in the problem."""

TOLERANCES: Mapping[str, Sequence[float]] = MappingProxyType(
    {"state": (1e-1, 1e-2, 1e-3), "full": (1e-1, 1e-2, 1e-3, 1e-4, 1e-5)}
)
"""Of the others that choose their steps, by the abilities of the FMUs."""


@dataclass(frozen=True)
class Run:
    """A run: which coupling, how often FMUs stepped, and the error over the peak."""

    coupling: str
    steps: int
    error: float


@dataclass(frozen=True)
class Chosen:
    """What ``auto`` made of a problem, and the best other coupling at its price.

    Parameters
    ----------
    problem : Problem
    ability, setting : str
    run : Run
    best : str
        The other coupling; empty where none is as cheap.
    error : float
        Its error; nan where there is none.
    """

    problem: Problem
    ability: str
    setting: str
    run: Run
    best: str
    error: float

    @property
    def ratio(self) -> float:
        """The error of ``auto`` over the best other one; nan where there is none."""
        return self.run.error / self.error if self.error > 0.0 else math.nan

    def __str__(self) -> str:
        """One line."""
        return (
            f"{self.problem.name}, {self.ability}, {self.setting}: {self.run.coupling}, "
            f"{self.run.steps} steps, error {self.run.error:.2g}; {self.best or 'no other'}: "
            f"{self.error:.2g}, ratio {self.ratio:.2f}"
        )


def measure(folder: Path, problem: Problem) -> list[Chosen]:
    """Every ability and setting of a problem; chaos is cut where it can still be followed."""
    if problem.chaotic:
        problem = replace(problem, stop=min(problem.stop, PREDICTABLE))
    wanted: list[tuple[str, str, Mapping[str, Any]]] = []
    for ability in TRIED:
        for setting in TRIED[ability]:
            wanted.append((ability, "auto", dict(_given(problem, setting))))
    # FMUs that hold their inputs do the same at a fixed step, whatever else they can.
    for ability in ("state", "full"):
        iterated = {"hermite": "hermite"}
        for name in (*FIXED, *iterated):
            for step in problem.steps:
                wanted.append((ability, name, {"step": step}))
        for tolerance in TOLERANCES[ability]:
            wanted.append((ability, f"hermite{CHOSEN}", {"tolerance": tolerance}))
            if ability == "state":
                wanted.append((ability, f"derivative{CHOSEN}", {"tolerance": tolerance}))
    results = [_run(folder, problem, *each) for each in wanted]
    runs = list(_compared(problem, results))
    others: dict[str, list[Run]] = {"state": [], "full": []}
    for (ability, name, _), run in zip(wanted, runs, strict=True):
        if name != "auto" and run is not None:
            others[ability].append(run)
    found = []
    for (ability, name, how), run in zip(wanted, runs, strict=True):
        if name != "auto":
            continue
        setting = ", ".join(f"{key} {value:g}" for key, value in how.items())
        run = run or Run("failed", 0, math.inf)
        able = others["full" if ability == "full" else "state"]
        if ability in ("fixed", "held"):
            able = [other for other in able if other.coupling in FIXED]
        if "step" in how:
            able = [other for other in able if not other.coupling.endswith(CHOSEN)]
        best, error = _best(able, run.steps)
        found.append(Chosen(problem, ability, setting, run, best, error))
    return found


def _given(problem: Problem, setting: Mapping[str, float]) -> Iterator[tuple[str, float]]:
    for key, value in setting.items():
        yield key, problem.steps[int(value)] if key == "step" else value


def _run(
    folder: Path, problem: Problem, ability: str, name: str, how: Mapping[str, Any]
) -> tuple[str, Result]:
    coupling = FIXED.get(name, name.removesuffix(CHOSEN))
    result = simulate(
        problem.system(folder, ability),
        stop_time=problem.stop,
        coupling=coupling,
        record=problem.record,
        max_steps=MOST_STEPS,
        **how,
    )
    return (result.coupling if name == "auto" else name), result


def _compared(problem: Problem, results: Sequence[tuple[str, Result]]) -> Iterator[Run | None]:
    """The runs with their errors; None for those that did not come to their end.

    The error of a variable is the largest over its peak. One that switches is wrong by its whole
    size whenever it switches late: its error is the share of the time in which it is wrong.
    """
    rows = [slice(None, None, max(1, len(result.time) // ROWS)) for _, result in results]
    whole = [r.time[part] for (_, r), part in zip(results, rows, strict=True) if r.completed]
    times = np.unique(np.concatenate(whole))
    exact = problem.exact(times)
    peaks = np.abs(exact).max(axis=0)
    switched = np.array([len(np.unique(column)) <= MOST_LEVELS for column in exact.T])
    instants = np.linspace(0.0, problem.stop, INSTANTS + 1)[:-1]
    levels = problem.exact(instants)[:, switched] if switched.any() else np.empty((INSTANTS, 0))
    for (name, result), part in zip(results, rows, strict=True):
        if not result.completed:
            yield None
            continue
        expected = exact[np.searchsorted(times, result.time[part])]
        errors = np.abs(result.values[part] - expected).max(axis=0) / peaks
        last = np.searchsorted(result.time, instants, "right") - 1
        errors[switched] = (result.values[last][:, switched] != levels).mean(axis=0)
        steps = result.statistics.iterations * len(problem.parts)
        yield Run(name, steps, float(errors.max()))


def _best(runs: Iterable[Run], steps: int) -> tuple[str, float]:
    """The coupling of the least error at so many steps, and that error."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run.coupling, []).append(run)
    best = ("", math.nan)
    for name, own in found.items():
        own.sort(key=lambda run: run.steps)
        if own[0].steps > steps:
            continue
        # Not beyond the last run: rounding ends what is gained there.
        error = math.exp(
            np.interp(
                math.log(steps),
                [math.log(run.steps) for run in own],
                [math.log(max(run.error, 1e-300)) for run in own],
            )
        )
        if not best[1] <= error:
            best = name, error
    return best


def table(found: Sequence[Chosen]) -> list[str]:
    """The worst ratio of each problem and ability, in Markdown; and what is above the limit."""
    lines = [
        "| problem | " + " | ".join(f"`{ability}`" for ability in TRIED) + " |",
        "|---|" + "---|" * len(TRIED),
    ]
    for title in dict.fromkeys(chosen.problem.title for chosen in found):
        cells = []
        for ability in TRIED:
            own = [c for c in found if (c.problem.title, c.ability) == (title, ability)]
            rated = [c.ratio for c in own if not math.isnan(c.ratio)]
            kinds = ", ".join(dict.fromkeys(c.run.coupling for c in own))
            cells.append(f"{max(rated):.2f} {kinds}" if rated else kinds)
        lines.append(f"| {title} | {' | '.join(cells)} |")
    rated = [chosen for chosen in found if not math.isnan(chosen.ratio)]
    above = [chosen for chosen in rated if chosen.ratio > LIMIT]
    lines += ["", f"{len(found)} runs, {len(above)} of them above {LIMIT:g} times the best other."]
    if above:
        lines += ["", *(f"- {chosen}" for chosen in above)]
    return lines
