"""Sweeps: on two workers, outside the stepping loops, ten thousand of them, and by FMPy alone.

Every sweep is a process of its own with those that it starts, and counts whole.
"""

from __future__ import annotations

import tempfile
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from benchmarks.phases import PHASES, STEPPING
from benchmarks.sweep_job import FRESH, RESULTS, Cost, Job, elsewhere, measured
from benchmarks.timing import Timing

__all__ = ["CHEAP", "Fresh", "Many", "Overhead", "Scaling", "fresh", "many", "overhead", "scaling"]

Key = TypeVar("Key", bound=Hashable)

HELD_STEP = 1e-4
"""Communication step with held inputs, in seconds."""
CHEAP: Mapping[str, float | str | None] = {"coupling": "hermite", "tolerance": 1e-6, "step": None}
"""Of a run that takes about a tenth of a second."""


@dataclass(frozen=True)
class Scaling:
    """The same sweep on one worker and on two, by round.

    Parameters
    ----------
    runs : int
    one, two : tuple of Cost
    """

    runs: int
    one: tuple[Cost, ...]
    two: tuple[Cost, ...]

    def elapsed(self, workers: int) -> Timing:
        """By the clock."""
        return Timing(tuple(cost.elapsed for cost in self.costs(workers)))

    def path(self, workers: int) -> Timing:
        """Processor time of the parent and of one worker: what the clock would show, at most, on a
        machine with nothing else to do."""
        return Timing(
            tuple(
                cost.answer["parent"] + (cost.used - cost.answer["parent"]) / workers
                for cost in self.costs(workers)
            )
        )

    def costs(self, workers: int) -> tuple[Cost, ...]:
        """Of the sweep on one worker or on two."""
        return self.one if workers == 1 else self.two


@dataclass(frozen=True)
class Overhead:
    """Where the time of a sweep on one worker went.

    Parameters
    ----------
    title : str
    cost : Cost
    per_run : mapping of str to Timing
        Seconds of each run by phase, the stepping loop among them.
    once : mapping of str to float
        Seconds of what is done once per sweep.
    """

    title: str
    cost: Cost
    per_run: Mapping[str, Timing]
    once: Mapping[str, float]

    @property
    def runs(self) -> int:
        """Their number."""
        return len(self.per_run[STEPPING].values)

    @property
    def share(self) -> float:
        """Of the elapsed time of the sweep, the part outside the stepping loops."""
        return 1.0 - sum(self.per_run[STEPPING].values) / self.cost.elapsed


@dataclass(frozen=True)
class Many:
    """A sweep of many short runs.

    Parameters
    ----------
    cost : Cost
    readers : mapping of str to Cost
        What it takes to read the results, by command.
    """

    cost: Cost
    readers: Mapping[str, Cost]


@dataclass(frozen=True)
class Fresh:
    """The same held-input runs by fresh FMPy instances and by a sweep.

    Parameters
    ----------
    steps, runs : int
        Macro steps of a run, and runs.
    times : mapping of str to Timing
        Seconds of all runs together: FRESH, "1 worker", "2 workers".
    """

    steps: int
    runs: int
    times: Mapping[str, Timing]


def scaling(points: int, stop_time: float, rounds: int) -> Scaling:
    """Two workers against one, in turns.

    Parameters
    ----------
    points : int
        Each is run with both controllers.
    stop_time : float
        Seconds.
    rounds : int
    """
    experiment = {**CHEAP, "stop_time": stop_time}
    jobs = {count: Job(points, experiment, workers=count) for count in (1, 2)}
    costs = _in_turns(jobs, rounds)
    return Scaling(jobs[1].runs, costs[1], costs[2])


def overhead(title: str, points: int, experiment: Mapping[str, float | str | None]) -> Overhead:
    """Where the time of a sweep on one worker goes."""
    with tempfile.TemporaryDirectory() as folder:
        cost = _whole(elsewhere(Job(points, experiment, phases=True), Path(folder)))
    answer = cost.answer
    labels = dict.fromkeys(label for _, _, label in PHASES)
    per_run = {
        label: Timing(tuple(run.get(label, 0.0) for run in answer["phases"])) for label in labels
    }
    in_runs = sum(sum(timing.values) for timing in per_run.values())
    once = {
        "starting and ending Python, imports": cost.elapsed - answer["planning"] - answer["sweep"],
        "planning the sweep": answer["planning"],
        "starting the worker, handing out runs": answer["sweep"] - answer["index"] - in_runs,
        "writing runs.parquet": answer["index"],
    }
    return Overhead(title, cost, per_run, once)


def many(points: int, stop_time: float, marks: tuple[int, ...]) -> Many:
    """Many short runs, metrics only, on two workers; then what reading them takes."""
    job = Job(points, {"stop_time": stop_time}, workers=2, marks=marks)
    with tempfile.TemporaryDirectory() as folder:
        cost = _whole(elsewhere(job, Path(folder)))
        results = str(Path(folder) / RESULTS)
        readers = {
            "congelation ls": measured("congelation", "ls", results),
            "congelation report --by variant": measured(
                "congelation", "report", results, "--by", "variant"
            ),
        }
    return Many(cost, readers)


def fresh(steps: int, points: int, rounds: int) -> Fresh:
    """Held inputs: a loop of fresh FMPy instances, a sweep on one worker and on two, in turns."""
    experiment = {
        "coupling": "jacobi",
        "step": HELD_STEP,
        "tolerance": None,
        "stop_time": steps * HELD_STEP,
    }
    jobs = {
        FRESH: Job(points, experiment, program=FRESH),
        "1 worker": Job(points, experiment),
        "2 workers": Job(points, experiment, workers=2),
    }
    costs = _in_turns(jobs, rounds)
    times = {name: Timing(tuple(cost.seconds for cost in found)) for name, found in costs.items()}
    return Fresh(steps, jobs[FRESH].runs, times)


def _in_turns(jobs: Mapping[Key, Job], rounds: int) -> dict[Key, tuple[Cost, ...]]:
    """Every job once a round; each is a fresh process, so none has to be warmed up."""
    found: dict[Key, list[Cost]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            with tempfile.TemporaryDirectory() as folder:
                found[name].append(_whole(elsewhere(job, Path(folder))))
    return {name: tuple(costs) for name, costs in found.items()}


def _whole(cost: Cost) -> Cost:
    """The cost of a sweep all of whose runs reached their stop time."""
    failed = cost.answer.get("failed", 0)
    if failed:
        raise RuntimeError(f"{failed} of {cost.answer['runs']} runs of a sweep failed")
    return cost
