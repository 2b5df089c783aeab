"""How well error bars cover: every problem, coupling and step against the solution.

A pair is one recorded variable of one run. Its true error is the largest distance from the
solution over the rows, relative to the largest of the solution, and so is its bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.coupling.problems import Problem
from congelation.cosim import Result, simulate
from congelation.cosim.trust import FLOOR

__all__ = ["FIXED", "TOLERANT", "Pair", "Setting", "measure", "settings"]

Floats = npt.NDArray[np.float64]

FIXED = (
    ("held", "jacobi"),
    ("held", "gauss_seidel"),
    ("held", "derivative"),
    ("full", "derivative"),
    ("state", "hermite"),
    ("full", "hermite"),
)
"""Abilities of the FMUs and coupling, with fixed steps."""

TOLERANT = (
    ("state", "derivative"),
    ("full", "derivative"),
    ("state", "hermite"),
    ("full", "hermite"),
)
"""The same with steps chosen by a tolerance."""

TOLERANCES = (1e-3, 1e-4, 1e-5)

MOST_STEPS = 20_000
"""Of a run; more are not worth their while here."""

ROUNDING = 1e-9

ROWS = 0.95
"""Of the row times, the part that should be covered."""

LARGE, SMALL = 0.3, 0.1
"""True errors that should be flagged, and that should not."""


@dataclass(frozen=True)
class Setting:
    """How a problem is run; `length` is the step, or the tolerance where that is chosen."""

    problem: Problem
    ability: str
    coupling: str
    chosen: bool
    length: float

    def __str__(self) -> str:
        kind = "tolerance" if self.chosen else "step"
        return f"{self.problem.name}, {self.ability}, {self.coupling}, {kind} {self.length:g}"

    def run(self, folder: Path, **more: object) -> Result:
        """With the FMUs in a folder."""
        return simulate(
            self.problem.system(folder, self.ability),
            stop_time=self.problem.stop,
            coupling=self.coupling,
            record=self.problem.record,
            **({"tolerance": self.length} if self.chosen else {"step": self.length}),
            **more,  # type: ignore[arg-type]
        )


@dataclass(frozen=True)
class Pair:
    """A variable of a run.

    Parameters
    ----------
    setting : Setting
    variable : str
    error, bar : float
        True and told, relative.
    covered : float
        Share of the row times at which the solution lies in the band.
    verdict : str
    told, true : float
        When the band, and the error, first pass a tenth of the peak; infinity if they do not.
    runs : float
        What the bars cost, in macro steps of the run.
    """

    setting: Setting
    variable: str
    error: float
    bar: float
    covered: float
    verdict: str
    told: float
    true: float
    runs: float

    @property
    def ratio(self) -> float:
        """Bar over true error; nan where the error is within the floor of the bars."""
        return self.bar / self.error if self.error > 10.0 * FLOOR else math.nan


def settings(
    problems: Sequence[Problem], steps: slice = slice(None), tolerances: slice = slice(None)
) -> Iterator[Setting]:
    """All runs of some problems."""
    for problem in problems:
        for ability, coupling in FIXED:
            for step in problem.steps[steps]:
                yield Setting(problem, ability, coupling, False, step)
        for ability, coupling in TOLERANT:
            for tolerance in TOLERANCES[tolerances]:
                yield Setting(problem, ability, coupling, True, tolerance)


def measure(
    folder: Path, problem: Problem, settings: Sequence[Setting]
) -> tuple[list[Pair], list[str]]:
    """The pairs of some runs of a problem; and how those ended that have no bars."""
    results, ended = [], []
    for setting in settings:
        result = setting.run(folder, trust=True, max_steps=MOST_STEPS)
        if result.trust is not None and result.trust.bands is not None:
            results.append((setting, result))
        else:
            verdict = result.status.name if not result.completed else result.trust.verdict
            ended.append(f"{setting}: {verdict}")
    # One solution for all of them: it takes longer than a run.
    times = np.unique(np.concatenate([result.time for _, result in results]))
    exact = problem.exact(times)
    pairs = []
    for setting, result in results:
        pairs += _pairs(setting, result, exact[np.searchsorted(times, result.time)])
    return pairs, ended


def _pairs(setting: Setting, result: Result, exact: Floats) -> list[Pair]:
    """The pairs of a run, with the solution, shape (N, M), at its rows."""
    trust, record = result.trust, setting.problem.record
    errors = np.abs(result.values[:, : len(record)] - exact)
    peaks = np.abs(exact).max(axis=0)
    # Rounding is no error that a band has to hold.
    covered = (errors <= trust.bands + ROUNDING * peaks).mean(axis=0)
    pairs = []
    for k, variable in enumerate(record):
        passes = errors[:, k] > SMALL * peaks[k]
        since = trust.since[k]
        pairs.append(
            Pair(
                setting,
                variable,
                float(errors[:, k].max() / peaks[k]),
                float(trust.bands[:, k].max() / peaks[k]),
                float(covered[k]),
                trust.verdicts[k],
                math.inf if since is None else since,
                float(result.time[np.argmax(passes)]) if passes.any() else math.inf,
                trust.runs,
            )
        )
    return pairs
