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
from congelation.cosim.bands import FLOOR
from congelation.cosim.error_bars import MOST_LEVELS, NOT_RESOLVED

__all__ = ["FIXED", "TOLERANT", "Pair", "Setting", "goals", "measure", "per_problem", "settings"]

Floats = npt.NDArray[np.float64]

FIXED = (
    ("held", "jacobi", (0, 2)),
    ("held", "gauss_seidel", (1,)),
    ("held", "derivative", (1,)),
    ("full", "derivative", (0,)),
    ("state", "hermite", (0,)),
    ("full", "hermite", (0, 2)),
)
"""Abilities of FMUs and coupling, with the fixed steps: places among those of a problem."""

TOLERANT = (
    ("full", "derivative", (1e-3,)),
    ("state", "hermite", (1e-2,)),
    ("full", "hermite", (1e-4,)),
)
"""The same with steps chosen by tolerances."""

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
        """One line."""
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


WIDE = 2.5
"""Bars above so many errors are wider than they should be."""


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
    switched : bool
        Whether it jumps between a few values: then `error` and `bar` are the shares of the rows in
        which it is wrong, and in which its band says that it may be.
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
    switched: bool = False

    def __str__(self) -> str:
        """One line."""
        return (
            f"{self.setting}, {self.variable}: error {self.error:.3g}, bar {self.bar:.3g}, "
            f"{100.0 * self.covered:.1f} % of rows, {self.verdict}, told at {self.told:.4g} s, "
            f"true {self.true:.4g} s"
        )

    @property
    def is_good(self) -> bool:
        """Whether the bar is what it should be."""
        covers = self.bar >= self.error or self.error <= FLOOR
        return covers and self.covered >= ROWS and not self.ratio > WIDE

    @property
    def ratio(self) -> float:
        """Bar over true error; nan where the error is within the floor of the bars, or is none."""
        if self.switched or self.error <= 10.0 * FLOOR:
            return math.nan
        return self.bar / self.error


def settings(problem: Problem) -> Iterator[Setting]:
    """All runs of a problem."""
    for ability, coupling, places in FIXED:
        for place in places:
            yield Setting(problem, ability, coupling, False, problem.steps[place])
    for ability, coupling, tolerances in TOLERANT:
        for tolerance in tolerances:
            yield Setting(problem, ability, coupling, True, tolerance)


def measure(folder: Path, problem: Problem) -> tuple[list[Pair], list[str]]:
    """The pairs of all runs of a problem; and how those ended that have no bars."""
    results, ended = [], []
    for setting in settings(problem):
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
        if len(np.unique(exact[:, k])) <= MOST_LEVELS:
            wrong, seen = errors[:, k] > 0.0, trust.bands[:, k] > 0.0
            pairs.append(
                Pair(
                    setting,
                    variable,
                    float(wrong.mean()),
                    float(seen.mean()),
                    float((seen | ~wrong).mean()),
                    trust.verdicts[k],
                    math.inf,
                    math.inf,
                    trust.runs,
                    switched=True,
                )
            )
            continue
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


def goals(pairs: Sequence[Pair]) -> list[str]:
    """What was asked for, and what was measured, as a table in Markdown."""
    ratios = [pair.ratio for pair in pairs if not math.isnan(pair.ratio)]
    large = [pair for pair in pairs if pair.error > LARGE and not pair.switched]
    small = [pair for pair in pairs if pair.error < SMALL]
    runs = {str(pair.setting): pair.runs for pair in pairs}
    chaos = [pair for pair in pairs if pair.setting.problem.chaotic and pair.true < math.inf]
    told = [pair for pair in chaos if pair.told <= pair.true]
    flagged = [pair for pair in large if pair.verdict == NOT_RESOLVED]
    alarms = [pair for pair in small if pair.verdict == NOT_RESOLVED]
    # The largest error is covered, or is rounding.
    covered = [pair for pair in pairs if pair.bar >= pair.error or pair.error <= FLOOR]
    rows = [pair for pair in pairs if pair.covered >= ROWS]
    lines = [
        "| what | goal | measured |",
        "|---|---|---|",
        f"| pairs whose largest error is covered | 99 % | {_share(covered, pairs)} |",
        f"| pairs with 95 % of the row times covered | 98 % | {_share(rows, pairs)} |",
        f"| bar over true error, median | 1.7 | {np.median(ratios):.2f} |",
        f"| the same, 95 % of the pairs below | 2.5 | {np.percentile(ratios, 95):.2f} |",
        f"| errors above 30 % of the peak, flagged | all | {len(flagged)} of {len(large)} |",
        f"| false alarms, of errors below 10 % | 1 % | {_share(alarms, small)} |",
        f"| chaos: told no later than true | all | {len(told)} of {len(chaos)} |",
        f"| macro steps, in runs, at most | 3.05 | {max(runs.values()):.2f} |",
    ]
    return [f"{len(runs)} runs, {len(pairs)} pairs.", "", *lines]


def per_problem(pairs: Sequence[Pair]) -> list[str]:
    """The same by problem, as a table in Markdown."""
    lines = [
        "| problem | pairs | maximum covered | 95 % of rows covered | bar / error: median | 95 % |",
        "|---|---|---|---|---|---|",
    ]
    for title in dict.fromkeys(pair.setting.problem.title for pair in pairs):
        own = [pair for pair in pairs if pair.setting.problem.title == title]
        ratios = [pair.ratio for pair in own if not math.isnan(pair.ratio)] or [math.nan]
        covered = [pair for pair in own if pair.bar >= pair.error or pair.error <= FLOOR]
        rows = [pair for pair in own if pair.covered >= ROWS]
        new = "" if own[0].setting.problem.known else " (new)"
        lines.append(
            f"| {title}{new} | {len(own)} | {_share(covered, own)} | {_share(rows, own)} "
            f"| {np.median(ratios):.2f} | {np.percentile(ratios, 95):.2f} |"
        )
    return lines


def _share(some: Sequence[Pair], every: Sequence[Pair]) -> str:
    return f"{100.0 * len(some) / len(every):.1f} %" if every else "none"
